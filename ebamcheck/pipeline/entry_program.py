"""A program of a run that begins at a layer, beside the whole one: written, read back and compared with it."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ebamcheck.errors import InputError, SettingsError
from ebamcheck.json_values import sha256_of_file
from ebamcheck.numeric.rings import Floats
from ebamcheck.program import Check, read_program
from ebamcheck.program.checking.checks import check_record
from ebamcheck.program.checking.entry_check import NAME, entry_check
from ebamcheck.program.checking.marked import marked_validated
from ebamcheck.program.language.files import ProgramFiles
from ebamcheck.program.reading.motions import NCProgram
from ebamcheck.program.writing.entry import begin_at_layer
from ebamcheck.settings.config import Config

FOLDER = "entry"
"""Folder of the program within a run."""


@dataclass(frozen=True)
class Entry:
    """A program that begins at a layer, as it was written, and what its check says of it."""

    layer: int
    files: ProgramFiles
    check: Check

    def marked_validated(self) -> Entry:
        """The same program with the status of a validated one."""
        return replace(self, files=marked_validated(self.files))

    def record(self) -> dict[str, Any]:
        """What the run's record holds of it."""
        files = self.files
        return {
            "layer": self.layer,
            "validated": files.validated,
            "files": [{"name": name, "sha256": files.sha256[name]} for name in files.names],
            "check": check_record(self.check),
        }


def write_entry(files: ProgramFiles, layer: int, z_of: Floats, config: Config) -> Entry:
    """Write the program that begins at `layer`, beside the whole one that is not yet marked, and check it.

    Raises
    ------
    SettingsError
        If the program has no such layer.
    """
    folder = files.folder.parent / FOLDER
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(files.folder, folder)
    begun = begin_at_layer(replace(files, folder=folder), layer)
    check = _checked(read_program(files.main, config), begun.main, layer, z_of, config, files.validated)
    return Entry(layer, begun, check)


def checked_again(
    run: Path, record: Mapping[str, Any], whole: Path, z_of: Floats, config: Config
) -> list[Check]:
    """Check the entry program of a run again; nothing for a run without one.

    Its status is that of the whole program: either is called validated only with the other.
    """
    entry = record.get(FOLDER)
    if entry is None:
        return []
    folder, validated = run / FOLDER, bool(record["validated"])
    names = [str(file["name"]) for file in entry["files"]]
    try:
        nc = read_program(whole, config)
        check = _checked(nc, folder / names[0], int(entry["layer"]), z_of, config, validated)
    except InputError as error:
        check = Check(NAME, False, 1.0, 0.0, "faults", FOLDER, str(error))
    if bool(entry["validated"]) != validated:
        text = f"is recorded as {_status(not validated)}, the whole program is {_status(validated)}"
        check = replace(check, passed=False, where=f"{names[0]}:1", text=text)
    for file in entry["files"]:
        if not (folder / file["name"]).is_file() or sha256_of_file(folder / file["name"]) != file["sha256"]:
            check = replace(
                check, passed=False, where=f"{file['name']}:1", text="its bytes are not those recorded"
            )
    return [check]


def _status(validated: bool) -> str:
    return "validated" if validated else "not validated"


def _checked(
    whole: NCProgram, main: Path, layer: int, z_of: Floats, config: Config, validated: bool
) -> Check:
    if not 1 <= layer <= len(z_of):
        raise SettingsError(f"--from-layer {layer}: the part has layers 1 to {len(z_of)}")
    entry = read_program(main, config)
    return entry_check(whole, entry, layer, float(z_of[layer - 1]), config, validated)

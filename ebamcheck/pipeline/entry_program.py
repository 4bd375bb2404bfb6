"""A program of a run that begins at a layer, beside the whole one: written, read back and compared with it."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from ebamcheck.errors import InputError, SettingsError
from ebamcheck.numeric.rings import Floats
from ebamcheck.program import Check, mark_validated, read_program
from ebamcheck.program.checking.entry_check import NAME, entry_check
from ebamcheck.program.language.files import ProgramFiles
from ebamcheck.program.reading.motions import NCProgram
from ebamcheck.program.writing.entry import begin_at_layer
from ebamcheck.settings.config import Config

FOLDER = "entry"
"""Folder of the program within a run."""


def write_entry(files: ProgramFiles, layer: int, z_of: Floats, config: Config) -> dict[str, Any]:
    """Write the program that begins at `layer`, beside the whole one, and check it; its record.

    It says validated where the whole program does and the check passes.

    Raises
    ------
    SettingsError
        If the program has no such layer.
    """
    folder = files.folder.parent / FOLDER
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(files.folder, folder)
    begun = begin_at_layer(replace(files, folder=folder), layer)
    check = _checked(read_program(files.main, config), begun.main, layer, z_of, config)
    if begun.validated and not check.passed:
        begun = mark_validated(begun, validated=False)
    return {
        "layer": layer,
        "validated": begun.validated,
        "files": [{"name": name, "sha256": begun.sha256[name]} for name in begun.names],
        "check": asdict(check),
    }


def checked_again(
    run: Path, record: Mapping[str, Any], whole: Path, z_of: Floats, config: Config
) -> list[Check]:
    """Check the entry program of a run again; nothing for a run without one."""
    entry = record.get(FOLDER)
    if entry is None:
        return []
    main = run / FOLDER / entry["files"][0]["name"]
    try:
        check = _checked(read_program(whole, config), main, int(entry["layer"]), z_of, config)
    except InputError as error:
        check = Check(NAME, False, 1.0, 0.0, "faults", FOLDER, str(error))
    said, may = bool(entry["validated"]), bool(record["validated"]) and check.passed
    if check.passed and said and not may:
        text = "says validated, the whole program does not"
        check = replace(check, passed=False, where=f"{main.name}:1", text=text)
    return [check]


def _checked(whole: NCProgram, main: Path, layer: int, z_of: Floats, config: Config) -> Check:
    if not 1 <= layer <= len(z_of):
        raise SettingsError(f"--from-layer {layer}: the part has layers 1 to {len(z_of)}")
    return entry_check(whole, read_program(main, config), layer, float(z_of[layer - 1]), config)

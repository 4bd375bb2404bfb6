"""Programs of a run beside the whole one: one that begins at a layer, read back as the end of a whole program, and a main program
that waits."""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, replace
from os.path import realpath
from pathlib import Path
from typing import Any

import numpy as np

from ebamcheck.checks.checks import PLACE_MM
from ebamcheck.checks.text_checks import entry_check, marked_validated
from ebamcheck.errors import EbamcheckError, InputError, SettingsError
from ebamcheck.json_values import sha256_of_file
from ebamcheck.kernels import Floats
from ebamcheck.nc.control import control
from ebamcheck.nc.files import NOT_VALIDATED, VALIDATED, ProgramFiles
from ebamcheck.nc.motions import NCProgram
from ebamcheck.program import read_program
from ebamcheck.record.run_folder import MANIFEST, RunFolder, own_file
from ebamcheck.result import Check, check_record
from ebamcheck.settings.config import Config, validated
from ebamcheck.writing.posts import begin_at_layer

ENTRY = "entry"  # folder of the program within a run


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
        files = [{"name": name, "sha256": self.files.sha256[name]} for name in self.files.names]
        said = {"layer": self.layer, "validated": self.files.validated}
        return {**said, "files": files, "check": check_record(self.check)}


def write_entry(files: ProgramFiles, layer: int, z_of: Floats, config: Config) -> Entry:
    """Write the program that begins at `layer`, beside the whole one that is not yet marked, and check it."""
    folder = files.folder.parent / ENTRY
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(files.folder, folder)
    begun = begin_at_layer(replace(files, folder=folder), layer)
    check = _checked(read_program(files.main, config), begun.main, layer, z_of, config, files.validated)
    return Entry(layer, begun, check)


def checked_again(run: Path, record: Mapping[str, Any], whole: Path, z_of: Floats, config: Config) -> list[Check]:
    """Check the entry program of a run again, whose status is that of the whole program; nothing for a run without one."""
    entry = record.get(ENTRY)
    if entry is None:
        return []
    folder, validated = run / ENTRY, bool(record["validated"])
    names = [str(file["name"]) for file in entry["files"]]
    try:
        nc = read_program(whole, config)
        check = _checked(nc, folder / names[0], int(entry["layer"]), z_of, config, validated)
    except InputError as error:
        check = Check.fault("entry", ENTRY, str(error))
    if bool(entry["validated"]) != validated:
        text = f"is recorded as {_status(not validated)}, the whole program is {_status(validated)}"
        check = replace(check, passed=False, where=f"{names[0]}:1", text=text)
    for file in entry["files"]:
        if not (folder / file["name"]).is_file() or sha256_of_file(folder / file["name"]) != file["sha256"]:
            text = "its bytes are not those recorded"
            check = replace(check, passed=False, where=f"{file['name']}:1", text=text)
    return [check]


def _status(validated: bool) -> str:
    return "validated" if validated else "not validated"


def _checked(whole: NCProgram, main: Path, layer: int, z_of: Floats, config: Config, validated: bool) -> Check:
    if not 1 <= layer <= len(z_of):
        raise SettingsError(f"--from-layer {layer}: the part has layers 1 to {len(z_of)}")
    entry = read_program(main, config)
    return entry_check(whole, entry, layer, float(z_of[layer - 1]), config, validated)


def entry_of_whole(program: Path, whole: Path, config: Config) -> Check:
    """Check a program against the whole one, a program or a run folder: it begins where its text lays its first metal, whatever its
    comments say."""
    said_validated = False
    if own_file(whole / MANIFEST):
        run = RunFolder(whole)
        record = run.manifest().get("program")
        if record is None:
            raise SettingsError(f"{whole}: this run wrote no program")
        config = validated(run.manifest()["settings"], f"{whole / MANIFEST}: settings")
        whole = run.program_folder / record["files"][0]["name"]
        inside = Path(realpath(program)).is_relative_to(realpath(run.path / ENTRY))
        said_validated = inside and bool(record["validated"])
    complete, entry = read_program(whole, config), read_program(program, config)
    tops = np.unique(np.round(complete.end[complete.deposit, 2], 3))
    z_mm = _first_mm(entry)
    if not tops.size or not np.isfinite(z_mm):
        return Check.fault("entry", program.name, "one of the two programs lays no metal")
    layer = int(np.abs(tops - z_mm).argmin())
    return entry_check(complete, entry, layer + 1, float(tops[layer]), config, said_validated)


def begins_later(program: Path, z_of: Floats, config: Config) -> list[Check]:
    """A failed check where a program lays its first metal over the first layer of the part, whose Z are `z_of` (L,) mm; else
    none."""
    try:
        nc = read_program(program, config)
    except EbamcheckError:  # A check of its own tells that.
        return []
    z_mm = _first_mm(nc)
    if not len(z_of) or not z_mm > z_of[0] + PLACE_MM:
        return []
    layer = int(np.abs(z_of - z_mm).argmin()) + 1
    text = (
        f"the program begins at Z {z_mm:.3f}, layer {layer} of {len(z_of)}, and so does not make the whole part: one that goes on "
        "after a break is verified against the whole program, --whole RUN or --whole PROGRAM"
    )
    return [Check("entry", False, float(layer), 1.0, "layer", nc.where(_first(nc)), text)]


def _first(nc: NCProgram) -> int:
    """Motion with which a program begins to lay metal; -1 where it lays none."""
    laid = np.flatnonzero(nc.deposit)
    return int(laid[0]) if laid.size else -1


def _first_mm(nc: NCProgram) -> float:
    first = _first(nc)
    return float(nc.end[first, 2]) if first >= 0 else np.nan


# -- the main program that waits -------------------------------------------------------------------

LIVE = "live"  # folder of the program within a run
NAME = "handshake"


def check_waits(config: Config) -> None:
    """Refuse a control for which no main program that waits is written."""
    name = config.machine.control
    if not control(name).waiting:
        raise SettingsError(f"--live: for machine.control {name!r} there is no main program that waits between layers")


def write_live(run: Path, config: Config, top_mm: float, validated: bool, header: Mapping[str, str]) -> dict[str, Any]:
    """Write the waiting main program into a run folder and judge its text; it says validated where the whole program does and the
    check passes."""
    own = control(config.machine.control)
    name, text = own.load("waiting")(config, top_mm, header)
    check: Check = own.load("handshake")(text, name, config, top_mm)
    validated = validated and check.passed
    if validated:
        text = text.replace(NOT_VALIDATED, VALIDATED, 1)
    (run / LIVE).mkdir(exist_ok=True)
    (run / LIVE / name).write_text(text, encoding="ascii", newline="\n")
    sha256 = hashlib.sha256(text.encode("ascii")).hexdigest()
    return {"name": name, "sha256": sha256, "validated": validated, "check": check_record(check)}


def live_checked_again(run: Path, record: Mapping[str, Any], config: Config, top_mm: float) -> list[Check]:
    """Judge the waiting main program of a run again, of a part whose top is to lie at a Z; nothing for a run without one."""
    live = record.get(LIVE)
    if live is None:
        return []
    path = run / LIVE / str(live["name"])
    try:
        text = path.read_bytes().decode("ascii")
    except (OSError, UnicodeDecodeError) as error:
        return [Check.fault(NAME, f"{LIVE}/{live['name']}", f"cannot be read: {error}")]
    check: Check = control(config.machine.control).load("handshake")(text, path.name, config, top_mm)
    said = f"\n{VALIDATED}\n" in text
    if check.passed and said and not record["validated"]:
        text = "says validated, the whole program does not"
        check = Check.fault(NAME, f"{path.name}:1", text)
    return [check]

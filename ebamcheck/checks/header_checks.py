"""Checks that what a program says of itself is true: its status, part, layers, machine, control and place."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ebamcheck.checks.checks import PRINTED, Faults, count_check, limit_check, place_of
from ebamcheck.nc.control import control
from ebamcheck.nc.conventions import comment, header_lines
from ebamcheck.nc.files import NOT_VALIDATED, STATUS_LINES, VALIDATED, ProgramFiles, mark_validated, status_of
from ebamcheck.nc.inputs import deposition_heights
from ebamcheck.nc.motions import NCProgram, SourceFile
from ebamcheck.nc.timeline import Kind
from ebamcheck.result import Check
from ebamcheck.settings.config import Config
from ebamcheck.settings.machine import MachineSettings

# Lines of the header that do not follow from the settings and the program's own text.
FREE = ("SOFTWARE", "SETTINGS SHA-256")
# Lines that follow from the program's own text, or are known of it.
OF_THE_TEXT = ("LAYERS", "PART SHA-256", "SETTINGS SHA-256")
TOLD, LETTERS = 3, 12  # Differing settings that are told, and letters of a hash
_LAYER = re.compile(rb"^(?:; |\()LAYER: (\d+) OF (\d+)(?:, CUT AT (-?[\d.]+), Z (-?[\d.]+))?", re.MULTILINE)
MEGABYTE = 1e6
MARK, NOT = b"VALIDATED", b"NOT "  # What a validated program says, and what it loses when marked


@dataclass(frozen=True)
class Truth:
    """What is known of a program from elsewhere; None for what is not."""

    validated: bool | None = None
    part_sha256: str | None = None
    settings_sha256: str | None = None
    # Hash of settings that were given by someone, who need not have those that the program was made with.
    given_sha256: str | None = None
    # Which of the settings given are not those that the program was made with, where both are known, in words.
    differences: tuple[str, ...] = ()


def header_checks(
    nc: NCProgram, config: Config, truth: Truth, heights: ArrayLike | None = None
) -> list[Check]:
    """Check status and header of a program against settings, text, and what is known of it from elsewhere."""
    faults = [*_header(nc, config, truth), *_layers(nc, heights, config)]
    # Settings that name no control name the default one.
    if config.machine.control not in (nc.dialect, MachineSettings.model_fields["control"].default):
        what = f"is read as one of {nc.dialect}, machine.control is {config.machine.control}"
        faults.insert(0, (f"{nc.files[0].name}:1", what))
    header = count_check("header", faults, f"true{_other_settings(nc, truth)}")
    return [status_check(nc, truth), header, _size(nc, config)]


def status_check(nc: NCProgram, truth: Truth) -> Check:
    """Check that every file that has a status says the same, and what was recorded of it."""
    said = [(file, *_status_of(file)) for file in nc.files]
    told = [(file, status, line) for file, status, line in said if status is not None]
    faults = [
        (f"{file.name}:1", "has comments and no status in its first lines")
        for file, status, _ in said
        if status is None and _LAYER.search(file.data) is not None
    ]
    most = 2 * sum(status for _, status, _ in told) > len(told)
    wanted = most if truth.validated is None else truth.validated
    words = {True: "VALIDATED", False: "NOT VALIDATED"}
    faults += [
        (f"{file.name}:{line}", f"says {words[status]}, the program is {words[wanted]}")
        for file, status, line in told
        if status != wanted
    ]
    return count_check("status", faults, "the same in every file, and as recorded")


def _status_of(file: SourceFile) -> tuple[bool | None, int]:
    """Status of a file, and its line; None where it has none."""
    found = status_of(file.data)
    return (None, 0) if found is None else (found[0] == MARK, file.data.count(b"\n", 0, found.start()) + 1)


def _header(nc: NCProgram, config: Config, truth: Truth) -> Faults:
    layers = len(nc.layer_files)
    told = sum(len(_LAYER.findall(file.data)) for file in nc.files)
    if nc.header.get("LAYERS") == str(told):
        layers = told  # a layer without a bead is no level of Z
    known = header_lines(config, control(nc.dialect), layers)
    # As they stand in a comment of the control, which has no reserved characters and ends with its block.
    said = {key: control(nc.dialect).comment_text(comment(f"{key}: {value}")) for key, value in known.items()}
    wanted = {key: line.removeprefix(f"; {key}:").strip() for key, line in said.items() if key not in FREE}
    hashes = {"PART SHA-256": truth.part_sha256, "SETTINGS SHA-256": truth.settings_sha256}
    faults, file = [], nc.files[0]
    for key, value in (wanted | hashes).items():
        if value is not None and nc.header.get(key, value) != value:
            by = "in truth it is" if key in OF_THE_TEXT else "by the settings it is"
            where = place_of(file, max(file.data.find(f"{key}:".encode("ascii", "replace")), 0))
            faults.append((where, f"says {key}: {nc.header[key]}, {by} {value}"))
    return faults


def _other_settings(nc: NCProgram, truth: Truth) -> str:
    """What is told where the program was made with other settings than those by which it is judged: that is no fault."""
    said = nc.header.get("SETTINGS SHA-256")
    if said is None or truth.given_sha256 in (None, said):
        return ""
    more = len(truth.differences) - TOLD
    names = [*truth.differences[:TOLD], *([f"{more} more"] if more > 0 else [])]
    which = "; ".join(names) or "which ones, its text does not say"
    return (
        f"; made with other settings than those by which it is judged here, SETTINGS SHA-256 {said[:LETTERS]}..., not "
        f"{str(truth.given_sha256)[:LETTERS]}...: {which}"
    )


def _layers(nc: NCProgram, heights: ArrayLike | None, config: Config) -> Faults:
    """Comments at the head of layers: their number, in the order in which they come, their cut and their Z."""
    # Files in the order in which they run, the main one first.
    files, suffix = {file.name: file for file in nc.files}, control(nc.dialect).subprogram_suffix
    called = [f"{nc.events.said(i)}{suffix}" for i in np.flatnonzero(nc.events.kind == Kind.CALL).tolist()]
    order = [nc.files[0], *(files[name] for name in dict.fromkeys(called) if name in files)]
    found = [(file, layer) for file in order for layer in _LAYER.finditer(file.data)]
    cuts = np.asarray(() if heights is None else heights, np.float64)
    z, faults = deposition_heights(cuts, config.layer_height_mm, config.base_mm), []
    for k, (file, layer) in enumerate(found):
        said = f"layer {int(layer[1])} of {int(layer[2])}"
        true = f"layer {k + 1} of {len(found)}"
        wrong = said != true
        if not wrong and layer[3] and k < cuts.size:
            off_mm = max(abs(float(layer[3]) - cuts[k]), abs(float(layer[4]) - z[k]))
            wrong = off_mm > PRINTED
            said += f" cut at {float(layer[3]):.6f} mm, Z {float(layer[4]):.6f} mm"
            true += f" cut at {cuts[k]:.6f} mm, Z {z[k]:.6f} mm"
        if wrong:
            faults.append((place_of(file, layer.start()), f"says {said}, it is {true}"))
    return faults


def _size(nc: NCProgram, config: Config) -> Check:
    """Bytes of all files, as they are when they are validated, against the room on the control."""
    longer = len(NOT_VALIDATED) - len(VALIDATED)
    size = sum(len(file.data) - longer * (_status_of(file)[0] is False) for file in nc.files)
    megabytes = size / MEGABYTE
    limit = config.machine.program_limit_mb
    text = f"{megabytes:.3g} MB in {len(nc.files)} files"
    if limit is None:
        text += "; the profile sets no limit (machine.program_limit_mb)"
        return Check("size on the control", True, megabytes, megabytes, "MB", "", text)
    where = "" if megabytes <= limit else f"{nc.files[0].name}:1"
    return limit_check("size on the control", megabytes, limit, "MB", text, where)


def marked_validated(files: ProgramFiles) -> ProgramFiles:
    """Mark a program that was checked as validated; RuntimeError, and the files as they were, if more than its status has changed."""
    checked = {name: (files.folder / name).read_bytes() for name in files.names}
    made = mark_validated(files)
    for name, data in checked.items():
        if made.folder != files.folder or not is_marked(data, (made.folder / name).read_bytes()):
            for file, before in checked.items():
                (files.folder / file).write_bytes(before)
            raise RuntimeError(f"{made.folder / name}: more than its status has changed since it was checked")
    return made


def is_marked(checked: bytes, marked: bytes) -> bool:
    """Whether bytes are those that were checked, with the status of a program that is validated in one of its first lines.

    >>> is_marked(b"%_N_A_MPF\\n; NOT VALIDATED\\nM30\\n", b"%_N_A_MPF\\n; VALIDATED\\nM30\\n")
    True
    >>> is_marked(b"%_N_A_MPF\\n; NOT VALIDATED\\nM30\\n", b"%_N_A_MPF\\n; VALIDATED\\nM3\\n")
    False
    """
    at = next((i for i, (a, b) in enumerate(zip(checked, marked, strict=False)) if a != b), len(marked))
    if checked[at : at + len(NOT)] != NOT or not checked.startswith(MARK, at + len(NOT)):
        return False
    return marked == checked[:at] + checked[at + len(NOT) :] and checked[:at].count(b"\n") < STATUS_LINES

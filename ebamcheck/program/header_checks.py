"""Checks that what a program says of itself is true: its status, part, layers, machine, control and place.

Nothing rests on these comments, and a program without them is judged alike; one that says something untrue is refused,
since a person reads them at the control.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from ebamcheck.config import Config
from ebamcheck.program.checks import Check, count_check
from ebamcheck.program.dialects import SINUMERIK
from ebamcheck.program.files import STATUS, STATUS_LINES, VALIDATED
from ebamcheck.program.header import CONTROL_NAMES, header_lines
from ebamcheck.program.layer_text import comment
from ebamcheck.program.motions import NCProgram, SourceFile

CHECKED = ("CONTROL", "MACHINE", "LAYERS", "COORDINATES", "BEAM", "WIRE")
"""Lines of the header that follow from the settings and the program's own text."""

_LAYER = re.compile(rb"^; LAYER: (\d+) OF (\d+)\b", re.MULTILINE)

MEGABYTE = 1e6


@dataclass(frozen=True)
class Truth:
    """What is known of a program from elsewhere; None for what is not."""

    validated: bool | None = None
    part_sha256: str | None = None
    settings_sha256: str | None = None


def header_checks(nc: NCProgram, config: Config, truth: Truth) -> list[Check]:
    """Check status and header of a program against settings, text, and what is known of it from elsewhere."""
    return [
        count_check("status", _status(nc, truth), "the same in every file, and as recorded"),
        count_check("header", [*_header(nc, config, truth), *_layers(nc), *_paths(nc, config)], "true"),
        _size(nc, config),
    ]


def _status(nc: NCProgram, truth: Truth) -> list[tuple[str, str]]:
    """Status of every file that has one: all are to say the same, and what was recorded."""
    said = [(file, *_status_of(file)) for file in nc.files]
    told = [(file, status, line) for file, status, line in said if status is not None]
    if not told:
        return []
    wanted = truth.validated
    if wanted is None:
        wanted = 2 * sum(status for _, status, _ in told) > len(told)
    word = "VALIDATED" if wanted else "NOT VALIDATED"
    return [
        (f"{file.name}:{line}", f"says {'VALIDATED' if status else 'NOT VALIDATED'}, the program is {word}")
        for file, status, line in told
        if status != wanted
    ]


def _status_of(file: SourceFile) -> tuple[bool | None, int]:
    """Status of a file, and its line; None where it has none."""
    head = b"\n".join(file.data.split(b"\n")[:STATUS_LINES])
    found = STATUS.search(head)
    if found is None:
        return None, 0
    return found[0] == VALIDATED.encode("ascii"), head.count(b"\n", 0, found.start()) + 1


def _header(nc: NCProgram, config: Config, truth: Truth) -> list[tuple[str, str]]:
    layers = len(nc.layer_files)
    told = sum(len(_LAYER.findall(file.data)) for file in nc.files)
    if nc.header.get("LAYERS") == str(told):
        layers = told  # a layer without a bead is no level of Z
    known = header_lines(config, CONTROL_NAMES.get(nc.dialect, nc.dialect), layers, {})
    wanted = {key: _printed(key, known[key]) for key in CHECKED} | {
        "PART SHA-256": truth.part_sha256,
        "SETTINGS SHA-256": truth.settings_sha256,
    }
    return [
        (_line_of(nc.files[0], key), f"says {key}: {nc.header[key]}, in truth {value}")
        for key, value in wanted.items()
        if value is not None and key in nc.header and nc.header[key] != value
    ]


def _printed(key: str, value: str) -> str:
    """A value as it stands in a comment, which has no reserved characters and ends with its block."""
    return comment(f"{key}: {value}").removeprefix(f"; {key}:").strip()


def _line_of(file: SourceFile, key: str) -> str:
    """``FILE:line`` of a line of the header."""
    return _place(file, max(file.data.find(f"{key}:".encode("ascii", "replace")), 0))


def _place(file: SourceFile, offset: int) -> str:
    """``FILE:line`` of a byte."""
    line = file.data.count(b"\n", 0, offset) + 1
    return f"{file.name}:{line}"


def _layers(nc: NCProgram) -> list[tuple[str, str]]:
    """Comments that number the layers, against the order in which they come."""
    said = [
        (_place(file, found.start()), int(found[1]), int(found[2]))
        for file in _in_order(nc)
        for found in _LAYER.finditer(file.data)
    ]
    return [
        (where, f"says layer {number} of {count}, it is layer {k} of {len(said)}")
        for k, (where, number, count) in enumerate(said, start=1)
        if (number, count) != (k, len(said))
    ]


def _in_order(nc: NCProgram) -> list[SourceFile]:
    """Files in the order in which they run, the main one first."""
    files = {file.name: file for file in nc.files}
    called = [f"{name.removeprefix('call ')}.SPF" for name in nc.events.name if name.startswith("call ")]
    return [nc.files[0], *(files[name] for name in dict.fromkeys(called) if name in files)]


def _paths(nc: NCProgram, config: Config) -> list[tuple[str, str]]:
    """Folder of the control that the files of a SINUMERIK say they belong to: the one of the profile."""
    if nc.dialect != SINUMERIK:
        return []
    wanted = f";$PATH=/_N_WKS_DIR/_N_{config.machine.workpiece_directory}_WPD".encode("ascii")
    faults = []
    for file in nc.files:
        lines = file.data.split(b"\n", 2)
        said = lines[1].rstrip(b"\r") if len(lines) > 1 else b""
        if said.startswith(b";$PATH=") and said != wanted:
            faults.append((f"{file.name}:2", f"says {said.decode('latin-1')}, the profile {wanted.decode()}"))
    return faults


def _size(nc: NCProgram, config: Config) -> Check:
    """Bytes of all files against the room on the control."""
    megabytes = sum(len(file.data) for file in nc.files) / MEGABYTE
    limit = config.machine.program_limit_mb
    text = f"{megabytes:.3g} MB in {len(nc.files)} files"
    if limit is None:
        text += "; the profile sets no limit (machine.program_limit_mb)"
        return Check("size on the control", True, megabytes, megabytes, "MB", "", text)
    where = "" if megabytes <= limit else f"{nc.files[0].name}:1"
    return Check("size on the control", megabytes <= limit, megabytes, limit, "MB", where, text)

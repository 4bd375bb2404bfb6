"""Names and first lines of a SINUMERIK's files: what the control asks of them, and the folder that they say they lie in."""

from __future__ import annotations

import re

from ebamcheck.nc.motions import NCProgram, SourceFile
from ebamcheck.settings.config import Config

_NAME = re.compile(r"(?=.{1,24}\.)(?:[A-Z]{2}|_[A-Z])[A-Z0-9_]*\.(?:MPF|SPF)")
_DEVICE = re.compile(r"(?:CON|PRN|AUX|NUL|COM\d|LPT\d)\..*")
_PATH = re.compile(rb";\$PATH=/_N_(?:WKS_DIR/_N_[A-Z0-9_]+_WPD|MPF_DIR|SPF_DIR)\r?")


def file_faults(nc: NCProgram, config: Config) -> list[tuple[str, str]]:
    """Places and texts of what is wrong with names, first lines and paths of the files."""
    return [fault for file in nc.files for fault in [*_header(file), *_path(file, config)]]


def _header(file: SourceFile) -> list[tuple[str, str]]:
    faults = []
    if not _NAME.fullmatch(file.name) or _DEVICE.fullmatch(file.name):
        faults.append((f"{file.name}:1", f"{file.name!r} is not a legal name of a program"))
    lines = [*file.data.split(b"\n", 2), b"", b""]
    wanted = f"%_N_{file.name.replace('.', '_')}"
    if lines[0].rstrip(b"\r") != wanted.encode("latin-1", "replace"):
        faults.append((f"{file.name}:1", f"first line is not {wanted}"))
    if not _PATH.fullmatch(lines[1]):
        faults.append((f"{file.name}:2", "second line is not ;$PATH=/_N_WKS_DIR/_N_..._WPD"))
    return faults


def _path(file: SourceFile, config: Config) -> list[tuple[str, str]]:
    """Folder of the control that a file says it belongs to: the one of the profile."""
    wanted = f";$PATH=/_N_WKS_DIR/_N_{config.machine.workpiece_directory}_WPD".encode("ascii")
    lines = file.data.split(b"\n", 2)
    said = lines[1].rstrip(b"\r") if len(lines) > 1 else b""
    if said.startswith(b";$PATH=") and said != wanted:
        return [(f"{file.name}:2", f"says {said.decode('latin-1')}, the profile {wanted.decode()}")]
    return []

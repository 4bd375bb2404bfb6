"""Files of a program: legal names, writing all or nothing, hashes, and the line that says validated."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from ebamcheck.errors import InputError, SettingsError
from ebamcheck.scratch import scratch_folder
from ebamcheck.showing import short_text

NOT_VALIDATED = "; NOT VALIDATED"
VALIDATED = "; VALIDATED"  # The status of every file, at the end of one of its first lines
STATUS_LINES = 3  # Lines among which the status stands: a SINUMERIK wants a name and a path first
STATUS = re.compile(rb"(?<=; )(?:NOT )?VALIDATED(?=\r?$)|(?<=\()(?:NOT )?VALIDATED(?=\)\r?$)", re.MULTILINE)
LONGEST_NAME = 24
RESERVED_NAME = re.compile(r"CON|PRN|AUX|NUL|COM\d|LPT\d")
SUFFIXES = (".MPF", ".SPF")  # Files that are programs whatever they hold
SCRIPT = "#!"  # Begins a file that can be run


@dataclass(frozen=True)
class ProgramFiles:
    """A program on disk, in a folder that holds nothing else."""

    folder: Path
    names: tuple[str, ...]  # in the order in which the control meets them: the main program first
    sha256: Mapping[str, str]  # by name
    blocks: Mapping[str, int]  # lines of each file that are no comment and no header, by name
    validated: bool  # whether the files carry "; VALIDATED"

    def __repr__(self) -> str:
        said = "VALIDATED" if self.validated else "NOT VALIDATED"
        files = f"{self.names[0]} of {len(self.names)} files"
        return short_text.line("ProgramFiles", said, files, str(self.folder))

    @property
    def main(self) -> Path:
        """Path of the main program."""
        return self.folder / self.names[0]


def legal_name(name: str) -> str:
    """Return `name` if the control accepts it as a program's name, else raise :class:`SettingsError`."""
    if len(name) > LONGEST_NAME:
        raise SettingsError(
            f"program name {name!r} has {len(name)} characters, over {LONGEST_NAME}: shorten machine.program_name"
        )
    if not re.fullmatch(r"(?:[A-Z]{2}|_[A-Z])[A-Z0-9_]*", name) or RESERVED_NAME.fullmatch(name):
        raise SettingsError(
            f"program name {name!r} is not legal on a SINUMERIK: use A-Z, 0-9 and _, begin with two letters or "
            "an underscore and a letter, and avoid the names of devices"
        )
    return name


PREHEAT_DIGITS = 4  # Digits of the layer in the name of a preheating subprogram, at least


def preheat_name(stem: str, layer: int, digits: int = 4) -> str:
    """Name of the subprogram that preheats before a layer, from 0, of the program `stem`."""
    return f"{stem}_P{layer + 1:0{digits}d}"


def layer_of_preheat(stem: str, name: str) -> int | None:
    """Layer, from 0, before which a subprogram of the program `stem` preheats, as MAIN_P0003 does before 2; None for another
    one."""
    begin, digits = f"{stem}_P", name.removeprefix(f"{stem}_P")
    known = name.startswith(begin) and len(digits) >= PREHEAT_DIGITS and digits.isascii() and digits.isdigit()
    return int(digits) - 1 if known else None


def write_files(texts: Mapping[str, str], folder: Path, *, validated: bool) -> ProgramFiles:
    """Write all files of a program, the main one first in `texts`, or none of them; an earlier program in `folder` is replaced.
    They are written beside `folder`, and take its place when whole; a folder that holds anything else is refused."""
    folder = Path(folder)
    _refuse_foreign_files(folder)
    folder.parent.mkdir(parents=True, exist_ok=True)
    with scratch_folder(f".{folder.name}", folder.parent) as scratch:
        made = scratch / "made"
        made.mkdir()
        made.chmod(0o755)
        for name, text in texts.items():
            (made / name).parent.mkdir(exist_ok=True)
            (made / name).write_bytes(text.encode("ascii"))
            if text.startswith(SCRIPT):
                (made / name).chmod(0o755)
        if folder.exists():
            folder.rename(scratch / "old")
        made.rename(folder)
    sha256 = {name: hashlib.sha256(text.encode("ascii")).hexdigest() for name, text in texts.items()}
    blocks = {name: block_count(text) for name, text in texts.items()}
    return ProgramFiles(folder, tuple(texts), sha256, blocks, validated)


def block_count(text: str) -> int:
    """Lines of a file that are no comment and no header."""
    return len(re.findall(r"^[^;(%\n]", text, re.MULTILINE))


def _refuse_foreign_files(folder: Path) -> None:
    if not folder.exists():
        return
    if not folder.is_dir():
        raise SettingsError(f"{folder}: is a file; a program needs a folder of its own")
    for path in sorted(folder.rglob("*")):
        if path.is_dir() and not path.is_symlink() and any(path.iterdir()):
            continue  # what is in it comes next
        if path.suffix not in SUFFIXES and not (path.is_file() and status_of(path.read_bytes())):
            raise SettingsError(
                f"{folder}: holds {path.relative_to(folder)}, which is no program; give a folder of its own, it is replaced whole"
            )


def status_of(data: bytes) -> re.Match[bytes] | None:
    """Find the status of a file in its first lines."""
    return STATUS.search(b"\n".join(data.split(b"\n", STATUS_LINES)[:STATUS_LINES]))


def mark_validated(files: ProgramFiles, validated: bool = True) -> ProgramFiles:
    """Rewrite the status of every file, and no other byte, the main program last; InputError for a file that is not the one
    written."""
    status = b"VALIDATED" if validated else b"NOT VALIDATED"
    stamped: dict[str, bytes] = {}
    for name in files.names:
        path = files.folder / name
        data = path.read_bytes()
        if hashlib.sha256(data).hexdigest() != files.sha256[name]:
            raise InputError(f"{path}: has changed since it was written; write the program again")
        found = status_of(data)
        if found is None:
            raise InputError(f"{path}:{STATUS_LINES}: no status so far, which a program written here has")
        stamped[name] = data[: found.start()] + status + data[found.end() :]
    for name in reversed(files.names):
        path = files.folder / name
        temporary = path.with_name(f".{path.name}.new")
        temporary.write_bytes(stamped[name])
        os.replace(temporary, path)
    sha256 = {name: hashlib.sha256(stamped[name]).hexdigest() for name in files.names}
    return replace(files, sha256=sha256, validated=validated)

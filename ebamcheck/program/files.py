"""Files of a program: legal names, writing all or nothing, hashes, and the line that says validated."""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from ebamcheck.errors import InputError, SettingsError

NOT_VALIDATED = "; NOT VALIDATED"
VALIDATED = "; VALIDATED"
"""The status line of every file, always the third: after the name and the path."""

STATUS_LINE = 2
LONGEST_NAME = 24
RESERVED_NAME = re.compile(r"CON|PRN|AUX|NUL|COM\d|LPT\d")
SUFFIXES = (".MPF", ".SPF")


@dataclass(frozen=True)
class ProgramFiles:
    """A program on disk.

    Parameters
    ----------
    folder
        Folder that holds nothing but this program.
    names
        File names in the order in which the control meets them: the main program first.
    sha256
        Hash of the bytes of each file, by name.
    blocks
        Numbered blocks of each file, by name.
    validated
        Whether the files carry the line ``; VALIDATED``.
    """

    folder: Path
    names: tuple[str, ...]
    sha256: Mapping[str, str]
    blocks: Mapping[str, int]
    validated: bool

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


def write_files(texts: Mapping[str, str], folder: Path, *, validated: bool) -> ProgramFiles:
    """Write all files of a program, the main one first in `texts`, or none of them.

    They are written to a folder beside `folder` that takes its place when whole. An earlier program in
    `folder` is replaced; a folder that holds anything else is refused.
    """
    folder = Path(folder)
    _refuse_foreign_files(folder)
    folder.parent.mkdir(parents=True, exist_ok=True)
    made = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=folder.parent))
    try:
        made.chmod(0o755)
        for name, text in texts.items():
            (made / name).write_bytes(text.encode("ascii"))
        if folder.exists():
            old = made.with_name(f"{made.name}.old")
            folder.rename(old)
            made.rename(folder)
            shutil.rmtree(old)
        else:
            made.rename(folder)
    finally:
        shutil.rmtree(made, ignore_errors=True)
    return ProgramFiles(
        folder=folder,
        names=tuple(texts),
        sha256={name: hashlib.sha256(text.encode("ascii")).hexdigest() for name, text in texts.items()},
        blocks={name: len(re.findall(r"^N\d", text, re.MULTILINE)) for name, text in texts.items()},
        validated=validated,
    )


def _refuse_foreign_files(folder: Path) -> None:
    if not folder.exists():
        return
    if not folder.is_dir():
        raise SettingsError(f"{folder}: is a file; a program needs a folder of its own")
    for path in sorted(folder.iterdir()):
        if path.suffix not in SUFFIXES:
            raise SettingsError(
                f"{folder}: holds {path.name}, which is no program; give a folder of its own, it is replaced whole"
            )


def mark_validated(files: ProgramFiles, validated: bool = True) -> ProgramFiles:
    """Rewrite the status line of every file, and no other byte; the main program comes last.

    Raises
    ------
    InputError
        If a file is not the one that was written: its hash differs, or it has no status line.
    """
    status = VALIDATED if validated else NOT_VALIDATED
    stamped: dict[str, bytes] = {}
    for name in files.names:
        path = files.folder / name
        data = path.read_bytes()
        if hashlib.sha256(data).hexdigest() != files.sha256[name]:
            raise InputError(f"{path}: has changed since it was written; write the program again")
        lines = data.split(b"\n", STATUS_LINE + 1)
        if len(lines) <= STATUS_LINE or lines[STATUS_LINE].decode("ascii") not in (NOT_VALIDATED, VALIDATED):
            raise InputError(f"{path}:{STATUS_LINE + 1}: is not the status line of a program written here")
        lines[STATUS_LINE] = status.encode("ascii")
        stamped[name] = b"\n".join(lines)
    for name in reversed(files.names):
        temporary = files.folder / f".{name}.new"
        temporary.write_bytes(stamped[name])
        os.replace(temporary, files.folder / name)
    return ProgramFiles(
        folder=files.folder,
        names=files.names,
        sha256={name: hashlib.sha256(stamped[name]).hexdigest() for name in files.names},
        blocks=files.blocks,
        validated=validated,
    )

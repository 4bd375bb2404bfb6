"""Writes files that appear whole or not at all; refuses a folder, a pipe or a device that a user names in place of a file, without
opening it."""

from __future__ import annotations

import os
import stat
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from ebamcheck.errors import EbamcheckError, InputError, SettingsError
from ebamcheck.scratch import owned_file, sweep_parts

# Compression of the Parquet files of a run: coordinates hardly get smaller by a slower one
COMPRESSION: Final = "lz4"


def made_folder(path: Path) -> Path:
    """Make a folder where there is none, and return it."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise SettingsError(f"{path}: cannot be made: {error.strerror}") from None
    return path


@contextmanager
def replacing(path: str | Path) -> Iterator[Path]:
    """Give a temporary name in the folder of `path`; the file written there takes its place at the end.

    Where the block raises, the temporary file goes and what stood at `path` stays as it was; what a killed process
    left in that folder goes, too.

    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     with replacing(Path(folder, "a.txt")) as temporary:
    ...         _ = temporary.write_text("whole")
    ...     Path(folder, "a.txt").read_text()
    'whole'
    """
    path = Path(path)
    if not path.parent.is_dir():
        raise SettingsError(f"{path}: cannot be written: there is no folder {path.parent}: make it first")
    temporary = path.with_name(f".{path.name}.{os.getpid()}-{threading.get_ident()}.part")
    sweep_parts(path.parent)
    try:
        with owned_file(temporary):
            yield temporary
            os.replace(temporary, path)
    except OSError as error:
        raise SettingsError(f"{path}: cannot be written: {error.strerror or error}") from None
    finally:
        temporary.unlink(missing_ok=True)


# What else may stand under a name: opening one of them blocks, never ends, or fails in another way each time
KINDS = {
    stat.S_IFDIR: "is a folder, not a file",
    stat.S_IFIFO: "is a pipe, not a file: save what comes through it to a file first",
    stat.S_IFCHR: "is a device, not a file",
    stat.S_IFBLK: "is a device, not a file",
    stat.S_IFSOCK: "is a socket, not a file",
}


def regular_file(path: str | Path, error: type[EbamcheckError] = InputError) -> Path:
    """Return a path, without opening it; raise `error` if anything but a regular file, or a link to one, stands
    there.

    A missing or forbidden file passes: the code that opens it reports that.

    >>> regular_file("/dev/zero")
    Traceback (most recent call last):
    ebamcheck.errors.InputError: /dev/zero: is a device, not a file
    """
    path = Path(path)
    try:
        kind = stat.S_IFMT(path.stat().st_mode)
    except OSError:
        return path
    except ValueError as found:  # a null byte
        raise error(f"{path}: cannot be read: {found}") from None
    if kind in KINDS:
        raise error(f"{path}: {KINDS[kind]}")
    return path

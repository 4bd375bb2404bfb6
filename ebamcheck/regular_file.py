"""Files that a user names are regular files: a folder, a pipe or a device is refused before it is opened."""

from __future__ import annotations

import stat
from pathlib import Path

from ebamcheck.errors import EbamcheckError, InputError

# What else may stand under a name: opening one of them blocks, never ends, or fails in another way each time
KINDS = {
    stat.S_IFDIR: "is a folder, not a file",
    stat.S_IFIFO: "is a pipe, not a file: save what comes through it to a file first",
    stat.S_IFCHR: "is a device, not a file",
    stat.S_IFBLK: "is a device, not a file",
    stat.S_IFSOCK: "is a socket, not a file",
}


def regular_file(path: str | Path, error: type[EbamcheckError] = InputError) -> Path:
    """Return a path, without opening it, unless something else than a regular file, or a link to one, stands there: else raise `error`.

    What is missing, or must not be looked at, is told by whoever opens it.

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

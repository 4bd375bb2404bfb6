"""Turns at compiling a kernel: one process compiles it, and whoever needs it meanwhile waits for that.

A turn is a lock on one byte of a file beside the compiled kernels, at a place that the kernel's name and types choose. The
system gives it back when its process ends, however that ends, and tells of processes that would wait for each other.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import os
from functools import cache

FILE = "kernels.turns"

_PLACE_BYTES = 7
"""Bytes of a hash that choose the place: places have to fit into 63 bits."""


def take_turn(folder: str, what: str) -> None:
    """Wait until no other process compiles something, and have it be this one's turn.

    Where the folder's file system knows no locks, or two processes would wait for each other, nobody waits: then both
    compile, and the last one keeps what it has.

    Parameters
    ----------
    folder
        Where compiled kernels lie.
    what
        Name and types of the kernel, the same in every process.

    Examples
    --------
    >>> from ebamcheck.scratch import scratch_folder
    >>> with scratch_folder() as folder:
    ...     take_turn(str(folder), "area (float64)")
    ...     end_turn(str(folder), "area (float64)")
    """
    with contextlib.suppress(OSError):
        fcntl.lockf(_file_of(folder), fcntl.LOCK_EX, 1, _place(what))


def end_turn(folder: str, what: str) -> None:
    """Let others have a turn that :func:`take_turn` gave; without one, nothing happens.

    Parameters
    ----------
    folder, what
        As they were given there.

    Examples
    --------
    >>> from ebamcheck.scratch import scratch_folder
    >>> with scratch_folder() as folder:
    ...     end_turn(str(folder), "area (float64)")
    """
    with contextlib.suppress(OSError):
        fcntl.lockf(_file_of(folder), fcntl.LOCK_UN, 1, _place(what))


@cache
def _file_of(folder: str) -> int:
    """Descriptor of the file of a folder; it stays open, for closing it would end all turns of this process."""
    return os.open(os.path.join(folder, FILE), os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)


def _place(what: str) -> int:
    return int.from_bytes(hashlib.sha256(what.encode()).digest()[:_PLACE_BYTES])

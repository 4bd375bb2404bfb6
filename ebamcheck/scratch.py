"""Temporary folders and files that the next process clears away, should their owner, who holds a lock on each, have been killed."""

from __future__ import annotations

import contextlib
import fcntl
import os
import re
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

MARK = ".scratch-"  # stands in the name of every such folder, so that no other one is ever taken for one

PREFIX = "ebamcheck"

_PART = re.compile(r"\..+\.\d+-\d+\.part")  # names of files in the making (`ebamcheck.atomic_file.replacing`)
_swept: set[Path] = set()  # folders in which this process has looked for abandoned files


@contextmanager
def scratch_folder(prefix: str = PREFIX, parent: Path | None = None) -> Iterator[Path]:
    """Give a folder that goes at the end; those that killed processes left under the same prefix go at once."""
    where = Path(tempfile.gettempdir()) if parent is None else parent
    sweep_folders(prefix, where)
    folder, lock = _locked_folder(prefix + MARK, where)
    try:
        yield folder
    finally:
        # The lock goes last: nobody else clears away meanwhile.
        shutil.rmtree(folder, ignore_errors=True)
        os.close(lock)


def sweep_folders(prefix: str, where: Path) -> list[Path]:
    """Remove the scratch folders of a prefix whose owners are gone; returns them."""
    return _gone(where, lambda e: e.name.startswith(prefix + MARK) and e.is_dir(follow_symlinks=False))


def sweep_parts(where: Path) -> list[Path]:
    """Remove files in the making whose owners are gone, once for each folder in the life of a process; returns them."""
    if where in _swept:
        return []
    _swept.add(where)
    return _gone(where, lambda e: bool(_PART.fullmatch(e.name)) and e.is_file(follow_symlinks=False))


def _gone(where: Path, is_ours: Callable[[os.DirEntry[str]], bool]) -> list[Path]:
    """Remove what lies in a folder and is ours, where its owner is gone."""
    gone = []
    with contextlib.suppress(OSError), os.scandir(where) as entries:
        for path in [Path(entry.path) for entry in entries if is_ours(entry)]:
            with _abandoned(path) as abandoned:
                if not abandoned:
                    continue
                if path.is_dir():
                    shutil.rmtree(path, ignore_errors=True)
                else:
                    path.unlink(missing_ok=True)
                gone.append(path)
    return gone


@contextmanager
def owned_file(path: Path) -> Iterator[None]:
    """Make an empty file that nobody takes for abandoned while the block runs."""
    while True:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
        if _lock(descriptor) and _is_still(path, descriptor):
            break
        # Another process has taken it for abandoned before it was locked.
        os.close(descriptor)
    try:
        yield
    finally:
        os.close(descriptor)


def _locked_folder(prefix: str, where: Path) -> tuple[Path, int]:
    """Make a folder and lock it; anew where another process has taken it for abandoned before it was locked."""
    while True:
        folder = Path(tempfile.mkdtemp(prefix=prefix, dir=where))
        try:
            lock = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        except FileNotFoundError:
            continue
        if _lock(lock) and _is_still(folder, lock):
            return folder, lock
        os.close(lock)


@contextmanager
def _abandoned(path: Path) -> Iterator[bool]:
    """Whether what lies at a path has no owner; it is locked while the block runs."""
    try:
        lock = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC)
    except OSError:
        yield False
        return
    try:
        owned_by_us = os.fstat(lock).st_uid == os.getuid()
        yield owned_by_us and _lock(lock, sure=True) and _is_still(path, lock)
    finally:
        os.close(lock)


def _lock(descriptor: int, sure: bool = False) -> bool:
    """Lock, if nobody else does; where the file system has no locks, `sure` decides."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return not sure
    return True


def _is_still(path: Path, descriptor: int) -> bool:
    with contextlib.suppress(FileNotFoundError):
        return os.path.samestat(os.fstat(descriptor), os.stat(path, follow_symlinks=False))
    return False

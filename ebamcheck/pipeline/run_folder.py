"""The run folder: everything that a run leaves behind, written aside and moved into place when whole.

``run.json`` is the truth; every other file is named in it, and every report is a rendering of it.
"""

from __future__ import annotations

import ctypes
import fcntl
import hashlib
import json
import math
import os
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ebamcheck.atomic_file import replacing
from ebamcheck.errors import InputError, SettingsError
from ebamcheck.layers import files as layer_files
from ebamcheck.layers.stack import Layers

MANIFEST = "run.json"
FINGERPRINT = "fingerprint"
"""Marks an unfinished folder with what it is a run of."""
FORMAT_VERSION = 1

AT_FDCWD = -100
RENAME_EXCHANGE = 2
"""Numbers of Linux's requests, from <linux/fcntl.h> and <linux/fs.h>."""


def sha256_of_file(path: Path) -> str:
    """SHA-256 of a file's bytes, in hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def sha256_of_json(value: Any) -> str:
    """SHA-256 of a value as compact JSON with sorted keys, as settings are hashed."""
    text = json.dumps(plain(value), sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def plain(value: Any) -> Any:
    """Turn a value into what strict JSON can hold: numpy numbers and arrays, tuples, infinities (as text)."""
    if isinstance(value, Mapping):
        return {plain(str(k)): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(v) for v in (sorted(value) if isinstance(value, set | frozenset) else value)]
    if isinstance(value, np.ndarray):
        return [plain(v) for v in value.tolist()]
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return "NaN" if math.isnan(value) else ("Infinity" if value > 0 else "-Infinity")
    if isinstance(value, str | Path):
        # A file name need not be UTF-8; what cannot be written as such is escaped.
        return str(value).encode("utf-8", "backslashreplace").decode("utf-8")
    return value


def json_text(value: Any) -> str:
    """Strict JSON with sorted keys, as files hold it."""
    return json.dumps(plain(value), indent=2, sort_keys=True, allow_nan=False, ensure_ascii=False) + "\n"


def write_json(value: Any, path: Path) -> None:
    """Write strict JSON with sorted keys, whole or not at all."""
    with replacing(path) as temporary:
        temporary.write_text(json_text(value), encoding="utf-8")


@dataclass(frozen=True)
class RunFolder:
    """A run folder on disk, finished or in the making."""

    path: Path

    @property
    def layers_folder(self) -> Path:
        """Folder of one Parquet file per backend."""
        return self.path / "layers"

    def layers_file(self, backend: str) -> Path:
        """Where a backend's layers lie."""
        return self.layers_folder / f"{backend}.parquet"

    @property
    def program_folder(self) -> Path:
        """Folder of the NC programs."""
        return self.path / "program"

    def read_layers(self, backend: str) -> Layers:
        """Layers of one backend."""
        return layer_files.read_parquet(self.layers_file(backend))

    def manifest(self) -> dict[str, Any]:
        """Read ``run.json``; raises :class:`InputError` where it is missing or is not one of ours."""
        path = self.path / MANIFEST
        try:
            found = json.loads(path.read_text(encoding="utf-8"))
        except FileNotFoundError:
            raise InputError(f"{self.path}: is no run folder: it has no {MANIFEST}") from None
        except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
            raise InputError(f"{path}: cannot be read: {error}") from None
        if not isinstance(found, dict) or found.get("format") != FORMAT_VERSION:
            raise InputError(f"{path}: is not a run of format {FORMAT_VERSION}")
        return found


@dataclass(frozen=True)
class RunInProgress(RunFolder):
    """A run folder in the making, beside the place that it will take; locked against a second run to the same place."""

    target: Path
    lock: int

    def finish(self) -> RunFolder:
        """Move the folder to its place; a former run there is replaced in one step and then removed."""
        if self.target.exists():
            _exchange(self.path, self.target)
            shutil.rmtree(self.path, ignore_errors=True)
        else:
            os.replace(self.path, self.target)
        return RunFolder(self.target)

    def release(self) -> None:
        """Let go of the lock; what was made so far stays, for a later run to go on with."""
        os.close(self.lock)


def start_run(target: Path, fingerprint: str, resume: bool) -> RunInProgress:
    """Begin a run that will end at `target`.

    Parameters
    ----------
    target
        Folder to make; a former run folder there is replaced when the new one is whole.
    fingerprint
        Hash of part and settings. With `resume`, what a killed run of the same fingerprint left is kept.
    resume
        Go on with a killed run instead of starting over.

    Raises
    ------
    SettingsError
        If something that is no run folder stands at `target`, it cannot be written, or another run to the same
        place is under way.
    """
    target = Path(os.path.realpath(target))
    path = target.with_name(f".{target.name}.unfinished") if target.name else target
    try:
        if _is_foreign(target):
            raise SettingsError(f"{target}: is there and is no run folder: give another place with -o")
        path.mkdir(parents=True, exist_ok=True)
        lock = _locked(path, target)
        try:
            mark = path / FINGERPRINT
            if not (resume and mark.is_file() and mark.read_text() == fingerprint):
                _clear(path)
            (path / "layers").mkdir(exist_ok=True)
            mark.write_text(fingerprint)
        except OSError:
            os.close(lock)
            raise
    except OSError as error:
        raise SettingsError(f"{path}: cannot be written: {error.strerror or error}") from None
    return RunInProgress(path, target, lock)


def _is_foreign(target: Path) -> bool:
    """Whether something stands at a place that is neither a run folder nor an empty folder."""
    if not target.exists():
        return False
    return not (target / MANIFEST).is_file() and (not target.is_dir() or any(target.iterdir()))


def _locked(path: Path, target: Path) -> int:
    """Lock a folder and return its descriptor; the lock ends with the process, however that ends."""
    descriptor = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        # Who waited for nothing may still hold a folder that its maker has just moved to its place.
        if os.path.samestat(os.fstat(descriptor), os.stat(path)):
            return descriptor
    except (BlockingIOError, FileNotFoundError):
        pass
    os.close(descriptor)
    raise SettingsError(
        f"{target}: another run to this place is under way: wait for it, or give another with -o"
    )


def _clear(folder: Path) -> None:
    for entry in folder.iterdir():
        if entry.is_dir() and not entry.is_symlink():
            shutil.rmtree(entry)
        else:
            entry.unlink()


def _exchange(new: Path, old: Path) -> None:
    """Let two folders change places, in one step where the system can (Linux's ``renameat2``)."""
    libc = ctypes.CDLL(None, use_errno=True)
    if hasattr(libc, "renameat2"):
        made = libc.renameat2(AT_FDCWD, os.fsencode(new), AT_FDCWD, os.fsencode(old), RENAME_EXCHANGE)
        if made == 0:
            return
    aside = old.with_name(f".{old.name}.old.{os.getpid()}")
    os.replace(old, aside)
    os.replace(new, old)
    os.replace(aside, new)

"""The run folder: everything that a run leaves behind, written aside and moved into place when whole. ``run.json`` is the truth,
which names every file; times and dates stand in ``timings.json`` alone, so that two runs of the same input are the same bytes in
everything else."""

from __future__ import annotations

import contextlib
import ctypes
import fcntl
import json
import os
import re
import shutil
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ebamcheck.atomic_file import regular_file
from ebamcheck.errors import InputError, SettingsError
from ebamcheck.json_values import read_json, write_json
from ebamcheck.layers import files as layer_files
from ebamcheck.layers.stack import Layers
from ebamcheck.record.form import FORMAT_VERSION, RecordForm, TimingsForm, in_form

MANIFEST = "run.json"
FINGERPRINT = "fingerprint"  # marks an unfinished folder; a finished run has it in its record
LAYERS = "layers"
AT_FDCWD = -100
RENAME_EXCHANGE = 2  # numbers of Linux's requests, from <linux/fcntl.h> and <linux/fs.h>


@dataclass(frozen=True)
class RunFolder:
    """A run folder on disk, finished or in the making."""

    path: Path

    @property
    def layers_folder(self) -> Path:
        """Folder of one Parquet file per backend."""
        return self.path / LAYERS

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
        """Read ``run.json``, and times and dates of the run as its ``timings``; raises InputError where either is missing or not in
        its form."""
        path = self.path / MANIFEST
        if not own_file(path):
            raise InputError(f"{self.path}: is no run folder: it has no {MANIFEST}")
        found = read_json(path)
        if not isinstance(found, dict) or found.get("format") != FORMAT_VERSION:
            again = "make it again with `ebamcheck run`"
            raise InputError(f"{path}: is not a run of format {FORMAT_VERSION}: {again}")
        found = in_form(RecordForm, found, path)
        # Runs of earlier versions have them in the record itself.
        return found if "timings" in found else {**found, "timings": self._timings()}

    def _timings(self) -> dict[str, Any]:
        path = self.path / TIMINGS
        if not own_file(path):
            return {}
        return in_form(TimingsForm, read_json(path), path)

    def write_manifest(self, manifest: Mapping[str, Any]) -> None:
        """Write the record: ``timings`` into a file of their own, everything else into ``run.json``."""
        write_json(manifest["timings"], self.path / TIMINGS)
        write_json({k: v for k, v in manifest.items() if k != "timings"}, self.path / MANIFEST)


@dataclass(frozen=True)
class RunInProgress(RunFolder):
    """A run folder in the making, beside the place that it will take; locked against a second run to the same place."""

    target: Path
    lock: int

    @property
    def former(self) -> Path | None:
        """Name that the finished run at this place will get; None where there is none."""
        return dated_name(self.target, finished_at(self.target, MANIFEST)) if is_run(self.target) else None

    def finish(self) -> RunFolder:
        """Move the folder to its place, in one step; a finished run there is kept under a name with its date."""
        if self.target.exists():
            _exchange(self.path, self.target)
            _set_aside(self.path, self.target)
        else:
            os.replace(self.path, self.target)
        return RunFolder(self.target)

    def release(self) -> None:
        """Let go of the lock; what was made so far stays, for a later run to go on with."""
        os.close(self.lock)


def start_run(target: Path, fingerprint: str, resume: bool, force: bool = False) -> RunInProgress:
    """Begin a run that will end at `target`, under the hash of part and settings.

    With `resume`, what a killed run of the same fingerprint left is kept; with `force`, a finished run at `target` gets a name with
    its date when the new one is whole. Raises SettingsError where a finished run stands there otherwise, or something that is no
    run folder; where it cannot be written, or another run to the same place is under way."""
    target = Path(os.path.realpath(target))
    path = _unfinished(target)
    try:
        if _is_foreign(target):
            raise SettingsError(f"{target}: is there and is no run folder: give another place with -o")
        settle(target)
        if is_run(target) and not force:
            finished = finished_at(target, MANIFEST)
            raise SettingsError(
                f"{target}: holds a run that was finished at {finished}Z: give another place with -o, or --force, which keeps "
                f"that one as {dated_name(target, finished).name}"
            )
        path.mkdir(parents=True, exist_ok=True)
        lock = _locked(path, target)
        try:
            mark = path / FINGERPRINT
            _clear(path, keep_layers=resume and mark.is_file() and mark.read_text() == fingerprint)
            (path / LAYERS).mkdir(exist_ok=True)
            mark.write_text(fingerprint)
        except OSError:
            os.close(lock)
            raise
    except OSError as error:
        raise SettingsError(f"{path}: cannot be written: {error.strerror or error}") from None
    return RunInProgress(path, target, lock)


def settle(target: Path) -> None:
    """Finish the move of a whole run that was killed on its way to `target`, or of the former one that made room."""
    target = Path(os.path.realpath(target))
    path = _unfinished(target)
    if not _is_whole(path):
        return
    lock = _locked(path, target)
    try:
        if is_run(target):
            _set_aside(path, target)
        elif not _is_foreign(target):
            os.replace(path, target)
    finally:
        os.close(lock)


def finished_run(target: Path, fingerprint: str) -> RunFolder | None:
    """Run at `target`, if it is finished and one of that fingerprint."""
    settle(target)
    if not is_run(target):
        return None
    found = read_json(target / MANIFEST)
    same = isinstance(found, dict) and found.get(FINGERPRINT) == fingerprint
    return RunFolder(target) if same else None


def own_file(path: Path) -> bool:
    """Whether a file of a run's own stands at a path; raises InputError for a link, which may lead anywhere, a folder or a pipe."""
    if path.is_symlink():
        raise InputError(f"{path}: is a link, not a file: put the file itself in its place")
    return regular_file(path).is_file()


def is_run(folder: Path) -> bool:
    """Whether a folder is that of a finished run."""
    return (folder / MANIFEST).is_file()


def _unfinished(target: Path) -> Path:
    return target.with_name(f".{target.name}.unfinished") if target.name else target


def _is_whole(path: Path) -> bool:
    """Whether an unfinished folder lacks nothing but its place."""
    return is_run(path) and not (path / FINGERPRINT).exists()


def _set_aside(run: Path, target: Path) -> None:
    """Give a finished run that stood at `target` its dated name; what is no run is an empty folder, and goes."""
    if is_run(run):
        os.replace(run, dated_name(target, finished_at(run, MANIFEST)))
    else:
        with contextlib.suppress(OSError):
            run.rmdir()


def _is_foreign(target: Path) -> bool:
    """Whether something stands at a place that is neither a run folder nor an empty folder."""
    if not target.exists():
        return False
    return not is_run(target) and (not target.is_dir() or any(target.iterdir()))


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
    raise SettingsError(f"{target}: another run to this place is under way: wait for it, or give another with -o")


def _clear(folder: Path, keep_layers: bool) -> None:
    """Remove what lies in an unfinished folder; of what can be gone on with, whole layers and blocks of layers stay."""
    if _is_whole(folder):
        raise SettingsError(f"{folder}: holds a whole run that another process has just finished: try again")
    kept = set(layer_files.resumable(folder / LAYERS)) if keep_layers else set()
    for entry in [*folder.iterdir(), *(folder / LAYERS).glob("*")]:
        if entry in kept or (kept and entry == folder / LAYERS):
            continue
        if entry.is_dir() and not entry.is_symlink():
            shutil.rmtree(entry)
        else:
            entry.unlink(missing_ok=True)


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


TIMINGS = (
    "timings.json"  # times and dates of a run, which are all that differs from one run of the same input to the next
)
_DATE = re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d")


def finished_at(run: Path, record: str) -> str:
    """When a finished run came to its end, UTC, as ``2026-11-22T14:15:00``: by its own record, else by the date of that file."""
    for name in (TIMINGS, record):
        try:
            told = json.loads((run / name).read_text(encoding="utf-8"))
            found = _DATE.match(str((told if name == TIMINGS else told["timings"])["finished"]))
        except (OSError, ValueError, KeyError, TypeError):
            continue
        if found:
            return found[0]
    return time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime((run / record).stat().st_mtime))


def dated_name(target: Path, finished: str) -> Path:
    """Free name beside `target` for the run that stood there: ``RUN.2026-11-22T141500``, numbered where that is taken."""
    plain = target.with_name(f"{target.name}.{finished.replace(':', '')}")
    name, number = plain, 1
    while os.path.lexists(name):
        number += 1
        name = plain.with_name(f"{plain.name}-{number}")
    return name

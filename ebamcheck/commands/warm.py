"""``ebamcheck warm``: compiles the kernels of the main job once, by doing that job on small parts in two processes that begin at
its two ends.

Commands that need most kernels begin with this; those that need few compile them as they are called.
"""

from __future__ import annotations

import contextlib
import fcntl
import shutil
import subprocess
import sys
import time
from pathlib import Path

import typer

from ebamcheck.errors import ExitCode
from ebamcheck.scratch import scratch_folder

JOBS = "ebamcheck.commands.warm_jobs"


def warm_command() -> ExitCode:
    """Compile the kernels once, so that no later command has to wait for it."""
    start = time.perf_counter()
    if not warm_kernels():
        return ExitCode.OUT_OF_TOLERANCE
    typer.echo(f"kernels are compiled ({time.perf_counter() - start:.1f} s)")
    return ExitCode.PASS


def tell_if_cold() -> None:
    """Say that a command that needs few kernels compiles them as it goes, where nothing is compiled yet."""
    from ebamcheck.kernels import cache_folder

    folder = cache_folder("ebamcheck")
    if folder is not None and not folder.exists():
        _tell("the first command compiles the kernels that it needs; `ebamcheck warm` compiles all of them")


def warm_kernels() -> bool:
    """Compile the kernels of the main job unless that is done; one process does so, the others wait for it."""
    if (mark := _mark()) is None:
        return True  # Nothing can be kept.
    if not mark.exists():
        mark.parent.mkdir(parents=True, exist_ok=True)
        with open(mark.parent / "compiling.lock", "w", encoding="utf-8") as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                _tell("waiting for another process that compiles the kernels")
                fcntl.flock(lock, fcntl.LOCK_EX)
            if not mark.exists():
                _compile(mark)
    if done := mark.exists():
        with contextlib.suppress(OSError):
            mark.touch()
    return done


def _mark() -> Path | None:
    """Return the file that says that the kernels of this project and of its installed slicers are compiled; None without a
    cache."""
    from ebamcheck.kernels import cache_folder
    from ebamcheck.plugins import registry

    points = registry.points(registry.BACKENDS)
    packages = {points[name].module.partition(".")[0] for name in registry.house_slicers()}
    folders = [cache_folder(package) for package in ("ebamcheck", *sorted(packages - {"ebamcheck"}))]
    if folders[0] is None:
        return None
    stamps = "-".join(folder.name.rpartition("-")[2][:6] for folder in folders[1:] if folder is not None)
    return folders[0] / f"warm-{stamps}"


def _compile(mark: Path) -> None:
    _tell("compiling the kernels, once for this version: about two minutes on two cores")
    start = time.perf_counter()
    with scratch_folder() as folder:
        nowhere = subprocess.DEVNULL
        commands = ([sys.executable, "-m", JOBS, end, str(folder)] for end in ("first", "second"))
        workers = [subprocess.Popen(command, stdin=nowhere, stdout=nowhere) for command in commands]
        try:
            codes = [worker.wait() for worker in workers]
        finally:
            for worker in workers:
                worker.kill()
    if any(codes):
        _tell("not all kernels compiled; the rest compile when they are called")
        return
    mark.touch()
    _tell(f"kernels are compiled ({time.perf_counter() - start:.0f} s); they are kept for the next time")
    # Folders of kernels that no command has asked for in a while go: their sources have changed since.
    for folder in set(mark.parent.parent.glob("*-*")) - {mark.parent}:
        asked_for_s = max(f.stat().st_mtime for f in (folder, *folder.glob("warm-*")))
        if time.time() - asked_for_s > 30.0 * 86400.0:
            shutil.rmtree(folder, ignore_errors=True)


def _tell(text: str) -> None:
    typer.echo(f"ebamcheck: {text}", err=True)

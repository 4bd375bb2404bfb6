"""Processes of code that is not ours: started with limits, and ended with everything that they have started."""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

MARK = "EBAMCHECK_PROCESS"  # variable of the environment that a process and all its descendants carry, those that left its group, too
POLL_S = 0.05  # how often time and memory are looked at
LARGEST_SAID_BYTES = (
    64_000_000  # what a process may write to its standard output and error before it is ended: a flood fills the disk
)


def started(arguments: Sequence[str], folder: Path, said: Path, **streams: Any) -> tuple[subprocess.Popen[bytes], str]:
    """Start a Python module (last argument: our id) in a session of its own, with its words in `said`; and its mark."""
    mark = os.urandom(16).hex()
    with said.open("wb") as told:
        process = subprocess.Popen(
            [sys.executable, "-P", "-m", *arguments, str(os.getpid())],
            stdout=told,
            stderr=told,
            start_new_session=True,
            env={**os.environ, "TMPDIR": str(folder), MARK: mark},
            **streams,
        )
    return process, mark


def die_with(parent: int) -> None:
    """Have the kernel end this process when its parent ends, however that ends."""
    libc = ctypes.CDLL(None)
    if hasattr(libc, "prctl"):
        libc.prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG of <linux/prctl.h>
        if os.getppid() != parent:
            sys.exit("the parent has ended")


def has_ended(process: subprocess.Popen[bytes]) -> bool:
    """Whether a process has ended; it is not reaped, so that the number of its group stays its own."""
    if process.returncode is not None:
        return True
    try:
        return os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None
    except ChildProcessError:
        return True


def end_with_children(process: subprocess.Popen[bytes], mark: str = "") -> None:
    """End a process that leads its group, running or ended, and what it started: with its mark, those that left the group, too."""
    if process.returncode is None:
        # Once it is reaped its number may be another's.
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    # One that forks while it is sought is found in the next round.
    for _ in range(5 if mark else 0):
        marked = _marked(mark)
        for other in marked:
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.kill(other, signal.SIGKILL)
        if not marked:
            return


def _marked(mark: str) -> list[int]:
    """Ids of the running processes that carry a mark."""
    sought = f"{MARK}={mark}".encode()
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        # Of an ended one, and of another user's, nothing can be read.
        with contextlib.suppress(OSError):
            if sought in (folder / "environ").read_bytes().split(b"\0"):
                found.append(int(folder.name))
    return [pid for pid in found if pid != os.getpid()]


def last_words(file: Path) -> str:
    """Last line of a file, for a message; however long the file is, only its end is read."""
    with contextlib.suppress(OSError), file.open("rb") as said:
        said.seek(max(0, file.stat().st_size - 4096))
        lines = said.read().decode("utf-8", "replace").strip().splitlines()
        return f": {one_line(lines[-1])}" if lines else ""
    return ""


def one_line(text: str, longest: int = 200) -> str:
    """Words of others as one line that no terminal minds."""
    shown = "".join(c if c.isprintable() else " " for c in text[: 4 * longest])
    return " ".join(shown.split())[:longest]


def run_limited(arguments: Sequence[str], folder: Path, time_s: float, memory_mb: float) -> str:
    """Run a Python module (last argument: our id) in `folder` within limits; returns why it was lost, if it was."""
    said = folder / "said"
    process, mark = started(arguments, folder, said, stdin=subprocess.DEVNULL, cwd=folder)
    try:
        why = _watched(process, said, time_s, memory_mb)
    finally:
        end_with_children(process, mark)
    if not why and process.returncode:
        why = f"it ended the process {code_in_words(process.returncode)}{last_words(said)}"
    return why


def size_of(file: Path) -> int:
    """Bytes of a file; 0 where it has been removed."""
    with contextlib.suppress(OSError):
        return file.stat().st_size
    return 0


def _watched(process: subprocess.Popen[bytes], said: Path, time_s: float, memory_mb: float) -> str:
    import psutil

    started = time.monotonic()
    while not has_ended(process):
        with contextlib.suppress(psutil.Error):
            resident_mb = psutil.Process(process.pid).memory_info().rss / 1e6
            if resident_mb > memory_mb:
                return f"it held {resident_mb:.0f} MB, over the limit of {memory_mb:g} MB"
        if time.monotonic() - started > time_s:
            return f"it took over {time_s:g} s"
        if size_of(said) > LARGEST_SAID_BYTES:
            return f"it wrote over {LARGEST_SAID_BYTES // 1_000_000} MB to the terminal"
        time.sleep(POLL_S if time.monotonic() - started > 1.0 else POLL_S / 5.0)
    return ""


def code_in_words(code: int) -> str:
    """A return code of :class:`subprocess.Popen` in words.

    >>> code_in_words(7), code_in_words(-11)
    ('with code 7', 'by SIGSEGV')
    """
    if code >= 0:
        return f"with code {code}"
    known = -code in signal.Signals.__members__.values()
    return f"by {signal.Signals(-code).name}" if known else f"by signal {-code}"

"""A process and all its children under a watch: how long they take, and how much memory at most."""

from __future__ import annotations

import contextlib
import json
import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import psutil

POLL_S = 0.05
"""Looking at a tree of processes costs a millisecond or two, which others lack meanwhile."""

ROOT = Path(__file__).resolve().parents[1]
WARM_UP_LIMIT_S = 600.0
"""Time for what comes before the clock starts: imports, and kernels that are compiled for the first time."""


@dataclass(frozen=True)
class Watched:
    """What became of a process."""

    code: int
    wall_s: float
    peak_mb: float
    """Greatest sum of the resident memory of the tree that was seen; pages that processes share count for each."""
    processor_s: float = 0.0
    """Processor time of the process and of all children that were waited for."""
    ended: Literal["", "time", "memory"] = ""
    """Why it was ended, if it was."""
    last_words: str = ""
    """Last line of its standard error."""


def watch(
    command: Sequence[str], limit_s: float, memory_mb: float = float("inf"), clock: Path | None = None
) -> Watched:
    """Run a command (no shell) from the repository's root and wait for its end, or end it at a limit of time or of memory.

    The memory is that of the whole tree. The clock of the limit starts when the file `clock` appears; None: at once.
    """
    with tempfile.TemporaryFile() as errors:
        before_s, start = children_s(), time.perf_counter()
        process = subprocess.Popen(
            command, cwd=ROOT, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=errors,
            start_new_session=True, env=user_environment(),
        )  # fmt: skip
        try:
            peak_mb, ended = _wait(process, limit_s, memory_mb, clock)
        finally:
            _end(process)
        wall_s = time.perf_counter() - start
        errors.seek(0)
        lines = errors.read().decode("utf-8", "replace").strip().splitlines()
    last_words = lines[-1].strip().replace(f"{ROOT}{os.sep}", "") if lines else ""
    return Watched(process.returncode, wall_s, peak_mb, children_s() - before_s, ended, last_words)


def user_environment(*without: str) -> dict[str, str]:
    """Environment of a user's command: without what is named, and with bytecode, without which each process compiles all it
    imports."""
    return {key: value for key, value in os.environ.items() if key not in (*without, "PYTHONDONTWRITEBYTECODE")}


def children_s() -> float:
    """Processor time of all processes that this one has started and waited for, and of theirs."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def run_task(task: str, request: Mapping[str, Any], limit_s: float) -> dict[str, Any]:
    """Run a task of :mod:`benchmarks.worker` in a fresh process.

    The answer, with ``status`` ("done", "over", "failed"), ``why``, ``peak_mb`` of the tree, ``wall_s``, and the machine's ``load``
    before it.
    """
    with tempfile.TemporaryDirectory(prefix="ebamcheck-benchmark-") as name:
        folder = Path(name)
        (folder / "request.json").write_text(json.dumps({"task": task, **request}), encoding="utf-8")
        command = [sys.executable, "-m", "benchmarks.worker", name]
        load = os.getloadavg()[0]
        watched = watch(command, limit_s, clock=folder / "began")
        found: dict[str, Any] = {
            "load": round(load, 2), "status": "done", "why": "", "peak_mb": watched.peak_mb, "wall_s": watched.wall_s,
        }  # fmt: skip
        answer = folder / "answer.json"
        if watched.ended == "time":
            return {**found, "status": "over", "why": f"ended after {limit_s:g} s"}
        if watched.code or not answer.is_file():
            why = watched.last_words or f"ended with code {watched.code}"
            return {**found, "status": "failed", "why": why}
        answered = json.loads(answer.read_text(encoding="utf-8"))
    # The sampled peak can miss a short one of the process itself, which the kernel has counted.
    return {**found, **answered, "peak_mb": max(watched.peak_mb, answered.get("own_peak_mb", 0.0))}


def _wait(
    process: subprocess.Popen[bytes], limit_s: float, memory_mb: float, clock: Path | None
) -> tuple[float, Literal["", "time", "memory"]]:
    peak_mb = 0.0
    start = time.monotonic()
    running = clock is None
    while process.poll() is None:
        now_mb = _resident_mb(process.pid)
        peak_mb = max(peak_mb, now_mb)
        if not running and clock is not None and clock.exists():
            running, start = True, time.monotonic()
        if time.monotonic() - start > (limit_s if running else WARM_UP_LIMIT_S):
            return peak_mb, "time"
        if now_mb > memory_mb:
            return peak_mb, "memory"
        try:
            process.wait(POLL_S)
        except subprocess.TimeoutExpired:
            continue
    return peak_mb, ""


def _resident_mb(pid: int) -> float:
    """Resident memory of a process and all its children, MB."""
    total = 0
    try:
        root = psutil.Process(pid)
        family = [root, *root.children(recursive=True)]
    except psutil.Error:
        return 0.0
    for process in family:
        try:
            total += process.memory_info().rss
        except psutil.Error:
            continue
    return total / 1e6


def _end(process: subprocess.Popen[bytes]) -> None:
    """End what is left of the session that the process was started in."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()

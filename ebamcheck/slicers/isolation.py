"""One process per backend, with limits: a crash, a hang or a kill of one is a finding, not the end of a run.

The parent writes the part once as plain columns, gives each worker its order, and watches its resident memory and its
time; a worker writes its layers to a file, block by block.
"""

from __future__ import annotations

import contextlib
import json
import selectors
import signal
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import psutil
from numpy.typing import NDArray

from ebamcheck.backend import BackendSettings, Probe, Progress
from ebamcheck.errors import BackendFailed, BackendMissing, SettingsError
from ebamcheck.layers import files as layer_files
from ebamcheck.layers.stack import Layers
from ebamcheck.mesh.part import Part
from ebamcheck.numeric.kernels import thread_count
from ebamcheck.slicers.worker import write_part
from ebamcheck.slicers.worker_pool import Crew, Failure, Worker

POLL_S = 0.05
"""How often memory and time of the workers are looked at."""

CHILDREN_S = 1.0
"""How often processes that a worker has started are looked for."""


@dataclass(frozen=True)
class Limits:
    """What a backend's process may use, and how many there are at a time."""

    time_s: float = 600.0
    memory_mb: float = 8192.0
    processes: int | None = None
    """Processes side by side; None: as many as there are cores."""


@dataclass(frozen=True)
class Outcome:
    """What became of one backend."""

    name: str
    failure: Failure = ""
    why: str = ""
    file: Path | None = None
    """Where its layers lie; None where it failed."""
    probe: Probe = field(default_factory=lambda: Probe(False))
    error_bound_mm: float = 0.0
    height_bound_mm: float = 0.0
    rings: int = 0
    open_paths: int = 0
    points: int = 0
    prepare_s: float = 0.0
    slice_s: float = 0.0
    peak_mb: float = 0.0

    def made(self) -> Path:
        """File of its layers; raises what it failed of."""
        if self.file is None:
            kind = BackendMissing if self.failure == "unavailable" else BackendFailed
            raise kind(f"backend {self.name!r} {self.failure}: {self.why}")
        return self.file

    def read(self) -> Layers:
        """Read all its layers; raises what it failed of."""
        return layer_files.read_parquet(self.made())


def slice_isolated(
    name: str,
    part: Part,
    heights: NDArray[np.float64],
    settings: BackendSettings,
    limits: Limits | None = None,
    progress: Progress | None = None,
) -> Layers:
    """Slice with one backend in a process of its own; raises what its outcome says."""
    told = None if progress is None else (lambda _, done: progress(done))
    with tempfile.TemporaryDirectory(prefix="ebamcheck-") as folder:
        return slice_all(part, heights, {name: settings}, Path(folder), limits or Limits(), told)[name].read()


def slice_all(
    part: Part,
    heights: NDArray[np.float64],
    backends: Mapping[str, BackendSettings],
    target: Path,
    limits: Limits = Limits(),
    progress: Callable[[str, int], None] | None = None,
    finished: Callable[[Outcome], None] | None = None,
    borders: NDArray[np.int64] | None = None,
    crew: Crew | None = None,
) -> dict[str, Outcome]:
    """Slice with several backends, each in its own process.

    Parameters
    ----------
    part, heights
        The part as placed and strictly increasing heights (L,), mm.
    backends
        Settings of each backend to run, by name.
    target
        Folder for the layers, one file ``NAME.parquet`` a backend that comes to an end.
    limits
        Time and resident memory of each process, and how many run side by side.
    progress
        Called with a backend's name and the layers done since the last call.
    finished
        Called with each outcome as it comes in.
    borders
        Blocks of layers (:func:`~ebamcheck.layers.heights.layer_blocks`) that a backend cuts and writes one after the
        other; all at once if None.
    crew
        Workers that were started ahead; started here if None.

    Returns
    -------
    dict
        One outcome for every name, in the order given; none of them raises.

    Raises
    ------
    SettingsError
        If layers cannot be written to `target` (no permission, disk full).
    """
    outcomes: dict[str, Outcome] = {}
    with ExitStack() as opened:
        crew = crew or opened.enter_context(Crew())
        _write_work(crew.folder, part, heights, borders)
        waiting = list(backends)
        running: list[Worker] = []
        most = limits.processes or max(1, thread_count())
        try:
            while waiting or running:
                while waiting and len(running) < most:
                    name = waiting.pop(0)
                    running.append(_started(crew, name, backends[name], target))
                _listen(running, progress)
                for worker in list(running):
                    _enforce(worker, limits)
                    if worker.process.poll() is not None:
                        running.remove(worker)
                        outcome = _collect(worker)
                        outcomes[worker.name] = outcome
                        if finished is not None:
                            finished(outcome)
        finally:
            for worker in running:
                worker.end()
                worker.close()
                _discard(worker)
    return {name: outcomes[name] for name in backends}


def _write_work(
    folder: Path, part: Part, heights: NDArray[np.float64], borders: NDArray[np.int64] | None
) -> None:
    """Write what every worker needs, once."""
    write_part(folder, part)
    np.save(folder / "heights.npy", heights)
    np.save(folder / "borders.npy", np.array([0, heights.size]) if borders is None else borders)


def _started(crew: Crew, name: str, settings: BackendSettings, target: Path) -> Worker:
    """Give the worker of a backend its order."""
    worker = crew.worker(name)
    file = target.absolute() / f"{name}.parquet"
    worker.begin(
        {
            "backend": name,
            "folder": str(crew.folder),
            "file": str(file),
            "settings": settings.model_dump(mode="json"),
        }
    )
    return worker


def _listen(running: Sequence[Worker], progress: Callable[[str, int], None] | None) -> None:
    """Wait a moment for events and take in what has come."""
    with selectors.DefaultSelector() as selector:
        for worker in running:
            selector.register(worker.events, selectors.EVENT_READ, worker)
        ready = selector.select(POLL_S)
    if ready and all(
        key.data.process.poll() is not None or not _take_in(key.data, progress) for key, _ in ready
    ):
        # A closed pipe is always ready; its worker is about to end.
        time.sleep(POLL_S)


def _take_in(worker: Worker, progress: Callable[[str, int], None] | None) -> bool:
    """Read what a worker has told; false where its pipe is closed or empty."""
    some = False
    while chunk := worker.events.read(1 << 16):
        some = True
        worker.unread += chunk
    *lines, worker.unread = worker.unread.split(b"\n")
    for line in lines:
        event = json.loads(line)
        if "done" in event:
            if progress is not None:
                progress(worker.name, event["done"])
        else:
            worker.told.update(event)
    return some


def _enforce(worker: Worker, limits: Limits) -> None:
    """Kill a worker that has used up its time or its memory, and note which."""
    try:
        resident = _resident_mb(worker)
    except psutil.Error:
        return
    worker.peak_mb = max(worker.peak_mb, resident)
    if resident > limits.memory_mb:
        worker.failure = "out of memory"
        worker.why = (
            f"held {resident:.0f} MB, over the limit of {limits.memory_mb:.0f} MB (slicing.memory_limit_mb)"
        )
    elif time.monotonic() - worker.started > limits.time_s:
        worker.failure = "timed out"
        worker.why = f"took over {limits.time_s:g} s (slicing.time_limit_s)"
    if worker.failure:
        worker.end()


def _resident_mb(worker: Worker) -> float:
    """Resident memory of a worker and of what it started, MB."""
    used = psutil.Process(worker.process.pid)
    if time.monotonic() - worker.children_seen > CHILDREN_S:
        # A look at every process of the machine: dear, and hardly any backend starts one.
        worker.children, worker.children_seen = used.children(recursive=True), time.monotonic()
    total = used.memory_info().rss
    for child in worker.children:
        with contextlib.suppress(psutil.Error):
            total += child.memory_info().rss
    return float(total) / 1e6


def _collect(worker: Worker) -> Outcome:
    """Turn an ended worker into its outcome."""
    _take_in(worker, None)
    worker.close()
    told = worker.told
    outcome = Outcome(
        worker.name,
        probe=Probe(**told["probe"]) if "probe" in told else Probe(False),
        error_bound_mm=told.get("error_bound_mm", 0.0),
        height_bound_mm=told.get("height_bound_mm", 0.0),
        **{name: told.get(name, 0) for name in ("rings", "open_paths", "points")},
        prepare_s=told.get("prepare_s", 0.0),
        slice_s=told.get("slice_s", 0.0),
        peak_mb=max(worker.peak_mb, told.get("peak_mb", 0.0)),
    )
    code = worker.process.returncode
    if code or worker.failure:
        _discard(worker)
    if "unwritable" in told:
        raise SettingsError(told["unwritable"])
    if worker.failure:
        return replace(outcome, failure=worker.failure, why=worker.why)
    if "failure" in told:
        return replace(outcome, failure=told["failure"], why=told["why"])
    if code < 0:
        name = (
            signal.Signals(-code).name if -code in signal.Signals.__members__.values() else f"signal {-code}"
        )
        kind: Failure = "killed" if name in ("SIGKILL", "SIGTERM", "SIGINT", "SIGHUP") else "crashed"
        return replace(outcome, failure=kind, why=f"its process was ended by {name}{worker.last_words()}")
    if code > 0 or "written" not in told:
        return replace(
            outcome, failure="crashed", why=f"its process ended with code {code}{worker.last_words()}"
        )
    return replace(outcome, file=worker.file)


def _discard(worker: Worker) -> None:
    """Remove what a worker that was ended had begun to write."""
    for part in worker.file.parent.glob(f".{worker.file.name}.*.part"):
        part.unlink(missing_ok=True)

"""One process per backend, with limits on time and memory: a crash, a hang or a kill of one is a finding, not the end of a run."""

from __future__ import annotations

import contextlib
import json
import math
import os
import selectors
import subprocess
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Self

import numpy as np
import psutil

from ebamcheck.backend import BackendSettings, Progress
from ebamcheck.errors import BackendFailed, SettingsError
from ebamcheck.kernels import Floats, Ints
from ebamcheck.layers.stack import Layers
from ebamcheck.mesh.part import Part
from ebamcheck.plugins import processes, registry
from ebamcheck.scratch import scratch_folder
from ebamcheck.slicers.outcome import Failure, NoEvent, bounds_fault, event_of, file_fault, probe_of
from ebamcheck.slicers.outcome import Limits as Limits
from ebamcheck.slicers.outcome import Outcome as Outcome
from ebamcheck.slicers.worker import write_part
from ebamcheck.threads import thread_count

if TYPE_CHECKING:
    from ebamcheck.slicers.worker import Order

DEFAULT_LIMITS = Limits()
OVER_MEMORY = "held {:.0f} MB, over the limit of {:.0f} MB (slicing.memory_limit_mb)"

FIGURES = ("rings", "open_paths", "points", "prepare_s", "slice_s")  # what a worker tells of its layers
KILLS = ("SIGKILL", "SIGTERM", "SIGINT", "SIGHUP")  # signals that come from outside
POLL_S = 0.05  # how often memory and time of the workers are looked at
CHILDREN_S = 1.0  # how often processes that a worker has started are looked for
# What is read of one worker before its limits and the others are looked at
CHUNK_BYTES, MOST_CHUNKS = 1 << 16, 16
LONGEST_LINE_BYTES = 1_000_000  # an event is a line of a few hundred bytes
# More events than the first, and so much more for each second, are a flood: progress is some 1000 bytes a second
FLOOD_BYTES, FLOOD_BYTES_S = 4_000_000, 100_000


def slice_isolated(
    name: str, part: Part, heights: Floats, settings: BackendSettings, limits: Limits | None = None,
    progress: Progress | None = None,
) -> Layers:  # fmt: skip
    """Slice with one backend in a process of its own; raises what its outcome says."""
    told = None if progress is None else (lambda _, done: progress(done))
    with scratch_folder() as folder:
        return slice_all(part, heights, {name: settings}, folder, limits or Limits(), told)[name].read()


def bounds_of(outcomes: Mapping[str, Outcome]) -> dict[str, tuple[float, float]]:
    """Error bound and height bound, mm, that slicers declared for what they made."""
    return {name: (made.error_bound_mm, made.height_bound_mm) for name, made in outcomes.items()}


def declared_bounds(
    part: Part, backends: Mapping[str, BackendSettings], limits: Limits = DEFAULT_LIMITS
) -> dict[str, tuple[float, float]]:
    """Error bound and height bound of a part, mm, by backend; strangers are asked in processes of their own."""
    asked = {name: settings for name, settings in backends.items() if registry.is_stranger(name)}
    outcomes: dict[str, Outcome] = {}
    if asked:
        with scratch_folder() as folder:
            outcomes = slice_all(part, np.zeros(0), asked, folder, limits, bounds_only=True)
    for name, outcome in outcomes.items():
        if outcome.failure:
            raise BackendFailed(f"backend {name!r} {outcome.failure}: {outcome.why}")
    found = bounds_of(outcomes)
    for name in backends.keys() - asked:
        slicer, settings = registry.slicer(name), backends[name]
        found[name] = slicer.error_bound_mm(part, settings), slicer.height_bound_mm(part, settings)
    return found


def slice_all(
    part: Part, heights: Floats, backends: Mapping[str, BackendSettings], target: Path,
    limits: Limits = DEFAULT_LIMITS, progress: Callable[[str, int], None] | None = None,
    borders: Ints | None = None, pool: WorkerPool | None = None, keep_blocks: bool = False,
    bounds_only: bool = False, meanwhile: Callable[[], object] | None = None,
) -> dict[str, Outcome]:  # fmt: skip
    """Slice with several backends, each in its own process; returns one outcome for every name, in the order given.

    Heights (L,), mm, strictly increase; layers go to `target`, one file ``NAME.parquet`` a backend that comes to an end. `progress`
    takes a backend's name and the layers done since its last call. The blocks between `borders`
    (:func:`~ebamcheck.layers.heights.layer_blocks`) are cut one after the other; with `keep_blocks` they are kept until the file is
    whole, and those that a killed process left in `target` are taken. `pool` has workers that were started early. With
    `bounds_only` outcomes have no file. `meanwhile` is called once, when the first backends are at work, while nothing watches
    them. Only a `target` that cannot be written raises."""
    outcomes: dict[str, Outcome] = {}
    with ExitStack() as opened:
        pool = pool or opened.enter_context(WorkerPool())
        write_part(pool.folder, part)
        np.save(pool.folder / "heights.npy", heights)
        np.save(pool.folder / "borders.npy", np.array([0, heights.size]) if borders is None else borders)
        waiting = longest_first(backends)
        running: list[Worker] = []
        most = limits.processes or max(1, thread_count())
        try:
            while waiting or running:
                while waiting and len(running) < most:
                    name = waiting.pop(0)
                    worker = pool.worker(name)
                    worker.begin({
                        "backend": name, "folder": str(pool.folder), "file": str(target.absolute() / f"{name}.parquet"),
                        "settings": backends[name].model_dump(mode="json"),
                        "keep_blocks": keep_blocks, "bounds_only": bounds_only,
                    }, heights.size)  # fmt: skip
                    running.append(worker)
                if meanwhile is not None:
                    meanwhile()
                    meanwhile = None
                _listen(running, progress)
                for worker in list(running):
                    _enforce(worker, limits)
                    if processes.has_ended(worker.process):
                        running.remove(worker)
                        outcomes[worker.name] = _collect(worker, part, heights, limits)
        finally:
            for worker in running:
                worker.discard()
    return {name: outcomes[name] for name in backends}


def _listen(running: Sequence[Worker], progress: Callable[[str, int], None] | None) -> None:
    with selectors.DefaultSelector() as selector:
        for worker in running:
            selector.register(worker.events, selectors.EVENT_READ, worker)
        ready = [key.data for key, _ in selector.select(POLL_S)]
    # Each of them is heard, however much one tells.
    silent = [processes.has_ended(worker.process) or not _take_in(worker, progress) for worker in ready]
    if ready and all(silent):
        time.sleep(POLL_S)  # A closed pipe is always ready; its worker is about to end.


def _take_in(worker: Worker, progress: Callable[[str, int], None] | None) -> bool:
    """Read some of what a worker has told, so that none keeps the others waiting; false where its pipe is closed or empty."""
    some = False
    for _ in range(MOST_CHUNKS):
        if worker.failure or not (chunk := worker.events.read(CHUNK_BYTES)):
            break
        some = True
        worker.heard_bytes += len(chunk)
        *lines, worker.unread = (worker.unread + chunk).split(b"\n")
        try:
            for line in lines:
                worker.take(event_of(line), progress)
        except NoEvent as error:
            worker.lose("crashed", str(error))
        allowed = FLOOD_BYTES + FLOOD_BYTES_S * (time.monotonic() - worker.started)
        if len(worker.unread) > LONGEST_LINE_BYTES or worker.heard_bytes > allowed:
            worker.lose("crashed", f"told {worker.heard_bytes} bytes of events: a flood")
    return some


def _enforce(worker: Worker, limits: Limits) -> None:
    try:
        resident = _resident_mb(worker)
    except psutil.Error:
        return
    worker.peak_mb = max(worker.peak_mb, resident)
    if resident > limits.memory_mb:
        worker.lose("out of memory", OVER_MEMORY.format(resident, limits.memory_mb))
    elif time.monotonic() - worker.started > limits.time_s:
        worker.lose("timed out", f"took over {limits.time_s:g} s (slicing.time_limit_s)")
    elif processes.size_of(worker.errors) > processes.LARGEST_SAID_BYTES:
        worker.lose("crashed", f"wrote over {processes.LARGEST_SAID_BYTES // 1_000_000} MB to the terminal")


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


def _collect(worker: Worker, part: Part, heights: Floats, limits: Limits) -> Outcome:
    """Turn an ended worker into its outcome; nothing that it has left behind runs on."""
    worker.end()
    while _take_in(worker, None):
        pass
    worker.close()
    told = worker.told
    figures = {name: told[name] for name in FIGURES if name in told}
    for name in ("error_bound_mm", "height_bound_mm"):
        if abs(told.get(name, math.inf)) < math.inf:
            figures[name] = float(told[name])
    peak_mb = max(worker.peak_mb, told.get("peak_mb", 0.0))
    outcome = Outcome(worker.name, probe=probe_of(told), peak_mb=peak_mb, **figures)
    failure, why = _failure(worker, part, heights)
    if not failure and outcome.peak_mb > limits.memory_mb:
        # It came to its end between two looks.
        failure, why = "out of memory", OVER_MEMORY.format(outcome.peak_mb, limits.memory_mb)
    if "unwritable" in told and not worker.stranger:
        worker.discard()
        raise SettingsError(told["unwritable"])
    if not failure:
        return replace(outcome, file=None if worker.bounds_only else worker.file)
    worker.discard()
    worker.file.unlink(missing_ok=True)
    return replace(outcome, failure=failure, why=why)


def _failure(worker: Worker, part: Part, heights: Floats) -> tuple[Failure, str]:
    """What became of an ended worker, and why; nothing where its layers are good."""
    told, code = worker.told, worker.process.returncode
    if worker.failure:
        return worker.failure, worker.why
    if "failure" in told:
        return told["failure"], told["why"]
    if code < 0:
        ended = processes.code_in_words(code)
        kind: Failure = "killed" if ended.split()[-1] in KILLS else "crashed"
        return kind, f"its process was ended {ended}{processes.last_words(worker.errors)}"
    if code > 0 or not (told.get("written") or worker.bounds_only):
        return "crashed", f"its process ended with code {code}{processes.last_words(worker.errors)}"
    fault = bounds_fault(told, float(part.size.max()))
    if not fault and not worker.bounds_only:
        fault = file_fault(worker.file, part, heights, whole=worker.stranger)
    return ("crashed", fault) if fault else ("", "")


@dataclass
class Worker:
    """A process and what it has told so far."""

    name: str
    process: subprocess.Popen[bytes]
    events: IO[bytes]
    errors: Path  # where its standard error goes
    file: Path = Path()  # where its layers go, once it has an order
    started: float = 0.0
    told: dict[str, Any] = field(default_factory=dict)
    unread: bytes = b""
    failure: Failure = ""
    why: str = ""
    peak_mb: float = 0.0
    mark: str = ""  # what it and its descendants carry in their environment
    # It runs another distribution's code: its descendants are looked for outside of its group, too
    stranger: bool = False
    heard_bytes: int = 0
    layers: int = 0  # layers that it was asked for
    done: int = 0
    bounds_only: bool = False
    children: list[psutil.Process] = field(default_factory=list)
    children_seen: float = 0.0

    def begin(self, order: Order, layers: int) -> None:
        """Give the worker its order; its time counts from here."""
        self.file, self.bounds_only, self.layers = Path(order["file"]), order["bounds_only"], layers
        self.stranger, self.started = registry.is_stranger(self.name), time.monotonic()
        assert self.process.stdin is not None
        # A worker that has ended already is found out by whoever waits for it.
        with contextlib.suppress(BrokenPipeError), self.process.stdin as orders:
            orders.write(json.dumps(order).encode() + b"\n")

    def take(self, event: dict[str, Any], progress: Callable[[str, int], None] | None) -> None:
        """Take one event in; progress beyond the work that there is counts for nothing."""
        if "done" not in event:
            self.told.update(event)
            return
        done = min(event["done"], self.layers - self.done)
        self.done += done
        if progress is not None and done:
            progress(self.name, done)

    def lose(self, failure: Failure, why: str) -> None:
        """End it for a reason; the first one counts."""
        if not self.failure:
            self.failure, self.why = failure, why
        self.end()

    def end(self) -> None:
        """End the process and everything that it started; of one that has ended, what it has left behind."""
        processes.end_with_children(self.process, self.mark if self.stranger else "")

    def close(self) -> None:
        """Close the pipes to the process."""
        self.events.close()
        if self.process.stdin is not None:
            self.process.stdin.close()

    def discard(self) -> None:
        """End it, and remove what it has begun to write."""
        self.end()
        self.close()
        for part in self.file.parent.glob(f".{self.file.name}.*.part"):
            part.unlink(missing_ok=True)


class WorkerPool:
    """Workers, those of backends in `ahead` started at once, and their folder; those without an order end with it."""

    def __init__(self, ahead: Iterable[str] = ()) -> None:
        self._opened = ExitStack()
        self.folder = self._opened.enter_context(scratch_folder())
        self._count = 0
        self._idle = {name: self._start(name) for name in dict.fromkeys(ahead)}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.dismiss()
        self._opened.close()

    def dismiss(self) -> None:
        """End the workers that got no order."""
        while self._idle:
            _, worker = self._idle.popitem()
            worker.end()
            worker.close()

    def worker(self, name: str) -> Worker:
        """Take the worker of a backend, whose name it carries in a list of processes: the one that waits, or a new one."""
        return self._idle.pop(name, None) or self._start(name)

    def _start(self, name: str) -> Worker:
        read, write = os.pipe()
        self._count += 1
        # What a worker that is killed leaves behind goes with the pool's own folder; one that clears its folder for
        # temporary files takes nothing from the others.
        errors, own = self.folder / f"stderr-{self._count}", self.folder / f"tmp-{self._count}"
        own.mkdir()
        arguments = ["ebamcheck.slicers.worker", name, str(write)]
        process, mark = processes.started(arguments, own, errors, stdin=subprocess.PIPE, pass_fds=(write,))
        os.close(write)
        os.set_blocking(read, False)
        return Worker(name, process, os.fdopen(read, "rb", buffering=0), errors, mark=mark)


def longest_first(names: Iterable[str]) -> list[str]:
    """Slicers in the order in which they begin: those that are not exact cast rays and take longest."""
    return sorted(names, key=lambda name: registry.slicer(name).exact)

"""One process per backend, with limits: a crash, a hang or a kill of one is a finding, not the end of a run.

The parent writes the part once as memory-mapped columns, starts ``python -m ebamcheck.isolate NAME FOLDER`` for each
backend, and watches its resident memory and its time. The worker writes its layers to a file, block by block, and tells
one JSON line an event.
"""

from __future__ import annotations

import contextlib
import ctypes
import itertools
import json
import os
import selectors
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import IO, Any, Literal

import numpy as np
import psutil
from numpy.typing import NDArray

from ebamcheck import layer_files, registry
from ebamcheck.backend import BackendSettings, Prepared, Probe, Progress
from ebamcheck.errors import BackendFailed, BackendMissing, EbamcheckError, SettingsError
from ebamcheck.kernels import thread_count
from ebamcheck.layers import Layers
from ebamcheck.part import Part

POLL_S = 0.05
"""How often memory and time of the workers are looked at."""
PR_SET_PDEATHSIG = 1
"""Number of Linux's request, from <linux/prctl.h>."""

CHILDREN_S = 1.0
"""How often processes that a worker has started are looked for."""

Failure = Literal["", "unavailable", "refused", "crashed", "timed out", "out of memory", "killed"]


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
    prepare_s: float = 0.0
    slice_s: float = 0.0
    peak_mb: float = 0.0

    def read(self) -> Layers:
        """Read all its layers; raises what it failed of."""
        if self.file is None:
            kind = BackendMissing if self.failure == "unavailable" else BackendFailed
            raise kind(f"backend {self.name!r} {self.failure}: {self.why}")
        return layer_files.read_parquet(self.file)


@dataclass
class _Worker:
    """A running process and what it has told so far."""

    name: str
    process: subprocess.Popen[bytes]
    events: IO[bytes]
    folder: Path
    file: Path
    started: float
    told: dict[str, Any] = field(default_factory=dict)
    unread: bytes = b""
    failure: Failure = ""
    why: str = ""
    peak_mb: float = 0.0
    children: list[psutil.Process] = field(default_factory=list)
    children_seen: float = 0.0


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
        Blocks of layers (:func:`~ebamcheck.heights.layer_blocks`) that a backend cuts and writes one after the
        other; all at once if None.

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
    with tempfile.TemporaryDirectory(prefix="ebamcheck-") as base:
        shared = Path(base)
        _write_part(shared, part, heights)
        np.save(shared / "borders.npy", np.array([0, heights.size]) if borders is None else borders)
        waiting = list(backends)
        running: list[_Worker] = []
        most = limits.processes or max(1, thread_count())
        try:
            while waiting or running:
                while waiting and len(running) < most:
                    name = waiting.pop(0)
                    running.append(_start(name, backends[name], shared, target))
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
                _kill(worker.process)
                worker.events.close()
                _discard(worker)
    return {name: outcomes[name] for name in backends}


def _write_part(folder: Path, part: Part, heights: NDArray[np.float64]) -> None:
    np.save(folder / "vertices.npy", part.vertices)
    np.save(folder / "faces.npy", part.faces)
    np.save(folder / "heights.npy", heights)
    labels = {
        "name": part.name,
        "source": part.source,
        "source_sha256": part.source_sha256,
        "units": part.units,
        "direction": list(part.direction),
        "sha256": part.sha256,
    }
    (folder / "part.json").write_text(json.dumps(labels), encoding="utf-8")


def _read_part(folder: Path) -> Part:
    labels = json.loads((folder / "part.json").read_text(encoding="utf-8"))
    sha256 = labels.pop("sha256")
    labels["direction"] = tuple(labels["direction"])
    # Read whole, not mapped: compiled kernels know plain arrays only.
    part = Part(np.load(folder / "vertices.npy"), np.load(folder / "faces.npy"), **labels)
    part.__dict__["sha256"] = sha256
    return part


def _start(name: str, settings: BackendSettings, shared: Path, target: Path) -> _Worker:
    folder = shared / name
    folder.mkdir()
    (folder / "settings.json").write_text(settings.model_dump_json(), encoding="utf-8")
    file = target.absolute() / f"{name}.parquet"
    read, write = os.pipe()
    with (folder / "stderr").open("wb") as errors:
        process = subprocess.Popen(
            [
                sys.executable,
                "-m",
                "ebamcheck.isolate",
                name,
                str(folder),
                str(file),
                str(write),
                str(os.getpid()),
            ],
            stdin=subprocess.DEVNULL,
            stdout=errors,
            stderr=errors,
            pass_fds=(write,),
            start_new_session=True,
        )
    os.close(write)
    os.set_blocking(read, False)
    return _Worker(name, process, os.fdopen(read, "rb", buffering=0), folder, file, time.monotonic())


def _listen(running: Sequence[_Worker], progress: Callable[[str, int], None] | None) -> None:
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


def _take_in(worker: _Worker, progress: Callable[[str, int], None] | None) -> bool:
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


def _enforce(worker: _Worker, limits: Limits) -> None:
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
        _kill(worker.process)


def _resident_mb(worker: _Worker) -> float:
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


def _kill(process: subprocess.Popen[bytes]) -> None:
    """End a worker and everything that it started."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def _collect(worker: _Worker) -> Outcome:
    """Turn an ended worker into its outcome."""
    _take_in(worker, None)
    worker.events.close()
    told = worker.told
    outcome = Outcome(
        worker.name,
        probe=Probe(**told["probe"]) if "probe" in told else Probe(False),
        error_bound_mm=told.get("error_bound_mm", 0.0),
        height_bound_mm=told.get("height_bound_mm", 0.0),
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
        return replace(
            outcome, failure=kind, why=f"its process was ended by {name}{_last_words(worker.folder)}"
        )
    if code > 0 or "written" not in told:
        return replace(
            outcome, failure="crashed", why=f"its process ended with code {code}{_last_words(worker.folder)}"
        )
    return replace(outcome, file=worker.file)


def _discard(worker: _Worker) -> None:
    """Remove what a worker that was ended had begun to write."""
    for part in worker.file.parent.glob(f".{worker.file.name}.*.part"):
        part.unlink(missing_ok=True)


def _last_words(folder: Path) -> str:
    """Last line that a worker wrote to its standard error, for a message."""
    text = (folder / "stderr").read_text(encoding="utf-8", errors="replace").strip().splitlines()
    return f": {text[-1].strip()[:200]}" if text else ""


# -- the worker's side ---------------------------------------------------------------------------------


def _work(name: str, folder: Path, file: Path, tell: Callable[..., None]) -> None:
    """Slice in this process and tell the parent how it goes."""
    probe = registry.probe(name)
    tell(probe={**asdict(probe), "versions": dict(probe.versions)})
    if not probe.available:
        tell(failure="unavailable", why=f"{probe.why}{f'; {probe.hint}' if probe.hint else ''}")
        return
    slicer = registry.slicer(name)
    settings = slicer.Settings.model_validate_json((folder / "settings.json").read_text(encoding="utf-8"))
    part = _read_part(folder.parent)
    heights = np.load(folder.parent / "heights.npy")
    tell(
        error_bound_mm=float(slicer.error_bound_mm(part, settings)),
        height_bound_mm=float(slicer.height_bound_mm(part, settings)),
    )
    borders = np.load(folder.parent / "borders.npy")
    start = time.perf_counter()
    try:
        with slicer.prepare(part, settings) as prepared:
            tell(prepare_s=time.perf_counter() - start)
            _write(_blocks(prepared, heights, borders, tell), file, tell)
    except EbamcheckError as error:
        tell(failure="refused", why=str(error))
        return
    except MemoryError:
        tell(failure="out of memory", why="an allocation failed")
        return
    tell(peak_mb=_peak_mb())


def _write(blocks: Iterator[Layers], file: Path, tell: Callable[..., None]) -> None:
    """Write what the slicer gives, and tell a file that cannot be written from a slicer that refuses."""
    try:
        layer_files.write_blocks(blocks, file)
    except SettingsError as error:
        tell(unwritable=str(error))
    else:
        tell(written=True)


def _blocks(
    prepared: Prepared, heights: NDArray[np.float64], borders: NDArray[np.int64], tell: Callable[..., None]
) -> Iterator[Layers]:
    """Cut one block of layers after the other; the time that is told is that of the slicer alone."""
    seconds = 0.0
    for first, past in itertools.pairwise(borders.tolist()):
        start = time.perf_counter()
        try:
            layers = prepared.slice(heights[first:past], lambda done: tell(done=done))
        except (EbamcheckError, OSError) as error:
            raise BackendFailed(str(error)) from error
        seconds += time.perf_counter() - start
        tell(slice_s=seconds)
        yield layers
        del layers  # so that there are never two blocks in memory


def _peak_mb() -> float:
    """Largest resident memory of this process, MB (what ``getrusage`` tells includes the parent before the exec)."""
    with contextlib.suppress(OSError), open("/proc/self/status", encoding="ascii") as status:
        for line in status:
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) * 1024 / 1e6
    return 0.0


@contextlib.contextmanager
def _teller(pipe: int) -> Iterator[Callable[..., None]]:
    """A function that writes its keywords as one JSON line; progress is thinned to a few lines a second."""
    pending = 0
    last = 0.0
    with os.fdopen(pipe, "wb", buffering=0) as out:

        def tell(**event: Any) -> None:
            nonlocal pending, last
            if "done" in event:
                pending += event["done"]
                if time.monotonic() - last < POLL_S:
                    return
                last, event, pending = time.monotonic(), {"done": pending}, 0
            elif pending:
                out.write(json.dumps({"done": pending}).encode() + b"\n")
                pending = 0
            out.write(json.dumps(event).encode() + b"\n")

        yield tell


def _die_with(parent: int) -> None:
    """Have the kernel end this process when its parent ends, however that ends."""
    libc = ctypes.CDLL(None)
    if hasattr(libc, "prctl"):
        libc.prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != parent:
            sys.exit("the parent has ended")


def main(arguments: Sequence[str]) -> int:
    """Entry point of a worker: backend name, its folder, the file to write, descriptor of the event pipe, its parent's id."""
    name, folder, file, pipe, parent = arguments
    _die_with(int(parent))
    # A worker whose parent is gone gets no answer any more and must not run on.
    with _teller(int(pipe)) as tell, contextlib.suppress(BrokenPipeError):
        _work(name, Path(folder), Path(file), tell)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

"""A job in its run folder: begun under a fingerprint, carried out, and what it came to; and the observers of its progress."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError, Executor
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from threading import Event
from typing import Any, Protocol

from ebamcheck.errors import ExitCode, SettingsError
from ebamcheck.json_values import sha256_of_json
from ebamcheck.kernels import Floats
from ebamcheck.mesh.inspection import Inspection
from ebamcheck.mesh.part import Part
from ebamcheck.record.run_folder import RunFolder, RunInProgress, finished_run, start_run
from ebamcheck.result import Check, gate_of_record
from ebamcheck.settings.config import Config
from ebamcheck.slicers.isolation import WorkerPool
from ebamcheck.threads import worker_threads
from ebamcheck.version import __version__


class Observer(Protocol):
    """Whoever watches a run."""

    def stage(self, name: str, total: int) -> None:
        """Tell that a stage of `total` steps begins."""

    def advance(self, steps: int) -> None:
        """Tell that steps of the stage are done."""

    def note(self, text: str) -> None:
        """Tell how it goes, in a line; what a person has to know of the result is a finding."""


class Silent:
    """Watches without a word."""

    def stage(self, name: str, total: int) -> None:
        """Ignore it."""

    def advance(self, steps: int) -> None:
        """Ignore it."""

    def note(self, text: str) -> None:
        """Ignore it."""


@dataclass
class Job:
    """A run in progress: its parts as they come to be."""

    kind: str  # what is asked for: ``run``, or ``check`` without a program
    config: Config
    observer: Observer
    part: Part
    found: Inspection
    heights: Floats
    folder: RunInProgress = field(init=False)
    fingerprint: str = field(init=False)  # hash of part, settings and version: of what this is a run
    timings: dict[str, float] = field(default_factory=dict)
    # Layer, from 1, at which a second program begins, to go on after a break; 1: none is written
    from_layer: int = 1
    # Workers for the slicers that were spawned early; None: they are when they are needed
    workers: WorkerPool | None = None
    live: bool = False  # whether a main program that waits between layers is written, too
    # Set where the run has ended by an error or an interrupt while work goes on beside it
    ended: Event = field(default_factory=Event)

    def go_on(self) -> None:
        """Raise CancelledError where the run has ended meanwhile; to be called between the steps of work beside the stages."""
        if self.ended.is_set():
            raise CancelledError

    @contextmanager
    def stage(self, name: str, total: int) -> Iterator[None]:
        """Time a stage and tell the observer of it."""
        self.observer.stage(name, total)
        with self.beside(name):
            yield

    @contextmanager
    def beside(self, name: str) -> Iterator[None]:
        """Time what goes on beside a stage."""
        start = time.perf_counter()
        yield
        self.timings[name] = time.perf_counter() - start


@contextmanager
def one_beside(ended: Event | None = None) -> Iterator[Executor]:
    """One thread beside this one; where the block ends with an error or an interrupt, what has not begun is dropped, and `ended` is
    set for the rest."""
    with worker_threads(1) as pool:
        try:
            yield pool
        except BaseException:
            if ended is not None:
                ended.set()
            pool.shutdown(wait=False, cancel_futures=True)
            raise


@dataclass(frozen=True)
class RunResult:
    """What a run came to."""

    folder: RunFolder
    gates: tuple[Check, ...]
    exit_code: ExitCode
    manifest: Mapping[str, Any] = field(repr=False)

    @classmethod
    def of(cls, run: RunFolder) -> RunResult:
        """What a finished run came to, by its record."""
        manifest = run.manifest()
        gates = tuple(gate_of_record(gate) for gate in manifest["gates"])
        return cls(run, gates, ExitCode(manifest["exit_code"]), manifest)


def carried_out(
    job: Job,
    what: str,
    sha256: str,
    backends: Iterable[str],
    inputs: Sequence[Any],
    target: str | Path,
    work: Callable[[Job], RunResult],
    *,
    resume: bool,
    force: bool,
    keep_layers: bool = True,
) -> RunResult:
    """Carry a job out in its run folder; a finished run of the same is returned where `resume` asks for it.

    `what`, `sha256`, `backends` and `inputs` make it another job than others, beside settings, heights and version. Layers that a
    killed run left are gone on with unless `keep_layers` is off."""
    target, observer = Path(target), job.observer
    of_job = [job.config.model_dump(), job.heights, list(backends), __version__]
    job.fingerprint = sha256_of_json([what, sha256, *of_job, *inputs])
    if resume and not force and (done := finished_run(target, job.fingerprint)) is not None:
        observer.note(f"{target}: is finished already")
        return RunResult.of(done)
    job.folder = start_run(target, job.fingerprint, resume and keep_layers, force)
    if job.folder.former is not None:
        observer.note(f"{target}: the former run will be kept as {job.folder.former.name}")
    try:
        return work(job)
    except OSError as error:
        raise SettingsError(f"{job.folder.path}: cannot be written: {error.strerror or error}") from error
    finally:
        job.folder.release()

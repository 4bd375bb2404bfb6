"""The context of a run in progress, and the observers of its progress."""

from __future__ import annotations

import time
from collections.abc import Iterator
from concurrent.futures import CancelledError, Executor
from contextlib import contextmanager
from dataclasses import dataclass, field
from threading import Event
from typing import Protocol

from ebamcheck.mesh.inspection import Inspection
from ebamcheck.mesh.part import Part
from ebamcheck.numeric import compiling
from ebamcheck.numeric.kernels import worker_threads
from ebamcheck.numeric.rings import Floats
from ebamcheck.record.run_folder import RunInProgress
from ebamcheck.result import Check
from ebamcheck.settings.config import Config
from ebamcheck.slicers.worker_pool import WorkerPool


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

    kind: str
    """What is asked for: ``run``, or ``check`` without a program."""
    config: Config
    observer: Observer
    part: Part
    found: Inspection
    heights: Floats
    folder: RunInProgress
    fingerprint: str = ""
    """Hash of part, settings and version: of what this is a run."""
    compile_s: float = 0.0
    """Time in which this process compiled kernels; it is in none of the stages."""
    timings: dict[str, float] = field(default_factory=dict)
    findings: list[Check] = field(default_factory=list)
    from_layer: int = 1
    """Layer, from 1, at which a second program begins, to go on after a break; 1: none is written."""
    workers: WorkerPool | None = None
    """Workers for the slicers that were spawned early; None: they are when they are needed."""
    live: bool = False
    """Whether a main program that waits between layers is written, too."""
    ended: Event = field(default_factory=Event)
    """Set where the run has ended by an error or an interrupt while work goes on beside it."""

    def go_on(self) -> None:
        """Leave work beside the stages where the run has ended meanwhile; to be called between its steps.

        Raises
        ------
        CancelledError
            Where it has: nobody asks for the result any more.
        """
        if self.ended.is_set():
            raise CancelledError

    def add_finding(self, *findings: Check) -> None:
        """Add what a person has to know of this job, whatever becomes of its gates."""
        self.findings.extend(findings)

    @contextmanager
    def stage(self, name: str, total: int) -> Iterator[None]:
        """Time a stage and tell the observer of it."""
        self.observer.stage(name, total)
        compiled = compiling.seconds()
        with self.beside(name):
            yield
        self.compile_s += compiling.seconds() - compiled

    @contextmanager
    def beside(self, name: str) -> Iterator[None]:
        """Time what goes on beside a stage; kernels that are compiled meanwhile count for the stage alone."""
        start, compiled = time.perf_counter(), compiling.seconds()
        yield
        self.timings[name] = time.perf_counter() - start - (compiling.seconds() - compiled)


@contextmanager
def one_beside(ended: Event | None = None) -> Iterator[Executor]:
    """One thread beside this one; where the block ends with an error or an interrupt, what has not begun is dropped.

    Parameters
    ----------
    ended
        Set then, so that what has begun can stop.
    """
    with worker_threads(1) as pool:
        try:
            yield pool
        except BaseException:
            if ended is not None:
                ended.set()
            pool.shutdown(wait=False, cancel_futures=True)
            raise

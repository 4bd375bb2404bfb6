"""Worker pool: worker processes are spawned early, so that their imports run while the part is read and the stages are loaded."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import time
from collections.abc import Iterable
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Self

from ebamcheck.plugins import registry
from ebamcheck.plugins.processes import end_with_children, started
from ebamcheck.scratch import scratch_folder

if TYPE_CHECKING:
    # A pool is there to start before such imports, not after them.
    import psutil

    from ebamcheck.slicers.outcome import Failure
    from ebamcheck.slicers.worker import Order


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
    stranger: bool = False
    """It runs another distribution's code: its descendants are looked for outside of its group, too."""
    heard_bytes: int = 0
    layers: int = 0  # layers that it was asked for
    done: int = 0
    bounds_only: bool = False
    children: list[psutil.Process] = field(default_factory=list)
    children_seen: float = 0.0

    def begin(self, order: Order) -> None:
        """Give the worker its order; its time counts from here."""
        self.file, self.started = Path(order["file"]), time.monotonic()
        assert self.process.stdin is not None
        # A worker that has ended already is found out by whoever waits for it.
        with contextlib.suppress(BrokenPipeError), self.process.stdin as orders:
            orders.write(json.dumps(order).encode() + b"\n")

    def lose(self, failure: Failure, why: str) -> None:
        """End it for a reason; the first one counts."""
        if not self.failure:
            self.failure, self.why = failure, why
        self.end()

    def end(self) -> None:
        """End the process and everything that it started; of one that has ended, what it has left behind."""
        end_with_children(self.process, self.mark if self.stranger else "")

    def close(self) -> None:
        """Close the pipes to the process."""
        self.events.close()
        if self.process.stdin is not None:
            self.process.stdin.close()


class WorkerPool:
    """Workers, and the folder where they find their work; those that got no order are ended with it.

    The workers of backends in `ahead` are started at once, others when they are asked for.
    """

    def __init__(self, ahead: Iterable[str] = ()) -> None:
        self._opened = ExitStack()
        self.folder = self._opened.enter_context(scratch_folder())
        """Folder of this pool alone."""
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
        waiting = self._idle.pop(name, None)
        return waiting if waiting is not None else self._start(name)

    def _start(self, name: str) -> Worker:
        read, write = os.pipe()
        self._count += 1
        # What a worker that is killed leaves behind goes with the pool's own folder; one that clears its folder for
        # temporary files takes nothing from the others.
        errors, own = self.folder / f"stderr-{self._count}", self.folder / f"tmp-{self._count}"
        own.mkdir()
        arguments = ["ebamcheck.slicers.worker", name, str(write)]
        process, mark = started(arguments, own, errors, stdin=subprocess.PIPE, pass_fds=(write,))
        os.close(write)
        os.set_blocking(read, False)
        return Worker(name, process, os.fdopen(read, "rb", buffering=0), errors, mark=mark)


def longest_first(names: Iterable[str]) -> list[str]:
    """Names of slicers in the order in which they are to begin: those that are not exact cast rays, and take longest.

    What ends last is short then, and no core waits long for it.
    """
    return sorted(names, key=lambda name: registry.slicer(name).exact)

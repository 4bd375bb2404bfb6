"""Progress on a terminal: one bar a stage; where the output is no terminal, a line now and then while kernels compile."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from ebamcheck.printable import printable

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress, TaskID


class LineObserver:
    """Shows what is noted of a run, line by line on standard error."""

    def stage(self, name: str, total: int) -> None:
        """Show nothing: a bar is for terminals."""

    def advance(self, steps: int) -> None:
        """Show nothing."""

    def note(self, text: str) -> None:
        """Print a line."""
        print(f"ebamcheck: {printable(text)}", file=sys.stderr)


class TerminalObserver:
    """Shows the stages of a run on a terminal."""

    def __init__(self, bars: Progress) -> None:
        self._bars = bars
        self._task: TaskID | None = None

    def stage(self, name: str, total: int) -> None:
        """Finish the bar of the last stage and begin one."""
        self.finish()
        self._task = self._bars.add_task(name, total=max(total, 1))

    def advance(self, steps: int) -> None:
        """Move the bar of the stage."""
        if self._task is not None:
            self._bars.advance(self._task, steps)

    def note(self, text: str) -> None:
        """Print a line above the bars."""
        self._bars.console.print(
            f"ebamcheck: {printable(text)}", markup=False, highlight=False, soft_wrap=True
        )

    def finish(self) -> None:
        """Fill the bar of the last stage."""
        if self._task is not None:
            task = self._bars.tasks[self._task]
            self._bars.update(self._task, completed=task.total)


@contextmanager
def watched() -> Iterator[LineObserver | TerminalObserver]:
    """Show progress while the block runs."""
    if not may_be_terminal():
        with announced():
            yield LineObserver()
        return
    with _terminal_bars() as bars, announced(bars):
        observer = TerminalObserver(bars)
        yield observer
        observer.finish()


def may_be_terminal() -> bool:
    """Whether bars may be shown: what shows them takes a tenth of a second to load."""
    return sys.stderr.isatty() or any(os.environ.get(name) for name in ("FORCE_COLOR", "TTY_COMPATIBLE"))


def _terminal_bars() -> Progress:
    from rich.console import Console

    return _bars(Console(stderr=True))


def _bars(console: Console) -> Progress:
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (
        TextColumn("{task.description:>20}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeElapsedColumn(),
    )
    return Progress(*columns, console=console, disable=not console.is_terminal)


# -- kernels that are compiled -------------------------------------------------------------------------

LINE_EVERY_S = 15.0  # where there is no terminal, a line about kernels is written no more often than this


class Announcer:
    """Tells on standard error which kernel is compiled: by a bar on a terminal (`bars` are those that are shown anyway), else by a line now and then."""

    def __init__(self, bars: Progress | None = None) -> None:
        self._bars = bars
        self._task: TaskID | None = None
        self._began = self._told = 0.0
        self._number = 0
        self._is_ours = False

    def kernel(self, number: int, most: int, name: str) -> None:
        """Tell of a kernel that is begun: the `number`-th, of `most` at most."""
        now = time.monotonic()
        text = f"compiling (once): kernel {number} of at most {most}"
        first, self._number = not self._number, number
        if first:
            self._began = now
            if self._bars is None and may_be_terminal():
                self._bars = _terminal_bars()
        if self._bars is not None and self._bars.console.is_terminal:
            if self._task is None:
                self._is_ours = not self._bars.live.is_started
                self._bars.start()
                self._task = self._bars.add_task(text, total=most)
            self._bars.update(self._task, description=text, completed=number - 1, total=most)
        elif first or now - self._told > LINE_EVERY_S:
            self._told = now
            print(f"ebamcheck: {printable(text)}", file=sys.stderr, flush=True)

    def close(self) -> None:
        """Say what was compiled, if anything was."""
        if not self._number:
            return
        if self._bars is not None and self._task is not None:
            self._bars.update(self._task, completed=self._number, total=self._number)
            self._bars.remove_task(self._task)
            if self._is_ours:
                self._bars.stop()
        counted = f"{self._number} kernel{'' if self._number == 1 else 's'}"
        took = time.monotonic() - self._began
        print(
            f"ebamcheck: compiled {counted} within {took:.0f} s; they are kept for the next time",
            file=sys.stderr,
        )


@contextmanager
def announced(bars: Progress | None = None) -> Iterator[None]:
    """Compile kernels beside the block, and tell of those that are compiled; `bars` are those that are shown anyway."""
    from ebamcheck.numeric import compiling
    from ebamcheck.numeric.compiling_beside import compiled_beside

    announcer = Announcer(bars)
    try:
        with compiling.heard_by(announcer.kernel), compiled_beside():
            yield
    finally:
        announcer.close()

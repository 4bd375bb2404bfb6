"""Progress on a terminal: one bar a stage; where the output is no terminal, what is noted line by line."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from ebamcheck.commands.warm import warm_kernels
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
    """Show progress while the block runs, which begins with all kernels compiled."""
    warm_kernels()
    if not may_be_terminal():
        yield LineObserver()
        return
    with _terminal_bars() as bars:
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

"""Progress on a terminal: one bar a stage; silent where the output is no terminal."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn


class TerminalObserver:
    """Shows the stages of a run on standard error."""

    def __init__(self, bars: Progress) -> None:
        self._bars = bars
        self._task: TaskID | None = None

    def stage(self, name: str, total: int) -> None:
        """Finish the bar of the last stage and begin one."""
        self._finish()
        self._task = self._bars.add_task(name, total=max(total, 1))

    def advance(self, steps: int) -> None:
        """Move the bar of the stage."""
        if self._task is not None:
            self._bars.advance(self._task, steps)

    def note(self, text: str) -> None:
        """Print a line above the bars."""
        if self._bars.console.is_terminal:
            self._bars.console.print(f"ebamcheck: {text}", markup=False, highlight=False, soft_wrap=True)
        else:
            print(f"ebamcheck: {text}", file=sys.stderr)

    def _finish(self) -> None:
        if self._task is not None:
            task = self._bars.tasks[self._task]
            self._bars.update(self._task, completed=task.total)


@contextmanager
def watched() -> Iterator[TerminalObserver]:
    """Show progress while the block runs."""
    console = Console(stderr=True)
    columns = (
        TextColumn("{task.description:>20}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=console, disable=not console.is_terminal) as bars:
        observer = TerminalObserver(bars)
        yield observer
        observer._finish()

"""What a target is, and what becomes of it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from benchmarks.figures import cell_times, find
from benchmarks.spread import Spread, quantity, spread, spread_text

Raw = Mapping[str, Any]
SLICE = ("prepare_s", "slice_s")


@dataclass(frozen=True)
class Figures:
    """The raw figures of one series: its cells, and its tasks on the part at the top."""

    cells: Sequence[Raw]
    tasks: Mapping[str, Sequence[Raw]]
    parts: Mapping[str, Raw]
    series: str
    top: int
    copy_bytes_s: float | None = None
    """Copy bandwidth of the machine; None where it was not measured."""
    touch_bytes_s: float | None = None
    """Bytes of new memory that it gives in a second; None where it was not measured."""
    cores: int | None = None
    """Processors over which work can be spread; None where that is not known."""

    def times(self, method: str, steps: Iterable[str] = SLICE) -> Spread | None:
        """Times of a method at the top."""
        return cell_times(find(self.cells, f"{self.series}-{self.top}", method), steps)

    def told(self, task: str, value: Callable[[Raw], float]) -> Spread | None:
        """A value of every answer of a task; None where one of them failed."""
        answers = self.tasks.get(task, [])
        if not answers or any(a["status"] != "done" for a in answers):
            return None
        return spread(value(a) for a in answers)

    def why(self, task: str) -> str:
        """Why a task has no figures."""
        answers = self.tasks.get(task, [])
        return next((f"{a['status']}: {a['why']}" for a in answers if a["status"] != "done"), "not measured")


@dataclass(frozen=True)
class Target:
    """One row.

    Parameters
    ----------
    key
        Name of its remark.
    what
        What is measured.
    limit, unit
        The figure must not be greater; None: there is no target, the row is told.
    measure
        Reads it from the figures; None where it was not measured.
    task
        The task that it comes from, to say why there is none.
    """

    key: str
    what: str
    limit: float | None
    unit: str
    measure: Callable[[Figures], Spread | None]
    task: str = ""


@dataclass(frozen=True)
class Result:
    """What became of a target on one series."""

    target: Target
    measured: Spread | None
    why: str = ""
    floor: float | None = None
    """What the figure cannot be under on this machine; None where that is not known."""

    @property
    def met(self) -> bool | None:
        """Whether the median is within the limit; None where there is no figure or no limit."""
        if self.measured is None or self.target.limit is None:
            return None
        return self.measured.median <= self.target.limit

    @property
    def verdict(self) -> str:
        """Met, or by how much it was missed."""
        if self.measured is None:
            return f"not measured ({self.why})"
        if self.target.limit is None:
            return "no target"
        if self.met:
            return "met"
        if self.target.limit == 0.0:
            return f"**missed** by {quantity(self.measured.median, self.target.unit)}"
        return f"**missed**: {self.measured.median / self.target.limit:.2f} times the target"

    @property
    def text(self) -> str:
        """The figure with its spread."""
        return "-" if self.measured is None else spread_text(self.measured, self.target.unit)

    @property
    def floor_text(self) -> str:
        """The floor in the target's unit."""
        return "-" if self.floor is None else quantity(self.floor, self.target.unit)


def judged(target: Target, figures: Figures, floor: float | None = None) -> Result:
    """Hold figures against a target, with its floor beside it."""
    measured = target.measure(figures)
    why = (
        figures.why(target.task)
        if measured is None and target.task
        else "not measured"
        if measured is None
        else ""
    )
    return Result(target, measured, why, floor)

"""What the raw figures of a cell come to."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from statistics import median
from typing import Any

from benchmarks.spread import Spread, spread

STEPS = ("load_s", "prepare_s", "slice_s")
"""Reading the file; what the method needs of the part; cutting all layers."""

Raw = Mapping[str, Any]


def round_s(taken: Raw, steps: Iterable[str] = STEPS) -> float:
    """Time of one round; that of some layers is scaled to all of them."""
    scale = taken["layers"] / taken["layers_cut"] if taken["layers_cut"] else 1.0
    return sum(float(taken[step]) * (scale if step == "slice_s" else 1.0) for step in steps)


def total_s(run: Raw, steps: Iterable[str] = STEPS) -> float:
    """Time of a process: the median of its rounds but the first, which pays for memory that is new to it."""
    steps = tuple(steps)
    rounds = run["rounds"][1:] or run["rounds"]
    return median(round_s(taken, steps) for taken in rounds)


def cell_times(cell: Raw | None, steps: Iterable[str] = STEPS) -> Spread | None:
    """Times of a cell, one figure a process; None where it was not measured."""
    if cell is None or not cell["runs"]:
        return None
    steps = tuple(steps)
    return spread(total_s(run, steps) for run in cell["runs"])


def first_times(cell: Raw | None) -> Spread | None:
    """Times of the first round of each process of a cell."""
    return spread(round_s(run["rounds"][0]) for run in cell["runs"]) if cell and cell["runs"] else None


def peak_mb(cell: Raw | None) -> Spread | None:
    """Greatest resident memory of a cell's processes."""
    return spread(run["peak_mb"] for run in cell["runs"]) if cell and cell["runs"] else None


def layers_cut(cell: Raw) -> tuple[int, int]:
    """Layers that were cut in the last round, and layers that there are; (0, 0) if the method does not tell."""
    last = cell["runs"][-1]["rounds"][-1]
    return last["layers_cut"], last["layers"]


def is_scaled(cell: Raw) -> bool:
    """Whether the time of some layers stands for all."""
    if not cell["runs"]:
        return False
    cut, there = layers_cut(cell)
    return cut < there


def find(cells: Sequence[Raw], part: str, method: str) -> Raw | None:
    """Return the cell of a part and a method."""
    return next((c for c in cells if c["part"] == part and c["method"] == method), None)


def ratio(a: Spread | None, b: Spread | None) -> Spread | None:
    """Ratio of two medians, with the least and greatest that the spreads allow."""
    if a is None or b is None or b.least <= 0.0:
        return None
    middle = a.median / b.median
    low, high = a.least / b.greatest, a.greatest / b.least
    return Spread(middle, low, high, max(middle - low, high - middle), min(a.count, b.count))

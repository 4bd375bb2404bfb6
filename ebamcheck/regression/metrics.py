"""The figures by which an accuracy is held: each a number of one entry, less is better.

A metric that sums up a column of the layers can be explained by it: which layers, by how much, where.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

Column = Sequence[float]
Columns = Mapping[str, Column]

DIGITS = 6
"""Significant digits that baselines keep."""

FINEST = 7
"""Decimals (mm, mm2) that they keep at most: a tenth of the finest depth that the comparison resolves."""


@dataclass(frozen=True)
class Metric:
    """One figure: its name, the column of layers that it sums up (none for a figure of the whole), and how."""

    name: str
    column: str
    summary: Callable[[Column], float]
    what: str


def _largest(column: Column) -> float:
    return max(map(abs, column), default=0.0)


def _mean(column: Column) -> float:
    return math.fsum(map(abs, column)) / len(column) if column else 0.0


def _count(column: Column) -> float:
    return float(sum(value != 0 for value in column))


METRICS = (
    Metric("depth_max_mm", "depth_mm", _largest, "deepest point of the symmetric difference with the exact section"),
    Metric("depth_mean_mm", "depth_mm", _mean, "mean over the layers of their deepest points"),
    Metric("hausdorff_max_mm", "hausdorff_mm", _largest, "largest Hausdorff distance of the contours"),
    Metric("area_error_max_mm2", "area_error_mm2", _largest, "largest error of a layer's area"),
    Metric("area_error_mean_mm2", "area_error_mm2", _mean, "mean error of the layers' areas, signs dropped"),
    Metric("ring_mismatch_layers", "ring_mismatch", _count, "layers with more or fewer rings than the truth"),
    Metric("hole_mismatch_layers", "hole_mismatch", _count, "layers with more or fewer holes than the truth"),
    Metric("empty_mismatch_layers", "empty_mismatch", _count, "layers empty where the truth is not, or the reverse"),
    Metric("open_path_layers", "open_paths", _count, "layers with open paths"),
    Metric("beyond_bound_layers", "beyond_bound_mm", _count, "layers deeper than bound and mesh allow"),
)  # fmt: skip
"""Figures that sum up a column of the layers."""

WHOLE = {
    "volume_error_mm3": "areas times layer height, against those of the exact sections",
    "bound_mm": "error bound that the backend declares",
    "not_compared_layers": "layers left out, in a vertex or face where the backend declares no rule",
}
"""Figures of an entry that no column explains."""

NAMES = (*(metric.name for metric in METRICS), *WHOLE)
LAYER_COLUMNS = tuple(dict.fromkeys(metric.column for metric in METRICS))
"""Columns that are held layer by layer, too: a loss on one layer must not hide behind a worse one."""

TOLERANCE_NAMES = (*NAMES, *LAYER_COLUMNS)


def summarised(columns: Columns) -> dict[str, float]:
    """All metrics of an entry's columns."""
    return {metric.name: rounded(metric.summary(columns[metric.column])) for metric in METRICS}


def rounded(value: float, digits: int = DIGITS, decimals: int | None = FINEST) -> float:
    """Round to the digits that a baseline keeps; zero has no sign.

    Examples
    --------
    >>> rounded(0.0123456789), rounded(-1e-17), rounded(123456.789)
    (0.0123457, 0.0, 123457.0)
    """
    near = value if decimals is None else round(value, decimals)
    return float(f"{near:.{digits}g}") + 0.0

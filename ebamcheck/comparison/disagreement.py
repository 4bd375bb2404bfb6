"""A disagreement of two slicers on a layer, with its place, its size, its limit and its likely cause."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

AGREE, OUTLIER, UNDECIDED, NOT_COMPARED, EMPTY = "agree", "outlier", "undecided", "not-compared", "empty"
"""Verdicts on a layer."""


@dataclass(frozen=True)
class Disagreement:
    """One disagreement on one layer."""

    layer: int
    height_mm: float
    backend: str
    """The outlier; on an undecided layer, either of the two."""
    against: str
    """The backend it was compared with, or ``part`` for a layer that came out empty."""
    metric: str
    """``depth``, ``topology`` (numbers of outer rings and holes) or ``empty``."""
    value: float
    limit: float
    x_mm: float
    y_mm: float
    cause: str
    """Kind of the likely cause: ``translation``, ``open edge``, ``unknown``."""
    cause_text: str = ""
    """Description of the cause, with its size and the share of the difference that it explains, if known."""
    cause_size: float | None = None
    """Fitted size of the cause, in `cause_unit`; None if it has none."""
    cause_unit: str = ""
    cause_share: float | None = None
    """Share of the difference between the two slicers that the cause explains, 0 .. 1."""
    remedy: str = ""
    """What to do about it, without a full stop."""

    @property
    def excess(self) -> float:
        """Severity: the value over its limit; a finding without a limit is the most severe."""
        return self.value / self.limit if self.limit > 0.0 else math.inf


def worst_of(findings: Sequence[Disagreement]) -> Disagreement | None:
    """The most severe finding: the largest excess, then the lowest layer; None if there is none."""
    return max(findings, key=lambda f: (f.excess, -f.layer), default=None)

"""What a disagreement is called: where it is, how large, against what limit, and its likely cause."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

AGREE, OUTLIER, UNDECIDED, NOT_COMPARED, EMPTY = "agree", "outlier", "undecided", "not-compared", "empty"
"""Verdicts on a layer."""


@dataclass(frozen=True)
class Finding:
    """One disagreement on one layer."""

    layer: int
    height_mm: float
    backend: str
    """The outlier; both names count alike where the layer is undecided."""
    against: str
    """The backend it was compared with, or ``part`` for a layer that came out empty."""
    metric: str
    """``depth``, ``topology`` (rings and holes apart) or ``empty``."""
    value: float
    limit: float
    x_mm: float
    y_mm: float
    cause: str
    """What is likely to be at fault, as a kind: ``translation``, ``open edge``, ``unknown``."""
    cause_text: str = ""
    """The cause in words, with its size and the share of the difference that it explains, where that is known."""
    cause_size: float | None = None
    """Its fitted size, in `cause_unit`; None for a cause that has none."""
    cause_unit: str = ""
    cause_share: float | None = None
    """Share of the difference of the two slicers that it explains, 0 .. 1."""
    remedy: str = ""
    """What to do about it, without a full stop."""

    @property
    def excess(self) -> float:
        """How grave it is: the value over its limit; one that has no limit goes before all."""
        return self.value / self.limit if self.limit > 0.0 else math.inf


def worst_of(findings: Sequence[Finding]) -> Finding | None:
    """The gravest finding: the largest excess, of equal ones the lowest layer; None for none."""
    return max(findings, key=lambda f: (f.excess, -f.layer), default=None)

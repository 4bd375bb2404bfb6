"""What a disagreement is called: where it is, how large, against what limit, and its likely cause."""

from __future__ import annotations

from dataclasses import dataclass


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

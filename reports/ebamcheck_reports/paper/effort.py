"""Effort: how much of the paper's work is reproduced."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from ebamcheck_reports.paper.published import tolerances_by_size

Note = Callable[[str], None]
"""Callback for progress, with one line of text."""


@dataclass(frozen=True)
class Effort:
    """Counts that decide how long the command takes.

    Parameters
    ----------
    name
        As it stands in the page.
    finest_mm
        Of the paper's eleven tolerances those down to this one are sliced.
    layer_step
        Every how manieth of the 4488 layers is cut for a time.
    literal_layers
        Layers on which the paper's own method (every facet drawn for each layer) is timed.
    polar_layers
        Layers of each model on which the error of the fit is measured.
    """

    name: str
    finest_mm: float
    layer_step: int
    literal_layers: int
    polar_layers: int

    @property
    def tolerances_mm(self) -> tuple[float, ...]:
        """Tolerances to be sliced, from coarse to fine."""
        return tuple(t for t in tolerances_by_size() if t >= self.finest_mm)


QUICK = Effort("quick", finest_mm=0.04, layer_step=8, literal_layers=6, polar_layers=24)
"""About a minute on two cores: the sizes up to some 40,000 facets."""

FULL = Effort("full", finest_mm=0.001, layer_step=1, literal_layers=24, polar_layers=200)
"""All eleven sizes and all 4488 layers."""

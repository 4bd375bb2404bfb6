"""What all pictures of a planned layer share: the frame of its section, its contour beads and its path."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from shapely.geometry.base import BaseGeometry

from ebamcheck.numeric.rings import Floats
from ebamcheck.scan.plan.columns import ScanPlan
from ebamcheck.settings.config import Config


@dataclass(frozen=True, eq=False)
class Scene:
    """One layer as it is drawn.

    Parameters
    ----------
    section
        The solid region; every picture shows its bounds.
    contour
        Region whose border is the centre line of the contour beads.
    lines
        (V, 4) mm, lines of the islands, x0, y0, x1, y1.
    jumps
        (J, 4) mm, ways from the last line of an island to the first of the next.
    """

    section: BaseGeometry
    contour: BaseGeometry
    lines: Floats
    jumps: Floats

    @classmethod
    def of(cls, section: BaseGeometry, plan: ScanPlan, layer: int = 0) -> Scene:
        """Scene of a layer of a plan."""
        vectors = plan.vectors_of(layer)
        lines = vectors[["x0", "y0", "x1", "y1"]].to_numpy(np.float64).reshape(-1, 4)
        island = vectors["island"].to_numpy()
        next_island = np.flatnonzero(island[1:] != island[:-1])
        jumps = np.hstack([lines[next_island, 2:], lines[next_island + 1, :2]])
        return cls(section, plan.contours[layer], lines, jumps)


@dataclass(frozen=True)
class TemperatureScale:
    """Scale of all temperature rises of a layer, K: from 0 to `greatest`, with marks at solidus and boiling point.

    A rise over the boiling point is none that the model can tell: it is shown as that or more.
    """

    greatest: float
    solidus: float
    boiling: float

    @classmethod
    def of(cls, config: Config, hottest: float) -> TemperatureScale:
        """Scale up to the hottest rise, or to the boiling point where that is less."""
        ambient_k = config.process.ambient_temperature_k
        boiling = config.material.boiling_k - ambient_k
        return cls(min(max(hottest, 1.0), boiling), config.material.solidus_k - ambient_k, boiling)

    @property
    def marks(self) -> tuple[tuple[str, float], ...]:
        """Names and rises of the marks."""
        return (("solidus", self.solidus), ("boiling", self.boiling))

    def told(self, rise_k: float) -> str:
        """Return a rise as it is printed: whole kelvins, none under 0, none over the boiling point."""
        return f"over {self.boiling:.0f}" if rise_k > self.boiling else f"{max(rise_k, 0.0):.0f}"

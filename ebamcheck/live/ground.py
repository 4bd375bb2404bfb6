"""What the next layer is laid on, as it was worked out and as it was measured: heat, metal, and what was corrected."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ebamcheck.live.heat_so_far import HeatSoFar
from ebamcheck.live.height_map import MENDING, MapFigures, figures_of
from ebamcheck.live.metal_so_far import MetalSoFar
from ebamcheck.live.pyrometer import Correction, corrected
from ebamcheck.live.readings import Reading
from ebamcheck.metal.surface import MENDED
from ebamcheck.settings.config import Config


@dataclass(frozen=True, eq=False)
class Ground:
    """Heat and metal under a layer.

    Parameters
    ----------
    heat, metal
        As worked out; the heat is that of the moment at which a temperature was measured, and corrected by it.
    figures, map_sha256
        What a height map says, and its hash; None and empty without one.
    correction
        What a pyrometer says; None without one.
    """

    heat: HeatSoFar
    metal: MetalSoFar
    figures: MapFigures | None = None
    map_sha256: str = ""
    correction: Correction | None = None

    @classmethod
    def of(cls, reading: Reading, heat: HeatSoFar, metal: MetalSoFar, config: Config) -> Ground:
        """Join what was worked out with a reading."""
        figures = correction = None
        if reading.cells is not None and metal.surface is not None:
            figures = figures_of(reading.cells, metal.surface, config)
        if reading.warmth is not None:
            heat, correction = corrected(heat, reading.warmth, config)
        return cls(heat, metal, figures, reading.map_sha256, correction)

    @property
    def since_s(self) -> float:
        """Time since the layer was done, at which the heat is known."""
        return 0.0 if self.correction is None else self.correction.measured.after_s

    @property
    def mending(self) -> tuple[float, ...]:
        """Shares of what is uneven that are tried to be mended, one after the other."""
        return (MENDED,) if self.figures is None else MENDING

    def surface(self, mended: float) -> MetalSoFar:
        """Metal on which the layer is planned that mends a share."""
        return self.metal if self.figures is None else self.metal.mapped(self.figures, mended)

    def told(self, mended: float) -> dict[str, Any]:
        """What was measured beside the height, for answer and certificate."""
        found: dict[str, Any] = {}
        if self.figures is not None:
            found["height_map"] = {**self.figures.told(), "sha256": self.map_sha256, "mended": mended}
        if self.correction is not None:
            found["temperature"] = self.correction.told()
        return found

"""The metal of layers that stand under a program: with it, what holds for a whole part holds for one that is half built."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from ebamcheck.settings.process import ProcessSettings

LEAST_ZONE = 25.0
"""Zones of a layer under this many squared bead widths do not count for the mean over all layers; each layer's own, however
small, has a limit by its size."""

MEAN_ZONES = ("inside", "edge")
"""Zones that have a mean over all layers."""


@dataclass(frozen=True)
class MetalBelow:
    """Sums over the layers that stand.

    Parameters
    ----------
    layers
        Layers with metal, which were laid.
    wanted_mm3, laid_mm3, outside_mm3
        Metal that they were to have, have, and have beside the part.
    zone_mm2, zone_layers_mm2
        By :data:`MEAN_ZONES`: area that counts, and the same times the height of its metal in layers.
    """

    layers: int = 0
    wanted_mm3: float = 0.0
    laid_mm3: float = 0.0
    outside_mm3: float = 0.0
    zone_mm2: tuple[float, float] = (0.0, 0.0)
    zone_layers_mm2: tuple[float, float] = (0.0, 0.0)

    def and_layers(self, table: pd.DataFrame, process: ProcessSettings) -> MetalBelow:
        """Return the sums with further layers, rows of :attr:`ebamcheck.checks.deposit.Deposit.layers`."""
        solid = with_metal(table)
        area, height = [], []
        for k, zone in enumerate(MEAN_ZONES):
            wide = counts(solid, zone, process)
            mm2 = solid[f"{zone}_mm2"].to_numpy(np.float64)[wide]
            area.append(self.zone_mm2[k] + float(mm2.sum()))
            height.append(
                self.zone_layers_mm2[k] + float((mm2 * solid[zone].to_numpy(np.float64)[wide]).sum())
            )
        return MetalBelow(
            self.layers + len(solid),
            self.wanted_mm3 + float(solid["wanted_mm3"].sum()),
            self.laid_mm3 + float(solid["laid_mm3"].sum()),
            self.outside_mm3 + float(solid["outside_mm3"].sum()),
            (area[0], area[1]),
            (height[0], height[1]),
        )

    def mean(self, zone: str) -> float:
        """Mean height of the metal of a zone, in layers; NaN where no layer is wide enough for one."""
        k = MEAN_ZONES.index(zone)
        return self.zone_layers_mm2[k] / self.zone_mm2[k] if self.zone_mm2[k] > 0.0 else float("nan")


def with_metal(table: pd.DataFrame) -> pd.DataFrame:
    """Rows of layers that have metal, or are to have some."""
    return table[(table["wanted_mm3"] > 0.0) | (table["laid_mm3"] > 0.0)]


def counts(
    solid: pd.DataFrame, zone: str, process: ProcessSettings
) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Layers (n,) of which a zone is wide enough to count for the mean over all layers."""
    area = solid[f"{zone}_mm2"].to_numpy(np.float64)
    return np.asarray(area >= LEAST_ZONE * process.bead_width_mm**2, np.bool_)

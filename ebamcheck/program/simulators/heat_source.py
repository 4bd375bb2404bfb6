"""The beam and the block that cases of heat simulators share: a Gaussian beam, and the box around a path."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ebamcheck.heat.referee import BEAM_SHARE
from ebamcheck.numeric.rings import Floats
from ebamcheck.settings.config import Config

EDGE = math.exp(-3.0)
"""Intensity of the beam over that of its middle where its heat counts as ended: at sqrt(6) standard deviations."""

MARGIN = 4.0
"""Metal beside the path, in bead widths."""


@dataclass(frozen=True)
class HeatSource:
    """A Gaussian beam that heats the layer that it lays.

    Parameters
    ----------
    sigma_mm
        Standard deviation in the plane: that of the house's own referee.
    depth_mm
        Depth at which the heat has fallen to :data:`EDGE`: the height of a layer, in which our own models set it free.
    power_w, absorptivity
        Power of the beam at full power, and the share of it that the part takes up.
    """

    sigma_mm: float
    depth_mm: float
    power_w: float
    absorptivity: float

    @classmethod
    def of(cls, config: Config) -> HeatSource:
        """Beam of a profile."""
        process = config.process
        return cls(
            BEAM_SHARE * process.bead_width_mm,
            config.layer_height_mm,
            process.power_w,
            config.material.absorptivity,
        )

    @property
    def sigma_z_mm(self) -> float:
        """Standard deviation downwards."""
        return self.depth_mm / math.sqrt(6.0)

    def radius_mm(self, share: float) -> float:
        """Radius at which the intensity has fallen to a share of that of the middle."""
        return self.sigma_mm * math.sqrt(-2.0 * math.log(share))


@dataclass(frozen=True)
class Block:
    """The box in which a path is simulated: (3,) least and greatest X, Y, Z, mm; it stands on its base plate."""

    low: tuple[float, float, float]
    high: tuple[float, float, float]

    @classmethod
    def around(cls, rows: Floats, config: Config) -> Block:
        """Box around rows (n, 6) of a path: a base plate deep below the lowest layer, up to the highest."""
        places = rows[:, 1:4] if len(rows) else np.zeros((1, 3))
        margin = MARGIN * config.process.bead_width_mm
        low, high = places.min(axis=0), places.max(axis=0)
        bottom = low[2] - config.layer_height_mm - config.process.base_plate_mm
        return cls(
            (float(low[0] - margin), float(low[1] - margin), float(bottom)),
            (float(high[0] + margin), float(high[1] + margin), float(high[2])),
        )

    def cells(self, wide_mm: float, high_mm: float) -> tuple[int, int, int]:
        """Cells along X, Y and Z that are no larger than asked."""
        sizes = zip(self.low, self.high, (wide_mm, wide_mm, high_mm), strict=True)
        nx, ny, nz = (max(1, math.ceil((b - a) / size - 1e-9)) for a, b, size in sizes)
        return nx, ny, nz

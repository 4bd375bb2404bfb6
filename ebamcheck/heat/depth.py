"""Modes over the depth of a body, between a radiating surface and a cooled or insulated base.

With zeta the distance from the base, they are cos(mu zeta) over an insulated base, where
mu tan(mu H) = h/k, and sin(mu zeta) over one held at its temperature, where mu cot(mu H) = -h/k
(Carslaw & Jaeger 1959, sections 3.9 to 3.11). Radiation is thus part of the modes, not a correction.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ebamcheck.numeric.rings import Floats

HALVINGS = 60
"""Bisections of an interval of pi/2: enough for the last bit of a double."""


@dataclass(frozen=True, eq=False)
class DepthModes:
    """Modes psi_n of the depth, normalised: the integral of psi_n^2 over the depth is 1.

    Parameters
    ----------
    depth_mm
        Depth H from the surface to the base.
    cooled
        Whether the base is held at its temperature; else it is insulated.
    wave_number
        (N,) mu_n, 1/mm, ascending.
    """

    depth_mm: float
    cooled: bool
    wave_number: Floats

    @property
    def scale(self) -> Floats:
        """Factor (N,) that normalises the modes."""
        mu = self.wave_number
        half, turn = 0.5 * self.depth_mm, 0.5 * self.depth_mm * np.sinc(2.0 * mu * self.depth_mm / math.pi)
        return np.asarray(1.0 / np.sqrt(half - turn if self.cooled else half + turn), np.float64)

    def at(self, below_mm: ArrayLike) -> Floats:
        """Modes at depths below the surface, (P, N)."""
        angle = np.multiply.outer(self.depth_mm - np.asarray(below_mm, np.float64), self.wave_number)
        return np.asarray(self.scale * (np.sin(angle) if self.cooled else np.cos(angle)), np.float64)

    def mean_of_layer(self, layer_mm: float) -> Floats:
        """Mean of the modes over the uppermost millimetres, (N,)."""
        # The mean of a sine or cosine is its middle value times a sinc, also where mu is zero.
        middle = self.at(0.5 * layer_mm)
        return np.asarray(middle * np.sinc(0.5 * self.wave_number * layer_mm / math.pi), np.float64)

    def integral(self) -> Floats:
        """Integral of the modes over the whole depth, (N,)."""
        return self.depth_mm * self.mean_of_layer(self.depth_mm)


def depth_modes(depth_mm: float, count: int, cooled: bool, loss_per_mm: float = 0.0) -> DepthModes:
    """Find the first modes of a depth.

    Parameters
    ----------
    count
        Number of modes N.
    cooled
        Whether the base is held at its temperature.
    loss_per_mm
        h/k, 1/mm: heat transfer coefficient of the surface over the conductivity.
    """
    biot = loss_per_mm * depth_mm
    low: Floats = np.asarray(np.pi * (np.arange(count) + (0.5 if cooled else 0.0)), np.float64)
    if biot == 0.0:
        return DepthModes(depth_mm, cooled, low / depth_mm)
    high = low + 0.5 * np.pi
    # Both conditions read x sin(x - c) = biot cos(x - c), c = pi/2 if cooled: one root between low and high.
    shift = 0.5 * np.pi if cooled else 0.0
    sign = np.cos(low - shift)
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        below = sign * (middle * np.sin(middle - shift) - biot * np.cos(middle - shift)) < 0.0
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    return DepthModes(depth_mm, cooled, np.asarray(0.5 * (low + high) / depth_mm, np.float64))

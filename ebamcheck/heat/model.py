"""The temperature rise of a section extruded to its base, as amplitudes of modes (K, N); every step is exact."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from ebamcheck.heat.depth import DepthModes
from ebamcheck.heat.medium import Medium
from ebamcheck.heat.rectangle import RectangleModes
from ebamcheck.numeric.rings import Floats

SERIES = 1e-4
"""Exponents under this are taken as power series, which is exact to the last digits there."""


class PlaneModes(Protocol):
    """Modes of a section, of its contour or in closed form."""

    @property
    def eigenvalue(self) -> Floats:
        """Eigenvalues (K,), 1/mm^2."""
        ...

    def at(self, points: ArrayLike) -> Floats:
        """Modes at points, (P, K)."""
        ...

    def integral(self) -> Floats:
        """Integral of the modes over the section, (K,)."""
        ...


@dataclass(frozen=True, eq=False)
class HeatModel:
    """Heat conduction d(rho c T)/dt = k lap T + q in modes; q lies in the uppermost layer.

    Amplitudes a (K, N) give T(x, y, z) = sum a_kn phi_k(x, y) psi_n(z), the rise over the base, K. Each obeys
    da/dt = -r a + s with r = alpha (lambda_k + mu_n^2).

    Parameters
    ----------
    plane, depth
        Modes of the section and of the depth.
    medium
        Material.
    layer_mm
        Thickness of the layer in which heat is set free, and over which its temperature is read.
    """

    plane: PlaneModes
    depth: DepthModes
    medium: Medium
    layer_mm: float

    @property
    def rate(self) -> Floats:
        """Decay r (K, N) of each amplitude, 1/s."""
        squares = np.add.outer(self.plane.eigenvalue, self.depth.wave_number**2)
        return np.asarray(self.medium.diffusivity_mm2_s * squares, np.float64)

    @property
    def in_layer(self) -> Floats:
        """Mean of the depth's modes over the layer, (N,)."""
        return self.depth.mean_of_layer(self.layer_mm)

    def cold(self) -> Floats:
        """Amplitudes (K, N) of a body at the temperature of its base."""
        return np.zeros((len(self.plane.eigenvalue), len(self.depth.wave_number)))

    def after(self, amplitudes: Floats, duration_s: float) -> Floats:
        """Amplitudes after a time without a source."""
        return np.asarray(amplitudes * np.exp(-self.rate * duration_s), np.float64)

    def after_source(self, amplitudes: Floats, shape: Floats, power_w: float, duration_s: float) -> Floats:
        """Amplitudes after a source that stands still for a time.

        Parameters
        ----------
        shape
            (K,) mean of the modes over the source: over an island, or at a point.
        """
        decay = self.rate * duration_s
        gain = duration_s * held(decay) * np.multiply.outer(shape, self.in_layer)
        return np.asarray(amplitudes * np.exp(-decay) + self._per_joule(power_w) * gain, np.float64)

    def after_spot(
        self, amplitudes: Floats, point: ArrayLike, energy_j: float, sigma_mm: float = 0.0
    ) -> Floats:
        """Amplitudes after an instantaneous Gaussian spot of a standard deviation."""
        shape = self._blurred(sigma_mm) * self.plane.at(point)[0]
        return np.asarray(
            amplitudes + self._per_joule(energy_j) * np.multiply.outer(shape, self.in_layer), np.float64
        )

    def after_line(
        self,
        amplitudes: Floats,
        start: ArrayLike,
        end: ArrayLike,
        power_w: float,
        duration_s: float,
        sigma_mm: float = 0.0,
        piece_mm: float = 1.0,
    ) -> Floats:
        """Amplitudes after a Gaussian spot has moved along a straight line at constant speed.

        On a rectangle it is exact; else the modes count as linear along pieces of the line, over each of
        which the time is integrated exactly.
        """
        a, b = np.asarray(start, np.float64), np.asarray(end, np.float64)
        rate = self.rate
        if isinstance(self.plane, RectangleModes):
            driven = self.plane.line_integral(a, b, duration_s, rate)
        else:
            pieces = max(1, int(np.ceil(np.hypot(*(b - a)) / piece_mm)))
            nodes = self.plane.at(a + np.linspace(0.0, 1.0, pieces + 1)[:, None] * (b - a))
            driven = np.zeros_like(rate)
            time = duration_s / pieces
            decay = rate * time
            level, ramp, fall = time * held(decay), time * ramped(decay), np.exp(-decay)
            for first, last in itertools.pairwise(nodes):
                driven = driven * fall + first[:, None] * level + (last - first)[:, None] * ramp
        blurred = self._blurred(sigma_mm)[:, None] * self.in_layer
        gain = self._per_joule(power_w) * driven * blurred
        return np.asarray(amplitudes * np.exp(-rate * duration_s) + gain, np.float64)

    def at(self, amplitudes: Floats, points: ArrayLike, below_mm: float = 0.0) -> Floats:
        """Temperature rise at points (P, 2) at a depth below the surface, (P,) K."""
        return np.asarray(self.plane.at(points) @ (amplitudes @ self.depth.at(below_mm)), np.float64)

    def over(self, amplitudes: Floats, shapes: Floats) -> Floats:
        """Mean temperature rise of the layer over islands whose modes have the means `shapes` (I, K), (I,) K."""
        return np.asarray(shapes @ (amplitudes @ self.in_layer), np.float64)

    def stored_j(self, amplitudes: Floats) -> float:
        """Heat in the body over the temperature of its base."""
        return float(
            self.medium.heat_capacity_j_mm3k * (self.plane.integral() @ amplitudes @ self.depth.integral())
        )

    def base_flow_w(self, amplitudes: Floats) -> float:
        """Heat that flows into the base."""
        slope = self.depth.slope_at_base()
        return float(self.medium.conductivity_w_mmk * (self.plane.integral() @ amplitudes @ slope))

    def radiated_w(self, amplitudes: Floats) -> float:
        """Heat that the surface radiates."""
        return float(self.medium.radiation_w_mm2k * (self.plane.integral() @ amplitudes @ self.depth.at(0.0)))

    def _per_joule(self, heat: float) -> float:
        return heat / self.medium.heat_capacity_j_mm3k

    def _blurred(self, sigma_mm: float) -> Floats:
        """A Gaussian spot is a point that has spread for sigma^2 / (2 alpha): modes fall by exp(-lambda sigma^2/2)."""
        return np.asarray(np.exp(-0.5 * self.plane.eigenvalue * sigma_mm**2), np.float64)


def held(decay: Floats) -> Floats:
    """(1 - e^-x) / x: what is left at the end of a unit time of what came in steadily."""
    safe = np.where(decay == 0.0, 1.0, decay)
    return np.asarray(np.where(decay == 0.0, 1.0, -np.expm1(-safe) / safe), np.float64)


def ramped(decay: Floats) -> Floats:
    """(1 - held(x)) / x: the same of what came in rising from 0 to 1."""
    safe = np.where(decay < SERIES, 1.0, decay)
    series = 0.5 - decay / 6.0 + decay**2 / 24.0
    return np.asarray(np.where(decay < SERIES, series, (1.0 - held(safe)) / safe), np.float64)

"""The temperature rise of a section extruded to its base, as amplitudes of modes (K, N); every step is exact."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ebamcheck.heat.medium import Medium
from ebamcheck.heat.modes import ContourModes
from ebamcheck.kernels import Floats


@dataclass(frozen=True, eq=False)
class HeatModel:
    """Heat conduction d(rho c T)/dt = k lap T + q in modes; q lies in the uppermost layer.

    Amplitudes a (K, N) give T(x, y, z) = sum a_kn phi_k(x, y) psi_n(z), the rise over the base, K. Each obeys
    da/dt = -r a + s with r = alpha (lambda_k + mu_n^2).
    """

    plane: ContourModes  # of the section
    depth: DepthModes
    medium: Medium
    layer_mm: float  # thickness of the layer in which heat is released, and over which its temperature is averaged

    @property
    def rate(self) -> Floats:
        """Decay rate r (K, N) of each amplitude, 1/s."""
        squares = np.add.outer(self.plane.eigenvalue, self.depth.wave_number**2)
        return np.asarray(self.medium.diffusivity_mm2_s * squares, np.float64)

    @property
    def in_layer(self) -> Floats:
        """Mean of the modes of the depth over the layer, (N,)."""
        return self.depth.mean_of_layer(self.layer_mm)

    def cold(self) -> Floats:
        """Amplitudes (K, N) of a body at the temperature of its base."""
        return np.zeros((len(self.plane.eigenvalue), len(self.depth.wave_number)))

    def after(self, amplitudes: Floats, duration_s: float) -> Floats:
        """Amplitudes after a time without a source."""
        return np.asarray(amplitudes * np.exp(-self.rate * duration_s), np.float64)

    def at(self, amplitudes: Floats, points: ArrayLike, below_mm: float = 0.0) -> Floats:
        """Temperature rise at points (P, 2) at a depth below the surface, (P,) K."""
        return np.asarray(self.plane.at(points) @ (amplitudes @ self.depth.at(below_mm)), np.float64)

    def over(self, amplitudes: Floats, shapes: Floats) -> Floats:
        """Mean temperature rise of the layer over islands whose modes have the means `shapes` (I, K), (I,) K."""
        return np.asarray(shapes @ (amplitudes @ self.in_layer), np.float64)

    def stored_j(self, amplitudes: Floats) -> float:
        """Heat in the body above that at the temperature of its base."""
        k_mm3 = self.plane.integral() @ amplitudes @ self.depth.integral()
        return float(self.medium.heat_capacity_j_mm3k * k_mm3)


NEWTON_STEPS = 8  # enough for the last bits of a double


@dataclass(frozen=True, eq=False)
class DepthModes:
    """Modes psi_n of the depth, normalised: the integral of psi_n^2 over the depth is 1."""

    depth_mm: float  # H from the surface to the base
    cooled: bool  # whether the base is held at its temperature; else it is insulated
    wave_number: Floats  # (N,) mu_n, 1/mm, ascending

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
    """Find the first `count` modes of a depth; `loss_per_mm` is the heat transfer coefficient of the surface over the conductivity."""
    biot = loss_per_mm * depth_mm
    low: Floats = np.asarray(np.pi * (np.arange(count) + (0.5 if cooled else 0.0)), np.float64)
    if biot == 0.0:
        return DepthModes(depth_mm, cooled, low / depth_mm)
    # Both conditions read (low + t) tan(t) = biot, 0 < t < pi/2. Newton's method on t - atan(biot / (low + t)), which is concave,
    # from where t stands for tan(t): beyond the root, and after one step under it, from where it only rises.
    t = np.minimum(2.0 * biot / (low + np.sqrt(low**2 + 4.0 * biot)), 0.5 * np.pi)
    for _ in range(NEWTON_STEPS):
        x = low + t
        t = t - (t - np.arctan2(biot, x)) / (1.0 + biot / (biot**2 + x**2))
    return DepthModes(depth_mm, cooled, np.asarray((low + t) / depth_mm, np.float64))


def carried(old: HeatModel, amplitudes: Floats, new: HeatModel) -> Floats:
    """Project the amplitudes (K, N) of a model onto the modes of a higher body on the same base, (K', N'): the least-squares
    approximation of the field."""
    # Integrals (K', K) of new times old modes over the intersection of the sections.
    grid = new.plane.grid
    row, column = np.nonzero(grid.number >= 0)
    centres = grid.origin + (np.column_stack([column, row]) + 0.5) * grid.step
    across = new.plane.values.T @ (grid.area_mm2[:, None] * old.plane.at(centres))
    return np.asarray(across @ amplitudes @ overlap_of_depths(old.depth, new.depth).T, np.float64)


def overlap_of_depths(old: DepthModes, new: DepthModes) -> Floats:
    """Integrals (N', N) of new times old modes over the old depth; both are counted from the base upwards."""
    height = min(old.depth_mm, new.depth_mm)
    less = np.subtract.outer(new.wave_number, old.wave_number)
    more = np.add.outer(new.wave_number, old.wave_number)
    # Half the sum or difference of two sines over their wave numbers; sinc is also right where these vanish.
    close, far = (height * np.sinc(wave * height / math.pi) for wave in (less, more))
    product = 0.5 * (close - far if old.cooled else close + far)
    return np.asarray(np.multiply.outer(new.scale, old.scale) * product, np.float64)

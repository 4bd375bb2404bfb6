"""The temperature rise of a section extruded to its base, as amplitudes of modes (K, N); every step is exact."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from ebamcheck.heat.depth import DepthModes
from ebamcheck.heat.medium import Medium
from ebamcheck.numeric.rings import Floats


class PlaneModes(Protocol):
    """Modes of a section."""

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
        Thickness of the layer in which heat is released, and over which its temperature is averaged.
    """

    plane: PlaneModes
    depth: DepthModes
    medium: Medium
    layer_mm: float

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
        return float(
            self.medium.heat_capacity_j_mm3k * (self.plane.integral() @ amplitudes @ self.depth.integral())
        )

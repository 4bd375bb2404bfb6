"""Modes of a rectangle in closed form: products of cosines."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ebamcheck.numeric.rings import Floats


@dataclass(frozen=True, eq=False)
class RectangleModes:
    """Modes cos(p x) cos(q y) of the rectangle from (0, 0) to (width, height), normalised.

    Parameters
    ----------
    width_mm, height_mm
        Sides.
    wave_x, wave_y
        (K,) p and q, 1/mm, by rising eigenvalue p^2 + q^2.
    """

    width_mm: float
    height_mm: float
    wave_x: Floats
    wave_y: Floats

    @property
    def eigenvalue(self) -> Floats:
        """Eigenvalues (K,), 1/mm^2."""
        return self.wave_x**2 + self.wave_y**2

    @property
    def area_mm2(self) -> float:
        """Area of the rectangle."""
        return self.width_mm * self.height_mm

    @property
    def scale(self) -> Floats:
        """Factor (K,) that normalises the modes."""
        halves = np.where(self.wave_x > 0, 2.0, 1.0) * np.where(self.wave_y > 0, 2.0, 1.0)
        return np.asarray(np.sqrt(halves / self.area_mm2), np.float64)

    def at(self, points: ArrayLike) -> Floats:
        """Modes at points (P, 2), (P, K)."""
        x, y = np.asarray(points, np.float64).reshape(-1, 2).T
        waves = np.cos(np.multiply.outer(x, self.wave_x)) * np.cos(np.multiply.outer(y, self.wave_y))
        return np.asarray(self.scale * waves, np.float64)

    def integral(self) -> Floats:
        """Integral of the modes over the rectangle, (K,)."""
        return np.where(self.eigenvalue == 0.0, math.sqrt(self.area_mm2), 0.0)

    def line_integral(
        self, start: ArrayLike, end: ArrayLike, duration_s: float, rate: Floats
    ) -> NDArray[np.float64]:
        """Integral of phi(x(s)) exp(-r (T - s)) over a straight line driven in the time T, exactly.

        The product of two cosines along the line is two cosines of p + w s, for which it is
        Re[e^(ip) (e^(iwT) - e^(-rT)) / (r + iw)], and T cos p where r and w vanish.

        Parameters
        ----------
        rate
            (K, ...) r of each mode, 1/s.
        """
        a, b = np.asarray(start, np.float64), np.asarray(end, np.float64)
        speed = (b - a) / duration_s
        total = np.zeros(rate.shape)
        column = (slice(None), *(None,) * (rate.ndim - 1))
        for side in (1.0, -1.0):
            phase = (self.wave_x * a[0] + side * self.wave_y * a[1])[column]
            turn = (self.wave_x * speed[0] + side * self.wave_y * speed[1])[column]
            exponent = (rate + 1j * turn) * duration_s
            flat = np.abs(exponent) < 1e-12
            ratio = duration_s * np.where(flat, 1.0, -np.expm1(-exponent) / np.where(flat, 1.0, exponent))
            total += 0.5 * np.real(np.exp(1j * (phase + turn * duration_s)) * ratio)
        return np.asarray(self.scale[column] * total, np.float64)


def rectangle_modes(width_mm: float, height_mm: float, largest_eigenvalue: float) -> RectangleModes:
    """List all modes of a rectangle up to an eigenvalue, 1/mm^2."""
    most = math.sqrt(largest_eigenvalue)
    p = np.arange(int(most * width_mm / math.pi) + 1) * (math.pi / width_mm)
    q = np.arange(int(most * height_mm / math.pi) + 1) * (math.pi / height_mm)
    wave_x, wave_y = (grid.ravel() for grid in np.meshgrid(p, q))
    eigenvalue = wave_x**2 + wave_y**2
    rising = np.argsort(eigenvalue, kind="stable")
    rising = rising[eigenvalue[rising] <= largest_eigenvalue]
    return RectangleModes(width_mm, height_mm, wave_x[rising], wave_y[rising])

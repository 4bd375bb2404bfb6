"""Heat in closed forms, which the model of the product is held against: modes of a rectangle, and sources that stand or move.

The modes of a rectangle are products of cosines. A source is added to the amplitudes (K, N) of a
:class:`ebamcheck.heat.HeatModel`, step by step and each step exactly.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ebamcheck.heat import DepthModes, HeatModel
from ebamcheck.kernels import Floats


class RectangleModes(NamedTuple):
    """Modes cos(p x) cos(q y) of the rectangle from (0, 0) to (width, height), normalised, by rising p^2 + q^2."""

    width_mm: float
    height_mm: float
    wave_x: Floats
    wave_y: Floats

    @property
    def eigenvalue(self) -> Floats:
        return self.wave_x**2 + self.wave_y**2

    @property
    def area_mm2(self) -> float:
        return self.width_mm * self.height_mm

    @property
    def scale(self) -> Floats:
        halves = np.where(self.wave_x > 0, 2.0, 1.0) * np.where(self.wave_y > 0, 2.0, 1.0)
        return np.sqrt(halves / self.area_mm2)

    def at(self, points: ArrayLike) -> Floats:
        """Modes at points (P, 2), (P, K)."""
        x, y = np.asarray(points, np.float64).reshape(-1, 2).T
        waves = np.cos(np.multiply.outer(x, self.wave_x)) * np.cos(np.multiply.outer(y, self.wave_y))
        return np.asarray(self.scale * waves, np.float64)

    def integral(self) -> Floats:
        return np.where(self.eigenvalue == 0.0, math.sqrt(self.area_mm2), 0.0)

    def line_integral(self, a: Floats, b: Floats, duration_s: float, rate: Floats) -> Floats:
        """Integral of phi(x(s)) exp(-r (T - s)) over a straight line traversed in the time T, exactly.

        The product of two cosines along the line is two cosines of p + w s, for which it is
        Re[e^(ip) (e^(iwT) - e^(-rT)) / (r + iw)], and T cos p where r and w vanish.
        """
        speed = (b - a) / duration_s
        total = np.zeros(rate.shape)
        for side in (1.0, -1.0):
            phase = (self.wave_x * a[0] + side * self.wave_y * a[1])[:, None]
            turn = (self.wave_x * speed[0] + side * self.wave_y * speed[1])[:, None]
            exponent = (rate + 1j * turn) * duration_s
            flat = np.abs(exponent) < 1e-12
            ratio = duration_s * np.where(flat, 1.0, -np.expm1(-exponent) / np.where(flat, 1.0, exponent))
            total += 0.5 * np.real(np.exp(1j * (phase + turn * duration_s)) * ratio)
        return self.scale[:, None] * total


def rectangle_modes(width_mm: float, height_mm: float, largest_eigenvalue: float) -> RectangleModes:
    """All modes of a rectangle up to an eigenvalue, 1/mm^2."""
    most = math.sqrt(largest_eigenvalue)
    p = np.arange(int(most * width_mm / math.pi) + 1) * (math.pi / width_mm)
    q = np.arange(int(most * height_mm / math.pi) + 1) * (math.pi / height_mm)
    wave_x, wave_y = (grid.ravel() for grid in np.meshgrid(p, q))
    eigenvalue = wave_x**2 + wave_y**2
    rising = np.argsort(eigenvalue, kind="stable")
    rising = rising[eigenvalue[rising] <= largest_eigenvalue]
    return RectangleModes(width_mm, height_mm, wave_x[rising], wave_y[rising])


def after_source(model: HeatModel, amplitudes: Floats, shape: Floats, power_w: float, duration_s: float) -> Floats:
    """Amplitudes after a source that stands still: `shape` (K,) is the mean of the modes over it."""
    decay = model.rate * duration_s
    gain = duration_s * held(decay) * np.multiply.outer(shape, model.in_layer)
    return amplitudes * np.exp(-decay) + power_w / model.medium.heat_capacity_j_mm3k * gain


def after_spot(
    model: HeatModel, amplitudes: Floats, point: ArrayLike, energy_j: float, sigma_mm: float = 0.0
) -> Floats:
    """Amplitudes after an instantaneous Gaussian spot of a standard deviation."""
    shape = np.multiply.outer(blurred(model, sigma_mm) * model.plane.at(point)[0], model.in_layer)
    return amplitudes + energy_j / model.medium.heat_capacity_j_mm3k * shape


def after_line(
    model: HeatModel,
    amplitudes: Floats,
    start: ArrayLike,
    end: ArrayLike,
    power_w: float,
    duration_s: float,
    sigma_mm: float = 0.0,
) -> Floats:
    """Amplitudes after a Gaussian spot has moved along a straight line of a rectangle at constant speed, exactly."""
    a, b = np.asarray(start, np.float64), np.asarray(end, np.float64)
    steady = model.plane.line_integral(a, b, duration_s, model.rate)
    gain = power_w / model.medium.heat_capacity_j_mm3k * steady * blurred(model, sigma_mm)[:, None]
    return amplitudes * np.exp(-model.rate * duration_s) + gain * model.in_layer


def base_flow_w(model: HeatModel, amplitudes: Floats) -> float:
    """Heat that flows into the base."""
    slope = slope_at_base(model.depth)
    return float(model.medium.conductivity_w_mmk * (model.plane.integral() @ amplitudes @ slope))


def slope_at_base(depth: DepthModes) -> Floats:
    """Rise of the modes of a depth from the base upwards, (N,) 1/mm: 0 where it is insulated."""
    return depth.scale * depth.wave_number if depth.cooled else np.zeros_like(depth.wave_number)


def radiated_w(model: HeatModel, amplitudes: Floats) -> float:
    """Heat that the surface radiates."""
    return float(model.medium.radiation_w_mm2k * (model.plane.integral() @ amplitudes @ model.depth.at(0.0)))


def blurred(model: HeatModel, sigma_mm: float) -> Floats:
    """Weights (K,) of a Gaussian spot: a point that has spread for sigma^2 / (2 alpha), modes fall by exp(-lambda sigma^2/2)."""
    return np.exp(-0.5 * model.plane.eigenvalue * sigma_mm**2)


def held(decay: Floats) -> Floats:
    """(1 - e^-x) / x: what is left at the end of a unit time of what came in steadily."""
    safe = np.where(decay == 0.0, 1.0, decay)
    return np.where(decay == 0.0, 1.0, -np.expm1(-safe) / safe)

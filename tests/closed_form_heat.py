"""Heat in closed forms, which the model of the product is held against: modes of a rectangle, and sources that stand or move.

The modes of a rectangle are products of cosines. A source is added to the amplitudes (K, N) of a
:class:`ebamcheck.heat.HeatModel`, step by step and each step exactly.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ebamcheck.heat import DepthModes, HeatModel
from ebamcheck.kernels import Floats

SERIES = 1e-4
"""Exponents under this are taken as power series, which is exact to the last digits there."""


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
        """Integral of phi(x(s)) exp(-r (T - s)) over a straight line traversed in the time T, exactly.

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


def after_source(
    model: HeatModel, amplitudes: Floats, shape: Floats, power_w: float, duration_s: float
) -> Floats:
    """Amplitudes after a source that stands still for a time.

    Parameters
    ----------
    shape
        (K,) mean of the modes over the source: over an island, or at a point.
    """
    decay = model.rate * duration_s
    gain = duration_s * held(decay) * np.multiply.outer(shape, model.in_layer)
    return np.asarray(
        amplitudes * np.exp(-decay) + power_w / model.medium.heat_capacity_j_mm3k * gain, np.float64
    )


def after_spot(
    model: HeatModel, amplitudes: Floats, point: ArrayLike, energy_j: float, sigma_mm: float = 0.0
) -> Floats:
    """Amplitudes after an instantaneous Gaussian spot of a standard deviation."""
    shape = blurred(model, sigma_mm) * model.plane.at(point)[0]
    return np.asarray(
        amplitudes + energy_j / model.medium.heat_capacity_j_mm3k * np.multiply.outer(shape, model.in_layer),
        np.float64,
    )


def after_line(
    model: HeatModel,
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
    rate = model.rate
    if isinstance(model.plane, RectangleModes):
        steady = model.plane.line_integral(a, b, duration_s, rate)
    else:
        pieces = max(1, int(np.ceil(np.hypot(*(b - a)) / piece_mm)))
        nodes = model.plane.at(a + np.linspace(0.0, 1.0, pieces + 1)[:, None] * (b - a))
        steady = np.zeros_like(rate)
        time = duration_s / pieces
        decay = rate * time
        level, ramp, fall = time * held(decay), time * ramped(decay), np.exp(-decay)
        for first, last in itertools.pairwise(nodes):
            steady = steady * fall + first[:, None] * level + (last - first)[:, None] * ramp
    spread = blurred(model, sigma_mm)[:, None] * model.in_layer
    gain = power_w / model.medium.heat_capacity_j_mm3k * steady * spread
    return np.asarray(amplitudes * np.exp(-rate * duration_s) + gain, np.float64)


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
    return np.asarray(np.exp(-0.5 * model.plane.eigenvalue * sigma_mm**2), np.float64)


def held(decay: Floats) -> Floats:
    """(1 - e^-x) / x: what is left at the end of a unit time of what came in steadily."""
    safe = np.where(decay == 0.0, 1.0, decay)
    return np.asarray(np.where(decay == 0.0, 1.0, -np.expm1(-safe) / safe), np.float64)


def ramped(decay: Floats) -> Floats:
    """(1 - held(x)) / x: the same of what came in rising from 0 to 1."""
    safe = np.where(decay < SERIES, 1.0, decay)
    series = 0.5 - decay / 6.0 + decay**2 / 24.0
    return np.asarray(np.where(decay < SERIES, series, (1.0 - held(safe)) / safe), np.float64)

"""Polar radius of a contour about a centre, by the exact crossing of ray and segment (paper, section 5.2)."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ebamcheck.errors import SettingsError
from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Floats

NEAR_DIRECTIONS = 8
"""Directions searched one by one: the first of a segment is rarely farther from the first of the segment before."""

NEARLY_HALF_TURN_RAD = 3.1
"""A segment that spans a larger angle passes so near to the centre that every ray is tested on it."""

ANGLE_MARGIN_RAD = 1e-9
"""Rays this far beyond the ends of a segment are tested too: angles are rounded, crossings are not."""


class Rays(NamedTuple):
    """Sorted directions (m,) of rays, 0 .. 2 pi, with their cosines and sines, computed once for many rings."""

    theta: Floats
    cosine: Floats
    sine: Floats


def polar_radius(ring: ArrayLike, centre: ArrayLike, theta_rad: ArrayLike) -> Floats:
    """Distance from `centre` at which a ray in each direction meets a closed ring.

    Parameters
    ----------
    ring
        (n, 2) points, mm, at least 3, without a repeated end point.
    centre
        (2,) mm.
    theta_rad
        (m,) directions, counter-clockwise from +x.

    Returns
    -------
    (m,) mm; NaN where the radius is undefined, because a ray meets the ring never or more than once.
    """
    points = np.asarray(ring, dtype=np.float64).reshape(-1, 2)
    middle = np.asarray(centre, dtype=np.float64).reshape(-1)
    if len(points) < 3 or middle.size != 2:
        raise SettingsError(
            f"a polar radius needs a ring of at least 3 points and a centre (x, y); got {len(points)} points, {middle.size} coordinates"
        )
    theta = np.mod(np.asarray(theta_rad, dtype=np.float64).reshape(-1), 2.0 * math.pi)
    order = np.argsort(theta, kind="stable")
    radii = np.empty(theta.size)
    radii[order] = ray_radii(closed_points(points), middle[0], middle[1], rays_of(theta[order]))
    return radii


@kernel
def closed_points(points: Floats) -> Floats:
    """Points of a ring with its first one repeated at the end."""
    result = np.empty((len(points) + 1, 2))
    result[:-1], result[-1] = points, points[0]
    return result


@kernel
def rays_of(theta: Floats) -> Rays:
    """Rays in sorted directions (m,), 0 .. 2 pi."""
    return Rays(theta, np.cos(theta), np.sin(theta))


@kernel
def _first_from(theta: Floats, least: float, guess: int) -> int:
    """First of sorted directions that is not less than an angle; a guess a few directions off saves the search."""
    place = guess
    for _ in range(NEAR_DIRECTIONS):
        if place < theta.size and theta[place] < least:
            place += 1
        elif place > 0 and theta[place - 1] >= least:
            place -= 1
        else:
            return place
    return int(np.searchsorted(theta, least))


@kernel
def ray_radii(points: Floats, x: float, y: float, rays: Rays) -> Floats:
    """As :func:`polar_radius`, of a closed polyline (n + 1, 2).

    A ray crosses a segment whose ends lie on different sides of its line, a point on the line counting
    as left: a ray through a vertex thus counts once.
    """
    turn, theta, cosine, sine = 2.0 * math.pi, rays.theta, rays.cosine, rays.sine
    radii = np.full(theta.size, np.nan)
    crossings = np.zeros(theta.size, dtype=np.int64)
    if not theta.size:
        return radii
    px, py = points[0, 0] - x, points[0, 1] - y
    p_angle = math.atan2(py, px)
    near = 0
    for i in range(1, len(points)):
        qx, qy = points[i, 0] - x, points[i, 1] - y
        q_angle = math.atan2(qy, qx)
        low = min(p_angle, q_angle)
        high = max(p_angle, q_angle)
        if high - low > math.pi:
            low, high = high, low + turn
        if high - low > NEARLY_HALF_TURN_RAD:
            low, high = 0.0, turn
        for shift in (-turn, 0.0, turn):  # the directions run from 0 to 2 pi, low from -pi to pi
            first, last = low + shift - ANGLE_MARGIN_RAD, high + shift + ANGLE_MARGIN_RAD
            if (high - low == turn and shift != 0.0) or last < theta[0] or first > theta[-1]:
                continue
            near = _first_from(theta, first, near)
            for k in range(near, theta.size):
                if theta[k] > last:
                    break
                p_left = cosine[k] * py - sine[k] * px >= 0.0
                q_left = cosine[k] * qy - sine[k] * qx >= 0.0
                if p_left == q_left:
                    continue
                rho = (px * qy - py * qx) / (cosine[k] * (qy - py) - sine[k] * (qx - px))
                if rho > 0.0:
                    radii[k] = rho
                    crossings[k] += 1
        px, py, p_angle = qx, qy, q_angle
    for k in range(theta.size):
        if crossings[k] != 1:
            radii[k] = np.nan
    return radii

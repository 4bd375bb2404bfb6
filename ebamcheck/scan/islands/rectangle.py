"""The smallest rectangle around a layer, in which the hexagons are laid out (paper, section 4.1)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
import shapely
from numpy.typing import ArrayLike

from ebamcheck.errors import GeometryError
from ebamcheck.numeric.rings import Floats

PAPER_STEPS = 10
"""The paper turns the envelope in steps of pi/10 (equation 11)."""

AT_ONCE = 1_000_000
"""Corners times directions of a hull that are worked out together, about."""

TIE = 1e-12
"""Relative difference of area under which two rectangles count as equal; the first one is kept."""


@dataclass(frozen=True)
class Rectangle:
    """A rectangle that may be turned.

    Parameters
    ----------
    x_mm, y_mm
        Centre.
    angle_rad
        Direction of the side L1, counter-clockwise from +X; in [0, pi) for a smallest rectangle.
    short_mm, long_mm
        Lengths L1 and L2 of the sides; L1 <= L2 for a smallest rectangle.
    """

    x_mm: float
    y_mm: float
    angle_rad: float
    short_mm: float
    long_mm: float

    @property
    def area_mm2(self) -> float:
        """Area L1 L2."""
        return self.short_mm * self.long_mm

    def to_world(self, along_short: ArrayLike, along_long: ArrayLike) -> Floats:
        """Points (..., 2), mm, from coordinates along the short and the long side about the centre."""
        a, b = np.asarray(along_short, np.float64), np.asarray(along_long, np.float64)
        c, s = math.cos(self.angle_rad), math.sin(self.angle_rad)
        return np.stack([self.x_mm + c * a - s * b, self.y_mm + s * a + c * b], axis=-1)

    def polygon(self) -> shapely.Polygon:
        """The rectangle as a polygon."""
        a, b = 0.5 * self.short_mm, 0.5 * self.long_mm
        return shapely.Polygon(self.to_world([-a, a, a, -a], [-b, -b, b, b]))


def minimum_rectangle(points: ArrayLike, method: Literal["paper", "exact"] = "exact") -> Rectangle:
    """Find the enclosing rectangle of least area.

    Parameters
    ----------
    points
        (N, 2) mm; only their convex hull matters.
    method
        ``"paper"`` tries the rotations 0, pi/10, 2 pi/10, ... (equation 11); ``"exact"`` every direction
        of an edge of the convex hull, among which the minimum lies.

    Raises
    ------
    GeometryError
        If there is no point, or one that is not finite.
    """
    column = np.asarray(points, np.float64).reshape(-1, 2)
    if not len(column) or not np.isfinite(column).all():
        raise GeometryError(
            f"minimum rectangle of {len(column)} points: give at least one point, all of them finite"
        )
    hull = _convex_hull(column)
    if method == "paper":
        angles = np.arange(PAPER_STEPS) * (math.pi / PAPER_STEPS)
        boxes = _envelopes(hull, np.stack([np.cos(angles), np.sin(angles)], axis=-1))
    else:
        edges = np.roll(hull, -1, axis=0) - hull
        lengths = np.hypot(edges[:, 0], edges[:, 1])
        directions = edges[lengths > 0] / lengths[lengths > 0, None]
        parts = np.array_split(directions, max(1, len(hull) * len(directions) // AT_ONCE))
        boxes = np.concatenate(
            [_envelopes(hull, part if len(part) else np.array([[1.0, 0.0]])) for part in parts]
        )
    return _rectangle(*_smallest(boxes))


def rectangle_along(points: ArrayLike, angle_rad: float) -> Rectangle:
    """Enclosing rectangle whose side L1 has a given direction, also where it is the longer one.

    Parameters
    ----------
    points
        (N, 2) mm, at least one, all of them finite.
    angle_rad
        Direction of L1, counter-clockwise from +X.
    """
    direction = np.array([[math.cos(angle_rad), math.sin(angle_rad)]])
    ux, uy, amin, amax, bmin, bmax = _envelopes(np.asarray(points, np.float64).reshape(-1, 2), direction)[0]
    a, b = 0.5 * (amin + amax), 0.5 * (bmin + bmax)
    return Rectangle(ux * a - uy * b, uy * a + ux * b, angle_rad, amax - amin, bmax - bmin)


def _convex_hull(points: Floats) -> Floats:
    """Corners of the convex hull, counter-clockwise, (H, 2); fewer than three where it has no area."""
    hull = shapely.convex_hull(shapely.LineString(points) if len(points) > 1 else shapely.Point(points[0]))
    if hull.geom_type == "Polygon":
        return shapely.get_coordinates(shapely.orient_polygons(hull))[:-1]
    return shapely.get_coordinates(hull)


def _envelopes(hull: Floats, directions: Floats) -> Floats:
    """Extent of the hull along and across each direction, (K, 6): ux, uy, amin, amax, bmin, bmax."""
    along = directions @ hull.T
    across = np.stack([-directions[:, 1], directions[:, 0]], axis=-1) @ hull.T
    extents = [along.min(axis=1), along.max(axis=1), across.min(axis=1), across.max(axis=1)]
    return np.column_stack([directions, *extents])


def _smallest(boxes: Floats) -> tuple[float, float, float, float, float, float]:
    """The box of least area; among equal ones the first."""
    areas = (boxes[:, 3] - boxes[:, 2]) * (boxes[:, 5] - boxes[:, 4])
    k = int(np.flatnonzero(areas <= areas.min() * (1.0 + TIE))[0])
    ux, uy, amin, amax, bmin, bmax = (float(v) for v in boxes[k])
    return ux, uy, amin, amax, bmin, bmax


def _rectangle(ux: float, uy: float, amin: float, amax: float, bmin: float, bmax: float) -> Rectangle:
    """Name the sides by their length and bring the direction into [0, pi)."""
    a, b = 0.5 * (amin + amax), 0.5 * (bmin + bmax)
    x, y = ux * a - uy * b, uy * a + ux * b
    angle = math.atan2(uy, ux)
    first, second = amax - amin, bmax - bmin
    if first > second:
        angle, first, second = angle + 0.5 * math.pi, second, first
    return Rectangle(x, y, angle % math.pi, first, second)

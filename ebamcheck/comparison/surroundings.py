"""Surroundings of a place in the mesh's own section: crossing or touching shells, thin walls, nearly level faces.

Everything here is derived from the oriented segments in which facets cut the plane of the layer.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ebamcheck.numeric.rings import Floats, Ints

MOST_SEGMENTS = 400
"""Most segments examined, the nearest ones: all pairs of them are compared."""

FACING_COS = -0.7
"""Largest cosine between the directions of the two sides of a wall or gap: opposite to within about 45 degrees."""

AS_NEAR = 1.0 + 1e-6
"""Factor of the least distance within which segments count as equally near."""

MOST_SIDES = 8
"""Most equally near segments examined; they meet in one point."""

ROUNDING_SHARE = 2.0**-22
"""Largest height error by single precision, over the part's size (four roundings)."""

Bools = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Surroundings:
    """Segments near a place, the nearest first.

    Parameters
    ----------
    place
        (2,) the place, mm.
    segments
        (n, 4) ``x0, y0, x1, y1`` with the solid on their left.
    body
        (n,) body of each segment's facet.
    normals
        (n, 3) unit normal of each segment's facet.
    distance
        (n,) distance of each segment from the place, mm, ascending.
    """

    place: Floats
    segments: Floats
    body: Ints
    normals: Floats
    distance: Floats

    def crossing(self) -> tuple[Ints, Ints]:
        """Pairs of segments that cross in the interior of both."""
        p, q = self.segments[:, :2], self.segments[:, 2:]
        side_p = _sides(p, q, p)
        side_q = _sides(p, q, q)
        apart = side_p * side_q < 0.0
        return tuple(np.nonzero(np.triu(apart & apart.T, 1)))  # type: ignore[return-value]

    def touching_bodies(self, within_mm: float) -> bool:
        """Whether an end of a segment lies on a segment of another body."""
        other = self.body[:, None] != self.body[None, :]
        return bool((other & (self._gaps() <= within_mm)).any())

    def width(self) -> tuple[float, bool]:
        """Distance between the sides of the wall or gap at the place, mm, and whether it is a wall.

        One side is the nearest segment, the other the nearest one that faces it. Of several equally near segments, as at
        the mouth of a slit, it is the one whose other side is nearest. Infinite if there is no other side.
        """
        if not len(self.segments):
            return np.inf, False
        along = self.segments[:, 2:] - self.segments[:, :2]
        along = along / np.maximum(np.linalg.norm(along, axis=1), np.finfo(np.float64).tiny)[:, None]
        as_near = np.flatnonzero(self.distance <= AS_NEAR * self.distance[0])[:MOST_SIDES]
        return min((self._across(along, int(k)) for k in as_near), key=lambda found: found[0])

    def _across(self, along: Floats, side: int) -> tuple[float, bool]:
        """Distance from one side to the nearest segment that faces it, and whether solid lies between."""
        facing = along @ along[side] < FACING_COS
        if not facing.any():
            return np.inf, False
        k = int(np.argmax(facing))
        foot = _nearest_point(self.segments[side : side + 1], self.place)[0]
        away = _nearest_point(self.segments[k : k + 1], foot)[0] - foot
        left = np.array([-along[side, 1], along[side, 0]])
        return float(np.linalg.norm(away)), bool(left @ away > 0.0)

    def travel_per_mm(self) -> float:
        """Movement of the contour at the place per mm of height: 0 at a vertical wall."""
        if not len(self.normals):
            return 0.0
        x, y, z = self.normals[0]
        return float(abs(z) / max(np.hypot(x, y), np.finfo(np.float64).tiny))

    def _gaps(self) -> Floats:
        """Distance (n, n) of the start of each segment (rows) from each segment (columns)."""
        start = self.segments[:, None, :2]
        a, u = self.segments[None, :, :2], self.segments[None, :, 2:] - self.segments[None, :, :2]
        square = np.maximum((u * u).sum(axis=2), np.finfo(np.float64).tiny)
        t = np.clip(((start - a) * u).sum(axis=2) / square, 0.0, 1.0)
        gaps: Floats = np.linalg.norm(start - a - t[:, :, None] * u, axis=2)
        return gaps


def surroundings(
    segments: Floats, body: Ints, corners: Floats, x_mm: float, y_mm: float, reach_mm: float
) -> Surroundings:
    """Select the segments (n, 4) within reach of a place; `corners` (n, 3, 3) are their facets'."""
    place = np.array([x_mm, y_mm])
    distance = np.linalg.norm(_nearest_point(segments, place) - place, axis=1)
    order = np.argsort(distance, kind="stable")[:MOST_SEGMENTS]
    near = order[distance[order] <= reach_mm]
    a, b, c = np.moveaxis(corners[near], 1, 0)
    normals = np.cross(b - a, c - a)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = normals / np.where(length > 0.0, length, 1.0)
    return Surroundings(place, segments[near], body[near], normals, distance[near])


def _nearest_point(segments: Floats, place: Floats) -> Floats:
    """Point of each segment (n, 2) that is nearest to a place."""
    a, u = segments[:, :2], segments[:, 2:] - segments[:, :2]
    square = (u * u).sum(axis=1)
    t = np.clip(((place - a) * u).sum(axis=1) / np.where(square > 0.0, square, 1.0), 0.0, 1.0)
    points: Floats = a + t[:, None] * u
    return points


def _sides(p: Floats, q: Floats, at: Floats) -> Floats:
    """Side (n, n) of the line through each segment p-q (rows) on which each point lies (columns)."""
    u = (q - p)[:, None]
    v = at[None] - p[:, None]
    sides: Floats = u[:, :, 0] * v[:, :, 1] - u[:, :, 1] * v[:, :, 0]
    return sides

"""Parallel lines that fill islands: an exact scan-line clip of all islands in one kernel.

An island of depth D across its hatch gets the whole number of lines that comes nearest to the set
spacing and leaves no gap, spread evenly: the first and last line lie half a pitch from its sides. Lines
end on its border, so that lines times pitch is its area, and neighbouring islands meet without a seam.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray

from ebamcheck.geometry.regions import equivalent_rectangles_mm, ring_columns
from ebamcheck.kernels import Floats, Ints, kernel
from ebamcheck.scan.islands.lattice import minimum_rectangle

WIDEST_PITCH = 0.9
"""Largest distance of neighbouring beads over their width: a bead's edge must lie on the next bead."""

SHORTEST_LINE = 0.1
"""Lines shorter than this times the bead width start and stop on one spot; they are left out."""


def widest_pitch_mm(bead_width_mm: float, spacing_mm: float) -> float:
    """Largest distance of neighbouring lines: that of :data:`WIDEST_PITCH`, or a wider set spacing."""
    return max(spacing_mm, WIDEST_PITCH * bead_width_mm)


def lines_across(depth_mm: float, spacing_mm: float, widest_mm: float) -> int:
    """Lines that fill a strip of the given depth: nearest to the spacing, none wider apart than allowed.

    Examples
    --------
    >>> [lines_across(depth, 4.32, 5.4) for depth in (0.5, 5.0, 5.5, 26.0)]
    [1, 1, 2, 6]
    """
    nearest = int(np.floor(depth_mm / spacing_mm + 0.5))
    return max(1, nearest, int(np.ceil(depth_mm / widest_mm - 1e-9)))


@dataclass(frozen=True, eq=False)
class Vectors:
    """Scan lines as columns: `island` (V,), `start` (V, 2) and `end` (V, 2), mm."""

    island: Ints
    start: Floats
    end: Floats


def hatch(
    islands: ArrayLike, angle_rad: ArrayLike, bead_width_mm: float, spacing_mm: float
) -> tuple[Vectors, Floats]:
    """Fill islands with parallel lines, one after the other, alternating in direction.

    An island narrower than the spacing is filled along its long side, whatever its angle: one line
    there is better than many stubs across.

    `islands`: (I,) shapely polygons; `angle_rad`: (I,) direction of the lines of each, counter-clockwise from +X.

    Returns `vectors`: sorted by island, in scan order within each; `angle_rad`: (I,) the angles that were used.
    """
    geometries = np.asarray(islands, object).reshape(-1)
    angles = np.array(np.broadcast_to(np.asarray(angle_rad, np.float64), geometries.shape))
    width, _ = equivalent_rectangles_mm(geometries)
    for i in np.flatnonzero(width < spacing_mm):
        angles[i] = _long_direction(geometries[i])
    vectors = _scan(geometries, angles, bead_width_mm, spacing_mm, SHORTEST_LINE * bead_width_mm)
    missed = np.setdiff1d(np.arange(geometries.size), vectors.island)
    for i in missed:
        angles[i] = _long_direction(geometries[i])
    if missed.size:
        rest = _scan(geometries[missed], angles[missed], bead_width_mm, spacing_mm, 0.0)
        vectors = joined(vectors, Vectors(missed[rest.island], rest.start, rest.end))
    return vectors, angles


def _long_direction(island: shapely.Polygon) -> float:
    """Direction of the long side of the smallest rectangle around an island."""
    return minimum_rectangle(shapely.get_coordinates(shapely.convex_hull(island))).angle_rad + 0.5 * math.pi


def joined(first: Vectors, second: Vectors) -> Vectors:
    """Both sets sorted by island; within one, those of the first set come first."""
    island = np.concatenate([first.island, second.island])
    order = np.argsort(island, kind="stable")
    start, end = np.vstack([first.start, second.start]), np.vstack([first.end, second.end])
    return Vectors(island[order], start[order], end[order])


def _scan(
    islands: NDArray[np.object_], angles: Floats, bead_width_mm: float, spacing_mm: float, shortest_mm: float
) -> Vectors:
    """Clip the lines of all islands."""
    points, (ring_starts, island_rings) = ring_columns(islands)
    widest_mm = widest_pitch_mm(bead_width_mm, spacing_mm)
    island, start, end = scan_lines(
        points, ring_starts, island_rings, angles, spacing_mm, widest_mm, shortest_mm
    )
    return Vectors(island, start, end)


@kernel
def scan_lines(
    points: Floats,
    ring_starts: Ints,
    island_rings: Ints,
    angles: Floats,
    spacing: float,
    widest: float,
    shortest: float,
) -> tuple[Ints, Floats, Floats]:
    """Lines inside each island (rings closed by a repeated point), by the even-odd rule.

    Works in coordinates turned by the island's angle about its first point, so that islands far from
    the origin lose no digits.
    """
    islands = island_rings.size - 1
    capacity = 64
    owner = np.empty(capacity, np.int64)
    start = np.empty((capacity, 2))
    end = np.empty((capacity, 2))
    used = 0
    for k in range(islands):
        first, last = ring_starts[island_rings[k]], ring_starts[island_rings[k + 1]]
        if last - first < 3:
            continue
        c, s = np.cos(angles[k]), np.sin(angles[k])
        x0, y0 = points[first, 0], points[first, 1]
        along = np.empty(last - first)
        across = np.empty(last - first)
        for i in range(first, last):
            dx, dy = points[i, 0] - x0, points[i, 1] - y0
            along[i - first] = c * dx + s * dy
            across[i - first] = c * dy - s * dx
        low, high = across.min(), across.max()
        depth = high - low
        # As :func:`lines_across`.
        count = max(1, int(np.floor(depth / spacing + 0.5)), int(np.ceil(depth / widest - 1e-9)))
        row = np.empty(last - first)
        forward = True
        for n in range(count):
            level = low + depth * (n + 0.5) / count
            found = 0
            for r in range(island_rings[k], island_rings[k + 1]):
                for i in range(ring_starts[r] - first, ring_starts[r + 1] - first - 1):
                    a, b = across[i], across[i + 1]
                    if (a <= level) != (b <= level):
                        crossing = along[i] + (along[i + 1] - along[i]) * ((level - a) / (b - a))
                        place = found
                        while place > 0 and row[place - 1] > crossing:
                            row[place] = row[place - 1]
                            place -= 1
                        row[place] = crossing
                        found += 1
            drawn = False
            for m in range(found // 2):
                pair = m if forward else found // 2 - 1 - m
                p, q = row[2 * pair], row[2 * pair + 1]
                if q - p <= shortest:
                    continue
                if not forward:
                    p, q = q, p
                if used == capacity:
                    capacity *= 2
                    owner = np.concatenate((owner, owner))
                    start, end = np.concatenate((start, start)), np.concatenate((end, end))
                owner[used] = k
                start[used, 0], start[used, 1] = x0 + c * p - s * level, y0 + s * p + c * level
                end[used, 0], end[used, 1] = x0 + c * q - s * level, y0 + s * q + c * level
                used += 1
                drawn = True
            if drawn:
                forward = not forward
    return owner[:used].copy(), start[:used].copy(), end[:used].copy()

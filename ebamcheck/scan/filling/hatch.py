"""Parallel lines that fill islands: an exact scan-line clip of all islands at once.

An island of depth D across its hatch gets the whole number of lines that comes nearest to the set spacing and leaves no gap, spread
evenly. Lines end on its border, so that lines times pitch is its area, and neighbouring islands meet without a seam."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ebamcheck.geometry.raster import each_of
from ebamcheck.geometry.regions import equivalent_rectangles_mm, ring_columns
from ebamcheck.kernels import Floats, Ints
from ebamcheck.scan.islands.lattice import long_direction_rad

# Largest distance of neighbouring beads over their width: a bead's edge must lie on the next bead
WIDEST_PITCH = 0.9
# Lines shorter than this times the bead width start and stop on one spot; they are left out
SHORTEST_LINE = 0.1


def widest_pitch_mm(bead_width_mm: float, spacing_mm: float) -> float:
    """Largest distance of neighbouring lines: that of :data:`WIDEST_PITCH`, or a wider set spacing."""
    return max(spacing_mm, WIDEST_PITCH * bead_width_mm)


def lines_across(depth_mm: Floats, spacing_mm: float, widest_mm: float) -> Ints:
    """Lines that fill strips of the given depths (n,): nearest to the spacing, none wider apart than allowed.

    >>> lines_across(np.array([0.5, 5.0, 5.5, 26.0]), 4.32, 5.4)
    array([1, 1, 2, 6])
    """
    fewest = np.ceil(depth_mm / widest_mm - 1e-9)
    return np.maximum(np.maximum(np.floor(depth_mm / spacing_mm + 0.5), fewest), 1.0).astype(np.int64)


@dataclass(frozen=True, eq=False)
class Vectors:
    """Scan lines as columns: `island` (V,), `start` (V, 2) and `end` (V, 2), mm."""

    island: Ints
    start: Floats
    end: Floats


def hatch(islands: ArrayLike, angle_rad: ArrayLike, bead_width_mm: float, spacing_mm: float) -> tuple[Vectors, Floats]:
    """Fill islands (I,) with parallel lines at angles (I,), rad counter-clockwise from +X, one after the other, alternating; and
    the angles used.

    An island narrower than the spacing is filled along its long side: one line there is better than many stubs across.
    """
    geometries = np.asarray(islands, object).reshape(-1)
    angles = np.array(np.broadcast_to(np.asarray(angle_rad, np.float64), geometries.shape))
    width, _ = equivalent_rectangles_mm(geometries)
    widest_mm = widest_pitch_mm(bead_width_mm, spacing_mm)

    def lines(which: Ints, shortest_mm: float) -> Vectors:
        points, (ring_starts, island_rings) = ring_columns(geometries[which])
        columns = points, ring_starts, island_rings, angles[which]
        island, start, end = scan_lines(*columns, spacing_mm, widest_mm, shortest_mm)
        return Vectors(which[island], start, end)

    for i in np.flatnonzero(width < spacing_mm):
        angles[i] = long_direction_rad(geometries[i])
    vectors = lines(np.arange(geometries.size), SHORTEST_LINE * bead_width_mm)
    missed = np.setdiff1d(np.arange(geometries.size), vectors.island)
    for i in missed:
        angles[i] = long_direction_rad(geometries[i])
    return (joined(vectors, lines(missed, 0.0)) if missed.size else vectors), angles


def joined(first: Vectors, second: Vectors) -> Vectors:
    """Both sets sorted by island; within one, those of the first set come first."""
    island = np.concatenate([first.island, second.island])
    order = np.argsort(island, kind="stable")
    start, end = np.vstack([first.start, second.start]), np.vstack([first.end, second.end])
    return Vectors(island[order], start[order], end[order])


def scan_lines(
    points: Floats,
    ring_starts: Ints,
    island_rings: Ints,
    angles: Floats,
    spacing: float,
    widest: float,
    shortest: float,
) -> tuple[Ints, Floats, Floats]:
    """Lines inside each island (rings closed by a repeated point), by the even-odd rule: island of each, start and end.

    Works in coordinates turned by the island's angle about its first point, so that islands far from the origin lose no digits.
    """
    first = ring_starts[island_rings]
    some = np.flatnonzero(np.diff(first) >= 3)
    if not len(some):
        return np.zeros(0, np.int64), np.zeros((0, 2)), np.zeros((0, 2))
    island = np.repeat(np.arange(len(angles)), np.diff(first))
    c, s, origin = np.cos(angles), np.sin(angles), points[np.minimum(first[:-1], len(points) - 1)]
    dx, dy = (points - origin[island]).T
    along, across = c[island] * dx + s[island] * dy, c[island] * dy - s[island] * dx
    low, depth = np.zeros(len(angles)), np.zeros(len(angles))
    low[some] = np.minimum.reduceat(across, first[some])
    depth[some] = np.maximum.reduceat(across, first[some]) - low[some]
    count = lines_across(depth, spacing, widest)

    # Where sides cross the lines: those between the ends of a side, and one more on either hand, are asked themselves.
    side = np.setdiff1d(np.arange(len(points) - 1), ring_starts[1:-1] - 1)
    of, a, b = island[side], across[side], across[side + 1]
    tiny = np.maximum(depth, np.finfo(float).tiny)[of]
    reach = np.stack([np.minimum(a, b), np.maximum(a, b)]) - low[of]
    least, most = np.clip(reach / tiny * count[of] - 0.5, -2.0, count[of] + 1.0)
    begin, end = np.maximum(np.floor(least), 0.0), np.minimum(np.ceil(most) + 1.0, count[of])
    owner, number = each_of(np.maximum(end - begin, 0.0).astype(np.int64))
    number += begin[owner].astype(np.int64)
    of, a, b, side = of[owner], a[owner], b[owner], side[owner]
    level = low[of] + depth[of] * (number + 0.5) / count[of]
    met = (a <= level) != (b <= level)
    of, a, b, side, level, number = (column[met] for column in (of, a, b, side, level, number))
    place = along[side] + (along[side + 1] - along[side]) * ((level - a) / (b - a))

    # Crossings of one line are as many as make pairs: between them lies the island.
    order = np.lexsort((place, number, of))
    of, number, level = of[order][::2], number[order][::2], level[order][::2]
    p, q = place[order].reshape(-1, 2).T
    kept = q - p > shortest
    of, number, level, p, q = (column[kept] for column in (of, number, level, p, q))
    new = np.diff(of, prepend=-1) != 0
    row = np.cumsum(new | (np.diff(number, prepend=-1) != 0))
    # Rows with lines alternate in direction within an island.
    turned = (row - row[np.flatnonzero(new)][np.cumsum(new) - 1]) % 2 == 1
    driven = np.lexsort((np.where(turned, -p, p), row))
    of, level, p, q, turned = (column[driven] for column in (of, level, p, q, turned))
    ends = [
        origin[of] + np.column_stack([c[of] * x - s[of] * level, s[of] * x + c[of] * level])
        for x in (np.where(turned, q, p), np.where(turned, p, q))
    ]
    return of, ends[0], ends[1]

"""Thinning: contour points that carry no shape are removed, those too near to others and those inside straight sides."""

from __future__ import annotations

import numpy as np

from ebamcheck.curves.sides import NO_PLANE, Sides
from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Floats, Ints

FLAT_MM = 2e-5
"""A smooth point this near to the chord of its neighbours, in place and direction, is removed: facets of one flat side meet
there. It is the 32-bit rounding of coordinates of some hundred mm."""

IN_PLANE_MM = 1e-3
"""A point inside a plane is removed if it lies this near to the chord of its neighbours: the rounding of a file's decimals, and
the least distance of contour points. Not every point in a plane is: around a level one the contour turns."""


@kernel
def is_sharp(sides: Sides, i: int) -> bool:
    """Whether a point lies on a crease of the mesh."""
    return not sides.smooth[i] and not np.isnan(sides.before[i, 0])


@kernel
def distance(points: Floats, i: int, j: int) -> float:
    """Distance of two of some points (n, 2)."""
    return float(np.hypot(points[j, 0] - points[i, 0], points[j, 1] - points[i, 1]))


@kernel
def without_near(sides: Sides, a: int, b: int, closed: bool, near: float, rows: Ints) -> int:
    """Leave out points nearer than `near` to the one before; of two, that on a crease stays. Returns how many are left.

    A ring that would be left with fewer than three points keeps them all.
    """
    n = 0
    for i in range(a, b):
        if n and distance(sides.points, rows[a + n - 1], i) < near:
            if is_sharp(sides, i) and not is_sharp(sides, rows[a + n - 1]) and n > 1:
                rows[a + n - 1] = i
            continue
        rows[a + n] = i
        n += 1
    while closed and n > 3 and distance(sides.points, rows[a + n - 1], rows[a]) < near:
        n -= 1
    if n < 3 <= b - a:
        for i in range(a, b):
            rows[i] = i
        return int(b - a)
    if not closed and n > 1:
        rows[a + n - 1] = b - 1
    return n


@kernel
def without_flat(sides: Sides, rows: Ints, closed: bool) -> int:
    """Leave out points inside of planes, and smooth ones inside of other straight sides; three points stay."""
    size = rows.size
    n = 0
    for k in range(size):
        left = n + size - k
        inner = closed or 0 < k < size - 1
        before = rows[n - 1] if n else rows[size - 1]
        if not (inner and left > 3 and _is_flat(sides, before, rows[k], rows[(k + 1) % size])):
            rows[n] = rows[k]
            n += 1
    return n


@kernel
def _is_flat(sides: Sides, p: int, i: int, q: int) -> bool:
    """Whether a point lies inside of a plane, or a smooth one on the chord of its neighbours in place and direction."""
    in_plane = sides.plane_after[i] != NO_PLANE and sides.plane_before[i] == sides.plane_after[i]
    if not in_plane and (not sides.smooth[i] or np.isnan(sides.before[i, 0])):
        return False
    x, y = sides.points[q, 0] - sides.points[p, 0], sides.points[q, 1] - sides.points[p, 1]
    long = np.hypot(x, y)
    u, v = sides.points[i, 0] - sides.points[p, 0], sides.points[i, 1] - sides.points[p, 1]
    off = abs(x * v - y * u)
    tilt = abs(x * sides.before[i, 1] - y * sides.before[i, 0])
    ahead = x * u + y * v
    if in_plane:
        return bool(0.0 < ahead < long * long and off < IN_PLANE_MM * long)
    return bool(0.0 < ahead < long * long and off < FLAT_MM * long and 0.25 * tilt < FLAT_MM)

"""Bends: by how much a contour turns within each of its segments, and which segments are straight.

The direction at a point lies between those of its two chords; where the mesh supports only a smaller bend, segments bend less.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ebamcheck.curves.plausible import plausible_share
from ebamcheck.curves.sides import NO_FORM, NO_PLANE, Sides
from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Bools, Floats, Ints
from ebamcheck.numeric.sorting import rotate_to

LARGEST_TURN_RAD = np.deg2rad(60.0)
"""A smooth mesh edge at which the contour turns by more than this is the tip of a thin feature: it counts as a corner."""

STRAIGHT_RATIO = 3.0
"""A straight run is this many times longer than any of the two segments on either side of it, up to a corner."""


class Ring(NamedTuple):
    """Points of one ring and the bends at them, as columns; the angles are those of :class:`OrientedContours`."""

    rows: Ints
    """(n,) row of each point among the contours' points."""
    before: Floats
    """(n,) angle from the chord of the segment before the point to the direction in which it ends, rad."""
    after: Floats
    """(n,) angle from the direction in which the segment after the point starts to its chord, rad."""
    corner: Bools
    """(n,) whether the point is a corner, or the end of an open path."""
    straight: Bools
    """(n,) whether the segment after the point is a straight line."""


@kernel
def find_corners(sides: Sides, ring: Ring, closed: bool, largest_turn: float) -> None:
    """Creases are corners; so are points of unknown direction that turn far, and the ends of open paths."""
    n = ring.rows.size
    for k in range(n):
        i = ring.rows[k]
        if not closed and (k == 0 or k == n - 1):
            ring.corner[k] = True
            continue
        turn = abs(_turn(sides.points, ring.rows[k - 1], i, ring.rows[(k + 1) % n]))
        if sides.smooth[i]:
            ring.corner[k] = turn > LARGEST_TURN_RAD
        else:
            ring.corner[k] = is_sharp(sides, i) or turn > largest_turn


@kernel
def set_angles(sides: Sides, ring: Ring, closed: bool) -> None:
    """Angles between chords and directions; NaN at corners without a direction."""
    n = ring.rows.size
    points = sides.points
    for k in range(n):
        h, i, j = ring.rows[k - 1], ring.rows[k], ring.rows[(k + 1) % n]
        if not closed and k in (0, n - 1):
            ring.before[k] = ring.after[k] = np.nan
            continue
        ax, ay = points[i, 0] - points[h, 0], points[i, 1] - points[h, 1]
        bx, by = points[j, 0] - points[i, 0], points[j, 1] - points[i, 1]
        if ring.corner[k]:
            ring.before[k] = _angle_to(ax, ay, sides.before[i])
            ring.after[k] = -_angle_to(bx, by, sides.after[i])
            continue
        turn = np.arctan2(ax * by - ay * bx, ax * bx + ay * by)
        if sides.smooth[i] and not np.isnan(sides.before[i, 0]):
            ahead = _angle_to(ax, ay, sides.before[i])
        else:  # the circle through the three points
            ahead = turn * np.hypot(ax, ay) / (np.hypot(ax, ay) + np.hypot(bx, by))
        if sides.form_before[i] == NO_FORM or sides.form_after[i] == NO_FORM:
            # Between the two chords: a direction beyond them would bend the curve out and back.
            ahead = min(max(ahead, min(turn, 0.0)), max(turn, 0.0))
        ring.before[k] = ahead
        ring.after[k] = turn - ring.before[k]


@kernel
def _is_sure(sides: Sides, ring: Ring, k: int) -> bool:
    """Whether the segment after point k lies on an exact surface at both of its ends."""
    m = (k + 1) % ring.rows.size
    form = sides.form_after[ring.rows[k]]
    return bool(form != NO_FORM and form == sides.form_before[ring.rows[m]])


@kernel
def limit_at_corners(sides: Sides, ring: Ring) -> None:
    """At a corner a segment bends no more than at its other end, and as a circle where nothing is known."""
    n = ring.corner.size
    for k in range(n):
        if _is_sure(sides, ring, k):
            continue
        m = (k + 1) % n
        start, end = ring.after[k], ring.before[m]
        if ring.corner[k] and np.isnan(start):
            start = end
        if ring.corner[m] and np.isnan(end):
            end = start
        if np.isnan(start):
            start = end = 0.0
        if ring.corner[k] or ring.corner[m]:
            lesser = min(abs(start), abs(end)) if start * end > 0.0 else 0.0
            if ring.corner[k]:
                start = np.copysign(lesser, start)
            if ring.corner[m]:
                end = np.copysign(lesser, end)
        ring.after[k], ring.before[m] = start, end


@kernel
def spare_long_segments(sides: Sides, ring: Ring) -> None:
    """Turn directions towards a segment that is far longer than the one beside it and bends far more there than at
    its other end: it goes over into something else, and is no part of the bend."""
    n = ring.rows.size
    points = sides.points
    ahead, back = ring.after.copy(), ring.before.copy()
    for k in range(n):
        here, there = _is_sure(sides, ring, k), _is_sure(sides, ring, k - 1)
        if ring.corner[k] or (here and there):
            continue
        m = (k + 1) % n
        to, away = (
            distance(points, ring.rows[k - 1], ring.rows[k]),
            distance(points, ring.rows[k], ring.rows[m]),
        )
        turn = ring.before[k] + ring.after[k]
        if not here and away >= STRAIGHT_RATIO * to and abs(ahead[k]) > STRAIGHT_RATIO * abs(back[m]):
            ring.after[k] = np.copysign(STRAIGHT_RATIO * abs(back[m]), ahead[k])
            if there:
                ring.corner[k] = True
            else:
                ring.before[k] = turn - ring.after[k]
        elif not there and to >= STRAIGHT_RATIO * away and abs(back[k]) > STRAIGHT_RATIO * abs(ahead[k - 1]):
            ring.before[k] = np.copysign(STRAIGHT_RATIO * abs(ahead[k - 1]), back[k])
            if here:
                ring.corner[k] = True
            else:
                ring.after[k] = turn - ring.before[k]


@kernel
def keep_plausible(sides: Sides, ring: Ring, closed: bool) -> None:
    """Bend segments less that would leave their chords by more than the surface plausibly does.

    What such a segment turns less at an end, its neighbour turns more, unless that then bends too much itself or lies on an
    exact surface: there is a kink then, as the contour has.
    """
    n = ring.rows.size
    last = n if closed else n - 1
    share = np.ones(n)
    for k in range(last):
        m = (k + 1) % n
        bulge = (
            0.25
            * distance(sides.points, ring.rows[k], ring.rows[m])
            * max(abs(ring.after[k]), abs(ring.before[m]))
        )
        if _is_sure(sides, ring, k):
            continue
        share[k] = plausible_share(bulge, max(sides.plausible[ring.rows[k]], sides.plausible[ring.rows[m]]))
        share[k] *= max(sides.share[ring.rows[k]], sides.share[ring.rows[m]])
    for k in range(n):
        if ring.corner[k]:
            ring.before[k] *= share[k - 1]
            ring.after[k] *= share[k]
            continue
        if share[k] == 1.0 and share[k - 1] == 1.0:
            continue
        turn = ring.before[k] + ring.after[k]
        to, away = (
            distance(sides.points, ring.rows[k - 1], ring.rows[k]),
            distance(sides.points, ring.rows[k], ring.rows[(k + 1) % n]),
        )
        sure = _is_sure(sides, ring, k if share[k] == 1.0 else k - 1)
        if sure or (share[k] < 1.0 and share[k - 1] < 1.0):
            ring.corner[k] = True
            ring.before[k] *= share[k - 1]
            ring.after[k] *= share[k]
        elif share[k] < 1.0:
            ring.after[k] *= share[k]
            ring.before[k] = turn - ring.after[k]
            plausible = max(sides.plausible[ring.rows[k - 1]], sides.plausible[ring.rows[k]])
            if 0.25 * to * abs(ring.before[k]) > plausible:
                ring.corner[k] = True
                ring.before[k] = np.copysign(4.0 * plausible / to, ring.before[k])
        else:
            ring.before[k] *= share[k - 1]
            ring.after[k] = turn - ring.before[k]
            plausible = max(sides.plausible[ring.rows[k]], sides.plausible[ring.rows[(k + 1) % n]])
            if 0.25 * away * abs(ring.after[k]) > plausible:
                ring.corner[k] = True
                ring.after[k] = np.copysign(4.0 * plausible / away, ring.after[k])


@kernel
def mark_straight(sides: Sides, ring: Ring, closed: bool, straight_run: float) -> None:
    """Mark straight segments, and turn what lies beside them to their direction.

    A segment is straight if it lies in a plane, if it does not bend between two corners, or if it is long, far longer
    than those beside it, and may be part of a flat side.
    """
    n = ring.rows.size
    lengths = np.empty(n)
    for k in range(n):
        lengths[k] = distance(sides.points, ring.rows[k], ring.rows[(k + 1) % n])
    if not closed:
        lengths[n - 1] = 0.0
    for k in range(n if closed else n - 1):
        m = (k + 1) % n
        bulge = 0.25 * lengths[k] * max(abs(ring.after[k]), abs(ring.before[m]))
        alone = ring.corner[k] and ring.corner[m] and bulge < FLAT_MM
        longest = 0.0
        if not ring.corner[m]:
            longest = lengths[m]
            if not ring.corner[(k + 2) % n]:
                longest = max(longest, lengths[(k + 2) % n])
        if not ring.corner[k]:
            longest = max(longest, lengths[k - 1])
            if not ring.corner[k - 1]:
                longest = max(longest, lengths[k - 2])
        long = lengths[k] >= straight_run and lengths[k] >= STRAIGHT_RATIO * longest
        plane = sides.plane_after[ring.rows[k]]
        in_plane = plane != NO_PLANE and plane == sides.plane_before[ring.rows[m]]
        ring.straight[k] = in_plane or alone or (long and sides.flat[ring.rows[k]])
    for k in range(n if closed else n - 1):
        if not ring.straight[k]:
            continue
        m = (k + 1) % n
        if _is_sure(sides, ring, k - 1):
            ring.corner[k] = True
        if _is_sure(sides, ring, m):
            ring.corner[m] = True
        if not ring.corner[k]:
            ring.before[k] += ring.after[k]
        if not ring.corner[m]:
            ring.after[m] += ring.before[m]
        ring.after[k] = ring.before[m] = 0.0


@kernel
def keep_rough(sides: Sides, ring: Ring, closed: bool) -> None:
    """Leave segments between points of a rough mesh as they are: a curve through noise is noisier than its chords."""
    n = ring.rows.size
    for k in range(n if closed else n - 1):
        m = (k + 1) % n
        if sides.rough[ring.rows[k]] and sides.rough[ring.rows[m]]:
            ring.corner[k] = ring.corner[m] = ring.straight[k] = True
            ring.after[k] = ring.before[m] = 0.0


@kernel
def keep_near(points: Floats, ring: Ring, closed: bool, largest_bulge: float) -> None:
    """Make segments straight that would leave their chords too far."""
    n = ring.rows.size
    for k in range(n if closed else n - 1):
        m = (k + 1) % n
        bulge = (
            0.25 * distance(points, ring.rows[k], ring.rows[m]) * max(abs(ring.after[k]), abs(ring.before[m]))
        )
        if bulge > largest_bulge:
            ring.corner[k] = ring.corner[m] = ring.straight[k] = True
            ring.after[k] = ring.before[m] = 0.0


@kernel
def start_at_a_split(ring: Ring) -> None:
    """Turn a closed ring so that it starts at a corner or beside a straight segment, where it has one."""
    n = ring.rows.size
    for k in range(n):
        if ring.corner[k] or ring.straight[k] or ring.straight[k - 1]:
            if k:
                rotate_to(ring.rows, k)
                rotate_to(ring.corner, k)
                rotate_to(ring.straight, k)
                rotate_to(ring.before, k)
                rotate_to(ring.after, k)
            return


@kernel
def _turn(points: Floats, i: int, j: int, k: int) -> float:
    """Signed angle from segment i-j to segment j-k, rad."""
    ax, ay = points[j, 0] - points[i, 0], points[j, 1] - points[i, 1]
    bx, by = points[k, 0] - points[j, 0], points[k, 1] - points[j, 1]
    return float(np.arctan2(ax * by - ay * bx, ax * bx + ay * by))


@kernel
def _angle_to(x: float, y: float, direction: Floats) -> float:
    """Signed angle from (x, y) to a direction, rad."""
    return float(np.arctan2(x * direction[1] - y * direction[0], x * direction[0] + y * direction[1]))


# -- Thinning: contour points that carry no shape are removed, those too near to others and those inside
# straight sides.


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

"""Oriented contours: contours with a direction at every point, ready to be fitted.

Corners and straight segments part a contour. In between, the direction at a point lies between those of its two
chords, so that a curve that follows it never leaves its chord by more than the contour turns there.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ebamcheck.curves.lifting import NO_PLANE, Sides
from ebamcheck.curves.plausible import plausible_share
from ebamcheck.numeric.kernels import kernel, run_blocks
from ebamcheck.numeric.rings import Bools, Floats, Ints
from ebamcheck.settings.curves import CurveSettings

RINGS_A_BLOCK = 16

LARGEST_TURN_RAD = np.deg2rad(60.0)
"""A smooth edge at which the contour turns by more than this is the tip of something thin: it counts as a corner."""

FLAT_MM = 2e-5
"""A smooth point this near to the chord of its neighbours, in both its place and its direction, goes: it is where a
flat side's facets meet. What 32-bit coordinates of some hundred mm leave of a plane."""

IN_PLANE_MM = 1e-3
"""A point inside of a plane goes if it lies this near to the chord of its neighbours: what the decimals of a file leave, and
the least distance of contour points. A layer that touches a level plane runs around it, and turns."""

STRAIGHT_RATIO = 3.0
"""A straight run is this many times longer than any of the two segments on either side of it, up to a corner."""


class Strands(NamedTuple):
    """Points of rings with their directions, as columns."""

    points: Floats
    """(K, 2) mm."""
    starts: Ints
    """(R + 1,) first point of each ring; a closed ring's last segment goes from its last point to its first."""
    before: Floats
    """(K,) angle by which the contour's direction at the end of the segment before the point is ahead of its chord,
    rad; positive where it turns left."""
    after: Floats
    """(K,) angle by which its chord is ahead of the direction at the start of the segment after the point, rad; on a
    circle both angles of a segment are half of the angle that it spans."""
    corner: Bools
    """(K,) a corner, or the end of an open path."""
    straight: Bools
    """(K,) the segment after the point is a straight line."""


def strands(
    sides: Sides, ring_starts: Ints, closed: Bools, settings: CurveSettings, largest_bulge_mm: float = np.inf
) -> Strands:
    """Make strands of contours.

    Parameters
    ----------
    sides
        Points and directions, of which some may be unknown (NaN): they are estimated from the chords.
    ring_starts, closed
        (R + 1,), (R,) rings of the points.
    settings
        Corner angle, smallest distance of points, least length of a straight run.
    largest_bulge_mm
        A segment that would leave its chord by more stays straight, between corners: a contour alone does not tell
        whether it stands for a curve there.
    """
    count = closed.size
    sizes = np.zeros(count, np.int64)
    total = len(sides.points)
    rows = np.empty(total, np.int64)
    before, after = np.zeros(total), np.zeros(total)
    corner, straight = np.zeros(total, np.bool_), np.zeros(total, np.bool_)
    turn = np.deg2rad(180.0 - settings.corner_angle_deg)

    def work(first: int, last: int) -> None:
        _strands(
            sides, ring_starts, closed, settings.near_point_mm, turn, settings.straight_run_mm, largest_bulge_mm,
            first, last, rows, before, after, corner, straight, sizes,
        )  # fmt: skip

    run_blocks(work, count, RINGS_A_BLOCK)
    starts = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
    kept = np.arange(starts[-1]) + np.repeat(ring_starts[:-1] - starts[:-1], sizes)
    return Strands(sides.points[rows[kept]], starts, before[kept], after[kept], corner[kept], straight[kept])


@kernel
def _strands(
    sides: Sides,
    ring_starts: Ints,
    closed: Bools,
    near: float,
    largest_turn: float,
    straight_run: float,
    largest_bulge: float,
    first: int,
    last: int,
    rows: Ints,
    before: Floats,
    after: Floats,
    corner: Bools,
    straight: Bools,
    sizes: Ints,
) -> None:
    for r in range(first, last):
        a, b = ring_starts[r], ring_starts[r + 1]
        n = _keep(sides, a, b, closed[r], near, rows)
        n = _drop_flat(sides, rows[a : a + n], closed[r])
        sizes[r] = n
        kept = rows[a : a + n]
        if n < 3:
            corner[a : a + n] = True
            straight[a : a + n] = True
            continue
        _find_corners(sides, kept, closed[r], largest_turn, corner[a : a + n])
        _set_angles(sides, kept, closed[r], corner[a : a + n], before[a : a + n], after[a : a + n])
        _limit_at_corners(corner[a : a + n], before[a : a + n], after[a : a + n])
        _spare_long_segments(sides.points, kept, corner[a : a + n], before[a : a + n], after[a : a + n])
        _keep_plausible(sides, kept, closed[r], corner[a : a + n], before[a : a + n], after[a : a + n])
        _mark_straight(
            sides, kept, closed[r], straight_run, corner[a : a + n], before[a : a + n],
            after[a : a + n], straight[a : a + n],
        )  # fmt: skip
        _keep_rough(
            sides,
            kept,
            closed[r],
            corner[a : a + n],
            before[a : a + n],
            after[a : a + n],
            straight[a : a + n],
        )
        _keep_near(
            sides.points, kept, closed[r], largest_bulge, corner[a : a + n], before[a : a + n],
            after[a : a + n], straight[a : a + n],
        )  # fmt: skip
        if closed[r]:
            _start_at_a_split(
                kept, corner[a : a + n], straight[a : a + n], before[a : a + n], after[a : a + n]
            )


@kernel
def _is_sharp(sides: Sides, i: int) -> bool:
    """Whether a point lies on a crease of the mesh."""
    return not sides.smooth[i] and not np.isnan(sides.before[i, 0])


@kernel
def _distance(points: Floats, i: int, j: int) -> float:
    return float(np.hypot(points[j, 0] - points[i, 0], points[j, 1] - points[i, 1]))


@kernel
def _keep(sides: Sides, a: int, b: int, closed: bool, near: float, rows: Ints) -> int:
    """Leave out points nearer than `near` to the one before; of two, that on a crease stays. Returns how many are left.

    A ring that would be left with fewer than three points keeps them all.
    """
    n = 0
    for i in range(a, b):
        if n and _distance(sides.points, rows[a + n - 1], i) < near:
            if _is_sharp(sides, i) and not _is_sharp(sides, rows[a + n - 1]) and n > 1:
                rows[a + n - 1] = i
            continue
        rows[a + n] = i
        n += 1
    while closed and n > 3 and _distance(sides.points, rows[a + n - 1], rows[a]) < near:
        n -= 1
    if n < 3 <= b - a:
        for i in range(a, b):
            rows[i] = i
        return int(b - a)
    if not closed and n > 1:
        rows[a + n - 1] = b - 1
    return n


@kernel
def _drop_flat(sides: Sides, rows: Ints, closed: bool) -> int:
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


@kernel
def _turn(points: Floats, i: int, j: int, k: int) -> float:
    """Signed angle from segment i-j to segment j-k, rad."""
    ax, ay = points[j, 0] - points[i, 0], points[j, 1] - points[i, 1]
    bx, by = points[k, 0] - points[j, 0], points[k, 1] - points[j, 1]
    return float(np.arctan2(ax * by - ay * bx, ax * bx + ay * by))


@kernel
def _find_corners(sides: Sides, rows: Ints, closed: bool, largest_turn: float, corner: Bools) -> None:
    """Creases are corners; so are points of unknown direction that turn far, and the ends of open paths."""
    n = rows.size
    for k in range(n):
        i = rows[k]
        if not closed and (k == 0 or k == n - 1):
            corner[k] = True
            continue
        turn = abs(_turn(sides.points, rows[k - 1], i, rows[(k + 1) % n]))
        if sides.smooth[i]:
            corner[k] = turn > LARGEST_TURN_RAD
        else:
            corner[k] = _is_sharp(sides, i) or turn > largest_turn


@kernel
def _angle_to(x: float, y: float, direction: Floats) -> float:
    """Signed angle from (x, y) to a direction, rad."""
    return float(np.arctan2(x * direction[1] - y * direction[0], x * direction[0] + y * direction[1]))


@kernel
def _set_angles(sides: Sides, rows: Ints, closed: bool, corner: Bools, before: Floats, after: Floats) -> None:
    """Angles between chords and directions; NaN at corners without a direction."""
    n = rows.size
    points = sides.points
    for k in range(n):
        h, i, j = rows[k - 1], rows[k], rows[(k + 1) % n]
        if not closed and k in (0, n - 1):
            before[k] = after[k] = np.nan
            continue
        ax, ay = points[i, 0] - points[h, 0], points[i, 1] - points[h, 1]
        bx, by = points[j, 0] - points[i, 0], points[j, 1] - points[i, 1]
        if corner[k]:
            before[k] = _angle_to(ax, ay, sides.before[i])
            after[k] = -_angle_to(bx, by, sides.after[i])
            continue
        turn = np.arctan2(ax * by - ay * bx, ax * bx + ay * by)
        if sides.smooth[i] and not np.isnan(sides.before[i, 0]):
            ahead = _angle_to(ax, ay, sides.before[i])
        else:  # the circle through the three points
            ahead = turn * np.hypot(ax, ay) / (np.hypot(ax, ay) + np.hypot(bx, by))
        # Between the two chords: a direction beyond them would bend the curve out and back.
        before[k] = min(max(ahead, min(turn, 0.0)), max(turn, 0.0))
        after[k] = turn - before[k]


@kernel
def _limit_at_corners(corner: Bools, before: Floats, after: Floats) -> None:
    """At a corner a segment bends no more than at its other end, and as a circle where nothing is known."""
    n = corner.size
    for k in range(n):
        m = (k + 1) % n
        start, end = after[k], before[m]
        if corner[k] and np.isnan(start):
            start = end
        if corner[m] and np.isnan(end):
            end = start
        if np.isnan(start):
            start = end = 0.0
        if corner[k] or corner[m]:
            lesser = min(abs(start), abs(end)) if start * end > 0.0 else 0.0
            if corner[k]:
                start = np.copysign(lesser, start)
            if corner[m]:
                end = np.copysign(lesser, end)
        after[k], before[m] = start, end


@kernel
def _spare_long_segments(points: Floats, rows: Ints, corner: Bools, before: Floats, after: Floats) -> None:
    """Turn directions towards a segment that is far longer than the one beside it and bends far more there than at
    its other end: it goes over into something else, and is no part of the bend."""
    n = rows.size
    ahead, back = after.copy(), before.copy()
    for k in range(n):
        if corner[k]:
            continue
        m = (k + 1) % n
        to, away = _distance(points, rows[k - 1], rows[k]), _distance(points, rows[k], rows[m])
        turn = before[k] + after[k]
        if away >= STRAIGHT_RATIO * to and abs(ahead[k]) > STRAIGHT_RATIO * abs(back[m]):
            after[k] = np.copysign(STRAIGHT_RATIO * abs(back[m]), ahead[k])
            before[k] = turn - after[k]
        elif to >= STRAIGHT_RATIO * away and abs(back[k]) > STRAIGHT_RATIO * abs(ahead[k - 1]):
            before[k] = np.copysign(STRAIGHT_RATIO * abs(ahead[k - 1]), back[k])
            after[k] = turn - before[k]


@kernel
def _keep_plausible(
    sides: Sides, rows: Ints, closed: bool, corner: Bools, before: Floats, after: Floats
) -> None:
    """Bend segments less that would leave their chords by more than the surface plausibly does.

    What such a segment turns less at an end, its neighbour turns more, unless that then bends too much itself: there is a
    kink then, as the contour has.
    """
    n = rows.size
    last = n if closed else n - 1
    share = np.ones(n)
    for k in range(last):
        m = (k + 1) % n
        bulge = 0.25 * _distance(sides.points, rows[k], rows[m]) * max(abs(after[k]), abs(before[m]))
        share[k] = plausible_share(bulge, max(sides.plausible[rows[k]], sides.plausible[rows[m]]))
        share[k] *= max(sides.share[rows[k]], sides.share[rows[m]])
    for k in range(n):
        if corner[k]:
            before[k] *= share[k - 1]
            after[k] *= share[k]
            continue
        if share[k] == 1.0 and share[k - 1] == 1.0:
            continue
        turn = before[k] + after[k]
        to, away = (
            _distance(sides.points, rows[k - 1], rows[k]),
            _distance(sides.points, rows[k], rows[(k + 1) % n]),
        )
        if share[k] < 1.0 and share[k - 1] < 1.0:
            corner[k] = True
            before[k] *= share[k - 1]
            after[k] *= share[k]
        elif share[k] < 1.0:
            after[k] *= share[k]
            before[k] = turn - after[k]
            plausible = max(sides.plausible[rows[k - 1]], sides.plausible[rows[k]])
            if 0.25 * to * abs(before[k]) > plausible:
                corner[k] = True
                before[k] = np.copysign(4.0 * plausible / to, before[k])
        else:
            before[k] *= share[k - 1]
            after[k] = turn - before[k]
            plausible = max(sides.plausible[rows[k]], sides.plausible[rows[(k + 1) % n]])
            if 0.25 * away * abs(after[k]) > plausible:
                corner[k] = True
                after[k] = np.copysign(4.0 * plausible / away, after[k])


@kernel
def _mark_straight(
    sides: Sides,
    rows: Ints,
    closed: bool,
    straight_run: float,
    corner: Bools,
    before: Floats,
    after: Floats,
    straight: Bools,
) -> None:
    """Mark straight segments, and turn what lies beside them to their direction.

    A segment is straight if it lies in a plane, if it does not bend between two corners, or if it is long, far longer
    than those beside it, and may be part of a flat side.
    """
    n = rows.size
    lengths = np.empty(n)
    for k in range(n):
        lengths[k] = _distance(sides.points, rows[k], rows[(k + 1) % n])
    if not closed:
        lengths[n - 1] = 0.0
    for k in range(n if closed else n - 1):
        m = (k + 1) % n
        bulge = 0.25 * lengths[k] * max(abs(after[k]), abs(before[m]))
        alone = corner[k] and corner[m] and bulge < FLAT_MM
        longest = 0.0
        if not corner[m]:
            longest = lengths[m]
            if not corner[(k + 2) % n]:
                longest = max(longest, lengths[(k + 2) % n])
        if not corner[k]:
            longest = max(longest, lengths[k - 1])
            if not corner[k - 1]:
                longest = max(longest, lengths[k - 2])
        long = lengths[k] >= straight_run and lengths[k] >= STRAIGHT_RATIO * longest
        plane = sides.plane_after[rows[k]]
        in_plane = plane != NO_PLANE and plane == sides.plane_before[rows[m]]
        straight[k] = in_plane or alone or (long and sides.flat[rows[k]])
    for k in range(n if closed else n - 1):
        if not straight[k]:
            continue
        m = (k + 1) % n
        if not corner[k]:
            before[k] += after[k]
        if not corner[m]:
            after[m] += before[m]
        after[k] = before[m] = 0.0


@kernel
def _keep_rough(
    sides: Sides, rows: Ints, closed: bool, corner: Bools, before: Floats, after: Floats, straight: Bools
) -> None:
    """Leave segments between points of a rough mesh as they are: a curve through noise is noisier than its chords."""
    n = rows.size
    for k in range(n if closed else n - 1):
        m = (k + 1) % n
        if sides.rough[rows[k]] and sides.rough[rows[m]]:
            corner[k] = corner[m] = straight[k] = True
            after[k] = before[m] = 0.0


@kernel
def _keep_near(
    points: Floats,
    rows: Ints,
    closed: bool,
    largest_bulge: float,
    corner: Bools,
    before: Floats,
    after: Floats,
    straight: Bools,
) -> None:
    """Make segments straight that would leave their chords too far."""
    n = rows.size
    for k in range(n if closed else n - 1):
        m = (k + 1) % n
        bulge = 0.25 * _distance(points, rows[k], rows[m]) * max(abs(after[k]), abs(before[m]))
        if bulge > largest_bulge:
            corner[k] = corner[m] = straight[k] = True
            after[k] = before[m] = 0.0


@kernel
def _start_at_a_split(rows: Ints, corner: Bools, straight: Bools, before: Floats, after: Floats) -> None:
    """Turn a closed ring so that it starts at a corner or beside a straight segment, where it has one."""
    n = rows.size
    for k in range(n):
        if corner[k] or straight[k] or straight[k - 1]:
            if k:
                rows[:] = np.roll(rows, -k)
                corner[:] = np.roll(corner, -k)
                straight[:] = np.roll(straight, -k)
                before[:] = np.roll(before, -k)
                after[:] = np.roll(after, -k)
            return

"""Crossings of curves: of a ring with itself, and of the rings of a layer with each other.

Each span lies in the convex hull of its four Bezier points. Two spans whose hulls can be separated by a line do not meet;
others are halved until their hulls are separate or smaller than :data:`SMALLEST_MM`. So curves farther apart than that are
never reported as crossing, and no crossing is missed. Consecutive spans meet at their joint: while the two together turn by
less than half a turn they cannot meet again.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ebamcheck.columns_file import starts_of
from ebamcheck.curves.bezier import BezierSpans
from ebamcheck.curves.columns import Curves
from ebamcheck.curves.runs import angles, around
from ebamcheck.kernels import Bools, Floats, Ints, kernel
from ebamcheck.threads import run_blocks

SMALLEST_MM = 1e-6  # Hulls that are smaller than this and still not separate count as touching

MOST_WAITING = 256  # Pairs of halves still to test: two for each halving of either span, of which there are at most 60
JOINT_MM = 1e-3  # Consecutive spans are tested only beyond this distance from the point that they share


class Crossings(NamedTuple):
    """Which rings cross, and where."""

    crossed: Bools  # (R,) whether the ring crosses or touches itself or another
    at: Floats  # (R, 2) the crossing that was found first, mm; NaN for rings without one


def crossings(curves: Curves, spans: BezierSpans | None = None) -> Crossings:
    """Find the rings that cross themselves or others of their layer; `spans` are those of the curves, where they are known."""
    spans = spans or curves.bezier_spans()
    count = curves.closed.size
    starts = starts_of(np.bincount(spans.ring, minlength=count))
    found = Crossings(np.zeros(count, np.bool_), np.full((count, 2), np.nan))
    ring, points, closed = spans.ring.astype(np.int64), np.ascontiguousarray(spans.points), curves.closed
    boxes = np.hstack([points.min(axis=1), points.max(axis=1)])
    following = around(starts)[1]
    smooth = _turns(points, following) < math.pi

    def work(first: int, last: int) -> None:
        for k in range(first, last):
            a, b = starts[curves.layer_starts[k : k + 2]].tolist()
            order = a + np.argsort(boxes[a:b, 0], kind="stable")
            _cross_layer(points, boxes, order, ring, following, smooth, closed, found.crossed, found.at)

    run_blocks(work, len(curves))
    return found


@kernel
def _cross_layer(
    points: Floats,
    boxes: Floats,
    order: Ints,
    ring: Ints,
    following: Ints,
    smooth: Bools,
    closed: Bools,
    crossed: Bools,
    at: Floats,
) -> None:
    """Sweep over the spans of a layer from left to right, and look at those whose boxes overlap."""
    n = order.size
    active = np.empty(n, np.int64)
    waiting, size = np.empty((MOST_WAITING, 2, 4, 2)), np.empty(2)
    count = 0
    for i in order:
        kept = 0
        for k in range(count):
            j = active[k]
            if boxes[j, 2] < boxes[i, 0]:
                continue
            active[kept] = j
            kept += 1
            if boxes[j, 1] > boxes[i, 3] or boxes[i, 1] > boxes[j, 3]:
                continue
            p, q = ring[i], ring[j]
            if crossed[p] and crossed[q]:
                continue
            one, two = min(i, j), max(i, j)
            follows = p == q and two == one + 1
            closes = p == q and closed[p] and following[two] == one
            if follows != closes and smooth[one if follows else two]:
                continue
            if not _meet_beyond_joint(points, one, two, follows, closes, waiting, size):
                continue
            for r in (p, q):
                if not crossed[r]:
                    ends = waiting[0, 0, 0] + waiting[0, 0, 3] + waiting[0, 1, 0] + waiting[0, 1, 3]
                    crossed[r], at[r] = True, 0.25 * ends
        count = kept
        active[count] = i
        count += 1


@kernel
def _meet_beyond_joint(
    points: Floats, i: int, j: int, follows: bool, closes: bool, waiting: Floats, size: Floats
) -> bool:
    """Whether two spans meet, other than where one follows the other; the place is left in ``waiting[0]``."""
    waiting[0, 0], waiting[0, 1] = points[i], points[j]
    count = 1
    # More halvings are needed only where spans coincide over a length: they touch.
    for _ in range(200_000):
        if count == 0:
            return False
        count -= 1
        pair = waiting[count]
        if _apart(pair[0], pair[1]) or _apart(pair[1], pair[0]):
            continue
        at_start, at_end = follows, closes
        for side in range(2):
            size[side] = 0.0
            for axis in range(2):
                low = high = pair[side, 0, axis]
                for k in range(1, 4):
                    low, high = min(low, pair[side, k, axis]), max(high, pair[side, k, axis])
                size[side] = max(size[side], high - low)
            for k in range(4):
                x, y = pair[side, k, 0], pair[side, k, 1]
                at_start = at_start and math.hypot(x - points[j, 0, 0], y - points[j, 0, 1]) <= JOINT_MM
                at_end = at_end and math.hypot(x - points[i, 0, 0], y - points[i, 0, 1]) <= JOINT_MM
        if at_start or at_end:
            continue
        if max(size[0], size[1]) <= SMALLEST_MM:
            waiting[0] = pair.copy()
            return True
        if count + 2 > MOST_WAITING:
            return True
        side = 0 if size[0] >= size[1] else 1
        other = waiting[count + 1]
        other[1 - side] = pair[1 - side]
        for axis in range(2):  # both halves (de Casteljau)
            p, q, r, s = pair[side, 0, axis], pair[side, 1, axis], pair[side, 2, axis], pair[side, 3, axis]
            pq, qr, rs = 0.5 * (p + q), 0.5 * (q + r), 0.5 * (r + s)
            pqr, qrs = 0.5 * (pq + qr), 0.5 * (qr + rs)
            middle = 0.5 * (pqr + qrs)
            pair[side, 1, axis], pair[side, 2, axis], pair[side, 3, axis] = pq, pqr, middle
            other[side, 0, axis], other[side, 1, axis] = middle, qrs
            other[side, 2, axis], other[side, 3, axis] = rs, s
        count += 2
    waiting[0, 0], waiting[0, 1] = points[i], points[j]
    return True


@kernel
def _apart(A: Floats, B: Floats) -> bool:
    """Whether a line along or across the chord of A has all of A on one side and all of B on the other."""
    x, y = A[3, 0] - A[0, 0], A[3, 1] - A[0, 1]
    if x == 0.0 and y == 0.0:
        x = 1.0
    for side in range(2):
        if side == 1:
            x, y = -y, x
        low_a = low_b = np.inf
        high_a = high_b = -np.inf
        for k in range(4):
            u = (A[k, 1] - A[0, 1]) * x - (A[k, 0] - A[0, 0]) * y
            v = (B[k, 1] - A[0, 1]) * x - (B[k, 0] - A[0, 0]) * y
            low_a, high_a = min(low_a, u), max(high_a, u)
            low_b, high_b = min(low_b, v), max(high_b, v)
        if low_a > high_b or low_b > high_a:
            return True
    return False


def _turns(points: Floats, following: Ints) -> Floats:
    """Sum of the angles (n,) by which the control polygons of each span and of the one that follows it turn, rad."""
    legs = np.diff(points, axis=1)
    for k, beside in (
        (1, 0),
        (2, 1),
        (1, 2),
        (0, 1),
    ):  # a leg without length takes the direction of one beside it
        lost = (legs[:, k] == 0.0).all(axis=1)
        legs[lost, k] = legs[lost, beside]
    own = np.abs(angles(legs[:, 0], legs[:, 1])) + np.abs(angles(legs[:, 1], legs[:, 2]))
    return np.asarray(own + np.abs(angles(legs[:, 2], legs[following, 0])) + own[following])

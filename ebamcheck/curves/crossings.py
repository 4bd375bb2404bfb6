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

from ebamcheck.curves.columns import Curves
from ebamcheck.kernels import Bools, Floats, Ints, kernel
from ebamcheck.threads import run_blocks

SMALLEST_MM = 1e-6
"""Hulls that are smaller than this and still not separate count as touching."""

MOST_WAITING = 256
"""Size of the stack of pairs of halves still to test: two for each halving of either span; there are at most 60 halvings."""

MOST_HALVINGS = 200_000
"""Most pairs tested for two spans. More are needed only where they coincide over a length: they touch."""

JOINT_MM = 1e-3
"""Consecutive spans are tested only beyond this distance from the point that they share."""


class Crossings(NamedTuple):
    """Which rings cross, and where."""

    crossed: Bools
    """(R,) whether the ring crosses or touches itself or another."""
    at: Floats
    """(R, 2) the crossing that was found first, mm; NaN for rings without one."""


def crossings(curves: Curves) -> Crossings:
    """Find the rings that cross themselves or others of their layer."""
    spans = curves.bezier_spans()
    counts = np.bincount(spans.ring, minlength=curves.closed.size)
    starts = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    found = Crossings(np.zeros(curves.closed.size, np.bool_), np.full((curves.closed.size, 2), np.nan))
    ring = spans.ring.astype(np.int64)
    points = np.ascontiguousarray(spans.points)
    boxes = np.hstack([points.min(axis=1), points.max(axis=1)])

    def work(first: int, last: int) -> None:
        for k in range(first, last):
            a, b = starts[curves.layer_starts[k : k + 2]].tolist()
            order = a + np.argsort(boxes[a:b, 0], kind="stable")
            _cross_layer(points, boxes, order, ring, starts, curves.closed, found.crossed, found.at)

    run_blocks(work, len(curves))
    return found


@kernel
def _cross_layer(
    points: Floats,
    boxes: Floats,
    order: Ints,
    ring: Ints,
    starts: Ints,
    closed: Bools,
    crossed: Bools,
    at: Floats,
) -> None:
    """Sweep over the spans of a layer from left to right, and look at those whose boxes overlap."""
    n = order.size
    active = np.empty(n, np.int64)
    waiting = np.empty((MOST_WAITING, 2, 4, 2))
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
            if _meet_beyond_joint(points, min(i, j), max(i, j), ring, starts, closed, waiting):
                for r in (p, q):
                    if not crossed[r]:
                        crossed[r] = True
                        at[r] = 0.25 * (
                            waiting[0, 0, 0] + waiting[0, 0, 3] + waiting[0, 1, 0] + waiting[0, 1, 3]
                        )
        count = kept
        active[count] = i
        count += 1


@kernel
def _meet_beyond_joint(
    points: Floats, i: int, j: int, ring: Ints, starts: Ints, closed: Bools, waiting: Floats
) -> bool:
    """Whether two spans meet, other than where one follows the other; the place is left in ``waiting[0]``."""
    r = ring[i]
    follows = ring[j] == r and j == i + 1
    closes = ring[j] == r and closed[r] and i == starts[r] and j == starts[r + 1] - 1 and j > i
    if follows and not closes and _turn_of(points[i], points[j]) < math.pi:
        return False
    if closes and not follows and _turn_of(points[j], points[i]) < math.pi:
        return False
    x = y = np.nan
    if follows:
        x, y = points[j, 0, 0], points[j, 0, 1]
    u = v = np.nan
    if closes:
        u, v = points[i, 0, 0], points[i, 0, 1]
    waiting[0, 0], waiting[0, 1] = points[i], points[j]
    count = 1
    for _ in range(MOST_HALVINGS):
        if count == 0:
            return False
        count -= 1
        A, B = waiting[count, 0], waiting[count, 1]
        if _apart(A, B) or _apart(B, A):
            continue
        if (_near(A, x, y) and _near(B, x, y)) or (_near(A, u, v) and _near(B, u, v)):
            continue
        size_a, size_b = _size(A), _size(B)
        if max(size_a, size_b) <= SMALLEST_MM:
            waiting[0, 0], waiting[0, 1] = A.copy(), B.copy()
            return True
        if count + 2 > MOST_WAITING:
            return True
        side = 0 if size_a >= size_b else 1
        left, right = _halves(waiting[count, side])
        other = waiting[count, 1 - side].copy()
        waiting[count, side], waiting[count, 1 - side] = left, other
        waiting[count + 1, side], waiting[count + 1, 1 - side] = right, other
        count += 2
    waiting[0, 0], waiting[0, 1] = points[i], points[j]
    return True


@kernel
def _turn_of(A: Floats, B: Floats) -> float:
    """Sum of the angles by which the control polygon of two spans in a row turns."""
    total = 0.0
    x = y = 0.0
    for k in range(6):
        if k < 3:
            u, v = A[k + 1, 0] - A[k, 0], A[k + 1, 1] - A[k, 1]
        else:
            u, v = B[k - 2, 0] - B[k - 3, 0], B[k - 2, 1] - B[k - 3, 1]
        if u == 0.0 and v == 0.0:
            continue
        if x != 0.0 or y != 0.0:
            total += abs(math.atan2(x * v - y * u, x * u + y * v))
        x, y = u, v
    return total


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


@kernel
def _near(A: Floats, x: float, y: float) -> bool:
    """Whether all of a span lies near a place; never where the place is NaN."""
    farthest = 0.0
    for k in range(4):
        away = math.hypot(A[k, 0] - x, A[k, 1] - y)
        farthest = max(farthest, away if away == away else np.inf)
    return farthest <= JOINT_MM


@kernel
def _size(A: Floats) -> float:
    size = 0.0
    for axis in range(2):
        low = high = A[0, axis]
        for k in range(1, 4):
            low, high = min(low, A[k, axis]), max(high, A[k, axis])
        size = max(size, high - low)
    return size


@kernel
def _halves(A: Floats) -> tuple[Floats, Floats]:
    """Both halves of a span (de Casteljau)."""
    left, right = np.empty((4, 2)), np.empty((4, 2))
    for axis in range(2):
        p, q, r, s = A[0, axis], A[1, axis], A[2, axis], A[3, axis]
        pq, qr, rs = 0.5 * (p + q), 0.5 * (q + r), 0.5 * (r + s)
        pqr, qrs = 0.5 * (pq + qr), 0.5 * (qr + rs)
        middle = 0.5 * (pqr + qrs)
        left[0, axis], left[1, axis], left[2, axis], left[3, axis] = p, pq, pqr, middle
        right[0, axis], right[1, axis], right[2, axis], right[3, axis] = middle, qrs, rs, s
    return left, right

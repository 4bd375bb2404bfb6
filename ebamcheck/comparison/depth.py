"""How deep the symmetric difference of two regions goes: branch and bound over its trapezoids.

The depth of a point is its distance from the contours that count. The distance from a fixed segment is convex, so over a trapezoid
it is greatest at a corner: that bounds the depth for each segment, and so does the mean distance from two segments. The second
bound is exact on the middle line between two parallel sides, so such ridges need no refinement along their length.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ebamcheck.comparison.outline import Outline
from ebamcheck.comparison.sweep import L0, L1, LEFT_SEGMENT, R0, R1, RIGHT_SEGMENT, Y0, Y1
from ebamcheck.geometry.nearest import distance_to_segment, nearest_segment
from ebamcheck.geometry.rings import stable_order
from ebamcheck.kernels import Floats, Ints, kernel

FINEST_DEPTH_MM = 1e-6
FINE_SHARE = 0.01  # resolution of depths that decide the verdict, over the limit; at least the finest depth
COARSE_SHARE = 0.05  # resolution of depths below the limit, which are only reported, over the limit
MOST_NODES = 400_000  # most trapezoids examined in one search; beyond it the upper bound is returned, which errs towards a finding
STACK = 4096  # size of the stack of trapezoids in one search; a split adds few, so float64 runs out of halvings first
MOST_PARTS = 16  # parts into which a trapezoid is split at once
# Trapezoids thinner than this share of the largest coordinate (1000 roundings) are ignored: there edges coincide, and rounding alone
# decided their order
THINNEST_SHARE = 2.0**-42
# Depth of a trapezoid's middle, over the greatest depth known, from which its corners are examined, too: only near a ridge do they
# tighten the bound enough to pay
RIDGE_SHARE = 0.75


class Nearby(NamedTuple):
    """Segments and distances near a trapezoid; :func:`_look` fills the rows."""

    sides: Floats  # (6, 4) segments nearest to the middle and the four corners and, in the last row, of the farther contours
    corners: Floats  # (6, 4) distances of the four corners from each of them, mm
    guess: Ints  # (2,) nearest segment of each region in the last search, from which the next one starts


class Deepest(NamedTuple):
    """Greatest depth found so far, and where."""

    depth_mm: float
    x_mm: float
    y_mm: float


@kernel
def resolution_mm(limit_mm: float) -> float:
    """How finely depth about the limit is resolved."""
    return max(FINEST_DEPTH_MM, FINE_SHARE * limit_mm)


@kernel
def enough_mm(depth_mm: float, limit_mm: float) -> float:
    """Upper bound that needs no search beside a known depth: fine above the limit, coarse below it."""
    finest = depth_mm + resolution_mm(limit_mm)
    return max(finest, min(depth_mm + COARSE_SHARE * limit_mm, limit_mm))


@kernel
def search(
    a: Outline, b: Outline, from_a: bool, from_b: bool, difference: Floats, deepest: Deepest, limit_mm: float
) -> Deepest:
    """Greatest depth over the symmetric difference (T, 8), from the contours of `a`, of `b`, or the nearer, as fine as `enough_mm`."""
    suspects = _suspects(a, b, from_a, from_b, difference, enough_mm(deepest.depth_mm, limit_mm))
    stack = np.empty((STACK, 7))
    nearby = Nearby(np.empty((6, 4)), np.empty((6, 4)), np.full(2, -1, np.int64))
    nodes = 0
    # The most suspect first: what it proves rules out most of the others.
    for s in stable_order(-suspects[:, 6]):
        if suspects[s, 6] <= enough_mm(deepest.depth_mm, limit_mm):
            break
        for c in range(7):
            stack[0, c] = suspects[s, c]
        count = 1
        while count > 0:
            count -= 1
            if stack[count, 6] <= enough_mm(deepest.depth_mm, limit_mm):
                continue
            nodes += 1
            if nodes > MOST_NODES or count + MOST_PARTS > STACK:
                # All suspects still to come are bounded by this one.
                rest = suspects[s, 6]
                if rest == np.inf:
                    finite = stack[: count + 1, 6]
                    rest = 0.0
                    for bound in finite:
                        rest = max(rest, bound) if bound < np.inf else rest
                return Deepest(max(deepest.depth_mm, rest), deepest.x_mm, deepest.y_mm)
            deepest, ceiling = _bound(a, b, from_a, from_b, stack, count, nearby, deepest, limit_mm)
            if ceiling > enough_mm(deepest.depth_mm, limit_mm):
                sides = nearby.sides
                side = math.hypot(sides[0, 2] - sides[0, 0], sides[0, 3] - sides[0, 1])
                count += _split(stack, count, min(ceiling, stack[count, 6]), side + deepest.depth_mm)
    return deepest


@kernel
def _suspects(a: Outline, b: Outline, from_a: bool, from_b: bool, difference: Floats, enough: float) -> Floats:
    """Trapezoids (S, 7) that may be deeper than enough: levels, x of both sides at each, bound of the depth."""
    suspects = np.empty((len(difference), 7))
    count = 0
    farthest = 0.0
    for box in (a.tree.boxes[1], b.tree.boxes[1]):
        farthest = max(farthest, -box[0], -box[1], box[2], box[3])
    thinnest_mm = THINNEST_SHARE * farthest
    for t in range(len(difference)):
        width = max(difference[t, R0] - difference[t, L0], difference[t, R1] - difference[t, L1])
        if min(width, difference[t, Y1] - difference[t, Y0]) <= thinnest_mm:
            continue
        ceiling = _between_sides(a, b, from_a, from_b, difference, t, enough)
        if ceiling > enough:
            for c in range(6):
                suspects[count, c] = difference[t, c]
            suspects[count, 6] = ceiling
            count += 1
    return suspects[:count]


@kernel
def _between_sides(
    a: Outline, b: Outline, from_a: bool, from_b: bool, difference: Floats, t: int, enough: float
) -> float:
    """Upper bound of the depth in trapezoid `t` by its two sides, the mean where both count; a first one within `enough` will do."""
    left, right = int(difference[t, LEFT_SEGMENT]), int(difference[t, RIGHT_SEGMENT])
    numbered = len(a.segments)
    left_counts, right_counts = from_a if left < numbered else from_b, from_a if right < numbered else from_b
    if not (left_counts or right_counts):
        return np.inf
    share = 0.5 if left_counts and right_counts else 1.0
    y0, y1, l0, l1 = difference[t, Y0], difference[t, Y1], difference[t, L0], difference[t, L1]
    r0, r1 = difference[t, R0], difference[t, R1]
    ceiling = share * max(r0 - l0, r1 - l1)
    if ceiling <= enough:
        return float(ceiling)
    ceiling = 0.0
    for segment, counts, x0, x1 in ((left, left_counts, r0, r1), (right, right_counts, l0, l1)):
        if counts:
            segments, s = (a.segments, segment) if segment < numbered else (b.segments, segment - numbered)
            ceiling = max(ceiling, distance_to_segment(x0, y0, segments, s))
            ceiling = max(ceiling, distance_to_segment(x1, y1, segments, s))
    return float(share * ceiling)


@kernel
def _bound(
    a: Outline, b: Outline, from_a: bool, from_b: bool, stack: Floats, at: int, nearby: Nearby, deepest: Deepest,
    limit_mm: float,
) -> tuple[Deepest, float]:  # fmt: skip
    """Depth at the middle and corners of trapezoid `at` (a lower bound), and an upper bound over it."""
    y0, y1, l0, l1 = stack[at, 0], stack[at, 1], stack[at, 2], stack[at, 3]
    r0, r1 = stack[at, 4], stack[at, 5]
    sides, corners, guess = nearby
    other = len(sides) - 1
    ceiling = np.inf
    for k in range(5):
        if k == 0:
            x, y = 0.25 * (l0 + l1 + r0 + r1), 0.5 * (y0 + y1)
        elif k < 3:
            x, y = (l0 if k == 1 else r0), y0
        else:
            x, y = (l1 if k == 3 else r1), y1
        depth = _look(a, b, from_a, from_b, x, y, sides, guess, k)
        if depth > deepest.depth_mm:
            deepest = Deepest(depth, x, y)
        ceiling = min(ceiling, _measure_corners(stack, at, sides, k, corners))
        # Of the mean distance from two segments, no lesser of both distances is more.
        if k == 0 and from_a and from_b:
            ceiling = min(ceiling, _measure_corners(stack, at, sides, other, corners))
            mean = 0.0
            for c in range(4):
                mean = max(mean, 0.5 * (corners[0, c] + corners[other, c]))
            ceiling = min(ceiling, mean)
        if k == 0 and (ceiling <= enough_mm(deepest.depth_mm, limit_mm) or depth < RIDGE_SHARE * deepest.depth_mm):
            return deepest, ceiling
    for i in range(4):
        for j in range(i + 1, 5):
            mean = 0.0
            for c in range(4):
                mean = max(mean, 0.5 * (corners[i, c] + corners[j, c]))
            ceiling = min(ceiling, mean)
    return deepest, ceiling


@kernel
def _look(
    a: Outline, b: Outline, from_a: bool, from_b: bool, x: float, y: float, sides: Floats, guess: Ints, k: int
) -> float:
    """Depth at a point; the nearest segment goes to row `k` of `sides`, the one of the other contours to the last row."""
    depth = np.inf
    if from_a:
        square, i = nearest_segment(a.tree, x, y, guess[0])
        depth = math.sqrt(square)
        guess[0] = i
        for c in range(4 if i >= 0 else 0):
            sides[k, c] = a.segments[i, c]
    if from_b:
        square, i = nearest_segment(b.tree, x, y, guess[1])
        other = math.sqrt(square)
        guess[1] = i
        for c in range(4 if i >= 0 else 0):
            if other < depth:
                sides[-1, c], sides[k, c] = sides[k, c], b.segments[i, c]
            else:
                sides[-1, c] = b.segments[i, c]
        depth = min(depth, other)
    return float(depth)


@kernel
def _measure_corners(stack: Floats, at: int, sides: Floats, k: int, corners: Floats) -> float:
    """Distances of a trapezoid's four corners from row `k` of `sides`, to row `k` of `corners`; the greatest."""
    ax, ay = sides[k, 0], sides[k, 1]
    ux, uy = sides[k, 2] - ax, sides[k, 3] - ay
    square = ux * ux + uy * uy
    scale = 1.0 / square if square > 0.0 else 0.0
    highest = 0.0
    for c in range(4):
        px, py = stack[at, 2 + c] - ax, stack[at, c % 2] - ay
        t = min(1.0, max(0.0, (px * ux + py * uy) * scale))
        px, py = px - t * ux, py - t * uy
        corners[k, c] = math.sqrt(px * px + py * py)
        highest = max(highest, corners[k, c])
    return highest


@kernel
def _split(stack: Floats, at: int, ceiling: float, stretch: float) -> int:
    """Write the parts of trapezoid `at` to its row and the following ones; returns their number.

    It is cut across its longer extent: in two, or along thin slivers into parts about as long as `stretch`, over which one side
    can settle the bound.
    """
    y0, y1, l0, l1 = stack[at, 0], stack[at, 1], stack[at, 2], stack[at, 3]
    r0, r1 = stack[at, 4], stack[at, 5]
    along = math.hypot(y1 - y0, max(abs(l1 - l0), abs(r1 - r0)))
    if along <= max(r0 - l0, r1 - l1):
        for c in (0, 1):
            stack[at + 1, c], stack[at + 1, 4 + c] = stack[at, c], stack[at, 4 + c]
            stack[at, 4 + c] = stack[at + 1, 2 + c] = 0.5 * (stack[at, 2 + c] + stack[at, 4 + c])
        stack[at, 6] = stack[at + 1, 6] = ceiling
        return 2
    parts = int(min(max(math.ceil(along / stretch), 2.0), float(MOST_PARTS)))
    for k in range(parts):
        for c, start, stop in ((0, y0, y1), (2, l0, l1), (4, r0, r1)):
            stack[at + k, c] = start + (k / parts) * (stop - start)
            stack[at + k, c + 1] = start + ((k + 1) / parts) * (stop - start)
        stack[at + k, 6] = ceiling
    return parts

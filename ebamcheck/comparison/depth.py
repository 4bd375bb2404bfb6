"""How deep the symmetric difference of two regions goes: branch and bound over its trapezoids.

The depth of a point is its distance from the contours that count; the greatest depth over a trapezoid is at
most the least, over segments, of the greatest distance of its corners from that segment (a convex function
is greatest at a corner), and at most the same for the mean distance from two segments. The second bound is
exact where a trapezoid lies astride the middle line between two parallel sides, so such ridges need no
refinement along their length.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ebamcheck.comparison import chains
from ebamcheck.comparison.chains import SLOPE, X_HIGH, X_LOW, Y_HIGH, Y_LOW
from ebamcheck.comparison.outline import Outline
from ebamcheck.geometry.nearest import distance_to_segment, nearest_segment
from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Floats, Ints
from ebamcheck.numeric.sorting import stable_order

FINEST_DEPTH_MM = 1e-6
FINE_SHARE = 0.01
"""Resolution of depths near the limit, over the limit; never finer than the finest depth. These depths decide the verdict."""

COARSE_SHARE = 0.05
"""Resolution of depths below the limit, over the limit. These depths are only reported."""

MOST_NODES = 400_000
"""Most trapezoids examined in one search; beyond it the upper bound is returned, which errs towards a finding."""

STACK = 4096
"""Size of the stack of trapezoids in one search; a split adds few, so float64 runs out of halvings first."""

MOST_PARTS = 16
"""Parts into which a trapezoid is split at once."""

OTHER = 5
"""Row of the segment of the farther contours, after those of the middle and of four corners."""

THINNEST_SHARE = 2.0**-42
"""Trapezoids thinner than this share of the largest coordinate (1000 roundings) are ignored: there edges coincide, and
rounding alone decided their order."""

RIDGE_SHARE = 0.75
"""Depth of a trapezoid's middle, over the greatest depth known, from which its corners are examined, too: only near a ridge do
they tighten the bound enough to pay."""


class Nearby(NamedTuple):
    """Segments and distances near a trapezoid; :func:`_look` fills the rows."""

    sides: Floats
    """(6, 4) nearest segments: of the middle, of the four corners, and of the farther contours."""
    corners: Floats
    """(6, 4) distances of the four corners from each of them, mm."""
    guess: Ints
    """(2,) segment of each region that was found last: the next search starts there."""


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
    """Upper bound of a depth that need not be looked into, where a depth is known already.

    What cannot pass the limit is resolved coarsely, what might finely.
    """
    finest = depth_mm + resolution_mm(limit_mm)
    return max(finest, min(depth_mm + COARSE_SHARE * limit_mm, limit_mm))


@kernel
def search(
    a: Outline, b: Outline, from_a: bool, from_b: bool, difference: Floats, deepest: Deepest, limit_mm: float
) -> Deepest:
    """Greatest depth over all trapezoids of the symmetric difference to within what :func:`enough_mm` says.

    Parameters
    ----------
    from_a, from_b
        Contours from which depth is measured; with both, depth is the distance from the nearer one.
    difference
        (T, 8) trapezoids, see :class:`ebamcheck.comparison.overlap.Overlap`.
    deepest
        Depth that is known already.
    """
    suspects = _suspects(a, b, from_a, from_b, difference, enough_mm(deepest.depth_mm, limit_mm))
    stack = np.empty((STACK, 7))
    nearby = Nearby(np.empty((OTHER + 1, 4)), np.empty((OTHER + 1, 4)), np.full(2, -1, np.int64))
    nodes = 0
    # The most suspect first: what it proves rules out most of the others.
    for s in stable_order(-suspects[:, 6]):
        if suspects[s, 6] <= enough_mm(deepest.depth_mm, limit_mm):
            break
        stack[0] = suspects[s]
        count = 1
        while count > 0:
            count -= 1
            if stack[count, 6] <= enough_mm(deepest.depth_mm, limit_mm):
                continue
            nodes += 1
            if nodes > MOST_NODES or count + MOST_PARTS > STACK:
                # All suspects still to come are bounded by this one.
                rest = suspects[s, 6] if suspects[s, 6] < np.inf else _highest(stack, count + 1)
                return Deepest(max(deepest.depth_mm, rest), deepest.x_mm, deepest.y_mm)
            deepest, ceiling = _bound(a, b, from_a, from_b, stack, count, nearby, deepest, limit_mm)
            if ceiling > enough_mm(deepest.depth_mm, limit_mm):
                sides = nearby.sides
                side = math.hypot(sides[0, 2] - sides[0, 0], sides[0, 3] - sides[0, 1])
                count += _split(stack, count, min(ceiling, stack[count, 6]), side + deepest.depth_mm)
    return deepest


@kernel
def _suspects(
    a: Outline, b: Outline, from_a: bool, from_b: bool, difference: Floats, enough: float
) -> Floats:
    """Trapezoids (S, 7) that may be deeper than enough: levels, x of both sides at each, bound of the depth."""
    suspects = np.empty((len(difference), 7))
    count = 0
    thinnest_mm = THINNEST_SHARE * max(_farthest_coordinate(a), _farthest_coordinate(b))
    for t in range(len(difference)):
        width = max(difference[t, R0] - difference[t, L0], difference[t, R1] - difference[t, L1])
        if min(width, difference[t, Y1] - difference[t, Y0]) <= thinnest_mm:
            continue
        ceiling = _between_sides(a, b, from_a, from_b, difference, t, enough)
        if ceiling > enough:
            suspects[count, :6] = difference[t, :6]
            suspects[count, 6] = ceiling
            count += 1
    return suspects[:count]


@kernel
def _farthest_coordinate(o: Outline) -> float:
    """Largest coordinate of an outline, mm; 0 if it is empty."""
    box = o.tree.boxes[1]
    return float(max(-box[0], -box[1], box[2], box[3], 0.0))


@kernel
def _between_sides(
    a: Outline, b: Outline, from_a: bool, from_b: bool, difference: Floats, t: int, enough: float
) -> float:
    """No point of trapezoid `t` is deeper than this, by its two sides; a first answer within `enough` will do.

    The distance from a fixed segment is convex, so over a trapezoid it is greatest at a corner; and where
    both sides count, the mean of the two distances bounds the lesser.
    """
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
    if left_counts:
        ceiling = _farther(a, b, left, r0, y0, r1, y1)
    if right_counts:
        ceiling = max(ceiling, _farther(a, b, right, l0, y0, l1, y1))
    return float(share * ceiling)


@kernel
def _farther(a: Outline, b: Outline, segment: int, x0: float, y0: float, x1: float, y1: float) -> float:
    """Greater distance of two points from a segment, those of `b` being numbered after those of `a`."""
    segments, s = (
        (a.segments, segment) if segment < len(a.segments) else (b.segments, segment - len(a.segments))
    )
    return max(distance_to_segment(x0, y0, segments, s), distance_to_segment(x1, y1, segments, s))


@kernel
def _highest(stack: Floats, count: int) -> float:
    """Greatest finite bound among the trapezoids still put aside (0 if there is none)."""
    highest = 0.0
    for k in range(count):
        if stack[k, 6] < np.inf:
            highest = max(highest, stack[k, 6])
    return highest


@kernel
def _bound(
    a: Outline, b: Outline, from_a: bool, from_b: bool, stack: Floats, at: int, nearby: Nearby, deepest: Deepest,
    limit_mm: float,
) -> tuple[Deepest, float]:  # fmt: skip
    """Depth at the middle and corners of trapezoid `at` (a lower bound), and an upper bound over it."""
    y0, y1, l0, l1 = stack[at, 0], stack[at, 1], stack[at, 2], stack[at, 3]
    r0, r1 = stack[at, 4], stack[at, 5]
    sides, corners, guess = nearby
    x, y = 0.25 * (l0 + l1 + r0 + r1), 0.5 * (y0 + y1)
    depth = _look(a, b, from_a, from_b, x, y, sides, guess, 0)
    if depth > deepest.depth_mm:
        deepest = Deepest(depth, x, y)
    ceiling = _measure_corners(stack, at, sides, 0, corners)
    if from_a and from_b:
        ceiling = min(ceiling, _measure_corners(stack, at, sides, OTHER, corners), _mean(corners, 0, OTHER))
    if ceiling <= enough_mm(deepest.depth_mm, limit_mm) or depth < RIDGE_SHARE * deepest.depth_mm:
        return deepest, ceiling
    for k in range(1, 5):
        if k < 3:
            x, y = (l0 if k == 1 else r0), y0
        else:
            x, y = (l1 if k == 3 else r1), y1
        depth = _look(a, b, from_a, from_b, x, y, sides, guess, k)
        if depth > deepest.depth_mm:
            deepest = Deepest(depth, x, y)
    for k in range(1, 5):
        ceiling = min(ceiling, _measure_corners(stack, at, sides, k, corners))
    for i in range(4):
        for j in range(i + 1, 5):
            ceiling = min(ceiling, _mean(corners, i, j))
    return deepest, ceiling


@kernel
def _mean(corners: Floats, i: int, j: int) -> float:
    """Mean distance from two segments, greatest over the corners: no lesser of the two distances is more."""
    mean = 0.0
    for c in range(4):
        mean = max(mean, 0.5 * (corners[i, c] + corners[j, c]))
    return mean


@kernel
def _look(
    a: Outline, b: Outline, from_a: bool, from_b: bool, x: float, y: float, sides: Floats, guess: Ints, k: int
) -> float:
    """Depth at a point; the segment that is nearest goes to row `k` of `sides`, that of the other contours after all.

    `guess` holds the segments found last, from which the next search starts.
    """
    depth = np.inf
    if from_a:
        square, i = nearest_segment(a.tree, x, y, guess[0])
        depth = math.sqrt(square)
        guess[0] = i
        if i >= 0:
            sides[k] = a.segments[i]
    if from_b:
        square, i = nearest_segment(b.tree, x, y, guess[1])
        other = math.sqrt(square)
        guess[1] = i
        if other < depth:
            depth = other
            sides[OTHER] = sides[k]
            sides[k] = b.segments[i]
        elif i >= 0:
            sides[OTHER] = b.segments[i]
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
    """Put the parts of trapezoid `at` in its row and those after it; their number.

    It is cut across its longer extent: in two, or along thin slivers into as many parts as are about as
    long as `stretch`, over which one side can settle the bound.
    """
    y0, y1, l0, l1 = stack[at, 0], stack[at, 1], stack[at, 2], stack[at, 3]
    r0, r1 = stack[at, 4], stack[at, 5]
    along = math.hypot(y1 - y0, max(abs(l1 - l0), abs(r1 - r0)))
    if along <= max(r0 - l0, r1 - l1):
        lower, upper = 0.5 * (l0 + r0), 0.5 * (l1 + r1)
        _place(stack, at, y0, y1, l0, l1, lower, upper, ceiling)
        _place(stack, at + 1, y0, y1, lower, upper, r0, r1, ceiling)
        return 2
    parts = int(min(max(math.ceil(along / stretch), 2.0), float(MOST_PARTS)))
    for k in range(parts):
        t, u = k / parts, (k + 1) / parts
        _place(
            stack, at + k, y0 + t * (y1 - y0), y0 + u * (y1 - y0), l0 + t * (l1 - l0), l0 + u * (l1 - l0),
            r0 + t * (r1 - r0), r0 + u * (r1 - r0), ceiling,
        )  # fmt: skip
    return parts


@kernel
def _place(
    stack: Floats, at: int, y0: float, y1: float, l0: float, l1: float, r0: float, r1: float, ceiling: float
) -> None:
    """Write a trapezoid and its bound into a row of the stack."""
    stack[at, 0], stack[at, 1], stack[at, 2], stack[at, 3] = y0, y1, l0, l1
    stack[at, 4], stack[at, 5], stack[at, 6] = r0, r1, ceiling


# -- Status of a sweep over two outlines: the edges that the sweep line crosses, and the gaps between them -----
#
# An edge is the part of a chain that the line crosses. The gap of an edge lies to its right, up to the next
# edge; its winding numbers stay the same from the level where the two become neighbours to the one where
# either ends, turns or is crossed. Only then is the trapezoid between them added, so the cost of a level is
# that of the changes there, not of all edges that pass through it.
#
# Neighbours are in the right order up to rounding: when two edges become neighbours, the level at which they
# cross is computed. If rounding gets an order wrong, the error is the area between edges that coincide within
# rounding; so shared edges and touching rings need no special care.
#
# The status is two tables with one row per edge, from left to right, and a few sums. They are passed on one
# by one: a tuple of them would cost reference counts at every call. Row -1, the last one, and the row after
# the last edge are borders (:func:`set_borders`), so that every edge has a gap on both sides.


SEGMENT = 5
"""Column of `edges` after those of :attr:`ebamcheck.comparison.chains.Chains.edges`: which segment it is."""

X_NOW = 6
"""Column of `edges`: x at the level at which the areas beside it were taken last."""

SINCE, LEFT, RIGHT, CROSSING = 7, 8, 9, 10
"""Columns of `edges` for its gap: level up to which its area is taken, x of its sides there, level at which they cross."""

EDGE_COLUMNS = 11

CHAIN, STEP_A, STEP_B, WINDING_A, WINDING_B = 0, 1, 2, 3, 4
"""Columns of `marks`: chain of the edge, change of both winding numbers across it, those in its gap."""

PLACE = 5
"""Column of `marks` with a row a chain instead: place of its edge in the status."""

MARK_COLUMNS = 6

AREA_A, AREA_B, DIFFERENCE, TRAPEZOIDS = 0, 1, 2, 3
"""Columns of `sums`: areas so far, mm2; number of trapezoids stored."""

SUMS = 4

BORDER_MM = 1e200
"""x of the borders: beyond every edge, yet so small that areas up to them are finite."""

Y0, Y1, L0, L1, R0, R1, LEFT_SEGMENT, RIGHT_SEGMENT = 0, 1, 2, 3, 4, 5, 6, 7
"""Columns of `difference`, the trapezoids of the symmetric difference: levels, x of both sides at each, and
the segments on which these lie. It has no rows where they are not wanted."""

TRAPEZOID_COLUMNS = 8


@kernel
def x_at(edges: Floats, k: int, y: float) -> float:
    """x of edge `k` at a level; exact at its ends."""
    # Without a branch: which way an edge leans and where it ends cannot be foretold from the edge before.
    low, high = edges[k, X_LOW], edges[k, X_HIGH]
    x = low + (y - edges[k, Y_LOW]) * edges[k, SLOPE]
    within = min(max(x, min(low, high)), max(low, high))
    return float(high if y >= edges[k, Y_HIGH] else within)


@kernel
def set_borders(edges: Floats, n: int) -> None:
    """Let a border stand after `n` edges and one before them. Winding numbers beyond both are 0: all rings are closed."""
    for k, x in ((-1, -BORDER_MM), (n, BORDER_MM)):
        edges[k, X_LOW], edges[k, X_HIGH], edges[k, X_NOW] = x, x, x
        edges[k, Y_LOW], edges[k, Y_HIGH], edges[k, SLOPE] = 0.0, np.inf, 0.0
        edges[k, CROSSING] = np.inf


@kernel
def set_edge(edges: Floats, k: int, segments: Floats, s: int, number: int) -> None:
    """Let edge `k` be segment `s`, which is known by a number."""
    chains.set_edge(edges, k, segments, s)
    edges[k, SEGMENT], edges[k, X_NOW] = number, edges[k, X_LOW]


@kernel
def pass_level(edges: Floats, k: int, y: float) -> float:
    """x of edge `k` at a level, which is noted: the areas beside it are taken there."""
    x = x_at(edges, k, y)
    edges[k, X_NOW] = x
    return x


@kernel
def gap_shares(
    edges: Floats, marks: Ints, k: int, left: float, right: float, y: float
) -> tuple[float, bool, bool, bool]:
    """Area of gap `k` up to a level at which its sides are at `left` and `right`; whether it is in a, in b, in one alone.

    They are taken as factors, so that all sums are added to, if only nothing: which of them a gap adds to is as good as
    random, and a choice between numbers by a condition on others is a branch in machine code.
    """
    area = 0.5 * ((edges[k, RIGHT] - edges[k, LEFT]) + (right - left)) * (y - edges[k, SINCE])
    in_a, in_b = marks[k, WINDING_A] > 0, marks[k, WINDING_B] > 0
    return area, in_a, in_b, in_a != in_b


@kernel
def take_areas(
    edges: Floats, marks: Ints, sums: Floats, difference: Floats, first: int, last: int, n: int, y: float
) -> None:
    """Add the trapezoids of gaps ``first .. last`` up to a level to the areas that they belong to."""
    first, last = max(first, 0), min(last, n - 2)
    right = pass_level(edges, first, y)
    for k in range(first, last + 1):
        left, right = right, pass_level(edges, k + 1, y)
        area, of_a, of_b, of_one = gap_shares(edges, marks, k, left, right, y)
        sums[AREA_A] += of_a * area
        sums[AREA_B] += of_b * area
        sums[DIFFERENCE] += of_one * max(area, 0.0)
        if len(difference) and of_one and edges[k, SINCE] != y:
            write_down(edges, sums, difference, k, y, left, right)
        edges[k, SINCE], edges[k, LEFT], edges[k, RIGHT] = y, left, right


@kernel
def start_gap(edges: Floats, k: int, y: float) -> float:
    """Start gap `k` at the level at which areas beside its edges were taken, or where these begin.

    The level at which they cross is returned; infinite where they do not.
    """
    left, right = edges[k, X_NOW], edges[k + 1, X_NOW]
    top = min(edges[k, Y_HIGH], edges[k + 1, Y_HIGH])
    over = x_at(edges, k, top) - x_at(edges, k + 1, top)
    apart = max(right - left, 0.0)
    level = min(y + np.divide(apart, apart + over) * (top - y), top) if over > 0.0 else np.inf
    edges[k, SINCE], edges[k, LEFT], edges[k, RIGHT], edges[k, CROSSING] = y, left, right, level
    return float(level)


@kernel
def start_gaps(edges: Floats, first: int, last: int, n: int, y: float) -> bool:
    """Start gaps ``first .. last`` at a level, as far as there are such; whether all are in order there is returned."""
    in_order = True
    for k in range(max(first, 0), min(last, n - 2) + 1):
        start_gap(edges, k, y)
        in_order &= edges[k, LEFT] <= edges[k, RIGHT]
    return in_order


@kernel
def first_crossing(edges: Floats, n: int) -> tuple[int, float]:
    """Edge that crosses the next one before any others do, and the level at which they cross; -1 and infinite for none."""
    first, level = -1, np.inf
    for k in range(n - 1):
        first = k if edges[k, CROSSING] < level else first
        level = min(level, edges[k, CROSSING])
    return first, level


@kernel
def swap(edges: Floats, marks: Ints, k: int) -> None:
    """Let edges `k` and `k + 1` change places."""
    for c in range(SINCE):
        edges[k, c], edges[k + 1, c] = edges[k + 1, c], edges[k, c]
    for c in range(WINDING_A):
        marks[k, c], marks[k + 1, c] = marks[k + 1, c], marks[k, c]
    marks[marks[k, CHAIN], PLACE], marks[marks[k + 1, CHAIN], PLACE] = k, k + 1
    _set_winding(marks, k)


@kernel
def settle(edges: Floats, marks: Ints, sums: Floats, difference: Floats, k: int, n: int, y: float) -> None:
    """Move edge `k` to where its x at a level belongs."""
    while k < n - 1 and edges[k, LEFT] > edges[k, RIGHT]:
        _exchange(edges, marks, sums, difference, k, n, y)
        k += 1
    while k > 0 and edges[k - 1, LEFT] > edges[k - 1, RIGHT]:
        _exchange(edges, marks, sums, difference, k - 1, n, y)
        k -= 1


# Thirteen parameters: a tuple of the tables would cost reference counts at every call, see above.
@kernel
def start_pair(
    edges: Floats, marks: Ints, sums: Floats, difference: Floats, n: int, y: float, left: int, right: int,
    segments: Floats, s: int, t: int, number: int, steps: Ints,
) -> None:  # fmt: skip
    """Let two chains start at a level, the left one with segment `s`, the other with `t`; `number` is that of segment 0."""
    k = 0
    x = segments[s, 0] if segments[s, 1] < segments[s, 3] else segments[s, 2]
    while k < n and x_at(edges, k, y) <= x:
        k += 1
    take_areas(edges, marks, sums, difference, k - 1, k - 1, n, y)
    for i in range(n - 1, k - 1, -1):
        _move(edges, marks, i, i + 2)
    for place, chain, segment in ((k, left, s), (k + 1, right, t)):
        set_edge(edges, place, segments, segment, number + segment)
        marks[place, CHAIN], marks[chain, PLACE] = chain, place
        marks[place, STEP_A], marks[place, STEP_B] = steps[chain, 0], steps[chain, 1]
        _set_winding(marks, place)
    set_borders(edges, n + 2)
    if not start_gaps(edges, k - 1, k + 1, n + 2, y):
        # Where a level run lies between the two, the right one belongs further to the right.
        settle(edges, marks, sums, difference, k + 1, n + 2, y)


@kernel
def end_pair(
    edges: Floats, marks: Ints, sums: Floats, difference: Floats, n: int, y: float, chain: int, other: int
) -> None:
    """Take out the edges of two chains that end at a level."""
    left, right = marks[chain, PLACE], marks[other, PLACE]
    if left > right:
        left, right = right, left
    for k in range(left, right - 1):
        _exchange(edges, marks, sums, difference, k, n, y)
    k = right - 1
    take_areas(edges, marks, sums, difference, k - 1, k + 1, n, y)
    for i in range(k + 2, n):
        _move(edges, marks, i, i - 2)
    set_borders(edges, n - 2)
    start_gaps(edges, k - 1, k - 1, n - 2, y)


@kernel
def _exchange(edges: Floats, marks: Ints, sums: Floats, difference: Floats, k: int, n: int, y: float) -> None:
    """Let edges `k` and `k + 1` change places at a level."""
    take_areas(edges, marks, sums, difference, k - 1, k + 1, n, y)
    swap(edges, marks, k)
    start_gaps(edges, k - 1, k + 1, n, y)


@kernel
def _set_winding(marks: Ints, k: int) -> None:
    """Winding numbers of gap `k` from those of the gap before it."""
    before_a, before_b = (marks[k - 1, WINDING_A], marks[k - 1, WINDING_B]) if k > 0 else (0, 0)
    marks[k, WINDING_A], marks[k, WINDING_B] = before_a + marks[k, STEP_A], before_b + marks[k, STEP_B]


@kernel
def write_down(
    edges: Floats, sums: Floats, difference: Floats, k: int, y: float, left: float, right: float
) -> None:
    """Write down the trapezoid of gap `k` up to a level."""
    t = int(sums[TRAPEZOIDS])
    sums[TRAPEZOIDS] = t + 1
    difference[t, Y0], difference[t, Y1] = edges[k, SINCE], y
    difference[t, L0], difference[t, L1] = edges[k, LEFT], left
    difference[t, R0], difference[t, R1] = edges[k, RIGHT], right
    difference[t, LEFT_SEGMENT], difference[t, RIGHT_SEGMENT] = edges[k, SEGMENT], edges[k + 1, SEGMENT]


@kernel
def _move(edges: Floats, marks: Ints, k: int, to: int) -> None:
    """Move edge `k` and its gap to another row."""
    for c in range(EDGE_COLUMNS):
        edges[to, c] = edges[k, c]
    for c in range(PLACE):
        marks[to, c] = marks[k, c]
    marks[marks[k, CHAIN], PLACE] = to

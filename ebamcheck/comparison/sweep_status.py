"""Status of a sweep over two outlines: the edges that the sweep line crosses, and the gaps between them.

An edge is the part of a chain that the line crosses. The gap of an edge lies to its right, up to the next
edge; its winding numbers stay the same from the level where the two become neighbours to the one where
either ends, turns or is crossed. Only then is the trapezoid between them added, so the cost of a level is that of
the changes there, not of all edges that pass through it.

Neighbours are in the right order up to rounding: when two edges become neighbours, the level at which they cross
is computed. If rounding gets an order wrong, the error is the area between edges that coincide within rounding;
so shared edges and touching rings need no special care.

The status is two tables with one row per edge, from left to right, and a few sums. They are passed on one by
one: a tuple of them would cost reference counts at every call. Row -1, the last one, and the row after the last
edge are borders (:func:`set_borders`), so that every edge has a gap on both sides.
"""

from __future__ import annotations

import numpy as np

from ebamcheck.comparison import chains
from ebamcheck.comparison.chains import SLOPE, X_HIGH, X_LOW, Y_HIGH, Y_LOW
from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Floats, Ints

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

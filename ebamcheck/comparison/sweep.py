"""Exact areas of two regions and of their symmetric difference, by a sweep from below.

It is the sweep of Bentley and Ottmann (Algorithms for reporting and counting geometric intersections, IEEE Transactions on
Computers C-28, 1979, 643-647): crossings are looked for between neighbours alone. Their balanced tree and queue are a sorted
table here and a scan of it, since the sections of a layer have few edges at one level.

An edge is the part of a chain that the sweep line crosses. The gap of an edge lies to its right, up to the next edge: a trapezoid,
wholly inside or outside either region (winding number > 0). Its winding numbers stay the same from the level where the two become
neighbours to the one where either ends, turns or is crossed. Only then is the trapezoid between them added, so a level costs what
changes there, not what passes through it.

When two edges become neighbours, the level at which they cross is computed. If rounding gets an order wrong, the error is the
area between edges that coincide within rounding; so shared edges and touching rings need no special care.

The status is two tables with one row per edge, from left to right, and a few sums. They are passed on one by one: a tuple of them
would cost reference counts at every call. Row -1, the last one, and the row after the last edge are borders, so that every edge
has a gap on both sides.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ebamcheck.comparison import outline as events
from ebamcheck.comparison.outline import (
    ADVANCE,
    CLOSE,
    KIND,
    SLOPE,
    X_HIGH,
    X_LOW,
    Y_HIGH,
    Y_LOW,
    Outline,
    set_edge,
)  # fmt: skip
from ebamcheck.kernels import Floats, Ints, kernel

MOST_CROSSINGS = 2_000_000  # most crossings in one sweep; beyond it the caller uses shapely instead

# Trapezoids that one step of the sweep takes at most for each edge of the status: an edge that moves passes every other once at
# most, and three gaps change each time, as at either end of a level run
TAKEN_AN_EDGE = 6

# Columns of `edges` after those of the chains: its segment, and x at the level at which the areas beside it were taken last; of its
# gap the level up to which its area is taken, x of its sides there, and the level at which they cross
SEGMENT, X_NOW, SINCE, LEFT, RIGHT, CROSSING = 5, 6, 7, 8, 9, 10
EDGE_COLUMNS = 11
# Columns of `marks`: chain of the edge, change of both winding numbers across it, those in its gap; and, with a row a chain
# instead, the place of its edge in the status
CHAIN, STEP_A, STEP_B, WINDING_A, WINDING_B, PLACE = 0, 1, 2, 3, 4, 5
MARK_COLUMNS = 6
# Columns of `sums`: areas so far, mm2; number of trapezoids stored
AREA_A, AREA_B, DIFFERENCE, TRAPEZOIDS = 0, 1, 2, 3
# Columns of `difference`, the trapezoids of the symmetric difference: levels, x of both sides at each, and the segments on which
# these lie. It has no rows where they are not wanted
Y0, Y1, L0, L1, R0, R1, LEFT_SEGMENT, RIGHT_SEGMENT = 0, 1, 2, 3, 4, 5, 6, 7
# State of a sweep: events passed of either outline, edges of the status, and crossings passed
NEXT_A, NEXT_B, EDGES, CROSSINGS = 0, 1, 2, 3
BORDER_MM = 1e200  # x of the borders: beyond every edge, yet so small that areas up to them are finite


class Overlap(NamedTuple):
    """Result of a sweep over two outlines."""

    area_a_mm2: float
    area_b_mm2: float
    symmetric_difference_mm2: float
    # (T, 8) trapezoids of the symmetric difference, if wanted; segments of the second outline are numbered after those of the first
    difference: Floats
    sound: bool  # false if there were too many crossings


@kernel
def overlap(a: Outline, b: Outline, wanted: bool) -> Overlap:
    """Sweep over two outlines; the trapezoids of the symmetric difference are written down if `wanted`."""
    of_a, of_b = a.chains.steps, b.chains.steps
    steps = np.zeros((of_a.size + of_b.size, 2), np.int64)
    for chain in range(of_a.size):
        steps[chain, 0] = of_a[chain]
    for chain in range(of_b.size):
        steps[of_a.size + chain, 1] = of_b[chain]
    # Beyond the edges there are two borders, and beyond the marks a row of zeros, the last one.
    edges = np.zeros((len(steps) + 2, EDGE_COLUMNS))
    marks = np.zeros((len(steps) + 1, MARK_COLUMNS), np.int64)
    sums, come = np.zeros(4), np.zeros(4, np.int64)
    _set_borders(edges, 0)
    difference = np.empty((64 if wanted else 0, 8))
    while not _sweep(a, b, steps, edges, marks, sums, difference, come):
        taken = int(sums[TRAPEZOIDS])
        larger = np.empty((2 * (taken + TAKEN_AN_EDGE * (come[EDGES] + 2)), 8))
        for t in range(taken):
            for c in range(8):
                larger[t, c] = difference[t, c]
        difference = larger
    if come[CROSSINGS] > MOST_CROSSINGS:
        return Overlap(0.0, 0.0, 0.0, difference[:0], False)
    found = difference[: int(sums[TRAPEZOIDS])].copy()
    return Overlap(sums[AREA_A], sums[AREA_B], sums[DIFFERENCE], found, True)


@kernel
def _sweep(
    a: Outline, b: Outline, steps: Ints, edges: Floats, marks: Ints, sums: Floats, difference: Floats, come: Ints
) -> bool:  # fmt: skip
    """Sweep on from the state `come`; False where there is no room to write down what the next step may add.

    The work at most levels stands here at length: to call a kernel with all tables costs more than the work itself. Nothing
    that is as good as random is a branch: which outline goes on, and to which areas a gap adds.
    """
    levels_a, events_a, edges_a = a.chains.levels, a.chains.events, a.chains.edges
    levels_b, events_b, edges_b = b.chains.levels, b.chains.events, b.chains.edges
    segments, chains = len(a.segments), a.chains.steps.size
    next_a, next_b, n, crossings = come[NEXT_A], come[NEXT_B], come[EDGES], come[CROSSINGS]
    room = True
    # The edge that crosses the next one first, if it does so at the lowest level; if not, it is looked for.
    first, lowest = _first_crossing(edges, n)
    for _ in range(levels_a.size + levels_b.size - 2 - next_a - next_b):
        y = min(levels_a[next_a], levels_b[next_b])
        room = len(difference) == 0 or int(sums[TRAPEZOIDS]) + TAKEN_AN_EDGE * (n + 2) <= len(difference)
        while room and lowest <= y and crossings <= MOST_CROSSINGS:
            if edges[first, CROSSING] != lowest:
                first, lowest = _first_crossing(edges, n)
                continue
            crossings += 1
            _exchange(edges, marks, sums, difference, first, n, lowest)
            first, lowest = _first_crossing(edges, n)
            room = len(difference) == 0 or int(sums[TRAPEZOIDS]) + TAKEN_AN_EDGE * (n + 2) <= len(difference)
        if not room or crossings > MOST_CROSSINGS:
            break
        from_a = levels_a[next_a] <= levels_b[next_b]
        kind_a, chain_a = events_a[next_a, KIND], events_a[next_a, events.LEFT]
        kind_b, chain_b = events_b[next_b, KIND], events_b[next_b, events.LEFT]
        in_order = advances = (kind_a if from_a else kind_b) == ADVANCE
        m = marks[chain_a if from_a else chain_b + chains, PLACE]
        if advances:
            _take_areas(edges, marks, sums, difference, m - 1, m, y)
            for c in range(SLOPE + 1):
                here, there = edges_a[next_a, c], edges_b[next_b, c]
                edges[m, c] = here if from_a else there
            of_a, of_b = events_a[next_a, events.LEFT_SEGMENT], events_b[next_b, events.LEFT_SEGMENT]
            edges[m, SEGMENT] = of_a if from_a else of_b + segments
            edges[m, X_NOW] = edges[m, X_LOW]
            for k in range(m - 1, m + 1):
                level = _start_gap(edges, k, y)
                in_order &= edges[k, LEFT] <= edges[k, RIGHT]
                first = k if (level < lowest) | ((level == lowest) & (k < first)) else first
                lowest = min(lowest, level)
        if not in_order:
            if advances:
                _settle(edges, marks, sums, difference, m, n, y)
            else:
                event = next_a if from_a else next_b
                n += _turn(a, b, from_a, event, steps, edges, marks, sums, difference, n, y)
            first, lowest = _first_crossing(edges, n)
        next_a, next_b = next_a + from_a, next_b + (not from_a)
    come[NEXT_A], come[NEXT_B], come[EDGES], come[CROSSINGS] = next_a, next_b, n, crossings
    return room


# Eleven parameters: a tuple of the tables would cost reference counts at every level.
@kernel
def _turn(
    a: Outline, b: Outline, from_a: bool, number: int, steps: Ints, edges: Floats, marks: Ints, sums: Floats,
    difference: Floats, n: int, y: float,
) -> int:  # fmt: skip
    """Let two chains start or end at an event of one outline; how many edges more there are then.

    Chains and segments of `b` are numbered after those of `a`.
    """
    event = a.chains.events[number] if from_a else b.chains.events[number]
    chains, before = (0, 0) if from_a else (a.chains.steps.size, len(a.segments))
    left, right = event[events.LEFT] + chains, event[events.RIGHT] + chains
    if event[KIND] == CLOSE:
        i, j = marks[left, PLACE], marks[right, PLACE]
        i, j = min(i, j), max(i, j)
        for k in range(i, j - 1):
            _exchange(edges, marks, sums, difference, k, n, y)
        k = j - 1
        _take_areas(edges, marks, sums, difference, max(k - 1, 0), min(k + 1, n - 2), y)
        for i in range(k + 2, n):
            _move(edges, marks, i, i - 2)
        _set_borders(edges, n - 2)
        _start_gaps(edges, k - 1, k - 1, n - 2, y)
        return -2
    segments = a.segments if from_a else b.segments
    s, t = event[events.LEFT_SEGMENT], event[events.RIGHT_SEGMENT]
    k = 0
    x = segments[s, 0] if segments[s, 1] < segments[s, 3] else segments[s, 2]
    while k < n and _x_at(edges, k, y) <= x:
        k += 1
    _take_areas(edges, marks, sums, difference, max(k - 1, 0), min(k - 1, n - 2), y)
    for i in range(n - 1, k - 1, -1):
        _move(edges, marks, i, i + 2)
    for place, chain, segment in ((k, left, s), (k + 1, right, t)):
        set_edge(edges, place, segments, segment)
        edges[place, SEGMENT], edges[place, X_NOW] = before + segment, edges[place, X_LOW]
        marks[place, CHAIN], marks[chain, PLACE] = chain, place
        marks[place, STEP_A], marks[place, STEP_B] = steps[chain, 0], steps[chain, 1]
        _set_winding(marks, place)
    _set_borders(edges, n + 2)
    if not _start_gaps(edges, k - 1, k + 1, n + 2, y):
        # Where a level run lies between the two, the right one belongs further to the right.
        _settle(edges, marks, sums, difference, k + 1, n + 2, y)
    return 2


@kernel
def _x_at(edges: Floats, k: int, y: float) -> float:
    """x of edge `k` at a level; exact at its ends."""
    # Without a branch: which way an edge leans and where it ends cannot be foretold from the edge before.
    low, high = edges[k, X_LOW], edges[k, X_HIGH]
    x = low + (y - edges[k, Y_LOW]) * edges[k, SLOPE]
    within = min(max(x, min(low, high)), max(low, high))
    return float(high if y >= edges[k, Y_HIGH] else within)


@kernel
def _set_borders(edges: Floats, n: int) -> None:
    """Let a border stand after `n` edges and one before them. Winding numbers beyond both are 0: all rings are closed."""
    for k, x in ((-1, -BORDER_MM), (n, BORDER_MM)):
        edges[k, X_LOW], edges[k, X_HIGH], edges[k, X_NOW] = x, x, x
        edges[k, Y_LOW], edges[k, Y_HIGH], edges[k, SLOPE] = 0.0, np.inf, 0.0
        edges[k, CROSSING] = np.inf


@kernel
def _take_areas(edges: Floats, marks: Ints, sums: Floats, difference: Floats, first: int, last: int, y: float) -> None:
    """Add the trapezoids of gaps ``first .. last`` up to a level to the areas that they belong to.

    Whether a gap is in a region is a factor: which sums a gap adds to is as good as random, and a choice would be a branch.
    """
    area_a, area_b, differs = sums[AREA_A], sums[AREA_B], sums[DIFFERENCE]
    right = edges[first, X_NOW] = _x_at(edges, first, y)
    for k in range(first, last + 1):
        left = right
        right = edges[k + 1, X_NOW] = _x_at(edges, k + 1, y)
        since = edges[k, SINCE]
        area = 0.5 * ((edges[k, RIGHT] - edges[k, LEFT]) + (right - left)) * (y - since)
        in_a, in_b = marks[k, WINDING_A] > 0, marks[k, WINDING_B] > 0
        area_a, area_b = area_a + in_a * area, area_b + in_b * area
        differs += (in_a != in_b) * max(area, 0.0)
        if len(difference) > 0 and in_a != in_b and since != y:
            t = int(sums[TRAPEZOIDS])
            sums[TRAPEZOIDS] = t + 1
            difference[t, Y0], difference[t, Y1] = since, y
            difference[t, L0], difference[t, L1] = edges[k, LEFT], left
            difference[t, R0], difference[t, R1] = edges[k, RIGHT], right
            difference[t, LEFT_SEGMENT] = edges[k, SEGMENT]
            difference[t, RIGHT_SEGMENT] = edges[k + 1, SEGMENT]
        edges[k, SINCE], edges[k, LEFT], edges[k, RIGHT] = y, left, right
    sums[AREA_A], sums[AREA_B], sums[DIFFERENCE] = area_a, area_b, differs


@kernel
def _start_gap(edges: Floats, k: int, y: float) -> float:
    """Start gap `k` at the level at which areas beside its edges were taken, or where these begin.

    The level at which they cross is returned; infinite where they do not.
    """
    left, right = edges[k, X_NOW], edges[k + 1, X_NOW]
    top = min(edges[k, Y_HIGH], edges[k + 1, Y_HIGH])
    over = _x_at(edges, k, top) - _x_at(edges, k + 1, top)
    apart = max(right - left, 0.0)
    level = min(y + np.divide(apart, apart + over) * (top - y), top) if over > 0.0 else np.inf
    edges[k, SINCE], edges[k, LEFT], edges[k, RIGHT], edges[k, CROSSING] = y, left, right, level
    return float(level)


@kernel
def _start_gaps(edges: Floats, first: int, last: int, n: int, y: float) -> bool:
    """Start gaps ``first .. last`` at a level, as far as there are such; whether all are in order there is returned."""
    in_order = True
    for k in range(max(first, 0), min(last, n - 2) + 1):
        _start_gap(edges, k, y)
        in_order &= edges[k, LEFT] <= edges[k, RIGHT]
    return in_order


@kernel
def _first_crossing(edges: Floats, n: int) -> tuple[int, float]:
    """Edge that crosses the next one before any others do, and the level at which they cross; -1 and infinite for none."""
    first, level = -1, np.inf
    for k in range(n - 1):
        first = k if edges[k, CROSSING] < level else first
        level = min(level, edges[k, CROSSING])
    return first, level


@kernel
def _set_winding(marks: Ints, k: int) -> None:
    """Winding numbers of gap `k` from those of the gap before it."""
    before_a, before_b = (marks[k - 1, WINDING_A], marks[k - 1, WINDING_B]) if k > 0 else (0, 0)
    marks[k, WINDING_A], marks[k, WINDING_B] = before_a + marks[k, STEP_A], before_b + marks[k, STEP_B]


@kernel
def _settle(edges: Floats, marks: Ints, sums: Floats, difference: Floats, k: int, n: int, y: float) -> None:
    """Move edge `k` to where its x at a level belongs."""
    while k < n - 1 and edges[k, LEFT] > edges[k, RIGHT]:
        _exchange(edges, marks, sums, difference, k, n, y)
        k += 1
    while k > 0 and edges[k - 1, LEFT] > edges[k - 1, RIGHT]:
        _exchange(edges, marks, sums, difference, k - 1, n, y)
        k -= 1


@kernel
def _exchange(edges: Floats, marks: Ints, sums: Floats, difference: Floats, k: int, n: int, y: float) -> None:
    """Let edges `k` and `k + 1` change places at a level."""
    _take_areas(edges, marks, sums, difference, max(k - 1, 0), min(k + 1, n - 2), y)
    for c in range(SINCE):
        edges[k, c], edges[k + 1, c] = edges[k + 1, c], edges[k, c]
    for c in range(WINDING_A):
        marks[k, c], marks[k + 1, c] = marks[k + 1, c], marks[k, c]
    marks[marks[k, CHAIN], PLACE], marks[marks[k + 1, CHAIN], PLACE] = k, k + 1
    _set_winding(marks, k)
    _start_gaps(edges, k - 1, k + 1, n, y)


@kernel
def _move(edges: Floats, marks: Ints, k: int, to: int) -> None:
    """Move edge `k` and its gap to another row."""
    for c in range(EDGE_COLUMNS):
        edges[to, c] = edges[k, c]
    for c in range(PLACE):
        marks[to, c] = marks[k, c]
    marks[marks[k, CHAIN], PLACE] = to

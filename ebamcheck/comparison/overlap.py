"""Exact areas of two regions and of their symmetric difference, by a sweep from below.

Between two edges that are neighbours in the status of the sweep lies a trapezoid, wholly inside or outside
either region (winding number > 0). See :mod:`ebamcheck.comparison.depth` for how the sweep proceeds.

It is the sweep of Bentley and Ottmann (Algorithms for reporting and counting geometric intersections, IEEE Transactions on
Computers C-28, 1979, 643-647): crossings are looked for between neighbours alone. Their balanced tree and queue are a sorted
table here and a scan of it, since the sections of a layer have few edges at one level.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ebamcheck.comparison import depth as status
from ebamcheck.comparison.chains import (
    ADVANCE,
    CLOSE,
    KIND,
    LEFT,
    LEFT_SEGMENT,
    RIGHT,
    RIGHT_SEGMENT,
    SLOPE,
    X_LOW,
)
from ebamcheck.comparison.outline import Outline
from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Floats, Ints, ShortInts

MOST_CROSSINGS = 2_000_000
"""Most crossings in one sweep; beyond it the caller uses shapely instead."""

TAKEN_AN_EDGE = 6
"""Trapezoids that one step of the sweep takes at most for each edge of the status: an edge that moves passes
every other once at most, and three gaps change each time, as at either end of a level run."""


class Overlap(NamedTuple):
    """Result of a sweep over two outlines."""

    area_a_mm2: float
    area_b_mm2: float
    symmetric_difference_mm2: float
    difference: Floats
    """(T, 8) trapezoids of the symmetric difference, if wanted; columns in :mod:`ebamcheck.comparison.depth`.
    Segments of the second outline are numbered after those of the first."""
    sound: bool
    """False if there were too many crossings."""


NEXT_A, NEXT_B, EDGES, CROSSINGS = 0, 1, 2, 3
"""State of a sweep: events passed of either outline, edges of the status, and crossings passed."""


@kernel
def overlap(a: Outline, b: Outline, wanted: bool) -> Overlap:
    """Sweep over two outlines; the trapezoids of the symmetric difference are written down if `wanted`."""
    steps = _steps(a.chains.steps, b.chains.steps)
    # Beyond the edges there are two borders, and beyond the marks a row of zeros, the last one.
    edges = np.zeros((len(steps) + 2, status.EDGE_COLUMNS))
    marks = np.zeros((len(steps) + 1, status.MARK_COLUMNS), np.int64)
    sums, come = np.zeros(status.SUMS), np.zeros(4, np.int64)
    status.set_borders(edges, 0)
    difference = np.empty((64 if wanted else 0, status.TRAPEZOID_COLUMNS))
    while not _sweep(a, b, steps, edges, marks, sums, difference, come):
        taken = int(sums[status.TRAPEZOIDS])
        larger = np.empty((2 * (taken + TAKEN_AN_EDGE * (come[EDGES] + 2)), status.TRAPEZOID_COLUMNS))
        larger[:taken] = difference[:taken]
        difference = larger
    if come[CROSSINGS] > MOST_CROSSINGS:
        return Overlap(0.0, 0.0, 0.0, difference[:0], False)
    found = difference[: int(sums[status.TRAPEZOIDS])].copy()
    return Overlap(sums[status.AREA_A], sums[status.AREA_B], sums[status.DIFFERENCE], found, True)


@kernel
def _sweep(
    a: Outline,
    b: Outline,
    steps: Ints,
    edges: Floats,
    marks: Ints,
    sums: Floats,
    difference: Floats,
    come: Ints,
) -> bool:
    """Sweep on from where it has come to; False where there is no room to write down what the next step may add.

    What most levels do stands here at length: to call a kernel with all tables costs more than what it does. And nothing
    that is as good as random is a branch: which outline goes on, and to which areas a gap adds.
    """
    levels_a, events_a, edges_a = a.chains.levels, a.chains.events, a.chains.edges
    levels_b, events_b, edges_b = b.chains.levels, b.chains.events, b.chains.edges
    segments, chains = len(a.segments), a.chains.steps.size
    next_a, next_b, n, crossings = come[NEXT_A], come[NEXT_B], come[EDGES], come[CROSSINGS]
    area_a, area_b, differs = sums[status.AREA_A], sums[status.AREA_B], sums[status.DIFFERENCE]
    wanted, room = len(difference) > 0, True
    # The edge that crosses the next one first, if it does so at the lowest level; if not, it is looked for.
    first, lowest = status.first_crossing(edges, n)
    for _ in range(levels_a.size + levels_b.size - 2 - next_a - next_b):
        y = min(levels_a[next_a], levels_b[next_b])
        room = not wanted or _has_room(difference, sums, n)
        while room and lowest <= y and crossings <= MOST_CROSSINGS:
            if edges[first, status.CROSSING] != lowest:
                first, lowest = status.first_crossing(edges, n)
                continue
            crossings += 1
            right = status.pass_level(edges, first - 1, lowest)
            for k in range(first - 1, first + 2):
                left, right = right, status.pass_level(edges, k + 1, lowest)
                of_a, of_b, of_one = _taken(edges, marks, sums, difference, k, lowest, left, right)
                area_a, area_b, differs = area_a + of_a, area_b + of_b, differs + of_one
            status.swap(edges, marks, first)
            for k in range(first - 1, first + 2):
                status.start_gap(edges, k, lowest)
            first, lowest = status.first_crossing(edges, n)
            room = not wanted or _has_room(difference, sums, n)
        if not room or crossings > MOST_CROSSINGS:
            break
        from_a = levels_a[next_a] <= levels_b[next_b]
        kind_a, chain_a = events_a[next_a, KIND], events_a[next_a, LEFT]
        kind_b, chain_b = events_b[next_b, KIND], events_b[next_b, LEFT]
        in_order = advances = (kind_a if from_a else kind_b) == ADVANCE
        m = marks[chain_a if from_a else chain_b + chains, status.PLACE]
        if advances:
            right = status.pass_level(edges, m - 1, y)
            for k in range(m - 1, m + 1):
                left, right = right, status.pass_level(edges, k + 1, y)
                of_a, of_b, of_one = _taken(edges, marks, sums, difference, k, y, left, right)
                area_a, area_b, differs = area_a + of_a, area_b + of_b, differs + of_one
            _go_on(edges, m, edges_a, events_a, next_a, edges_b, events_b, next_b, segments, from_a)
            for k in range(m - 1, m + 1):
                level = status.start_gap(edges, k, y)
                in_order &= edges[k, status.LEFT] <= edges[k, status.RIGHT]
                first = k if (level < lowest) | ((level == lowest) & (k < first)) else first
                lowest = min(lowest, level)
        if not in_order:
            sums[status.AREA_A], sums[status.AREA_B], sums[status.DIFFERENCE] = area_a, area_b, differs
            if advances:
                status.settle(edges, marks, sums, difference, m, n, y)
            else:
                event = next_a if from_a else next_b
                n += _turn(a, b, from_a, event, steps, edges, marks, sums, difference, n, y)
            area_a, area_b, differs = sums[status.AREA_A], sums[status.AREA_B], sums[status.DIFFERENCE]
            first, lowest = status.first_crossing(edges, n)
        next_a, next_b = next_a + from_a, next_b + (not from_a)
    sums[status.AREA_A], sums[status.AREA_B], sums[status.DIFFERENCE] = area_a, area_b, differs
    come[NEXT_A], come[NEXT_B], come[EDGES], come[CROSSINGS] = next_a, next_b, n, crossings
    return room


@kernel
def _taken(
    edges: Floats, marks: Ints, sums: Floats, difference: Floats, k: int, y: float, left: float, right: float
) -> tuple[float, float, float]:
    """Area of a gap up to a level that is in `a`, in `b` and in one of them alone, which is written down if wanted."""
    area, of_a, of_b, of_one = status.gap_shares(edges, marks, k, left, right, y)
    if len(difference) > 0 and of_one and edges[k, status.SINCE] != y:
        status.write_down(edges, sums, difference, k, y, left, right)
    return of_a * area, of_b * area, of_one * max(area, 0.0)


# Ten parameters: a tuple of the tables would cost reference counts at every call.
@kernel
def _go_on(
    edges: Floats, m: int, edges_a: Floats, events_a: ShortInts, next_a: int,
    edges_b: Floats, events_b: ShortInts, next_b: int, segments: int, from_a: bool,
) -> None:  # fmt: skip
    """Let edge `m` go on with the segment of the next event of one outline; `segments` are those of `a`."""
    for c in range(SLOPE + 1):
        here, there = edges_a[next_a, c], edges_b[next_b, c]
        edges[m, c] = here if from_a else there
    segment_a, segment_b = events_a[next_a, LEFT_SEGMENT], events_b[next_b, LEFT_SEGMENT]
    edges[m, status.SEGMENT] = segment_a if from_a else segment_b + segments
    edges[m, status.X_NOW] = edges[m, X_LOW]


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
    left, right = event[LEFT] + chains, event[RIGHT] + chains
    if event[KIND] == CLOSE:
        status.end_pair(edges, marks, sums, difference, n, y, left, right)
        return -2
    segments = a.segments if from_a else b.segments
    s, t = event[LEFT_SEGMENT], event[RIGHT_SEGMENT]
    status.start_pair(edges, marks, sums, difference, n, y, left, right, segments, s, t, before, steps)
    return 2


@kernel
def _has_room(difference: Floats, sums: Floats, n: int) -> bool:
    """Whether all trapezoids can be written down that one step of the sweep may add."""
    return bool(int(sums[status.TRAPEZOIDS]) + TAKEN_AN_EDGE * (n + 2) <= len(difference))


@kernel
def _steps(a: Ints, b: Ints) -> Ints:
    """Change (C, 2) of both winding numbers across the chains of both outlines."""
    steps = np.zeros((a.size + b.size, 2), np.int64)
    steps[: a.size, 0] = a
    steps[a.size :, 1] = b
    return steps

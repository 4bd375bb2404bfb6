"""Exact areas of two regions and of their symmetric difference, by a sweep from below.

Between two edges that are neighbours in the status of the sweep lies a trapezoid, wholly inside or outside
either region (winding number > 0). See :mod:`ebamcheck.comparison.sweep_status` for how it goes on.

It is the sweep of Bentley and Ottmann (Algorithms for reporting and counting geometric intersections, IEEE Transactions on
Computers C-28, 1979, 643-647): crossings are looked for between neighbours alone. Their balanced tree and queue are a sorted
table here and a scan of it, since the sections of a layer have few edges at one level.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ebamcheck.comparison import sweep_status as status
from ebamcheck.comparison.chains import (
    ADVANCE,
    KIND,
    LEFT,
    LEFT_SEGMENT,
    OPEN,
    RIGHT,
    RIGHT_SEGMENT,
    Chains,
)
from ebamcheck.comparison.outline import Outline
from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Floats, Ints, ShortInts

MOST_CROSSINGS = 2_000_000
"""Crossings in one sweep; beyond it the caller uses shapely instead."""

TAKEN_AN_EDGE = 6
"""Trapezoids that one step of the sweep takes at most for each edge of the status: an edge that moves passes
every other once at most, and three gaps change each time, as at either end of a level run."""


class Overlap(NamedTuple):
    """What a sweep over two outlines finds."""

    area_a_mm2: float
    area_b_mm2: float
    symmetric_difference_mm2: float
    difference: Floats
    """(T, 8) trapezoids of the symmetric difference, if wanted; columns in :mod:`ebamcheck.comparison.sweep_status`.
    Segments of the second outline are numbered after those of the first."""
    sound: bool
    """False where the crossings were too many."""


@kernel
def overlap(a: Outline, b: Outline, wanted: bool) -> Overlap:
    """Sweep over two outlines; the trapezoids of the symmetric difference are written down if `wanted`."""
    levels, events = _together(a.chains, b.chains, len(a.segments))
    segments = np.concatenate((a.segments, b.segments))
    steps = _steps(a.chains.steps, b.chains.steps)
    edges = np.empty((len(steps), status.EDGE_COLUMNS))
    marks = np.empty((len(steps), status.MARK_COLUMNS), np.int64)
    sums = np.zeros(status.SUMS)
    sums[status.NEXT_CROSSING] = np.inf
    difference = np.empty((64 if wanted else 0, status.TRAPEZOID_COLUMNS))
    crossings, n = 0, 0
    next_a, next_b = 0, a.chains.levels.size
    # What most levels do stands here at length: a kernel that calls kernels pays reference counts for its tables.
    for _ in range(len(events)):
        # Without a branch: which of the two goes on is as good as random.
        from_a = levels[next_a] <= levels[next_b]
        k = next_a if from_a else next_b
        next_a, next_b = next_a + from_a, next_b + (not from_a)
        y, k = levels[k], k - (not from_a)
        if wanted:
            difference = _with_room(difference, sums, n)
        while sums[status.NEXT_CROSSING] <= y:
            m = status.next_crossing(edges, sums, n)
            level = sums[status.NEXT_CROSSING]
            if level > y:
                break
            crossings += 1
            if crossings > MOST_CROSSINGS:
                return Overlap(0.0, 0.0, 0.0, difference[:0], False)
            status.take_areas(edges, marks, sums, difference, m - 1, m + 1, n, level)
            status.swap(edges, marks, m)
            status.start_gaps(edges, sums, m - 1, m + 1, n, level)
            if wanted:
                difference = _with_room(difference, sums, n)
        if events[k, KIND] == ADVANCE:
            m = marks[events[k, LEFT], status.PLACE]
            status.take_areas(edges, marks, sums, difference, m - 1, m, n, y)
            status.set_edge(edges, m, segments, events[k, LEFT_SEGMENT])
            if not status.start_gaps(edges, sums, m - 1, m, n, y):
                status.settle(edges, marks, sums, difference, m, n, y)
        elif events[k, KIND] == OPEN:
            left, right, s, t = (
                events[k, LEFT],
                events[k, RIGHT],
                events[k, LEFT_SEGMENT],
                events[k, RIGHT_SEGMENT],
            )
            status.start_pair(edges, marks, sums, difference, n, y, left, right, segments, s, t, steps)
            n += 2
        else:
            status.end_pair(edges, marks, sums, difference, n, y, events[k, LEFT], events[k, RIGHT])
            n -= 2
    found = difference[: int(sums[status.TRAPEZOIDS])].copy()
    return Overlap(sums[status.AREA_A], sums[status.AREA_B], sums[status.DIFFERENCE], found, True)


@kernel
def _together(a: Chains, b: Chains, segments_a: int) -> tuple[Floats, ShortInts]:
    """Levels and events of `a`, then those of `b`; chains and segments of `b` numbered after those of `a`."""
    levels = np.concatenate((a.levels, b.levels))
    events = np.concatenate((a.events, b.events))
    for k in range(len(a.events), len(events)):
        events[k, LEFT] += a.steps.size
        events[k, RIGHT] += a.steps.size
        events[k, LEFT_SEGMENT] += segments_a
        events[k, RIGHT_SEGMENT] += segments_a
    return levels, events


@kernel
def _steps(a: Ints, b: Ints) -> Ints:
    """Change (C, 2) of both winding numbers across the chains of both outlines."""
    steps = np.zeros((a.size + b.size, 2), np.int64)
    steps[: a.size, 0] = a
    steps[a.size :, 1] = b
    return steps


@kernel
def _with_room(difference: Floats, sums: Floats, n: int) -> Floats:
    """Trapezoids with room for all that one step of the sweep may add."""
    taken = int(sums[status.TRAPEZOIDS])
    needed = taken + TAKEN_AN_EDGE * (n + 2)
    if needed <= len(difference):
        return difference
    larger = np.empty((2 * needed, status.TRAPEZOID_COLUMNS))
    larger[:taken] = difference[:taken]
    return larger

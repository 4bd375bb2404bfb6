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
from ebamcheck.numeric.rings import Floats, Ints

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
    levels, events = _merged(a.chains, b.chains, len(a.segments))
    segments = np.concatenate((a.segments, b.segments))
    steps = _steps(a.chains.steps, b.chains.steps)
    edges = np.empty((len(steps), status.EDGE_COLUMNS))
    marks = np.empty((len(steps), status.MARK_COLUMNS), np.int64)
    sums = np.zeros(status.SUMS)
    sums[status.NEXT_CROSSING] = np.inf
    difference = np.empty((64 if wanted else 0, status.TRAPEZOID_COLUMNS))
    crossings, n = 0, 0
    # What most levels do stands here at length: a kernel that calls kernels pays reference counts for its tables.
    for k in range(levels.size):
        y = levels[k]
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
def _merged(a: Chains, b: Chains, segments_a: int) -> tuple[Floats, Ints]:
    """Levels and events of both outlines in one order; chains and segments of `b` numbered after those of `a`."""
    levels_a, levels_b, events_a, events_b = a.levels, b.levels, a.events, b.events
    count = levels_a.size + levels_b.size
    levels, events = np.empty(count), np.empty((count, 5), np.int64)
    chains_a = a.steps.size
    i, j = 0, 0
    for k in range(count):
        if j == levels_b.size or (i < levels_a.size and levels_a[i] <= levels_b[j]):
            levels[k] = levels_a[i]
            for c in range(5):
                events[k, c] = events_a[i, c]
            i += 1
        else:
            levels[k], events[k, 0] = levels_b[j], events_b[j, 0]
            for c in range(2):
                events[k, 1 + c] = events_b[j, 1 + c] + chains_a
                events[k, 3 + c] = events_b[j, 3 + c] + segments_a
            j += 1
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

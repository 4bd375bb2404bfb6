"""Closed rings as monotone chains of segments, and their vertices in the order in which a rising sweep line meets them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Floats, Ints, ShortInts

ADVANCE, OPEN, CLOSE = 0, 1, 2
"""Kinds of events: a chain continues with its next segment, two chains start, or two end."""

KIND, LEFT, RIGHT, LEFT_SEGMENT, RIGHT_SEGMENT = 0, 1, 2, 3, 4
"""Columns of events: kind; the chain, or the left and right one of two that start, or both that end; and
the segments with which these continue upwards, -1 for none."""

X_LOW, Y_LOW, X_HIGH, Y_HIGH, SLOPE = 0, 1, 2, 3, 4
"""Columns of `edges`: lower and upper end, mm, and change of x with y."""


class Chains(NamedTuple):
    """Vertices of closed rings from below, each with what happens there; level segments are left out.

    A chain is a run of segments of a ring that rises, or one that falls, taken from its lower end up.
    """

    levels: Floats
    """(E + 1,) y of each vertex, mm, in ascending order; infinite at the end."""
    events: ShortInts
    """(E + 1, 5) what happens at each, nothing in the last row; columns as above."""
    edges: Floats
    """(E + 1, 5) segment with which the chain, or the left one of two, goes on upwards; columns as above."""
    steps: Ints
    """(C,) change of the winding number where each chain is crossed from left to right."""


@kernel
def monotone_chains(segments: Floats, rings: Ints) -> Chains:
    """Chains of closed rings; `rings` tells where the segments of each start, and where the last ones end."""
    count = 0
    for s in range(rings[-1]):
        count += segments[s, 1] != segments[s, 3]
    levels, events, steps = np.empty(count), np.empty((count, 5), np.int32), np.empty(count, np.int64)
    count, chains = 0, 0
    for r in range(rings.size - 1):
        first = _turn(segments, rings[r], rings[r + 1])
        if first >= 0:
            count, chains = _follow(
                segments, rings[r], rings[r + 1], first, levels, events, steps, count, chains
            )
    order = rising_order(levels)
    rising, met = np.full(count + 1, np.inf), np.full((count + 1, 5), -1, np.int32)
    edges = np.zeros((count + 1, 5))
    for k in range(count):
        rising[k] = levels[order[k]]
        for c in range(5):
            met[k, c] = events[order[k], c]
        if met[k, LEFT_SEGMENT] >= 0:
            set_edge(edges, k, segments, met[k, LEFT_SEGMENT])
    return Chains(rising, met, edges, steps[:chains].copy())


@kernel
def set_edge(edges: Floats, k: int, segments: Floats, s: int) -> None:
    """Let edge `k` be segment `s`."""
    low, high = (0, 2) if segments[s, 3] > segments[s, 1] else (2, 0)
    x0, y0, x1, y1 = segments[s, low], segments[s, low + 1], segments[s, high], segments[s, high + 1]
    edges[k, X_LOW], edges[k, Y_LOW], edges[k, X_HIGH], edges[k, Y_HIGH] = x0, y0, x1, y1
    edges[k, SLOPE] = np.divide(x1 - x0, y1 - y0)


@kernel
def _follow(
    segments: Floats, start: int, stop: int, first: int, levels: Floats, events: ShortInts, steps: Ints,
    count: int, chains: int,
) -> tuple[int, int]:  # fmt: skip
    """Write the events of one ring from a segment on where it turns; new numbers of events and of chains."""
    opening = chain = chains
    steps[chain] = _step(segments, first)
    chains += 1
    before = first
    for k in range(1, stop - start + 1):
        s = start + (first - start + k) % (stop - start)
        if segments[s, 1] == segments[s, 3]:
            continue
        step = _step(segments, s)
        levels[count] = segments[s, 1]
        if step == _step(segments, before):
            _set_event(events, count, ADVANCE, chain, -1, s if step < 0 else before, -1)
        else:
            following = opening
            if k < stop - start:
                following = chains
                steps[chains] = step
                chains += 1
            if step > 0:
                _set_event(events, count, CLOSE, chain, following, -1, -1)
            elif _is_left(segments, s, before):
                _set_event(events, count, OPEN, following, chain, s, before)
            else:
                _set_event(events, count, OPEN, chain, following, before, s)
            chain = following
        before = s
        count += 1
    return count, chains


@kernel
def _step(segments: Floats, s: int) -> int:
    """Change of the winding number across a segment from left to right: -1 where it rises."""
    return -1 if segments[s, 3] > segments[s, 1] else 1


@kernel
def _set_event(
    events: ShortInts, k: int, kind: int, left: int, right: int, left_next: int, right_next: int
) -> None:
    """Write an event."""
    events[k, KIND], events[k, LEFT], events[k, RIGHT] = kind, left, right
    events[k, LEFT_SEGMENT], events[k, RIGHT_SEGMENT] = left_next, right_next


@kernel
def _turn(segments: Floats, start: int, stop: int) -> int:
    """First segment of a ring that rises after one that falls, or falls after one that rises; -1 for none."""
    before = stop - 1
    while before >= start and segments[before, 1] == segments[before, 3]:
        before -= 1
    for s in range(start, stop):
        if segments[s, 1] == segments[s, 3]:
            continue
        if (segments[s, 3] > segments[s, 1]) != (segments[before, 3] > segments[before, 1]):
            return s
        before = s
    return -1


@kernel
def _is_left(segments: Floats, s: int, before: int) -> bool:
    """Whether segment `s`, which rises, lies to the left of `before`, which falls, above the level of both."""
    if segments[s, 0] != segments[before, 2]:
        return bool(segments[s, 0] < segments[before, 2])
    ux, uy = segments[s, 2] - segments[s, 0], segments[s, 3] - segments[s, 1]
    vx, vy = segments[before, 0] - segments[before, 2], segments[before, 1] - segments[before, 3]
    return bool(ux * vy < vx * uy)


@kernel
def rising_order(values: Floats) -> Ints:
    """Stable ascending order: runs that rise or fall are found, then merged. Contours have few, but long ones."""
    order, borders, runs = _runs(values)
    spare = np.empty_like(order)
    while runs > 1:
        for run in range(0, runs, 2):
            a, b, c = borders[run], borders[min(run + 1, runs)], borders[min(run + 2, runs)]
            _merge(values, order, a, b, c, spare)
            borders[run // 2] = a
        runs = (runs + 1) // 2
        borders[runs] = values.size
        order, spare = spare, order
    return order


@kernel
def _runs(values: Floats) -> tuple[Ints, Ints, int]:
    """Places of values so that each run of them rises, where runs start and the last one ends, their number."""
    count = values.size
    order, borders = np.empty(count, np.int64), np.empty(count + 1, np.int64)
    runs, start = 0, 0
    while start < count:
        stop = start + 1
        if stop < count and values[stop] < values[start]:
            while stop < count and values[stop] < values[stop - 1]:
                stop += 1
            for k in range(start, stop):
                order[k] = start + stop - 1 - k
        else:
            while stop < count and values[stop] >= values[stop - 1]:
                stop += 1
            for k in range(start, stop):
                order[k] = k
        borders[runs] = start
        runs += 1
        start = stop
    borders[runs] = count
    return order, borders, runs


@kernel
def _merge(values: Floats, order: Ints, a: int, b: int, c: int, merged: Ints) -> None:
    """Merge the rising runs ``order[a:b]`` and ``order[b:c]`` into ``merged[a:c]``."""
    i, j = a, b
    for n in range(a, c):
        if j == c or (i < b and values[order[i]] <= values[order[j]]):
            merged[n] = order[i]
            i += 1
        else:
            merged[n] = order[j]
            j += 1

"""Distances between the contours of one layer: directed Hausdorff distance and 95th percentile.

The bounds used here follow from two facts: the distance from a fixed segment is a convex function, so over a piece of a
contour it is greatest at an end of the piece; and a chain of segments passes every place between its two ends.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ebamcheck.comparison.outline import Outline, distance_to_segment, nearest
from ebamcheck.kernels import kernel
from ebamcheck.rings import Floats, Ints

RESOLUTION_MM = 1e-7
"""Hausdorff distances are found to within this: ten thousand times finer than the default tolerance."""

PIECES = 512
"""A contour is cut into at least this many pieces of equal length; along each the distance is taken as
linear, which is exact while the nearest segment stays the same."""

PERCENTILE = 0.95

MOST_PIECES = 200_000
"""Pieces refined in one search at most; a count, so that results do not depend on the machine."""

LONGEST_CHAIN = 64
"""Segments between the nearest ones of a piece's two ends that are looked at at most: more is dearer than halving."""

STACK = 128
"""Pieces put aside in one search; each halving adds one, so float64 runs out of halves first."""


class Directed(NamedTuple):
    """Distance of one outline's contours from another's."""

    most_mm: float
    """Directed Hausdorff distance: the greatest distance of a point of the first from the second."""
    x_mm: float
    y_mm: float
    segment: int
    """Segment of the first outline on which that point lies; -1 where there is none."""
    p95_mm: float
    """Distance that 95 % of the first outline's length does not exceed."""


@kernel
def directed(a: Outline, b: Outline) -> Directed:
    """Distance of the contours of `a` from those of `b`; 0 if both are empty, infinite if one is."""
    if len(a.segments) == 0 or len(b.segments) == 0:
        apart = 0.0 if len(a.segments) == len(b.segments) else np.inf
        return Directed(apart, np.nan, np.nan, -1, apart)
    pieces, near, of_segment = _pieces(a, b)
    start, stop = pieces[:, 4], pieces[:, 5]
    k = int(np.argmax(stop))
    most, x, y, segment = stop[k], pieces[k, 2], pieces[k, 3], of_segment[k]
    if start.max() > most:
        k = int(np.argmax(start))
        most, x, y, segment = start[k], pieces[k, 0], pieces[k, 1], of_segment[k]
    segments = b.segments
    stack, near_stack = np.empty((STACK, 6)), np.empty((STACK, 2), np.int64)
    for k in range(len(pieces)):
        if _ceiling(segments, pieces, near, k) > most + RESOLUTION_MM:
            for c in range(6):
                stack[0, c] = pieces[k, c]
            near_stack[0, 0], near_stack[0, 1] = near[k, 0], near[k, 1]
            higher, hx, hy = _refine(b, stack, near_stack, most)
            if higher > most:
                most, x, y, segment = higher, hx, hy, of_segment[k]
    return Directed(most, x, y, segment, _percentile(pieces))


@kernel
def _pieces(a: Outline, b: Outline) -> tuple[Floats, Ints, Ints]:
    """Pieces of `a` (x0, y0, x1, y1, distance at each end, length), nearest segments of `b`, own segment."""
    segments, step = a.segments, a.length / PIECES
    count = 0
    cuts = np.empty(len(segments), np.int64)
    for s in range(len(segments)):
        x0, y0, x1, y1 = segments[s, 0], segments[s, 1], segments[s, 2], segments[s, 3]
        cuts[s] = max(1, math.ceil(math.hypot(x1 - x0, y1 - y0) / step)) if step > 0.0 else 1
        count += cuts[s]
    pieces = np.empty((count, 7))
    near = np.empty((count, 2), np.int64)
    of_segment = np.empty(count, np.int64)
    n = 0
    px, py, p_distance, p_near = np.nan, np.nan, np.inf, -1
    for s in range(len(segments)):
        x0, y0, x1, y1 = segments[s, 0], segments[s, 1], segments[s, 2], segments[s, 3]
        length = math.hypot(x1 - x0, y1 - y0) / cuts[s]
        if x0 != px or y0 != py:
            p_distance, p_near = nearest(b, x0, y0, p_near)
            px, py = x0, y0
        for j in range(1, cuts[s] + 1):
            t = j / cuts[s]
            x, y = (x0 + t * (x1 - x0), y0 + t * (y1 - y0)) if j < cuts[s] else (x1, y1)
            distance, found = nearest(b, x, y, p_near)
            pieces[n, 0], pieces[n, 1], pieces[n, 2], pieces[n, 3] = px, py, x, y
            pieces[n, 4], pieces[n, 5], pieces[n, 6] = p_distance, distance, length
            near[n, 0], near[n, 1] = p_near, found
            of_segment[n] = s
            n += 1
            px, py, p_distance, p_near = x, y, distance, found
    return pieces, near, of_segment


@kernel
def _ceiling(segments: Floats, pieces: Floats, near: Ints, k: int) -> float:
    """No point of piece `k` is farther than this from the segments (nearest ones at its two ends given)."""
    start, stop = pieces[k, 4], pieces[k, 5]
    if near[k, 0] == near[k, 1]:
        return float(max(start, stop))
    return min(_ceiling_of_two(segments, pieces, near, k), _ceiling_of_chain(segments, pieces, near, k))


@kernel
def _ceiling_of_chain(segments: Floats, pieces: Floats, near: Ints, k: int) -> float:
    """Bound by the segments from one nearest one to the other, where they follow each other.

    Seen square to the piece, that chain passes every place between the points nearest to the two ends, at most as
    far off as its farthest corner; and what lies before or behind it is no farther from those points than the ends.
    """
    first, last = min(near[k, 0], near[k, 1]), max(near[k, 0], near[k, 1])
    ux, uy = pieces[k, 2] - pieces[k, 0], pieces[k, 3] - pieces[k, 1]
    length = math.hypot(ux, uy)
    if last - first > LONGEST_CHAIN or not length > 0.0:
        return np.inf
    across = 0.0
    for i in range(first, last):
        x, y = segments[i, 2], segments[i, 3]
        if segments[i + 1, 0] != x or segments[i + 1, 1] != y:
            return np.inf
        across = max(across, abs(ux * (y - pieces[k, 1]) - uy * (x - pieces[k, 0])))
    return float(max(pieces[k, 4], pieces[k, 5], across / length))


@kernel
def _ceiling_of_two(segments: Floats, pieces: Floats, near: Ints, k: int) -> float:
    """Bound by the two nearest segments alone: on each the distance is convex."""
    start, stop = pieces[k, 4], pieces[k, 5]
    first_at_stop = distance_to_segment(pieces[k, 2], pieces[k, 3], segments, near[k, 0])
    last_at_start = distance_to_segment(pieces[k, 0], pieces[k, 1], segments, near[k, 1])
    mean = 0.5 * max(start + last_at_start, stop + first_at_stop)
    return float(min(max(start, first_at_stop), max(stop, last_at_start), mean))


@kernel
def _refine(b: Outline, stack: Floats, near: Ints, most: float) -> tuple[float, float, float]:
    """Greatest distance on the piece in row 0 of a stack if it is over `most`, by halving, with its place."""
    segments = b.segments
    count = 1
    x, y = np.nan, np.nan
    for _ in range(MOST_PIECES):
        if count == 0:
            break
        at = count - 1
        count -= 1
        if _ceiling(segments, stack, near, at) <= most + RESOLUTION_MM or count + 2 > len(stack):
            continue
        mx, my = 0.5 * (stack[at, 0] + stack[at, 2]), 0.5 * (stack[at, 1] + stack[at, 3])
        distance, middle = nearest(b, mx, my, near[at, 0])
        if distance > most:
            most, x, y = distance, mx, my
        stack[at + 1, 0], stack[at + 1, 1], stack[at + 1, 2], stack[at + 1, 3] = (
            mx,
            my,
            stack[at, 2],
            stack[at, 3],
        )
        stack[at + 1, 4], stack[at + 1, 5] = distance, stack[at, 5]
        stack[at, 2], stack[at, 3], stack[at, 5] = mx, my, distance
        near[at + 1, 0], near[at + 1, 1] = middle, near[at, 1]
        near[at, 1] = middle
        count += 2
    return most, x, y


@kernel
def _percentile(pieces: Floats) -> float:
    """Distance below which the given share of the length lies, the distance being linear along a piece."""
    count = len(pieces)
    low = np.empty(count)
    high = np.empty(count)
    weight = pieces[:, 6].copy()
    for k in range(count):
        low[k], high[k] = min(pieces[k, 4], pieces[k, 5]), max(pieces[k, 4], pieces[k, 5])
    wanted = PERCENTILE * weight.sum()
    bottom, top = low.min(), high.max()
    below = 0.0  # length known to lie under the bracket
    for _ in range(64):
        middle = 0.5 * (bottom + top)
        if not bottom < middle < top:
            break
        under = below
        for k in range(count):
            if high[k] <= middle:
                under += weight[k]
            elif low[k] < middle:
                under += weight[k] * (middle - low[k]) / (high[k] - low[k])
        if under >= wanted:
            top = middle
        else:
            bottom = middle
        kept = 0
        for k in range(count):
            if high[k] <= bottom:
                below += weight[k]
            elif low[k] < top:
                low[kept], high[kept], weight[kept] = low[k], high[k], weight[k]
                kept += 1
        count = kept
    return float(top)

"""Distances between the contours of one layer: directed Hausdorff distance and 95th percentile.

All bounds follow from one fact: the distance from a fixed segment is convex, so over a piece of a contour it is greatest at an end.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ebamcheck.comparison.outline import Outline
from ebamcheck.geometry.nearest import SegmentTree, distance_to_segment, nearest_segment, square_between
from ebamcheck.geometry.rings import EPSILON
from ebamcheck.kernels import Floats, Ints, kernel

RESOLUTION_MM = 1e-7  # resolution of Hausdorff distances: ten thousand times finer than the default tolerance
PERCENTILE = 0.95
MOST_PASSED = 8  # most vertices examined between the nearest segments at both ends of a piece; more are rare
MOST_PIECES = (
    200_000  # most pieces refined in one search; a count, not a time, so that results do not depend on the machine
)
STACK = 128  # size of the stack of pieces in one search; each halving adds one, so float64 runs out of halvings first


class Directed(NamedTuple):
    """Distance of one outline's contours from another's."""

    most_mm: float  # directed Hausdorff distance: the greatest distance of a point of the first from the second
    x_mm: float
    y_mm: float
    segment: int  # segment of the first outline on which that point lies; -1 where there is none
    p95_mm: float  # distance that 95 % of the first outline's length does not exceed
    near: Ints  # (M,) segment of the second outline nearest to each sample of the first; empty if there is none


@kernel
def directed(a: Outline, b: Outline) -> Directed:
    """Distance of the contours of `a` from those of `b`; 0 if both are empty, infinite if one is."""
    if len(a.segments) == 0 or len(b.segments) == 0:
        apart = 0.0 if len(a.segments) == len(b.segments) else np.inf
        return Directed(apart, np.nan, np.nan, -1, apart, np.empty(0, np.int64))
    places, lengths, owners = a.samples.places, a.samples.lengths, a.samples.segments
    segments = b.segments
    distances, near = np.empty(len(places)), np.empty(len(places), np.int64)
    found = len(segments) - 1
    for k in range(len(places)):
        square, found = nearest_segment(b.tree, places[k, 0], places[k, 1], found)
        distances[k], near[k] = math.sqrt(square), found
    k = int(np.argmax(distances))
    most, x, y, segment = distances[k], places[k, 0], places[k, 1], owners[k]
    least, sampled = distances[-1], most
    stack, near_stack = np.empty((STACK, 6)), np.empty((STACK, 2), np.int64)
    for k in range(len(distances) - 1):
        # Most pieces are settled by their ends: one nearest segment, or too short to rise over what is known;
        # the rest by the vertices that the nearest point passes on the way, of which there are mostly one or two.
        # These are looked at here and without branches: calls, and guesses at what is as good as random, cost more.
        reach, least = most + RESOLUTION_MM, min(least, distances[k])
        x0, y0, x1, y1 = places[k, 0], places[k, 1], places[k + 1, 0], places[k + 1, 1]
        i, j = min(near[k], near[k + 1]), max(near[k], near[k + 1])
        s = min(i + 1, j)
        few = (j - i <= 2) & (segments[s - 1, 2] == segments[s, 0]) & (segments[s - 1, 3] == segments[s, 1])
        few &= (segments[j - 1, 2] == segments[j, 0]) & (segments[j - 1, 3] == segments[j, 1])
        first = _square_to_piece(segments[s, 0], segments[s, 1], x0, y0, x1, y1)
        last = _square_to_piece(segments[j, 0], segments[j, 1], x0, y0, x1, y1)
        settled = (lengths[k] < 0.0) | (i == j) | (few & (max(first, last) <= reach * reach))
        if settled or 0.5 * (distances[k] + distances[k + 1] + lengths[k]) <= reach:
            continue
        if farthest_passed(segments, near[k], near[k + 1], x0, y0, x1, y1) <= reach:
            continue
        stack[0, 0], stack[0, 1], stack[0, 4] = places[k, 0], places[k, 1], distances[k]
        stack[0, 2], stack[0, 3], stack[0, 5] = places[k + 1, 0], places[k + 1, 1], distances[k + 1]
        near_stack[0, 0], near_stack[0, 1] = near[k], near[k + 1]
        higher, hx, hy = _refine(b.tree, stack, near_stack, most)
        if higher > most:
            most, x, y, segment = higher, hx, hy, owners[k]
    return Directed(most, x, y, segment, _percentile(distances, lengths, least, sampled), near)


@kernel
def farthest_passed(segments: Floats, i: int, j: int, x0: float, y0: float, x1: float, y1: float) -> float:
    """Greatest distance of the vertices between segments `i` and `j` from a piece; infinite where they are far apart.

    A piece whose ends are near `i` and `j` is nowhere farther from the contour between than this, or than its ends: link each of its
    points to one that runs along that contour and passes each vertex when the other is nearest to it; between two vertices the length
    of the link is convex.
    """
    low, high = min(i, j), max(i, j)
    if high - low > MOST_PASSED:
        return np.inf
    square = 0.0
    for s in range(low + 1, high + 1):
        x, y = segments[s, 0], segments[s, 1]
        if segments[s - 1, 2] != x or segments[s - 1, 3] != y:
            return np.inf
        square = max(square, square_between(x, y, x0, y0, x1, y1))
    return math.sqrt(square)


@kernel
def _square_to_piece(x: float, y: float, x0: float, y0: float, x1: float, y1: float) -> float:
    """Square of the distance of (x, y) from a piece, up to rounding: one way for all places, and so without a branch."""
    ux, uy, px, py = x1 - x0, y1 - y0, x - x0, y - y0
    t = min(max(np.divide(px * ux + py * uy, ux * ux + uy * uy), 0.0), 1.0)
    px, py = px - t * ux, py - t * uy
    return float(px * px + py * py)


@kernel
def _refine(tree: SegmentTree, stack: Floats, near: Ints, most: float) -> tuple[float, float, float]:
    """Greatest distance, if over `most`, and its place on a piece, by halving: rows hold both ends and distances, `near` segments."""
    segments = tree.segments
    count = 1
    x, y = np.nan, np.nan
    for _ in range(MOST_PIECES):
        if count == 0:
            break
        at = count - 1
        count -= 1
        x0, y0, x1, y1 = stack[at, 0], stack[at, 1], stack[at, 2], stack[at, 3]
        start, stop, i, j = stack[at, 4], stack[at, 5], near[at, 0], near[at, 1]
        ceiling = max(start, stop)
        if i != j:
            first, last = distance_to_segment(x1, y1, segments, i), distance_to_segment(x0, y0, segments, j)
            passed = max(ceiling, farthest_passed(segments, i, j, x0, y0, x1, y1))
            mean = 0.5 * max(start + last, stop + first)
            ceiling = min(max(start, first), max(stop, last), mean, passed)
        if ceiling <= most + RESOLUTION_MM or count + 2 > len(stack):
            continue
        mx, my = 0.5 * (x0 + x1), 0.5 * (y0 + y1)
        square, middle = nearest_segment(tree, mx, my, i)
        distance = math.sqrt(square)
        if distance > most:
            most, x, y = distance, mx, my
        stack[at + 1, 0], stack[at + 1, 1], stack[at + 1, 2], stack[at + 1, 3] = mx, my, x1, y1
        stack[at + 1, 4], stack[at + 1, 5] = distance, stop
        stack[at, 2], stack[at, 3], stack[at, 5] = mx, my, distance
        near[at + 1, 0], near[at + 1, 1], near[at, 1] = middle, j, middle
        count += 2
    return most, x, y


@kernel
def _percentile(distances: Floats, lengths: Floats, least: float, most: float) -> float:
    """95th percentile of the distance, which is linear along a piece.

    A bracket from the least to the greatest distance is halved until the length below a distance in it grows at one rate.
    """
    bottom, top = least, most
    low, high, weight = np.empty(distances.size), np.empty(distances.size), np.empty(distances.size)
    total, count = 0.0, 0
    for k in range(distances.size - 1):
        if lengths[k] >= 0.0:
            low[count], high[count] = min(distances[k], distances[k + 1]), max(distances[k], distances[k + 1])
            weight[count] = lengths[k]
            total, count = total + lengths[k], count + 1
    wanted = PERCENTILE * total
    # Sums of the same lengths in another order differ by less than this; nearer to what is wanted they are added in one order.
    doubt = 4.0 * EPSILON * distances.size * total
    # Length below the bracket, and its rise with the distance within, of pieces that have no end in it; of the others, how
    # many there are and how much of them is below the middle.
    below, rate, first = 0.0, 0.0, True
    while True:
        # Pieces without an end in the bracket are dropped; of the others the length below its middle is added up, to rounding.
        # Without a branch: where a piece lies is as good as random.
        more, steeper, half, kept = 0.0, 0.0, 0.0, 0
        middle = 0.5 * (bottom + top)
        for k in range(count):
            start, stop, length = low[k], high[k], weight[k]
            low[kept], high[kept], weight[kept] = start, stop, length
            rise = length / (stop - start)
            is_under, is_over = stop <= bottom, start >= top
            across = (start <= bottom) & (stop >= top) & (not is_under)
            stays = not (is_under | is_over | across)
            under = rise * (bottom - start) if across else 0.0
            more += length if is_under else under
            steeper += rise if across else 0.0
            lower = length if stop <= middle else rise * (middle - start)
            half += lower if stays & (start <= middle) else 0.0
            kept += stays
        below, rate, count = below + more, rate + steeper, kept
        if first and below >= wanted:
            return float(bottom)
        first = False
        if count == 0:
            return float(min(bottom + (wanted - below) / rate, top)) if rate > 0.0 else float(top)
        if not bottom < middle < top:
            return float(top)
        under = below + rate * (middle - bottom)
        if abs(under + half - wanted) > doubt:
            under += half
        else:
            for k in range(count):
                if high[k] <= middle:
                    under += weight[k]
                elif low[k] < middle:
                    under += weight[k] * (middle - low[k]) / (high[k] - low[k])
        if under >= wanted:
            top = middle
        else:
            below += rate * (middle - bottom)
            bottom = middle

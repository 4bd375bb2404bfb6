"""The contours of one layer prepared for measuring: segments, a tree over them, samples along them, sweep events.

Outlines that are measured against each other share one origin near the part, so that parts far from zero keep their digits.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ebamcheck.geometry.nearest import SegmentTree, tree_over
from ebamcheck.geometry.rings import EPSILON, stable_order
from ebamcheck.kernels import Bools, Floats, Ints, ShortInts, kernel
from ebamcheck.layers.stack import Layers

# Least number of equal pieces into which a contour is divided; along each the distance is taken as linear, which is a good
# approximation while the nearest segment stays the same
PIECES = 512

# Kinds of events: a chain continues with its next segment, two chains start, or two end
ADVANCE, OPEN, CLOSE = 0, 1, 2
# Columns of `events`: kind; the chain, or the left and right one of two that start or end; the segments with which these
# continue upwards, -1 for none
KIND, LEFT, RIGHT, LEFT_SEGMENT, RIGHT_SEGMENT = 0, 1, 2, 3, 4
# Columns of `edges`: lower and upper end, mm, and change of x with y
X_LOW, Y_LOW, X_HIGH, Y_HIGH, SLOPE = 0, 1, 2, 3, 4


class Samples(NamedTuple):
    """Both ends of every segment, and places between on long segments, path after path; a ring ends at its first place again."""

    places: Floats  # (M, 2) mm
    lengths: Floats  # (M,) length of the piece from each sample to the next, mm; -1 at the end of a path
    segments: Ints  # (M,) segment on which that piece lies; at the end of a path, the last segment


class Chains(NamedTuple):
    """Vertices of closed rings from below, with the event at each, without level segments.

    A chain is a run of segments of a ring that rises, or one that falls, taken from its lower end up.
    """

    levels: Floats  # (E + 1,) y of each vertex, mm, in ascending order; infinite at the end
    events: ShortInts  # (E + 1, 5) event at each, none in the last row; columns as above
    edges: Floats  # (E + 1, 5) segment with which the chain, or the left one of two, goes on upwards; columns as above
    steps: Ints  # (C,) change of the winding number where each chain is crossed from left to right


class Outline(NamedTuple):
    """The contours of one layer, mm, from a shared origin."""

    segments: Floats  # (S, 4) x0, y0, x1, y1 in the order of the contours; those of closed rings come first
    paths: Ints  # (P + 1,) first segment of each path
    rings: int  # number of closed rings, which are the first paths; the rest are open
    tree: SegmentTree
    samples: Samples  # places along the contours at which distances are taken
    chains: Chains  # closed rings in the order in which a rising sweep line meets them


def outline(layers: Layers, layer: int, origin_mm: tuple[float, float]) -> Outline:
    """Prepare one layer of a stack for measuring, in coordinates from `origin_mm`."""
    r0, r1 = int(layers.layer_starts[layer]), int(layers.layer_starts[layer + 1])
    starts = layers.ring_starts[r0 : r1 + 1]
    points = layers.points[starts[0] : starts[-1]]
    return _outline(points, starts - starts[0], layers.closed[r0:r1], origin_mm[0], origin_mm[1])


@kernel
def winding(segments: Floats, x: float, y: float) -> int:
    """Winding number of closed segments about (x, y), in whatever order they lie."""
    total = 0
    for i in range(len(segments)):
        if (segments[i, 1] <= y) == (segments[i, 3] <= y):
            continue
        low, high = (0, 2) if segments[i, 1] <= y else (2, 0)
        across = (segments[i, high] - segments[i, low]) * (y - segments[i, low + 1])
        across -= (x - segments[i, low]) * (segments[i, high + 1] - segments[i, low + 1])
        if across < 0.0:
            total += -1 if low == 0 else 1
    return total


@kernel
def windings(segments: Floats, places: Floats) -> Ints:
    """Winding number of closed segments about each of some places (N, 2)."""
    found = np.zeros(len(places), np.int64)
    for i in range(len(places)):
        found[i] = winding(segments, places[i, 0], places[i, 1])
    return found


@kernel
def _outline(points: Floats, starts: Ints, closed: Bools, x_mm: float, y_mm: float) -> Outline:
    """Build an outline from the rings of one layer: closed ones first, without the points inside straight runs."""
    most = 0.0  # the size of the coordinates decides which points lie on a straight run, to rounding
    for i in range(len(points)):
        most = max(most, abs(points[i, 0]), abs(points[i, 1]))
    tolerance = 4.0 * EPSILON * max(most, abs(x_mm) + abs(y_mm))
    written = np.empty((len(points), 4))
    paths = np.zeros(starts.size, np.int64)
    count, path, rings = 0, 0, 0
    for want_closed in (True, False):
        for r in range(starts.size - 1):
            a, b = starts[r], starts[r + 1]
            if closed[r] != want_closed or b - a < 2:
                continue
            x, y = points[a, 0], points[a, 1]
            last = b if want_closed else b - 1
            for i in range(a + 1, last + 1):
                k = i if i < b else a
                bx, by = points[k, 0], points[k, 1]
                if i < last:
                    # A point is left out where it lies on the way straight from the one before to the next.
                    n = i + 1 if i + 1 < b else a
                    cx, cy = points[n, 0], points[n, 1]
                    ux, uy, vx, vy = bx - x, by - y, cx - bx, cy - by
                    across, wx, wy = ux * vy - uy * vx, cx - x, cy - y
                    if ux * vx + uy * vy > 0.0 and across * across <= tolerance * tolerance * (wx * wx + wy * wy):
                        continue
                written[count, 0], written[count, 1], written[count, 2], written[count, 3] = x, y, bx, by
                count += 1
                x, y = bx, by
            path += 1
            paths[path] = count
        if want_closed:
            rings = path
    segments = written[:count].copy()
    for i in range(count):
        for k in range(2):
            segments[i, 2 * k] -= x_mm
            segments[i, 2 * k + 1] -= y_mm
    paths = paths[: path + 1].copy()
    chains = monotone_chains(segments, paths[: rings + 1])
    return Outline(segments, paths, rings, tree_over(segments), samples_along(segments, paths), chains)


@kernel
def samples_along(segments: Floats, paths: Ints) -> Samples:
    """Cut segments (S, 4), `paths` telling where those of each path start, into pieces."""
    extents = np.empty(len(segments))
    total = 0.0
    for s in range(len(segments)):
        ux, uy = segments[s, 2] - segments[s, 0], segments[s, 3] - segments[s, 1]
        extents[s] = math.sqrt(ux * ux + uy * uy)
        total += extents[s]
    step = total / PIECES
    pieces, count = np.ones(len(segments), np.int64), paths.size - 1
    for s in range(len(segments)):
        if step > 0.0:
            pieces[s] = max(1, math.ceil(extents[s] / step))
        count += pieces[s]
    places, lengths, owners = np.empty((count, 2)), np.empty(count), np.empty(count, np.int64)
    n = 0
    for p in range(paths.size - 1):
        for s in range(paths[p], paths[p + 1]):
            x0, y0, x1, y1 = segments[s, 0], segments[s, 1], segments[s, 2], segments[s, 3]
            for j in range(pieces[s]):
                t = j / pieces[s]
                places[n, 0], places[n, 1] = x0 + t * (x1 - x0), y0 + t * (y1 - y0)
                lengths[n], owners[n] = extents[s] / pieces[s], s
                n += 1
        s = paths[p + 1] - 1
        places[n, 0], places[n, 1] = segments[s, 2], segments[s, 3]
        lengths[n], owners[n] = -1.0, s
        n += 1
    return Samples(places, lengths, owners)


# -- Rings as chains, and their vertices in the order in which a rising sweep line meets them ------------------


@kernel
def monotone_chains(segments: Floats, rings: Ints) -> Chains:
    """Chains of closed rings; `rings` tells where the segments of each start, and where the last ones end."""
    count = 0
    for s in range(rings[-1]):
        count += segments[s, 1] != segments[s, 3]
    levels, events, steps = np.empty(count), np.empty((count, 5), np.int32), np.empty(count, np.int64)
    count, chains = 0, 0
    for r in range(rings.size - 1):
        start, stop = rings[r], rings[r + 1]
        before = stop - 1
        while before >= start and segments[before, 1] == segments[before, 3]:
            before -= 1
        for s in range(start, stop):
            if segments[s, 1] == segments[s, 3]:
                continue
            if (segments[s, 3] > segments[s, 1]) != (segments[before, 3] > segments[before, 1]):
                count, chains = _follow(segments, start, stop, s, levels, events, steps, count, chains)
                break
            before = s
    order = stable_order(levels)
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
    # Across a segment that rises, the winding number changes by -1 from left to right.
    last = steps[chain] = -1 if segments[first, 3] > segments[first, 1] else 1
    chains += 1
    before = first
    for k in range(1, stop - start + 1):
        s = start + (first - start + k) % (stop - start)
        if segments[s, 1] == segments[s, 3]:
            continue
        step = -1 if segments[s, 3] > segments[s, 1] else 1
        levels[count] = segments[s, 1]
        kind, left, right, left_next, right_next = ADVANCE, chain, -1, s if step < 0 else before, -1
        if step != last:
            following = opening
            if k < stop - start:
                following = chains
                steps[chains] = step
                chains += 1
            kind, left, right, left_next = CLOSE, chain, following, -1
            if step < 0:
                # Which of the two lies to the left above the level of both: the one that rises, or the one that falls.
                ux, uy = segments[s, 2] - segments[s, 0], segments[s, 3] - segments[s, 1]
                vx, vy = segments[before, 0] - segments[before, 2], segments[before, 1] - segments[before, 3]
                apart = segments[s, 0] - segments[before, 2]
                kind, left_next, right_next = OPEN, before, s
                if apart < 0.0 or (apart == 0.0 and ux * vy < vx * uy):
                    left, right, left_next, right_next = following, chain, s, before
            chain = following
        events[count, KIND], events[count, LEFT], events[count, RIGHT] = kind, left, right
        events[count, LEFT_SEGMENT], events[count, RIGHT_SEGMENT] = left_next, right_next
        before, last = s, step
        count += 1
    return count, chains

"""The contours of one layer prepared for measuring: segments, a tree over them, samples along them, sweep events.

A layer is prepared once and then measured against any number of others. All outlines that are measured
against each other share one origin near the part, so that parts far from zero keep their digits.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ebamcheck.comparison.chains import Chains, monotone_chains
from ebamcheck.geometry.nearest import SegmentTree, tree_over
from ebamcheck.layers.stack import Layers
from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import EPSILON, Bools, Floats, Ints

ROUNDING = 4.0 * EPSILON
"""Deviation, relative to the largest coordinate, below which a point on a straight run is dropped."""


class Outline(NamedTuple):
    """The contours of one layer, mm, from a shared origin."""

    segments: Floats
    """(S, 4) ``x0, y0, x1, y1`` in the order of the contours; those of closed rings come first."""
    paths: Ints
    """(P + 1,) first segment of each path."""
    rings: int
    """Number of closed rings, which are the first paths; the rest are open."""
    tree: SegmentTree
    """Segments by boxes."""
    samples: Samples
    """Places along the contours at which distances are taken."""
    chains: Chains
    """Closed rings in the order in which a rising sweep line meets them."""


def outline(layers: Layers, layer: int, origin_mm: tuple[float, float]) -> Outline:
    """Prepare one layer of a stack for measuring, in coordinates from `origin_mm`."""
    r0, r1 = int(layers.layer_starts[layer]), int(layers.layer_starts[layer + 1])
    starts = layers.ring_starts[r0 : r1 + 1]
    points = layers.points[starts[0] : starts[-1]]
    return _outline(points, starts - starts[0], layers.closed[r0:r1], origin_mm[0], origin_mm[1])


@kernel
def encloses(o: Outline) -> bool:
    """Whether any closed ring of an outline has an extent, so that it may bound a region."""
    return len(o.chains.steps) > 0


@kernel
def winding(o: Outline, x: float, y: float) -> int:
    """Winding number of the closed rings of an outline about (x, y)."""
    total = 0
    for i in range(o.paths[o.rings]):
        total += _turn(o.segments, i, x, y)
    return total


@kernel
def windings(o: Outline, x0: float, y0: float, x1: float, y1: float) -> tuple[int, int]:
    """Winding numbers about two points, in one pass over the segments."""
    first, second = 0, 0
    for i in range(o.paths[o.rings]):
        first += _turn(o.segments, i, x0, y0)
        second += _turn(o.segments, i, x1, y1)
    return first, second


@kernel
def _turn(segments: Floats, i: int, x: float, y: float) -> int:
    """What segment `i` adds to the winding number about (x, y)."""
    if (segments[i, 1] <= y) == (segments[i, 3] <= y):
        return 0
    low, high = (0, 2) if segments[i, 1] <= y else (2, 0)
    across = (segments[i, high] - segments[i, low]) * (y - segments[i, low + 1])
    across -= (x - segments[i, low]) * (segments[i, high + 1] - segments[i, low + 1])
    if across < 0.0:
        return -1 if low == 0 else 1
    return 0


@kernel
def _outline(points: Floats, starts: Ints, closed: Bools, x_mm: float, y_mm: float) -> Outline:
    """Build an outline from the rings of one layer."""
    segments, paths, rings = _segments(points, starts, closed, x_mm, y_mm)
    return Outline(
        segments,
        paths,
        rings,
        tree_over(segments),
        samples_along(segments, paths),
        monotone_chains(segments, paths[: rings + 1]),
    )


@kernel
def _segments(
    points: Floats, starts: Ints, closed: Bools, x_mm: float, y_mm: float
) -> tuple[Floats, Ints, int]:
    """Segments of all paths without the points inside straight runs, closed rings first; where paths start."""
    tolerance = ROUNDING * _largest(points, x_mm, y_mm)
    segments = np.empty((len(points), 4))
    paths = np.zeros(starts.size, np.int64)
    count, path, rings = 0, 0, 0
    for want_closed in (True, False):
        for r in range(starts.size - 1):
            a, b = starts[r], starts[r + 1]
            if closed[r] != want_closed or b - a < 2:
                continue
            count = _straightened(points, a, b, want_closed, tolerance, segments, count)
            path += 1
            paths[path] = count
        if want_closed:
            rings = path
    kept = segments[:count].copy()
    for i in range(count):
        kept[i, 0] -= x_mm
        kept[i, 1] -= y_mm
        kept[i, 2] -= x_mm
        kept[i, 3] -= y_mm
    return kept, paths[: path + 1].copy(), rings


@kernel
def _largest(points: Floats, x_mm: float, y_mm: float) -> float:
    """Size of the coordinates, whose spacing decides what is straight."""
    most = 0.0
    for i in range(len(points)):
        most = max(most, abs(points[i, 0]), abs(points[i, 1]))
    return float(max(most, abs(x_mm) + abs(y_mm)))


@kernel
def _straightened(
    points: Floats, a: int, b: int, is_closed: bool, tolerance: float, segments: Floats, count: int
) -> int:
    """Write the segments of path ``[a, b)`` after the first `count`; their new number."""
    x, y = points[a, 0], points[a, 1]
    last = b if is_closed else b - 1
    for i in range(a + 1, last + 1):
        k = i if i < b else a
        if i < last:
            n = i + 1 if i + 1 < b else a
            if _is_between(x, y, points[k, 0], points[k, 1], points[n, 0], points[n, 1], tolerance):
                continue
        segments[count, 0], segments[count, 1] = x, y
        segments[count, 2], segments[count, 3] = points[k, 0], points[k, 1]
        count += 1
        x, y = points[k, 0], points[k, 1]
    return count


@kernel
def _is_between(ax: float, ay: float, bx: float, by: float, cx: float, cy: float, tolerance: float) -> bool:
    """Whether b lies on the way straight from a to c, within the rounding of the coordinates."""
    ux, uy, vx, vy = bx - ax, by - ay, cx - bx, cy - by
    if ux * vx + uy * vy <= 0.0:
        return False
    across, wx, wy = ux * vy - uy * vx, cx - ax, cy - ay
    return bool(across * across <= tolerance * tolerance * (wx * wx + wy * wy))


# -- Samples: places along contours at which distances are taken -----------------------------------------------


PIECES = 512
"""Least number of equal pieces into which a contour is divided; along each the distance is taken as
linear, which is a good approximation while the nearest segment stays the same."""


class Samples(NamedTuple):
    """Both ends of every segment, and places between on long segments, path after path.

    A closed ring ends where it starts, with a sample of its own.
    """

    places: Floats
    """(M, 2) mm."""
    lengths: Floats
    """(M,) length of the piece from each sample to the next, mm; -1 at the end of a path."""
    segments: Ints
    """(M,) segment on which that piece lies; at the end of a path, the last segment."""


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
    count = paths.size - 1
    for s in range(len(segments)):
        count += _pieces(extents[s], step)
    places, lengths, owners = np.empty((count, 2)), np.empty(count), np.empty(count, np.int64)
    n = 0
    for p in range(paths.size - 1):
        for s in range(paths[p], paths[p + 1]):
            pieces = _pieces(extents[s], step)
            x0, y0, x1, y1 = segments[s, 0], segments[s, 1], segments[s, 2], segments[s, 3]
            for j in range(pieces):
                t = j / pieces
                places[n, 0], places[n, 1] = x0 + t * (x1 - x0), y0 + t * (y1 - y0)
                lengths[n], owners[n] = extents[s] / pieces, s
                n += 1
        s = paths[p + 1] - 1
        places[n, 0], places[n, 1] = segments[s, 2], segments[s, 3]
        lengths[n], owners[n] = -1.0, s
        n += 1
    return Samples(places, lengths, owners)


@kernel
def _pieces(length: float, step: float) -> int:
    """Pieces into which a segment is cut."""
    return max(1, math.ceil(length / step)) if step > 0.0 else 1

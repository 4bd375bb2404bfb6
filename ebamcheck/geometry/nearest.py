"""Nearest segment: a search through a tree of boxes around runs of segments, for one place or many.

Segments that follow one another along rings lie near each other, so that a tree over runs of them is built in one pass,
in their own order; and the answer for one place is a good guess for the next.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ebamcheck.kernels import Floats, Ints, kernel

if TYPE_CHECKING:
    # Loaded only where there are geometries; most commands make none.
    from shapely.geometry.base import BaseGeometry

SEGMENTS_A_LEAF = 4  # segments in one leaf of the tree
MOST_LEVELS = 64  # depth of the largest tree that memory could hold, and so the most nodes a search has waiting


class SegmentTree(NamedTuple):
    """Segments with a tree of boxes around runs of them.

    The tree is binary and complete: node k has the children 2 k and 2 k + 1, the root is 1, and the
    second half of the nodes are the leaves in the order of the segments.
    """

    segments: Floats  # (n, 4) x0, y0, x1, y1
    boxes: Floats  # (nodes, 4) xmin, ymin, xmax, ymax; inverted for a node without segments
    waiting: Ints  # working memory for the nodes still to visit; so one search at a time


class Nearest(NamedTuple):
    """The point of the segments nearest to a place."""

    distance: float
    segment: int
    t: float  # place along the segment, 0 .. 1


def segments_of(lines: BaseGeometry) -> Floats:
    """Segments (n, 4) of lines: x0, y0, x1, y1 of every two points that follow one another."""
    import shapely

    points, line = shapely.get_coordinates(shapely.get_parts(lines), return_index=True)
    joined = np.flatnonzero(line[1:] == line[:-1])
    return np.hstack([points[joined], points[joined + 1]])


@kernel
def segments_along(points: Floats, closed: bool) -> Floats:
    """Segments (n, 4) of a polyline, with the one back to its first point if it is closed."""
    count = len(points) if closed else len(points) - 1
    result = np.empty((count, 4))
    for i in range(count):
        k = i + 1 if i + 1 < len(points) else 0
        result[i, 0], result[i, 1] = points[i, 0], points[i, 1]
        result[i, 2], result[i, 3] = points[k, 0], points[k, 1]
    return result


@kernel
def tree_over(segments: Floats) -> SegmentTree:
    """Box segments (n, 4)."""
    leaves = 1
    while leaves * SEGMENTS_A_LEAF < len(segments):
        leaves *= 2
    boxes = np.empty((2 * leaves, 4))
    for node in range(len(boxes)):
        for axis in range(2):
            boxes[node, axis], boxes[node, axis + 2] = np.inf, -np.inf
    for i in range(len(segments)):
        node = leaves + i // SEGMENTS_A_LEAF
        for axis in range(2):
            a, b = segments[i, axis], segments[i, axis + 2]
            boxes[node, axis] = min(boxes[node, axis], a, b)
            boxes[node, axis + 2] = max(boxes[node, axis + 2], a, b)
    for k in range(leaves - 1, 0, -1):
        for axis in range(2):
            boxes[k, axis] = min(boxes[2 * k, axis], boxes[2 * k + 1, axis])
            boxes[k, axis + 2] = max(boxes[2 * k, axis + 2], boxes[2 * k + 1, axis + 2])
    return SegmentTree(segments, boxes, np.empty(MOST_LEVELS, np.int64))


@kernel
def nearest_segment(tree: SegmentTree, x: float, y: float, guess: int) -> tuple[float, int]:
    """Square of the distance of (x, y) from the nearest segment, and which one that is; infinite and -1 where there are none.

    From the leaf of the guess, a segment thought to be near, the search climbs to the root, and looks into what lies
    beside its way: near a good guess that is one box a level, and nearly none is opened.
    """
    segments, boxes, waiting = tree
    if len(segments) == 0:
        return np.inf, -1
    leaves, found = len(boxes) // 2, max(guess, 0)
    best = square_between(x, y, segments[found, 0], segments[found, 1], segments[found, 2], segments[found, 3])
    node = leaves + found // SEGMENTS_A_LEAF
    waiting[0], count = node, 1
    while True:
        while count > 0:
            count -= 1
            at = waiting[count]
            if at < leaves:
                left, right = _box_square(boxes, 2 * at, x, y), _box_square(boxes, 2 * at + 1, x, y)
                near, far = (2 * at, 2 * at + 1) if left <= right else (2 * at + 1, 2 * at)
                if max(left, right) < best:
                    waiting[count] = far
                    count += 1
                if min(left, right) < best:
                    waiting[count] = near
                    count += 1
                continue
            first = (at - leaves) * SEGMENTS_A_LEAF
            for i in range(first, min(first + SEGMENTS_A_LEAF, len(segments))):
                square = square_between(x, y, segments[i, 0], segments[i, 1], segments[i, 2], segments[i, 3])
                found = i if square < best else found
                best = min(best, square)
        while node > 1 and not _box_square(boxes, node ^ 1, x, y) < best:
            node >>= 1
        if node <= 1:
            return best, found
        waiting[0], count = node ^ 1, 1
        node >>= 1


@kernel
def nearest(tree: SegmentTree, x: float, y: float, guess: int) -> Nearest:
    """Nearest point of one segment or more to (x, y); `guess` is a segment thought to be near, which saves time."""
    _, i = nearest_segment(tree, x, y, guess)
    segments = tree.segments
    ux, uy = segments[i, 2] - segments[i, 0], segments[i, 3] - segments[i, 1]
    px, py = x - segments[i, 0], y - segments[i, 1]
    square = ux * ux + uy * uy
    t = (px * ux + py * uy) / square if square > 0.0 else 0.0
    t = min(max(t, 0.0), 1.0)
    return Nearest(math.hypot(px - t * ux, py - t * uy), i, t)


@kernel
def distances(places: Floats, segments: Floats) -> Floats:
    """Distance (n,) of places (n, 2) from the nearest of segments (m, 4), as GEOS reckons it; infinite where there is none."""
    tree = tree_over(segments)
    result = np.full(len(places), np.inf)
    guess = len(segments) - 1
    for n in range(len(places)):
        x, y = places[n, 0], places[n, 1]
        _, guess = nearest_segment(tree, x, y, guess)
        if guess < 0:
            break
        # In the steps of GEOS (``Distance::pointToSegment``), to the last bit.
        x0, y0, x1, y1 = segments[guess, 0], segments[guess, 1], segments[guess, 2], segments[guess, 3]
        dx, dy = x1 - x0, y1 - y0
        square = dx * dx + dy * dy
        along = ((x - x0) * dx + (y - y0) * dy) / square if square > 0.0 else 0.0
        if along <= 0.0:
            result[n] = math.sqrt((x - x0) * (x - x0) + (y - y0) * (y - y0))
        elif along >= 1.0:
            result[n] = math.sqrt((x - x1) * (x - x1) + (y - y1) * (y - y1))
        else:
            across = ((y0 - y) * dx - (x0 - x) * dy) / square
            result[n] = abs(across) * math.sqrt(square)
    return result


@kernel
def signed_distance(tree: SegmentTree, x: float, y: float, at: Nearest) -> float:
    """Distance of (x, y) from a closed ring, positive on the right of its direction of travel.

    Solid lies on the left of every ring, so that a positive distance means metal too much. At a vertex
    the side is that of the sum of the normals of its two segments, which is the true one (Baerentzen
    and Aanaes 2005).
    """
    segments, i = tree.segments, at.segment
    qx = segments[i, 0] + at.t * (segments[i, 2] - segments[i, 0])
    qy = segments[i, 1] + at.t * (segments[i, 3] - segments[i, 1])
    other = i
    if at.t <= 0.0:
        other = i - 1 if i > 0 else len(segments) - 1
    elif at.t >= 1.0:
        other = i + 1 if i + 1 < len(segments) else 0
    nx = ny = 0.0
    for k in (i, other):
        ux, uy = segments[k, 2] - segments[k, 0], segments[k, 3] - segments[k, 1]
        length = math.hypot(ux, uy)
        if length > 0.0:
            nx, ny = nx + uy / length, ny - ux / length
    side = (x - qx) * nx + (y - qy) * ny
    return float(at.distance if side >= 0.0 else -at.distance)


@kernel
def square_between(x: float, y: float, ax: float, ay: float, bx: float, by: float) -> float:
    """Square of the distance of (x, y) from the segment from a to b."""
    # All three are found and one is taken: which one it is cannot be foretold, and a wrong guess costs more.
    ux, uy, px, py = bx - ax, by - ay, x - ax, y - ay
    along, square, across = px * ux + py * uy, ux * ux + uy * uy, px * uy - py * ux
    qx, qy = px - ux, py - uy
    beyond = np.divide(across * across, square) if along < square else qx * qx + qy * qy
    return float(beyond if along > 0.0 else px * px + py * py)


@kernel
def distance_to_segment(x: float, y: float, segments: Floats, i: int) -> float:
    """Distance of (x, y) from segment `i`."""
    return math.sqrt(square_between(x, y, segments[i, 0], segments[i, 1], segments[i, 2], segments[i, 3]))


@kernel
def _box_square(boxes: Floats, node: int, x: float, y: float) -> float:
    """Square of the distance from the box of a node."""
    # The row of a node as an array of its own would be counted as one that is in use, at more than all the rest.
    dx = max(boxes[node, 0] - x, x - boxes[node, 2], 0.0)
    dy = max(boxes[node, 1] - y, y - boxes[node, 3], 0.0)
    return float(dx * dx + dy * dy)

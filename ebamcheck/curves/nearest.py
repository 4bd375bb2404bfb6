"""Nearest point of a ring: a search through a tree of boxes around runs of its segments."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Floats, Ints

MOST_LEVELS = 64
"""Depth of the largest tree that memory could hold, and so the most nodes a search has waiting."""

ROUNDING = 1e-12
"""Bound on the relative error of a squared distance; the actual error is far smaller."""

SEGMENTS_A_LEAF = 4
"""Segments in one leaf of the tree."""


class BoxedRing(NamedTuple):
    """A polyline with a tree of boxes around runs of its consecutive segments.

    The tree is binary and complete: node k has the children 2 k and 2 k + 1, the root is 1, and the
    second half of the nodes are the leaves in the order of the segments.
    """

    points: Floats
    """(n + 1, 2) ends of the n segments; a closed ring repeats its first point."""
    boxes: Floats
    """(nodes, 4) xmin, ymin, xmax, ymax; inverted for a node without segments."""
    stack: Ints
    """Working memory for the nodes still to visit; so one search at a time."""


class Nearest(NamedTuple):
    """The point of a ring nearest to a place."""

    distance: float
    segment: int
    t: float
    """Place along the segment, 0 .. 1."""


@kernel
def boxed(points: Floats) -> BoxedRing:
    """Box the segments of a polyline (n + 1, 2) with n >= 1."""
    segments = len(points) - 1
    leaves = 1
    while leaves * SEGMENTS_A_LEAF < segments:
        leaves *= 2
    boxes = np.empty((2 * leaves, 4))
    boxes[:, :2] = np.inf
    boxes[:, 2:] = -np.inf
    for i in range(segments):
        box = boxes[leaves + i // SEGMENTS_A_LEAF]
        for k in range(i, i + 2):
            x, y = points[k, 0], points[k, 1]
            box[0], box[1] = min(box[0], x), min(box[1], y)
            box[2], box[3] = max(box[2], x), max(box[3], y)
    for k in range(leaves - 1, 0, -1):
        for axis in range(2):
            boxes[k, axis] = min(boxes[2 * k, axis], boxes[2 * k + 1, axis])
            boxes[k, axis + 2] = max(boxes[2 * k, axis + 2], boxes[2 * k + 1, axis + 2])
    return BoxedRing(points, boxes, np.empty(MOST_LEVELS, dtype=np.int64))


@kernel
def closed_points(points: Floats, closed: bool) -> Floats:
    """Points of a ring with its first one repeated at the end if it is closed."""
    n = len(points)
    result = np.empty((n + 1 if closed else n, 2))
    result[:n] = points
    if closed:
        result[n] = points[0]
    return result


@kernel
def _on_segment(points: Floats, i: int, x: float, y: float, best: Nearest) -> Nearest:
    """The nearer of what is known and the nearest point of a segment."""
    ux, uy = points[i + 1, 0] - points[i, 0], points[i + 1, 1] - points[i, 1]
    px, py = x - points[i, 0], y - points[i, 1]
    square = ux * ux + uy * uy
    t = np.true_divide(px * ux + py * uy, square) if square > 0.0 else 0.0
    t = min(max(t, 0.0), 1.0)
    dx, dy = px - t * ux, py - t * uy
    # The exact distance takes far longer than its square, which tells nearly always that it is not asked for.
    if dx * dx + dy * dy > best.distance * best.distance * (1.0 + ROUNDING):
        return best
    distance = math.hypot(dx, dy)
    return Nearest(distance, i, t) if distance < best.distance else best


@kernel
def _box_distance(boxes: Floats, node: int, x: float, y: float) -> float:
    """Square of the distance from the box of a node."""
    # The row of a node as an array of its own would be counted as one that is in use, at more than all the rest.
    dx = max(boxes[node, 0] - x, x - boxes[node, 2], 0.0)
    dy = max(boxes[node, 1] - y, y - boxes[node, 3], 0.0)
    return float(dx * dx + dy * dy)


@kernel
def nearest(ring: BoxedRing, x: float, y: float, guess: int) -> Nearest:
    """Nearest point of `ring` to (x, y); `guess` is a segment thought to be near, which saves time.

    From the leaf of the guess the search climbs to the root, and looks into what lies beside its way: near a good guess
    that is one box a level, and nearly none is opened.
    """
    points, boxes = ring.points, ring.boxes
    node = len(boxes) // 2 + guess // SEGMENTS_A_LEAF
    best = _nearer(ring, node, x, y, _on_segment(points, guess, x, y, Nearest(np.inf, guess, 0.0)))
    while node > 1:
        if _box_distance(boxes, node ^ 1, x, y) < best.distance * best.distance:
            best = _nearer(ring, node ^ 1, x, y, best)
        node >>= 1
    return best


@kernel
def _nearer(ring: BoxedRing, root: int, x: float, y: float, best: Nearest) -> Nearest:
    """The nearer of what is known and what lies in a branch of the tree."""
    points, boxes, stack = ring.points, ring.boxes, ring.stack
    segments, leaves = len(points) - 1, len(boxes) // 2
    most = best.distance * best.distance
    stack[0] = root
    waiting = 1
    while waiting > 0:
        waiting -= 1
        node = stack[waiting]
        if _box_distance(boxes, node, x, y) >= most:
            continue
        if node < leaves:
            left = _box_distance(boxes, 2 * node, x, y)
            nearer = 2 * node if left <= _box_distance(boxes, 2 * node + 1, x, y) else 2 * node + 1
            stack[waiting], stack[waiting + 1] = nearer ^ 1, nearer
            waiting += 2
            continue
        first = (node - leaves) * SEGMENTS_A_LEAF
        for i in range(first, min(first + SEGMENTS_A_LEAF, segments)):
            best = _on_segment(points, i, x, y, best)
        most = best.distance * best.distance
    return best


@kernel
def signed_distance(ring: BoxedRing, x: float, y: float, at: Nearest) -> float:
    """Distance of (x, y) from the ring, positive on the right of its direction of travel.

    Solid lies on the left of every ring, so that a positive distance means metal too much. At a vertex
    the side is that of the sum of the normals of its two segments, which is the true one (Baerentzen
    and Aanaes 2005).
    """
    points = ring.points
    segments = len(points) - 1
    i = at.segment
    ax, ay = _unit_normal(points, i)
    qx = points[i, 0] + at.t * (points[i + 1, 0] - points[i, 0])
    qy = points[i, 1] + at.t * (points[i + 1, 1] - points[i, 1])
    other = i
    if at.t <= 0.0:
        other = i - 1 if i > 0 else segments - 1
    elif at.t >= 1.0:
        other = i + 1 if i + 1 < segments else 0
    bx, by = _unit_normal(points, other)
    side = (x - qx) * (ax + bx) + (y - qy) * (ay + by)
    return float(at.distance if side >= 0.0 else -at.distance)


@kernel
def _unit_normal(points: Floats, i: int) -> tuple[float, float]:
    """Unit normal to the right of segment `i`; (0, 0) for one without length."""
    ux, uy = points[i + 1, 0] - points[i, 0], points[i + 1, 1] - points[i, 1]
    length = math.hypot(ux, uy)
    if length == 0.0:
        return 0.0, 0.0
    return uy / length, -ux / length

"""Nearest point of a ring: a search through a tree of boxes around runs of its segments."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Floats, Ints

MOST_LEVELS = 64
"""Depth of the largest tree that memory could hold, and so the most nodes a search has waiting."""

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
    """(nodes, 4) xmin, ymin, xmax, ymax; of a node without segments, turned inside out."""
    stack: Ints
    """Room for the nodes that a search still has to see; one search at a time."""


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
def _on_segment(points: Floats, i: int, x: float, y: float) -> Nearest:
    ux, uy = points[i + 1, 0] - points[i, 0], points[i + 1, 1] - points[i, 1]
    px, py = x - points[i, 0], y - points[i, 1]
    square = ux * ux + uy * uy
    t = (px * ux + py * uy) / square if square > 0.0 else 0.0
    t = min(max(t, 0.0), 1.0)
    return Nearest(math.hypot(px - t * ux, py - t * uy), i, t)


@kernel
def _box_distance(box: Floats, x: float, y: float) -> float:
    dx = max(box[0] - x, x - box[2], 0.0)
    dy = max(box[1] - y, y - box[3], 0.0)
    return float(dx * dx + dy * dy)


@kernel
def nearest(ring: BoxedRing, x: float, y: float, guess: int) -> Nearest:
    """Nearest point of `ring` to (x, y); `guess` is a segment thought to be near, which saves time."""
    segments = len(ring.points) - 1
    leaves = len(ring.boxes) // 2
    best = _on_segment(ring.points, guess, x, y)
    ring.stack[0] = 1
    waiting = 1
    while waiting > 0:
        waiting -= 1
        node = ring.stack[waiting]
        if _box_distance(ring.boxes[node], x, y) >= best.distance * best.distance:
            continue
        if node < leaves:
            left_first = _box_distance(ring.boxes[2 * node], x, y) <= _box_distance(
                ring.boxes[2 * node + 1], x, y
            )
            ring.stack[waiting] = 2 * node + 1 if left_first else 2 * node
            ring.stack[waiting + 1] = 2 * node if left_first else 2 * node + 1
            waiting += 2
            continue
        first = (node - leaves) * SEGMENTS_A_LEAF
        for i in range(first, min(first + SEGMENTS_A_LEAF, segments)):
            found = _on_segment(ring.points, i, x, y)
            if found.distance < best.distance:
                best = found
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

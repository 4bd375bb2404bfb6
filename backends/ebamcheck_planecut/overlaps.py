"""Layers with winding numbers other than 0 and 1: those whose rings meet, or are nested wrongly.

A tree of boxes over runs of segments finds whether any two meet within a reach. A run that is monotone in x and in y does not meet
itself, nor do two consecutive runs that are monotone in the same directions. Where no rings meet, their nesting decides.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ebamcheck.geometry.rings import signed_area
from ebamcheck.kernels import Bools, Floats, Ints, ShortInts, kernel

CLEAN, NESTED_WRONG, TOUCHING = 0, 1, 2

# Segments of a leaf: with fewer, the tree costs more than it saves; with more, overlapping leaves do
SEGMENTS_A_LEAF = 8

LEFT, RIGHT, DOWN, UP = 1, 2, 4, 8  # directions of segments, as bits
SEVERAL_RINGS = -1


class OverlapSearch(NamedTuple):
    """Working memory to examine the rings of one layer: node 1 of the tree is its root, 2 n and 2 n + 1 are below node n."""

    boxes: Floats  # (2 M, 4) xmin, ymin, xmax, ymax of each node; leaf l is node M + l
    ways: NDArray[np.uint8]  # (2 M,) directions of the segments of each node
    ring: ShortInts  # (2 M,) ring of each node, or `SEVERAL_RINGS`
    first: (
        Ints  # (M + 1,) first segment of each leaf, by the row of its first point; the leaf ends where the next begins
    )
    stack: ShortInts  # pairs of nodes waiting to be tested, and whether one follows the other along its ring
    # Segments that come this near to each other meet: what rounding may have moved them apart
    reach_mm: float
    outward: Ints  # (R,) +1 for an outer ring, -1 for a hole
    first_leaf: Ints  # (R,) first leaf of each ring
    greatest_x: Floats  # (R,) right end of each ring
    around: Ints  # (R,) rings that may enclose the one examined
    keep: Bools  # (R,) whether a ring separates solid from void


@kernel
def overlap_search(points: int, reach_mm: float) -> OverlapSearch:
    """Room for layers of so many points, whose rings touch where they come within a reach of each other."""
    # The smallest rings are triangles, of one leaf each.
    leaves = 1
    while leaves < points // 3 + points // SEGMENTS_A_LEAF + 1:
        leaves *= 2
    boxes, ways, ring = (
        np.empty((2 * leaves, 4)),
        np.empty(2 * leaves, np.uint8),
        np.empty(2 * leaves, np.int32),
    )
    first = np.empty(leaves + 1, np.int64)
    # Under three pairs wait per level of two nodes, and levels are under 64.
    stack = np.empty((512, 3), np.int32)
    outward, first_leaf, around = (
        np.empty(points, np.int64),
        np.empty(points, np.int64),
        np.empty(points, np.int64),
    )
    greatest_x, keep = np.empty(points), np.empty(points, np.bool_)
    return OverlapSearch(boxes, ways, ring, first, stack, reach_mm, outward, first_leaf, greatest_x, around, keep)


@kernel
def classify_layer(points: Floats, ring_starts: Ints, closed: Bools, a: int, b: int, search: OverlapSearch) -> int:
    """Class of the layer with the rings ``[a, b)`` of a stack in canonical form: clean, nested wrongly, or with rings that touch
    or cross. Unless they touch, `keep` of `search`, which has room for its points, is written for its rings."""
    if a == b:
        return CLEAN
    leaves = _grow(search, points, ring_starts, closed, a, b)
    if _touching(search, leaves, points, ring_starts):
        return TOUCHING
    leaf = 0
    for r in range(a, b):
        if not closed[r]:
            continue
        first, stop = ring_starts[r], ring_starts[r + 1]
        search.outward[r - a] = 1 if signed_area(points, first, stop) > 0.0 else -1
        search.first_leaf[r - a] = leaf
        greatest = -np.inf
        for _ in range(first, stop, SEGMENTS_A_LEAF):
            greatest = max(greatest, search.boxes[leaves + leaf, 2])
            leaf += 1
        search.greatest_x[r - a] = greatest
    return CLEAN if _all_kept(points, ring_starts, closed, a, b, search, leaves) else NESTED_WRONG


@kernel
def _grow(search: OverlapSearch, points: Floats, ring_starts: Ints, closed: Bools, a: int, b: int) -> int:
    """Build the tree over the closed rings ``[a, b)``; returns the number M of its leaves, empty ones included."""
    boxes, ways, ring = search.boxes, search.ways, search.ring
    used = 0
    for r in range(a, b):
        if closed[r]:
            used += (ring_starts[r + 1] - ring_starts[r] + SEGMENTS_A_LEAF - 1) // SEGMENTS_A_LEAF
    leaves = 1
    while leaves < used:
        leaves *= 2
    node = leaves
    for r in range(a, b):
        if not closed[r]:
            continue
        for first in range(ring_starts[r], ring_starts[r + 1], SEGMENTS_A_LEAF):
            stop = min(first + SEGMENTS_A_LEAF, ring_starts[r + 1])
            end = stop if stop < ring_starts[r + 1] else ring_starts[r]
            x, y = points[end, 0], points[end, 1]
            xmin, ymin, xmax, ymax = x, y, x, y
            way = 0
            for i in range(stop - 1, first - 1, -1):
                px, py = points[i, 0], points[i, 1]
                xmin, xmax = min(xmin, px), max(xmax, px)
                ymin, ymax = min(ymin, py), max(ymax, py)
                way |= LEFT * (x < px) | RIGHT * (x > px) | DOWN * (y < py) | UP * (y > py)
                x, y = px, py
            boxes[node, 0], boxes[node, 1], boxes[node, 2], boxes[node, 3] = xmin, ymin, xmax, ymax
            search.first[node - leaves], ring[node], ways[node] = first, r, way
            node += 1
    for empty in range(node, 2 * leaves):
        ring[empty], ways[empty] = SEVERAL_RINGS, 0
        boxes[empty, 0] = boxes[empty, 1] = np.inf
        boxes[empty, 2] = boxes[empty, 3] = -np.inf
    for n in range(leaves - 1, 0, -1):
        c, d = 2 * n, 2 * n + 1
        boxes[n, 0], boxes[n, 1] = min(boxes[c, 0], boxes[d, 0]), min(boxes[c, 1], boxes[d, 1])
        boxes[n, 2], boxes[n, 3] = max(boxes[c, 2], boxes[d, 2]), max(boxes[c, 3], boxes[d, 3])
        ring[n] = ring[c] if ring[c] == ring[d] else SEVERAL_RINGS
        ways[n] = ways[c] | ways[d] if ring[n] != SEVERAL_RINGS else LEFT | RIGHT | DOWN | UP
    return leaves


@kernel
def _touching(search: OverlapSearch, leaves: int, points: Floats, ring_starts: Ints) -> bool:
    """Whether two segments of the tree meet elsewhere than where one follows the other."""
    boxes, ways, ring, stack, reach_mm = search.boxes, search.ways, search.ring, search.stack, search.reach_mm
    stack[0, 0], stack[0, 1], stack[0, 2] = 1, 1, 0
    waiting = 1
    while waiting > 0:
        waiting -= 1
        a, b = int(np.int64(stack[waiting, 0])), int(np.int64(stack[waiting, 1]))
        behind = int(np.int64(stack[waiting, 2]))
        if a != b and (
            boxes[b, 0] - boxes[a, 2] > reach_mm
            or boxes[a, 0] - boxes[b, 2] > reach_mm
            or boxes[b, 1] - boxes[a, 3] > reach_mm
            or boxes[a, 1] - boxes[b, 3] > reach_mm
        ):
            continue
        if a == b or (behind and ring[a] == ring[b]):
            way = ways[a] | ways[b]
            if way & (LEFT | RIGHT) != LEFT | RIGHT and way & (DOWN | UP) != DOWN | UP:
                continue  # monotone in x and in y
        if a >= leaves and b >= leaves:
            if _leaves_meet(search, leaves, a, b, points, ring_starts):
                return True
            continue
        if a == b:
            stack[waiting, 0], stack[waiting, 1], stack[waiting, 2] = 2 * a, 2 * a + 1, 1
            waiting += 1
            halves = (2 * a, 2 * a, 0), (2 * a + 1, 2 * a + 1, 0)
        elif b >= leaves or (
            a < leaves
            and boxes[a, 2] - boxes[a, 0] + boxes[a, 3] - boxes[a, 1]
            >= boxes[b, 2] - boxes[b, 0] + boxes[b, 3] - boxes[b, 1]
        ):
            halves = (2 * a, b, 0), (2 * a + 1, b, behind)
        else:
            halves = (a, 2 * b, behind), (a, 2 * b + 1, 0)
        for one, other, follows in halves:
            stack[waiting, 0], stack[waiting, 1], stack[waiting, 2] = one, other, follows
            waiting += 1
    return False


@kernel
def _leaves_meet(search: OverlapSearch, leaves: int, a: int, b: int, points: Floats, ring_starts: Ints) -> bool:
    """Whether a segment of leaf `b` meets one of leaf `a`, which is the same or stands before it."""
    boxes, reach_mm = search.boxes, search.reach_mm
    first_a, end_a = search.first[a - leaves], ring_starts[search.ring[a] + 1]
    stop_a = min(first_a + SEGMENTS_A_LEAF, end_a)
    first_b, end_b = search.first[b - leaves], ring_starts[search.ring[b] + 1]
    stop_b = min(first_b + SEGMENTS_A_LEAF, end_b)
    for i in range(first_b, stop_b):
        j = i + 1 if i + 1 < end_b else ring_starts[search.ring[b]]
        if (
            boxes[a, 0] - max(points[i, 0], points[j, 0]) > reach_mm
            or min(points[i, 0], points[j, 0]) - boxes[a, 2] > reach_mm
            or boxes[a, 1] - max(points[i, 1], points[j, 1]) > reach_mm
            or min(points[i, 1], points[j, 1]) - boxes[a, 3] > reach_mm
        ):
            continue
        for k in range(first_a, min(stop_a, i) if a == b else stop_a):
            after = k + 1 if k + 1 < end_a else ring_starts[search.ring[a]]
            if after != i and j != k and _meet(points, i, j, k, after, reach_mm):
                return True
    return False


@kernel
def _meet(points: Floats, a: int, b: int, c: int, d: int, reach_mm: float) -> bool:
    """Whether segments ab and cd come within the reach of each other."""
    if (
        min(points[c, 0], points[d, 0]) - max(points[a, 0], points[b, 0]) > reach_mm
        or min(points[a, 0], points[b, 0]) - max(points[c, 0], points[d, 0]) > reach_mm
        or min(points[c, 1], points[d, 1]) - max(points[a, 1], points[b, 1]) > reach_mm
        or min(points[a, 1], points[b, 1]) - max(points[c, 1], points[d, 1]) > reach_mm
    ):
        return False
    apart = False
    for i, j, k, m in ((a, b, c, d), (c, d, a, b)):
        along_x, along_y = points[j, 0] - points[i, 0], points[j, 1] - points[i, 1]
        p = along_x * (points[k, 1] - points[i, 1]) - (points[k, 0] - points[i, 0]) * along_y
        q = along_x * (points[m, 1] - points[i, 1]) - (points[m, 0] - points[i, 0]) * along_y
        apart = apart or (p > 0.0 and q > 0.0) or (p < 0.0 and q < 0.0)
    if not apart:
        return True
    if reach_mm == 0.0:
        return False
    # Segments that do not cross are nearest at an end of one of them.
    for i, j, k in ((a, b, c), (a, b, d), (c, d, a), (c, d, b)):
        along_x, along_y = points[j, 0] - points[i, 0], points[j, 1] - points[i, 1]
        x, y = points[k, 0] - points[i, 0], points[k, 1] - points[i, 1]
        square = along_x * along_x + along_y * along_y
        t = min(max((x * along_x + y * along_y) / square, 0.0), 1.0) if square > 0.0 else 0.0
        if (x - t * along_x) ** 2 + (y - t * along_y) ** 2 <= reach_mm * reach_mm:
            return True
    return False


@kernel
def _all_kept(
    points: Floats, ring_starts: Ints, closed: Bools, a: int, b: int, search: OverlapSearch, leaves: int
) -> bool:
    """Find which of the rings ``[a, b)``, which do not touch, separate solid from void; those around one begin left of it."""
    result = True
    count, following = 0, a
    for r in range(a, b):
        search.keep[r - a] = True
        if not closed[r]:
            continue
        x, y = points[ring_starts[r], 0], points[ring_starts[r], 1]
        while following < b and points[ring_starts[following], 0] <= x:
            if closed[following]:
                search.around[count] = following
                count += 1
            following += 1
        kept, outside = 0, 0
        for n in range(count):
            s = search.around[n]
            if search.greatest_x[s - a] < x:
                continue
            search.around[kept] = s
            kept += 1
            if s != r and _encloses(search, leaves + search.first_leaf[s - a], points, ring_starts, s, x, y):
                outside += search.outward[s - a]
        count = kept
        if (outside > 0) == (outside + search.outward[r - a] > 0):
            search.keep[r - a] = False
            result = False
    return result


@kernel
def _encloses(search: OverlapSearch, leaf: int, points: Floats, ring_starts: Ints, r: int, x: float, y: float) -> bool:
    """Whether (x, y) lies inside ring `r`, whose leaves begin at node `leaf`; on its boundary it does not."""
    inside = False
    for i in range(ring_starts[r], ring_starts[r + 1], SEGMENTS_A_LEAF):
        if search.boxes[leaf, 1] <= y <= search.boxes[leaf, 3]:
            for k in range(i, min(i + SEGMENTS_A_LEAF, ring_starts[r + 1])):
                after = k + 1 if k + 1 < ring_starts[r + 1] else ring_starts[r]
                xi, yi, xj, yj = points[after, 0], points[after, 1], points[k, 0], points[k, 1]
                if (yi > y) != (yj > y):
                    side = (xj - xi) * (y - yi) - (x - xi) * (yj - yi)
                    if side == 0.0:
                        return False
                    inside = inside != ((side > 0.0) == (yj > yi))
                elif yi == y and (xi == x or (yj == y and (xi > x) != (xj > x))):
                    return False
        leaf += 1
    return inside


def kept_rings(points: Floats, ring_starts: Ints, closed: Bools) -> Bools:
    """Tell which rings of one layer, which do not touch, separate solid from void (R,); open paths are kept."""
    search = overlap_search(points.shape[0], 0.0)
    classify_layer(points, ring_starts, closed, 0, closed.size, search)
    return search.keep[: closed.size]

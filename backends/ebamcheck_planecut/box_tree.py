"""A tree of boxes over the segments of one layer, to find whether any two of them meet within a reach.

Leaves are short runs of consecutive segments; inner nodes join neighbours. A run that is monotone in x and in y does not
meet itself; nor do two consecutive runs that are monotone in the same directions. A contour rarely reverses in x or y, so only
a small part of it remains to be tested.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import INSIDE, ON_BOUNDARY, OUTSIDE, Bools, Floats, Ints

SEGMENTS_A_LEAF = 8
"""Segments of a leaf: with fewer, the tree costs more than it saves; with more, overlapping leaves do."""

LARGEST_STACK = 512
"""Most pairs of nodes waiting to be tested: fewer than three per level of two nodes, with fewer than 64 levels."""

LEFT, RIGHT, DOWN, UP = 1, 2, 4, 8
"""Directions of segments, as bits; a run that goes both left and right, or both down and up, is not monotone."""

ALL_WAYS = LEFT | RIGHT | DOWN | UP

SEVERAL = -1
"""In place of the ring of a node that holds segments of several rings."""


class BoxTree(NamedTuple):
    """Working memory for the tree of one layer: node 1 is the root, the children of node n are 2 n and 2 n + 1."""

    boxes: Floats
    """(2 M, 4) xmin, ymin, xmax, ymax of each node; leaf l is node M + l."""
    ways: NDArray[np.uint8]
    """(2 M,) directions of the segments of each node."""
    ring: NDArray[np.int32]
    """(2 M,) ring of each node, or :data:`SEVERAL`."""
    first: Ints
    """(M + 1,) first segment of each leaf, by the row of its first point; the leaf ends where the next begins."""
    stack: NDArray[np.int32]
    """Pairs of nodes waiting to be tested, and whether one follows the other along its ring."""
    reach_mm: float
    """Segments that come this near to each other meet: what rounding may have moved them apart."""


@kernel
def box_tree(points: int, reach_mm: float) -> BoxTree:
    """Room for the tree over closed rings that have so many points together, and how near segments meet."""
    # The smallest rings are triangles, of one leaf each.
    leaves = _power_of_two(points // 3 + points // SEGMENTS_A_LEAF + 1)
    return BoxTree(
        np.empty((2 * leaves, 4)),
        np.empty(2 * leaves, np.uint8),
        np.empty(2 * leaves, np.int32),
        np.empty(leaves + 1, np.int64),
        np.empty((LARGEST_STACK, 3), np.int32),
        reach_mm,
    )


@kernel
def _power_of_two(count: int) -> int:
    """Least power of two that is not under `count`."""
    result = 1
    while result < count:
        result *= 2
    return result


@kernel
def grow(tree: BoxTree, points: Floats, ring_starts: Ints, closed: Bools, a: int, b: int) -> int:
    """Build the tree over the closed rings ``[a, b)``; returns the number M of its leaves, empty ones included."""
    used = 0
    for r in range(a, b):
        if closed[r]:
            used += (ring_starts[r + 1] - ring_starts[r] + SEGMENTS_A_LEAF - 1) // SEGMENTS_A_LEAF
    leaves = _power_of_two(max(used, 1))
    leaf = 0
    for r in range(a, b):
        if closed[r]:
            for i in range(ring_starts[r], ring_starts[r + 1], SEGMENTS_A_LEAF):
                stop = min(i + SEGMENTS_A_LEAF, ring_starts[r + 1])
                tree.first[leaf] = i
                tree.ring[leaves + leaf] = r
                _fill_leaf(
                    tree,
                    points,
                    i,
                    stop,
                    stop if stop < ring_starts[r + 1] else ring_starts[r],
                    leaves + leaf,
                )
                leaf += 1
    for node in range(leaves + used, 2 * leaves):
        tree.ring[node] = SEVERAL
        tree.ways[node] = 0
        tree.boxes[node, 0] = tree.boxes[node, 1] = np.inf
        tree.boxes[node, 2] = tree.boxes[node, 3] = -np.inf
    for node in range(leaves - 1, 0, -1):
        _join(tree, node)
    return leaves


@kernel
def _fill_leaf(tree: BoxTree, points: Floats, first: int, stop: int, end: int, node: int) -> None:
    """Box and ways of the segments that begin at the rows ``[first, stop)``, the last of which ends at row `end`."""
    x, y = points[end, 0], points[end, 1]
    xmin, ymin, xmax, ymax = x, y, x, y
    ways = 0
    for i in range(stop - 1, first - 1, -1):
        px, py = points[i, 0], points[i, 1]
        xmin, xmax = min(xmin, px), max(xmax, px)
        ymin, ymax = min(ymin, py), max(ymax, py)
        ways |= LEFT * (x < px) | RIGHT * (x > px) | DOWN * (y < py) | UP * (y > py)
        x, y = px, py
    tree.boxes[node, 0], tree.boxes[node, 1], tree.boxes[node, 2], tree.boxes[node, 3] = (
        xmin,
        ymin,
        xmax,
        ymax,
    )
    tree.ways[node] = ways


@kernel
def _join(tree: BoxTree, node: int) -> None:
    """Make an inner node of the two below it."""
    boxes, a, b = tree.boxes, 2 * node, 2 * node + 1
    boxes[node, 0] = min(boxes[a, 0], boxes[b, 0])
    boxes[node, 1] = min(boxes[a, 1], boxes[b, 1])
    boxes[node, 2] = max(boxes[a, 2], boxes[b, 2])
    boxes[node, 3] = max(boxes[a, 3], boxes[b, 3])
    tree.ring[node] = tree.ring[a] if tree.ring[a] == tree.ring[b] else SEVERAL
    tree.ways[node] = tree.ways[a] | tree.ways[b] if tree.ring[node] != SEVERAL else ALL_WAYS


@kernel
def _turns(ways: int) -> bool:
    """Whether segments that run in these ways turn around in x or in y."""
    return (ways & (LEFT | RIGHT)) == (LEFT | RIGHT) or (ways & (DOWN | UP)) == (DOWN | UP)


@kernel
def _apart(boxes: Floats, a: int, b: int, reach_mm: float) -> bool:
    """Whether the boxes of two nodes are farther apart than the reach."""
    return bool(
        boxes[b, 0] - boxes[a, 2] > reach_mm
        or boxes[a, 0] - boxes[b, 2] > reach_mm
        or boxes[b, 1] - boxes[a, 3] > reach_mm
        or boxes[a, 1] - boxes[b, 3] > reach_mm
    )


@kernel
def touching(tree: BoxTree, leaves: int, points: Floats, ring_starts: Ints) -> bool:
    """Whether two segments of the tree meet elsewhere than where one follows the other.

    Parameters
    ----------
    tree, leaves
        As :func:`grow` left it, and what it returned.
    points, ring_starts
        Of the stack that the layer is of.
    """
    stack = tree.stack
    stack[0, 0] = stack[0, 1] = 1
    stack[0, 2] = 0
    waiting = 1
    while waiting > 0:
        waiting -= 1
        a, b, behind = stack[waiting, 0], stack[waiting, 1], stack[waiting, 2]
        if a == b:
            if not _turns(tree.ways[a]):
                continue
            if a >= leaves:
                if _leaf_meets_itself(tree, leaves, a, points, ring_starts):
                    return True
                continue
            waiting = _push(stack, waiting, 2 * a, 2 * a + 1, 1)
            waiting = _push(stack, waiting, 2 * a, 2 * a, 0)
            waiting = _push(stack, waiting, 2 * a + 1, 2 * a + 1, 0)
            continue
        if _apart(tree.boxes, a, b, tree.reach_mm):
            continue
        if behind and tree.ring[a] == tree.ring[b] and not _turns(tree.ways[a] | tree.ways[b]):
            continue
        if a >= leaves and b >= leaves:
            if _leaves_meet(tree, leaves, a, b, points, ring_starts):
                return True
        elif b >= leaves or (a < leaves and _extent(tree.boxes, a) >= _extent(tree.boxes, b)):
            waiting = _push(stack, waiting, 2 * a, b, 0)
            waiting = _push(stack, waiting, 2 * a + 1, b, behind)
        else:
            waiting = _push(stack, waiting, a, 2 * b, behind)
            waiting = _push(stack, waiting, a, 2 * b + 1, 0)
    return False


@kernel
def _push(stack: NDArray[np.int32], waiting: int, a: int, b: int, behind: int) -> int:
    stack[waiting, 0], stack[waiting, 1], stack[waiting, 2] = a, b, behind
    return waiting + 1


@kernel
def _extent(boxes: Floats, node: int) -> float:
    extent: float = boxes[node, 2] - boxes[node, 0] + boxes[node, 3] - boxes[node, 1]
    return extent


@kernel
def _rows(tree: BoxTree, leaves: int, node: int, ring_starts: Ints) -> tuple[int, int, int]:
    """Rows ``[first, stop)`` at which the segments of a leaf begin, and the row at which the last one ends."""
    first, r = tree.first[node - leaves], tree.ring[node]
    stop = min(first + SEGMENTS_A_LEAF, ring_starts[r + 1])
    return first, stop, stop if stop < ring_starts[r + 1] else ring_starts[r]


@kernel
def _leaf_meets_itself(tree: BoxTree, leaves: int, node: int, points: Floats, ring_starts: Ints) -> bool:
    first, stop, end = _rows(tree, leaves, node, ring_starts)
    for i in range(first + 2, stop):
        j = i + 1 if i + 1 < stop else end
        for k in range(first, i - 1):
            if j != k and _meet(points, i, j, k, k + 1, tree.reach_mm):
                return True
    return False


@kernel
def _leaves_meet(tree: BoxTree, leaves: int, a: int, b: int, points: Floats, ring_starts: Ints) -> bool:
    """Whether a segment of leaf `b` meets one of leaf `a`, which stands before it."""
    first_a, stop_a, end_a = _rows(tree, leaves, a, ring_starts)
    first_b, stop_b, end_b = _rows(tree, leaves, b, ring_starts)
    for i in range(first_b, stop_b):
        j = i + 1 if i + 1 < stop_b else end_b
        if _beside(points, i, j, tree.boxes, a, tree.reach_mm):
            continue
        for k in range(first_a, stop_a):
            after = k + 1 if k + 1 < stop_a else end_a
            if after != i and j != k and _meet(points, i, j, k, after, tree.reach_mm):
                return True
    return False


@kernel
def _beside(points: Floats, i: int, j: int, boxes: Floats, node: int, reach_mm: float) -> bool:
    """Whether the box of segment ij is farther from that of a node than the reach."""
    return bool(
        boxes[node, 0] - max(points[i, 0], points[j, 0]) > reach_mm
        or min(points[i, 0], points[j, 0]) - boxes[node, 2] > reach_mm
        or boxes[node, 1] - max(points[i, 1], points[j, 1]) > reach_mm
        or min(points[i, 1], points[j, 1]) - boxes[node, 3] > reach_mm
    )


@kernel
def _side(points: Floats, i: int, j: int, k: int) -> float:
    """Twice the signed area of the triangle of points i, j, k."""
    along_x, along_y = points[j, 0] - points[i, 0], points[j, 1] - points[i, 1]
    result: float = along_x * (points[k, 1] - points[i, 1]) - (points[k, 0] - points[i, 0]) * along_y
    return result


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
    # Segments that do not cross are nearest at an end of one of them.
    return _cross(points, a, b, c, d) or (
        reach_mm > 0.0
        and (
            _near(points, a, b, c, reach_mm)
            or _near(points, a, b, d, reach_mm)
            or _near(points, c, d, a, reach_mm)
            or _near(points, c, d, b, reach_mm)
        )
    )


@kernel
def _cross(points: Floats, a: int, b: int, c: int, d: int) -> bool:
    """Whether segments ab and cd, whose boxes meet, share a point."""
    p, q = _side(points, a, b, c), _side(points, a, b, d)
    if (p > 0.0 and q > 0.0) or (p < 0.0 and q < 0.0):
        return False
    p, q = _side(points, c, d, a), _side(points, c, d, b)
    return not ((p > 0.0 and q > 0.0) or (p < 0.0 and q < 0.0))


@kernel
def _near(points: Floats, a: int, b: int, c: int, reach_mm: float) -> bool:
    """Whether point c lies within the reach of segment ab."""
    along_x, along_y = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1]
    x, y = points[c, 0] - points[a, 0], points[c, 1] - points[a, 1]
    square = along_x * along_x + along_y * along_y
    t = min(max((x * along_x + y * along_y) / square, 0.0), 1.0) if square > 0.0 else 0.0
    return bool((x - t * along_x) ** 2 + (y - t * along_y) ** 2 <= reach_mm * reach_mm)


@kernel
def encloses(
    tree: BoxTree, leaves: int, first_leaf: int, points: Floats, ring_starts: Ints, r: int, x: float, y: float
) -> bool:
    """Whether (x, y) lies inside ring `r`, whose leaves begin at `first_leaf`; on its boundary it does not.

    As :func:`ebamcheck.numeric.rings.locate`, but for the leaves beside which the point does not lie.
    """
    inside = False
    leaf = leaves + first_leaf
    for i in range(ring_starts[r], ring_starts[r + 1], SEGMENTS_A_LEAF):
        if tree.boxes[leaf, 1] <= y <= tree.boxes[leaf, 3]:
            stop = min(i + SEGMENTS_A_LEAF, ring_starts[r + 1])
            for k in range(i, stop):
                after = k + 1 if k + 1 < ring_starts[r + 1] else ring_starts[r]
                passed = _passed(points, k, after, x, y)
                if passed == ON_BOUNDARY:
                    return False
                inside = inside != (passed == INSIDE)
        leaf += 1
    return inside


@kernel
def _passed(points: Floats, j: int, i: int, x: float, y: float) -> int:
    """:data:`INSIDE` if a ray from (x, y) crosses segment ji, :data:`ON_BOUNDARY` if the point lies on it."""
    xi, yi, xj, yj = points[i, 0], points[i, 1], points[j, 0], points[j, 1]
    if (yi > y) != (yj > y):
        side = (xj - xi) * (y - yi) - (x - xi) * (yj - yi)
        if side == 0.0:
            return ON_BOUNDARY
        return INSIDE if (side > 0.0) == (yj > yi) else OUTSIDE
    if yi == y and ((xi == x) or (yj == y and (xi > x) != (xj > x))):
        return ON_BOUNDARY
    return OUTSIDE

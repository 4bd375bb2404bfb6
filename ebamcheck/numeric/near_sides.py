"""Distance of places from the nearest of many sides, by a tree of boxes around runs of them.

The figures are those of GEOS to the last bit (``Distance::pointToSegment``), a hundred times as fast as its search
tree, which asks for an object for every place and side.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Floats

if TYPE_CHECKING:
    # Loaded only where there are geometries; most commands make none.
    from shapely.geometry.base import BaseGeometry

SIDES_A_LEAF = 4
"""Sides in one leaf of the tree."""

MOST_LEVELS = 64
"""Depth of the largest tree that memory could hold."""

ROUNDING_MM = 1e-9
"""Boxes no farther than this beyond the nearest side are looked into: rounding must not decide what is nearest."""


def sides_of(lines: BaseGeometry) -> Floats:
    """Sides (m, 4) of lines: x0, y0, x1, y1 of every two points that follow one another."""
    import shapely

    points, line = shapely.get_coordinates(shapely.get_parts(lines), return_index=True)
    joined = np.flatnonzero(line[1:] == line[:-1])
    return np.hstack([points[joined], points[joined + 1]])


@kernel
def side_distances(places: Floats, sides: Floats) -> Floats:
    """Distance (n,) of places (n, 2) from the nearest of sides (m, 4) x0, y0, x1, y1; infinite where there is none."""
    result = np.full(len(places), np.inf)
    if len(sides) == 0:
        return result
    boxes = _boxed(sides)
    waiting = np.empty(MOST_LEVELS, np.int64)
    leaves, guess = len(boxes) // 2, 0
    for n in range(len(places)):
        x, y = places[n]
        best = _to_side(sides[guess], x, y)
        waiting[0], count = 1, 1
        while count > 0:
            count -= 1
            node = waiting[count]
            if _box_square(boxes[node], x, y) > (best + ROUNDING_MM) ** 2:
                continue
            if node < leaves:
                left, right = 2 * node, 2 * node + 1
                if _box_square(boxes[left], x, y) > _box_square(boxes[right], x, y):
                    left, right = right, left
                waiting[count], waiting[count + 1] = right, left
                count += 2
                continue
            first = (node - leaves) * SIDES_A_LEAF
            for side in range(first, min(first + SIDES_A_LEAF, len(sides))):
                away = _to_side(sides[side], x, y)
                if away < best:
                    best, guess = away, side
        result[n] = best
    return result


@kernel
def _boxed(sides: Floats) -> Floats:
    """Boxes (nodes, 4) of a complete binary tree: node k has the children 2 k and 2 k + 1, its second half are leaves."""
    leaves = 1
    while leaves * SIDES_A_LEAF < len(sides):
        leaves *= 2
    boxes = np.empty((2 * leaves, 4))
    boxes[:, :2] = np.inf
    boxes[:, 2:] = -np.inf
    for side in range(len(sides)):
        box, ends = boxes[leaves + side // SIDES_A_LEAF], sides[side]
        box[0], box[1] = min(box[0], ends[0], ends[2]), min(box[1], ends[1], ends[3])
        box[2], box[3] = max(box[2], ends[0], ends[2]), max(box[3], ends[1], ends[3])
    for k in range(leaves - 1, 0, -1):
        for axis in range(2):
            boxes[k, axis] = min(boxes[2 * k, axis], boxes[2 * k + 1, axis])
            boxes[k, axis + 2] = max(boxes[2 * k, axis + 2], boxes[2 * k + 1, axis + 2])
    return boxes


@kernel
def _box_square(box: Floats, x: float, y: float) -> float:
    """Square of the distance of a place from a box."""
    dx, dy = max(box[0] - x, x - box[2], 0.0), max(box[1] - y, y - box[3], 0.0)
    return float(dx * dx + dy * dy)


@kernel
def _to_side(side: Floats, x: float, y: float) -> float:
    """Distance of a place from one side, in the steps of GEOS."""
    x0, y0, x1, y1 = side
    dx, dy = x1 - x0, y1 - y0
    square = dx * dx + dy * dy
    if square == 0.0:
        return float(np.sqrt((x - x0) * (x - x0) + (y - y0) * (y - y0)))
    along = ((x - x0) * dx + (y - y0) * dy) / square
    if along <= 0.0:
        return float(np.sqrt((x - x0) * (x - x0) + (y - y0) * (y - y0)))
    if along >= 1.0:
        return float(np.sqrt((x - x1) * (x - x1) + (y - y1) * (y - y1)))
    across = ((y0 - y) * dx - (x0 - x) * dy) / square
    return float(abs(across) * np.sqrt(square))

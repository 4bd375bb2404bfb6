"""Which islands of a layer touch, and along which length."""

from __future__ import annotations

import numpy as np
import shapely
from numpy.typing import NDArray

from ebamcheck.geometry.regions import ring_columns
from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Floats, Ints

TOUCH_MM = 1e-6
"""Borders nearer than this coincide: islands are cut from one region, so only rounding parts them."""


def shared_borders(islands: NDArray[np.object_]) -> tuple[Ints, Floats]:
    """Pairs of islands with a common border, and its length.

    Parameters
    ----------
    islands
        (I,) polygons that do not overlap.

    Returns
    -------
    pairs
        (P, 2) indices, the lesser first, sorted.
    border_mm
        (P,) length of the common border; pairs that meet in a point only are left out.
    """
    if islands.size < 2:
        return np.zeros((0, 2), np.int64), np.zeros(0)
    boxes = shapely.box(*(shapely.bounds(islands) + np.array([-1, -1, 1, 1]) * TOUCH_MM).T)
    a, b = shapely.STRtree(islands).query(boxes)
    pairs = np.column_stack([a, b])[a < b].astype(np.int64)
    pairs = pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]
    points, (ring_starts, island_rings) = ring_columns(islands)
    lengths = common_lengths(points, ring_starts, island_rings, pairs, TOUCH_MM)
    touching = lengths > TOUCH_MM
    return pairs[touching], lengths[touching]


def polygon_edges(polygons: NDArray[np.object_]) -> tuple[Floats, Ints]:
    """Edges (E, 4) of polygons, x0, y0, x1, y1 with the lesser end first, and the polygon of each (E,)."""
    rings, owner = shapely.get_rings(polygons, return_index=True)
    points, ring = shapely.get_coordinates(rings, return_index=True)
    inner = np.flatnonzero(ring[:-1] == ring[1:])
    start, end = points[inner], points[inner + 1]
    turned = (start[:, 0] > end[:, 0]) | ((start[:, 0] == end[:, 0]) & (start[:, 1] > end[:, 1]))
    ends = np.where(turned[:, None], np.hstack([end, start]), np.hstack([start, end]))
    return ends.astype(np.float64), owner[ring[inner]].astype(np.int64)


def shared_edges(polygons: NDArray[np.object_]) -> tuple[Ints, Floats]:
    """Pairs of polygons with common edges, equal to the last bit, and their length; columns as of :func:`shared_borders`."""
    ends, owner = polygon_edges(polygons)
    order = np.lexsort((owner, *ends.T))
    ends, owner = ends[order], owner[order]
    common = np.flatnonzero((ends[:-1] == ends[1:]).all(axis=1) & (owner[:-1] != owner[1:]))
    length = np.hypot(*(ends[common, 2:] - ends[common, :2]).T)
    pairs, place = np.unique(np.column_stack([owner[common], owner[common + 1]]), axis=0, return_inverse=True)
    lengths = np.bincount(place.ravel(), length, len(pairs))
    return pairs.reshape(-1, 2).astype(np.int64), lengths.astype(np.float64)


@kernel
def common_lengths(
    points: Floats, ring_starts: Ints, island_rings: Ints, pairs: Ints, tolerance: float
) -> Floats:
    """Length over which the borders of each pair of polygons coincide within a tolerance, (P,)."""
    result = np.zeros(len(pairs))
    for n in range(len(pairs)):
        total = 0.0
        for r in range(island_rings[pairs[n, 0]], island_rings[pairs[n, 0] + 1]):
            for i in range(ring_starts[r], ring_starts[r + 1] - 1):
                for q in range(island_rings[pairs[n, 1]], island_rings[pairs[n, 1] + 1]):
                    for k in range(ring_starts[q], ring_starts[q + 1] - 1):
                        total += _overlap(points, i, k, tolerance)
        result[n] = total
    return result


@kernel
def _overlap(points: Floats, i: int, k: int, tolerance: float) -> float:
    """Length over which segment (k, k + 1) lies on segment (i, i + 1)."""
    ax, ay, bx, by = points[i, 0], points[i, 1], points[i + 1, 0], points[i + 1, 1]
    cx, cy, dx, dy = points[k, 0], points[k, 1], points[k + 1, 0], points[k + 1, 1]
    if (
        max(cx, dx) < min(ax, bx) - tolerance
        or min(cx, dx) > max(ax, bx) + tolerance
        or max(cy, dy) < min(ay, by) - tolerance
        or min(cy, dy) > max(ay, by) + tolerance
    ):
        return 0.0
    length = np.hypot(bx - ax, by - ay)
    if length == 0.0:
        return 0.0
    ux, uy = (bx - ax) / length, (by - ay) / length
    off_c = ux * (cy - ay) - uy * (cx - ax)
    off_d = ux * (dy - ay) - uy * (dx - ax)
    if abs(off_c) > tolerance or abs(off_d) > tolerance:
        return 0.0
    c, d = ux * (cx - ax) + uy * (cy - ay), ux * (dx - ax) + uy * (dy - ay)
    return float(max(0.0, min(length, max(c, d)) - max(0.0, min(c, d))))

"""Which layers have winding numbers other than 0 and 1, and their union.

A layer whose rings neither touch nor cross needs nothing but a look at how they nest; that is nearly every layer of
nearly every part. Where rings touch or cross, the arrangement of the layer decides.
"""

from __future__ import annotations

import numpy as np
import shapely
from numpy.typing import NDArray

from ebamcheck.kernels import kernel
from ebamcheck.layers import Layers
from ebamcheck.rings import INSIDE, Bools, Floats, Ints, locate

CLEAN, NESTED_WRONG, TOUCHING = 0, 1, 2

CELLS_PER_SEGMENT = 1.0
"""Cells of the search grid per segment of a layer: about one segment a cell is the cheapest."""


def classify_layers(layers: Layers) -> NDArray[np.int8]:
    """Tell clean layers from those with wrongly nested rings and those with touching or crossing ones, (L,)."""
    return _classify(
        layers.points,
        layers.ring_starts,
        layers.layer_starts,
        layers.closed,
        layers.ring_areas,
        layers.ring_bounds,
    )


@kernel
def _classify(
    points: Floats, ring_starts: Ints, layer_starts: Ints, closed: Bools, areas: Floats, boxes: Floats
) -> NDArray[np.int8]:
    count = layer_starts.size - 1
    result = np.zeros(count, np.int8)
    for layer in range(count):
        a, b = layer_starts[layer], layer_starts[layer + 1]
        if a == b:
            continue
        if _touching(points, ring_starts, closed, a, b):
            result[layer] = TOUCHING
        else:
            for r in range(a, b):
                if closed[r] and _kept(points, ring_starts, closed, areas, boxes, a, b, r) == 0:
                    result[layer] = NESTED_WRONG
                    break
    return result


@kernel
def _kept(
    points: Floats, ring_starts: Ints, closed: Bools, areas: Floats, boxes: Floats, a: int, b: int, r: int
) -> int:
    """1 where ring `r` separates solid from void under winding > 0, among rings ``[a, b)`` that do not touch."""
    x, y = points[ring_starts[r], 0], points[ring_starts[r], 1]
    outside = 0
    for s in range(a, b):
        if s == r or not closed[s]:
            continue
        if (
            boxes[s, 0] <= x <= boxes[s, 2]
            and boxes[s, 1] <= y <= boxes[s, 3]
            and locate(x, y, points, ring_starts[s], ring_starts[s + 1]) == INSIDE
        ):
            outside += 1 if areas[s] > 0.0 else -1
    inside = outside + (1 if areas[r] > 0.0 else -1)
    return 1 if (outside > 0) != (inside > 0) else 0


@kernel
def _touching(points: Floats, ring_starts: Ints, closed: Bools, a: int, b: int) -> bool:
    """Whether two segments of the closed rings ``[a, b)`` meet elsewhere than where one follows the other."""
    first, last = ring_starts[a], ring_starts[b]
    count = last - first
    following = np.empty(count, np.int64)
    for r in range(a, b):
        for i in range(ring_starts[r], ring_starts[r + 1]):
            following[i - first] = (
                (i + 1 if i + 1 < ring_starts[r + 1] else ring_starts[r]) if closed[r] else i
            )
    xmin, ymin = np.inf, np.inf
    xmax, ymax = -np.inf, -np.inf
    for i in range(first, last):
        xmin, xmax = min(xmin, points[i, 0]), max(xmax, points[i, 0])
        ymin, ymax = min(ymin, points[i, 1]), max(ymax, points[i, 1])
    side = np.sqrt(max((xmax - xmin) * (ymax - ymin), 1e-300) / (CELLS_PER_SEGMENT * count))
    side = max(side, max(xmax - xmin, ymax - ymin) / (4.0 * count), 1e-300)
    nx, ny = int((xmax - xmin) / side) + 1, int((ymax - ymin) / side) + 1
    # Count, then fill: each segment is listed in every cell of its box.
    starts = np.zeros(nx * ny + 1, np.int64)
    for i in range(first, last):
        j = following[i - first]
        if j == i:
            continue
        c0, c1, r0, r1 = _cells(points, i, j, xmin, ymin, side, nx, ny)
        for row in range(r0, r1 + 1):
            for column in range(c0, c1 + 1):
                starts[row * nx + column + 1] += 1
    for c in range(nx * ny):
        starts[c + 1] += starts[c]
    listed = np.empty(starts[-1], np.int64)
    fill = starts[:-1].copy()
    for i in range(first, last):
        j = following[i - first]
        if j == i:
            continue
        c0, c1, r0, r1 = _cells(points, i, j, xmin, ymin, side, nx, ny)
        for row in range(r0, r1 + 1):
            for column in range(c0, c1 + 1):
                cell = row * nx + column
                for s in range(starts[cell], fill[cell]):
                    other = listed[s]
                    if following[other - first] == i or j == other:
                        continue
                    if _meet(points, i, j, other, following[other - first]):
                        return True
                listed[fill[cell]] = i
                fill[cell] += 1
    return False


@kernel
def _cells(
    points: Floats, i: int, j: int, xmin: float, ymin: float, side: float, nx: int, ny: int
) -> tuple[int, int, int, int]:
    c0 = int((min(points[i, 0], points[j, 0]) - xmin) / side)
    c1 = int((max(points[i, 0], points[j, 0]) - xmin) / side)
    r0 = int((min(points[i, 1], points[j, 1]) - ymin) / side)
    r1 = int((max(points[i, 1], points[j, 1]) - ymin) / side)
    return min(c0, nx - 1), min(c1, nx - 1), min(r0, ny - 1), min(r1, ny - 1)


@kernel
def _side(points: Floats, i: int, j: int, k: int) -> float:
    """Twice the signed area of the triangle of points i, j, k."""
    return (points[j, 0] - points[i, 0]) * (points[k, 1] - points[i, 1]) - (points[k, 0] - points[i, 0]) * (
        points[j, 1] - points[i, 1]
    )


@kernel
def _meet(points: Floats, a: int, b: int, c: int, d: int) -> bool:
    """Whether segments ab and cd share a point."""
    if (
        max(points[a, 0], points[b, 0]) < min(points[c, 0], points[d, 0])
        or max(points[c, 0], points[d, 0]) < min(points[a, 0], points[b, 0])
        or max(points[a, 1], points[b, 1]) < min(points[c, 1], points[d, 1])
        or max(points[c, 1], points[d, 1]) < min(points[a, 1], points[b, 1])
    ):
        return False
    p, q = _side(points, a, b, c), _side(points, a, b, d)
    if (p > 0.0 and q > 0.0) or (p < 0.0 and q < 0.0):
        return False
    p, q = _side(points, c, d, a), _side(points, c, d, b)
    return not ((p > 0.0 and q > 0.0) or (p < 0.0 and q < 0.0))


def unite(layer: Layers, kind: int) -> tuple[Floats, Ints, Bools, NDArray[np.int32], Floats] | None:
    """Resolve one layer (a stack of length 1) under winding > 0.

    Returns
    -------
    points, ring_starts, closed, edge, edge_t
        Of the resolved layer, open paths included; None where nothing changes. Points that the union made
        (crossings) carry edge -1 and parameter NaN.
    """
    assert layer.edge is not None
    assert layer.edge_t is not None
    if kind == NESTED_WRONG:
        keep = _keep_rings(layer)
        rows = np.repeat(keep, np.diff(layer.ring_starts))
        sizes = np.diff(layer.ring_starts)[keep]
        starts = np.concatenate([[0], np.cumsum(sizes)])
        return layer.points[rows], starts, layer.closed[keep], layer.edge[rows], layer.edge_t[rows]
    faces = _arrangement(layer)
    inner = shapely.get_coordinates(shapely.point_on_surface(faces)) if len(faces) else np.zeros((0, 2))
    winding = winding_numbers(inner, layer.points, layer.ring_starts, layer.closed)
    if np.isin(winding, (0, 1)).all():
        return None
    united = shapely.orient_polygons(shapely.union_all(faces[winding > 0]))
    rings = [
        shapely.get_coordinates(ring)[:-1]
        for polygon in shapely.get_parts(united)
        for ring in (polygon.exterior, *polygon.interiors)
    ]
    open_paths = [layer.ring(r) for r in np.flatnonzero(~layer.closed)]
    paths = [*rings, *open_paths]
    points = np.concatenate(paths) if paths else np.zeros((0, 2))
    starts = np.concatenate([[0], np.cumsum([len(path) for path in paths])]).astype(np.int64)
    closed = np.arange(len(paths)) < len(rings)
    edge, edge_t = _known_edges(points, layer)
    return points, starts, closed, edge, edge_t


def _keep_rings(layer: Layers) -> Bools:
    areas, boxes = layer.ring_areas, layer.ring_bounds
    count = layer.closed.size
    return np.array(
        [
            not layer.closed[r]
            or bool(_kept(layer.points, layer.ring_starts, layer.closed, areas, boxes, 0, count, r))
            for r in range(count)
        ],
        dtype=np.bool_,
    )


def _arrangement(layer: Layers) -> NDArray[np.object_]:
    """Bounded faces of the arrangement of all closed rings of a layer, as shapely polygons."""
    lines = [
        shapely.LineString(np.vstack([layer.ring(r), layer.ring(r)[:1]]))
        for r in np.flatnonzero(layer.closed)
    ]
    noded = shapely.union_all(np.array(lines, dtype=object))
    return np.asarray(shapely.get_parts(shapely.polygonize([*shapely.get_parts(noded)])), dtype=object)


@kernel
def winding_numbers(queries: Floats, points: Floats, ring_starts: Ints, closed: Bools) -> Ints:
    """Winding number of all closed rings about each query point, (Q,)."""
    result = np.zeros(queries.shape[0], np.int64)
    for r in range(closed.size):
        if not closed[r]:
            continue
        a, b = ring_starts[r], ring_starts[r + 1]
        for i in range(a, b):
            j = i + 1 if i + 1 < b else a
            xi, yi, xj, yj = points[i, 0], points[i, 1], points[j, 0], points[j, 1]
            for q in range(queries.shape[0]):
                y = queries[q, 1]
                if (yi <= y) != (yj <= y):
                    side = (xj - xi) * (y - yi) - (queries[q, 0] - xi) * (yj - yi)
                    if yj > yi and side > 0.0:
                        result[q] += 1
                    elif yj < yi and side < 0.0:
                        result[q] -= 1
    return result


def _known_edges(points: Floats, layer: Layers) -> tuple[NDArray[np.int32], Floats]:
    """Mesh edges of the points that stood in the layer already; -1 and NaN for new ones."""
    assert layer.edge is not None
    assert layer.edge_t is not None
    old, new = (np.ascontiguousarray(p).view("V16").reshape(-1) for p in (layer.points + 0.0, points + 0.0))
    order = np.argsort(old)
    at = np.minimum(np.searchsorted(old, new, sorter=order), max(len(old) - 1, 0))
    source = order[at] if len(old) else np.zeros(len(new), np.int64)
    known = old[source] == new if len(old) else np.zeros(len(new), np.bool_)
    edge = np.where(known[:, None], layer.edge[source], -1).astype(np.int32)
    return edge, np.where(known, layer.edge_t[source], np.nan)

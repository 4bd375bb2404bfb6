"""The arrangement of the rings of one layer: where bodies meet within a reach they share points and sides.

Rounding moves sides of bodies that touch apart, or across each other. So points of different bodies within reach become one, sides
pass through every point of another body within reach, and what is passed once each way is no border. Within a body, told by the
sheets of its surface, nothing is moved: a groove is a groove, however narrow."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray

from ebamcheck.kernels import Bools, Floats, Ints, ShortInts, kernel
from ebamcheck.layers.stack import Layers, canonical
from ebamcheck.mesh.topology import components, edge_groups
from ebamcheck_planecut.overlaps import NESTED_WRONG, kept_rings

Index = NDArray[np.int32]

SEVERAL = -1  # in place of the sheet of a vertex, point or side that several sheets share


class Arrangement(NamedTuple):
    """What the rings of a layer make of the plane."""

    faces: NDArray[np.object_]  # (F,) bounded faces, as shapely polygons that share their borders to the bit
    winding: Ints  # (F,) winding number of the rings about each face
    seams: bool  # whether a side was left out, since different bodies pass it once each way


def arrangement(layer: Layers, reach_mm: float, sheets: Index) -> Arrangement:
    """Return the arrangement of all closed rings of a layer, whose points may be off by the reach; `sheets` (V,) are of the
    mesh."""
    assert layer.edge is not None
    # A point, and a side, of which one end belongs to a single sheet lies on that one.
    sheet = sheets[layer.edge].max(axis=1)
    rows = np.flatnonzero(np.repeat(layer.closed, np.diff(layer.ring_starts)))
    after = rows + 1
    last = np.isin(after, layer.ring_starts[1:])
    after[last] = layer.ring_starts[np.searchsorted(layer.ring_starts, rows[last], side="right") - 1]
    node = _merged(layer.points, rows, sheet, reach_mm)
    start, end, of = node[rows], node[after], np.maximum(sheet[rows], sheet[after])
    apart = start != end
    start, end, of = _through_points(layer.points, start[apart], end[apart], of[apart], reach_mm)
    low, high = np.minimum(start, end), np.maximum(start, end)
    key, first, which = np.unique(low * len(layer.points) + high, return_index=True, return_inverse=True)
    passes = np.bincount(which, np.where(start == low, 1, -1), minlength=key.size).astype(np.int64)
    border = first[passes != 0]
    met = np.zeros(key.size, np.bool_)
    met[which[_differ(of, of[first][which])]] = True
    sides = np.stack([layer.points[low[border]], layer.points[high[border]]], axis=1)
    noded = shapely.union_all(shapely.linestrings(sides))
    faces = np.asarray(shapely.get_parts(shapely.polygonize([*shapely.get_parts(noded)])), dtype=object)
    places = shapely.get_coordinates(shapely.point_on_surface(faces)).reshape(-1, 2)
    # By the sides that are left: within a seam that rounding has opened the rings tell nothing.
    winding = winding_numbers(places, sides, passes[passes != 0])
    return Arrangement(faces, winding, bool((met & (passes == 0)).any()))


@kernel
def winding_numbers(places: Floats, sides: Floats, passes: Ints) -> Ints:
    """Winding number (Q,) about places (Q, 2) of sides (S, 2, 2), each passed so many times from its start to its end."""
    result = np.zeros(places.shape[0], np.int64)
    for s in range(sides.shape[0]):
        xi, yi, xj, yj = sides[s, 0, 0], sides[s, 0, 1], sides[s, 1, 0], sides[s, 1, 1]
        for q in range(places.shape[0]):
            y = places[q, 1]
            if (yi <= y) != (yj <= y):
                side = (xj - xi) * (y - yi) - (places[q, 0] - xi) * (yj - yi)
                if yj > yi and side > 0.0:
                    result[q] += passes[s]
                elif yj < yi and side < 0.0:
                    result[q] -= passes[s]
    return result


def _differ(a: Index, b: Index) -> Bools:
    """Whether sheets (N,) may belong to different bodies."""
    return np.asarray((a != b) | (a == SEVERAL), np.bool_)


def _merged(points: Floats, rows: Ints, sheet: Index, reach_mm: float) -> Ints:
    """Row (N,) of the point that stands for each point in `rows`: the first of those at its place or, of other bodies, in reach."""
    node = np.arange(len(points))
    places = np.asarray(shapely.points(points[rows]), dtype=object)
    a, b = shapely.STRtree(places).query(places, predicate="dwithin", distance=reach_mm)
    a, b = rows[a], rows[b]
    one = _differ(sheet[a], sheet[b]) | (points[a] == points[b]).all(axis=1)
    a, b = a[one], b[one]
    while True:
        least = node.copy()
        np.minimum.at(least, a, node[b])
        if (least == node).all():
            return node
        node = least


def _through_points(points: Floats, start: Ints, end: Ints, of: Index, reach_mm: float) -> tuple[Ints, Ints, Index]:
    """Sides from `start` to `end` (S,) of sheets `of`, led in order through all points of other bodies within their reach."""
    # A point of several bodies is one of each.
    used, which = np.unique(start, return_inverse=True)
    least, most = np.full(used.size, np.iinfo(np.int32).max), np.full(used.size, SEVERAL)
    np.minimum.at(least, which, of)
    np.maximum.at(most, which, of)
    sheet = np.where(least == most, least, SEVERAL).astype(np.int32)
    sides = np.asarray(shapely.linestrings(np.stack([points[start], points[end]], axis=1)), dtype=object)
    near, side = shapely.STRtree(sides).query(shapely.points(points[used]), predicate="dwithin", distance=reach_mm)
    at = used[near]
    inner = (at != start[side]) & (at != end[side]) & _differ(sheet[near], of[side])
    at, side = at[inner], side[inner]
    way = points[end[side]] - points[start[side]]
    share = ((points[at] - points[start[side]]) * way).sum(axis=1)
    # Of each side: its start, what lies along it, and its end.
    every = np.arange(start.size)
    nodes = np.concatenate([start, at, end])
    owner = np.concatenate([every, side, every])
    order = np.lexsort((np.concatenate([np.full(start.size, -np.inf), share, np.full(end.size, np.inf)]), owner))
    nodes, owner = nodes[order], owner[order]
    follows = owner[1:] == owner[:-1]
    return nodes[:-1][follows], nodes[1:][follows], of[owner[:-1][follows]]


def sheets_of_vertices(faces: ShortInts, count: int) -> ShortInts:
    """Return the sheet (V,) of each of `count` vertices: that of all facets at it; :data:`SEVERAL` where they differ or lack.

    Sheets are facets that hang together across edges at which exactly two of them meet.
    """
    # Few meshes need them, and loading them takes longer than slicing a small part.

    groups = edge_groups(faces, count)
    two = groups.starts[:-1][np.diff(groups.starts) == 2]
    sheet = components(len(faces), groups.half_edges[two] // 3, groups.half_edges[two + 1] // 3)
    tails = faces.reshape(-1)[groups.half_edges]
    found = sheet[groups.half_edges // 3]
    result = np.full(count, SEVERAL, np.int32)
    result[tails] = found
    result[tails[result[tails] != found]] = SEVERAL
    return result


def unite(layer: Layers, kind: int, reach_mm: float, sheets: ShortInts) -> Layers | None:
    """Unite the shells of one layer (a stack of length 1) by the rule winding > 0; bodies that touch along a line are one.

    Points that the union made have edge -1 and parameter NaN. The result is None if nothing changes. `sheets` are read only where
    rings touch or cross.
    """
    assert layer.edge is not None
    assert layer.edge_t is not None
    if kind == NESTED_WRONG:
        keep = kept_rings(layer.points, layer.ring_starts, layer.closed)
        rows = np.repeat(keep, np.diff(layer.ring_starts))
        sizes = np.diff(layer.ring_starts)[keep]
        starts = np.concatenate([[0], np.cumsum(sizes)])
        return _canonical(layer, layer.points[rows], starts, layer.closed[keep], layer.edge[rows], layer.edge_t[rows])
    found = arrangement(layer, reach_mm, sheets)
    if not found.seams and np.isin(found.winding, (0, 1)).all():
        return None
    united = shapely.orient_polygons(shapely.union_all(found.faces[found.winding > 0]))
    rings = [
        shapely.get_coordinates(ring)[:-1]
        for polygon in shapely.get_parts(united)
        for ring in (polygon.exterior, *polygon.interiors)
    ]
    open_paths = [layer.ring(r) for r in np.flatnonzero(~layer.closed).tolist()]
    paths = [*rings, *open_paths]
    points = np.concatenate(paths) if paths else np.zeros((0, 2))
    starts = np.concatenate([[0], np.cumsum([len(path) for path in paths])]).astype(np.int64)
    closed = np.arange(len(paths)) < len(rings)
    return _canonical(layer, points, starts, closed, *_known_edges(points, layer))


def _canonical(layer: Layers, points: Floats, starts: Ints, closed: Bools, edge: Index, edge_t: Floats) -> Layers:
    """Put other rings in place of those of a layer."""
    labels = {name: getattr(layer, name) for name in ("part", "direction", "backend", "settings")}
    again = canonical(layer.heights, points, starts, [0, closed.size], closed, edge=edge, edge_t=edge_t, **labels)
    return again.labelled(dropped=again.dropped + layer.dropped)


def _known_edges(points: Floats, layer: Layers) -> tuple[ShortInts, Floats]:
    """Mesh edges and parameters of the points that the layer already had; -1 and NaN for new ones."""
    assert layer.edge is not None
    assert layer.edge_t is not None
    old, new = (np.ascontiguousarray(p).view("V16").reshape(-1) for p in (layer.points + 0.0, points + 0.0))
    order = np.argsort(old)
    at = np.minimum(np.searchsorted(old, new, sorter=order), max(len(old) - 1, 0))
    source = order[at] if len(old) else np.zeros(len(new), np.int64)
    known = old[source] == new if len(old) else np.zeros(len(new), np.bool_)
    edge = np.where(known[:, None], layer.edge[source], -1).astype(np.int32)
    return edge, np.where(known, layer.edge_t[source], np.nan)

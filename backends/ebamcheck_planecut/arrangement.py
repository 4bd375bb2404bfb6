"""The arrangement of the rings of one layer: where bodies meet within a reach they share points and sides.

Bodies that touch in a face have sides that lie on one another. Rounding moves these apart, or across each other, by units in the
last place; noding alone would leave slits of no width between them. So points of different bodies within the reach of one
another become one point, sides pass through every point of another body within their reach, and what is then passed once each
way is no border. Within a body nothing is moved: a groove just above its ground is a groove, however narrow. Bodies are told apart
by the sheets of their surface.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray

from ebamcheck.layers.stack import Layers
from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Bools, Floats, Ints
from ebamcheck_planecut.sheets import SEVERAL

Index = NDArray[np.int32]


class Arrangement(NamedTuple):
    """What the rings of a layer make of the plane."""

    faces: NDArray[np.object_]
    """(F,) bounded faces, as shapely polygons that share their borders to the bit."""
    winding: Ints
    """(F,) winding number of the rings about each face."""
    seams: bool
    """Whether a side was left out, since different bodies pass it once each way."""


def arrangement(layer: Layers, reach_mm: float, sheets: Index) -> Arrangement:
    """Return the arrangement of all closed rings of a layer.

    Parameters
    ----------
    layer
        A stack of length 1.
    reach_mm
        What the points of the rings may be off.
    sheets
        (V,) sheet of each vertex of the mesh, by :func:`~ebamcheck_planecut.sheets.sheets_of_vertices`.
    """
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


def _through_points(
    points: Floats, start: Ints, end: Ints, of: Index, reach_mm: float
) -> tuple[Ints, Ints, Index]:
    """Sides from `start` to `end` (S,) of sheets `of`, led in order through all points of other bodies within their reach."""
    # A point of several bodies is one of each.
    used, which = np.unique(start, return_inverse=True)
    least, most = np.full(used.size, np.iinfo(np.int32).max), np.full(used.size, SEVERAL)
    np.minimum.at(least, which, of)
    np.maximum.at(most, which, of)
    sheet = np.where(least == most, least, SEVERAL).astype(np.int32)
    sides = np.asarray(shapely.linestrings(np.stack([points[start], points[end]], axis=1)), dtype=object)
    near, side = shapely.STRtree(sides).query(
        shapely.points(points[used]), predicate="dwithin", distance=reach_mm
    )
    at = used[near]
    inner = (at != start[side]) & (at != end[side]) & _differ(sheet[near], of[side])
    at, side = at[inner], side[inner]
    way = points[end[side]] - points[start[side]]
    share = ((points[at] - points[start[side]]) * way).sum(axis=1)
    # Of each side: its start, what lies along it, and its end.
    every = np.arange(start.size)
    nodes = np.concatenate([start, at, end])
    owner = np.concatenate([every, side, every])
    order = np.lexsort(
        (np.concatenate([np.full(start.size, -np.inf), share, np.full(end.size, np.inf)]), owner)
    )
    nodes, owner = nodes[order], owner[order]
    follows = owner[1:] == owner[:-1]
    return nodes[:-1][follows], nodes[1:][follows], of[owner[:-1][follows]]

"""Layers with winding numbers other than 0 and 1, and the union of their shells.

For a layer whose rings neither touch nor cross, as nearly all layers of nearly all parts, the nesting of the rings decides.
Where rings touch or cross, the arrangement of the layer is built. Rings that touch in single points, and those of one
body that touch, stay as they are.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ebamcheck.layers.stack import Layers
from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Bools, Floats, Ints, signed_area
from ebamcheck_planecut.box_tree import SEGMENTS_A_LEAF, BoxTree, box_tree, encloses, grow, touching

CLEAN, NESTED_WRONG, TOUCHING = 0, 1, 2


class OverlapSearch(NamedTuple):
    """Working memory to examine the rings of one layer."""

    tree: BoxTree
    outward: Ints
    """(R,) +1 for an outer ring, -1 for a hole."""
    first_leaf: Ints
    """(R,) first leaf of each ring."""
    greatest_x: Floats
    """(R,) right end of each ring."""
    around: Ints
    """(R,) rings that may enclose the one examined."""
    keep: Bools
    """(R,) whether a ring separates solid from void."""


@kernel
def overlap_search(points: int, reach_mm: float) -> OverlapSearch:
    """Room for layers of so many points, whose rings touch where they come within a reach of each other."""
    return OverlapSearch(
        box_tree(points, reach_mm),
        np.empty(points, np.int64),
        np.empty(points, np.int64),
        np.empty(points),
        np.empty(points, np.int64),
        np.empty(points, np.bool_),
    )


@kernel
def classify_layer(
    points: Floats, ring_starts: Ints, closed: Bools, a: int, b: int, search: OverlapSearch
) -> int:
    """Tell a clean layer from one with wrongly nested rings and from one with touching or crossing ones.

    Parameters
    ----------
    points, ring_starts, closed
        Of a stack of layers in canonical form.
    a, b
        Rings of the layer.
    search
        Room for a layer of so many points; `keep` is written for its rings, unless they touch.
    """
    if a == b:
        return CLEAN
    leaves = grow(search.tree, points, ring_starts, closed, a, b)
    if touching(search.tree, leaves, points, ring_starts):
        return TOUCHING
    _measure(points, ring_starts, closed, a, b, search, leaves)
    return CLEAN if _all_kept(points, ring_starts, closed, a, b, search, leaves) else NESTED_WRONG


@kernel
def _measure(
    points: Floats, ring_starts: Ints, closed: Bools, a: int, b: int, search: OverlapSearch, leaves: int
) -> None:
    """Direction, leaves and right end of the closed rings ``[a, b)``."""
    leaf = 0
    for r in range(a, b):
        if not closed[r]:
            continue
        first, stop = ring_starts[r], ring_starts[r + 1]
        search.outward[r - a] = 1 if signed_area(points, first, stop) > 0.0 else -1
        search.first_leaf[r - a] = leaf
        greatest = -np.inf
        for _ in range(first, stop, SEGMENTS_A_LEAF):
            greatest = max(greatest, search.tree.boxes[leaves + leaf, 2])
            leaf += 1
        search.greatest_x[r - a] = greatest


@kernel
def _all_kept(
    points: Floats, ring_starts: Ints, closed: Bools, a: int, b: int, search: OverlapSearch, leaves: int
) -> bool:
    """Find which of the rings ``[a, b)``, which do not touch, separate solid from void under winding > 0.

    A ring starts at its left end, and rings are sorted by their starts; so those around one begin before it.
    """
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
            if s != r and encloses(
                search.tree, leaves, search.first_leaf[s - a], points, ring_starts, s, x, y
            ):
                outside += search.outward[s - a]
        count = kept
        if (outside > 0) == (outside + search.outward[r - a] > 0):
            search.keep[r - a] = False
            result = False
    return result


@kernel
def kept_rings(points: Floats, ring_starts: Ints, closed: Bools) -> Bools:
    """Tell which rings of one layer, which do not touch, separate solid from void (R,); open paths are kept."""
    search = overlap_search(points.shape[0], 0.0)
    classify_layer(points, ring_starts, closed, 0, closed.size, search)
    return search.keep[: closed.size].copy()


def unite(
    layer: Layers, kind: int, reach_mm: float, sheets: NDArray[np.int32]
) -> tuple[Floats, Ints, Bools, NDArray[np.int32], Floats] | None:
    """Unite the shells of one layer (a stack of length 1) by the rule winding > 0; bodies that touch along a line are one.

    Parameters
    ----------
    layer, kind
        The layer, and its class by :func:`classify_layer`.
    reach_mm
        What rounding may move a point by: bodies this near to each other touch.
    sheets
        (V,) sheet of each vertex of the mesh; read only where rings touch or cross.

    Returns
    -------
    points, ring_starts, closed, edge, edge_t
        Columns of the united layer, open paths included; None if nothing changes. Points that the union made
        (crossings) have edge -1 and parameter NaN.
    """
    assert layer.edge is not None
    assert layer.edge_t is not None
    if kind == NESTED_WRONG:
        keep = kept_rings(layer.points, layer.ring_starts, layer.closed)
        rows = np.repeat(keep, np.diff(layer.ring_starts))
        sizes = np.diff(layer.ring_starts)[keep]
        starts = np.concatenate([[0], np.cumsum(sizes)])
        return layer.points[rows], starts, layer.closed[keep], layer.edge[rows], layer.edge_t[rows]
    import shapely

    from ebamcheck_planecut.arrangement import arrangement

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
    edge, edge_t = _known_edges(points, layer)
    return points, starts, closed, edge, edge_t


def _known_edges(points: Floats, layer: Layers) -> tuple[NDArray[np.int32], Floats]:
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

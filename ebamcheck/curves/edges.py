"""Edges: the mesh edge under each contour point, by geometry, for slicers that do not return it.

A layer cuts a mesh edge if the edge's lower end is not above the layer and its upper end is. A contour point belongs to the
edge whose cut is nearest to it, if that is within a tolerance.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from ebamcheck.kernels import Floats
from ebamcheck.layers.stack import Layers
from ebamcheck.mesh.part import Part
from ebamcheck.mesh.topology import Index
from ebamcheck.threads import run_blocks

LEAST_SHARE = 0.5
"""Share of a stack's points that must lie on edges of the part: with fewer, the contours were traced from a raster."""


def with_edges(layers: Layers, part: Part, tolerance_mm: float) -> Layers | None:
    """Layers with the mesh edge of each point; None if they are not contours of the part.

    A point farther than `tolerance_mm` from the place where the layer cuts its edge gets none.
    """
    if layers.edge is not None:
        return layers
    count = len(layers.points)
    edge, edge_t = np.full((count, 2), -1, np.int32), np.zeros(count)
    ends = _edges(part)
    low, high = part.vertices[ends[:, 0], 2], part.vertices[ends[:, 1], 2]
    by_low = np.argsort(low, kind="stable")
    sorted_low = low[by_low]
    starts = layers.ring_starts[layers.layer_starts]

    def work(first: int, last: int) -> None:
        for k in range(first, last):
            z = float(layers.heights[k])
            begun = by_low[: int(np.searchsorted(sorted_low, z, side="right"))]
            cut = begun[high[begun] > z]
            a, b = int(starts[k]), int(starts[k + 1])
            _match(part.vertices, ends[cut], layers.points[a:b], z, tolerance_mm, edge[a:b], edge_t[a:b])

    run_blocks(work, len(layers))
    if count and np.count_nonzero(edge[:, 0] >= 0) < LEAST_SHARE * count:
        return None
    return replace(layers, edge=edge, edge_t=edge_t)


def _edges(part: Part) -> Index:
    """Edges of the mesh that are not level, each once, lower vertex first, (E, 2)."""
    pairs = np.concatenate([part.faces[:, [0, 1]], part.faces[:, [1, 2]], part.faces[:, [2, 0]]])
    z = part.vertices[:, 2]
    turned = z[pairs[:, 0]] > z[pairs[:, 1]]
    pairs[turned] = pairs[turned][:, ::-1]
    pairs = pairs[z[pairs[:, 0]] < z[pairs[:, 1]]]
    key = pairs[:, 0].astype(np.int64) * len(part.vertices) + pairs[:, 1]
    return np.ascontiguousarray(pairs[np.unique(key, return_index=True)[1]], dtype=np.int32)


def _match(
    vertices: Floats, ends: Index, points: Floats, z: float, tolerance: float, edge: Index, edge_t: Floats
) -> None:
    """Give each point the edge whose cut is nearest, of those within the tolerance."""
    if not len(ends) or not len(points):
        return
    low, high = vertices[ends[:, 0]], vertices[ends[:, 1]]
    t = (z - low[:, 2]) / (high[:, 2] - low[:, 2])
    places = low[:, :2] + t[:, None] * (high - low)[:, :2]
    away, chosen = cKDTree(places).query(points, distance_upper_bound=np.nextafter(tolerance, np.inf))
    near = np.flatnonzero(np.isfinite(away))
    rows = np.asarray(chosen)[near]
    edge[near], edge_t[near] = ends[rows], t[rows]

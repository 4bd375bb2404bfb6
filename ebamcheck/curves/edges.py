"""Edges: the mesh edge under each contour point, by geometry, for slicers that do not return it.

A layer cuts a mesh edge if the edge's lower end is not above the layer and its upper end is. A contour point belongs to the
edge whose cut is nearest to it, if that is within a tolerance.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from ebamcheck.layers.stack import Layers
from ebamcheck.mesh.part import Part
from ebamcheck.mesh.topology import Index
from ebamcheck.threads import run_blocks


def with_edges(layers: Layers, part: Part, tolerance_mm: float) -> Layers | None:
    """Layers with the mesh edge of each point; None if they are not contours of the part: less than half of their points are on
    edges.

    A point farther than `tolerance_mm` from the place where the layer cuts its edge gets none.
    """
    if layers.edge is not None:
        return layers
    count = len(layers.points)
    edge, edge_t = np.full((count, 2), -1, np.int32), np.zeros(count)
    ends = _edges(part)
    low, high = part.vertices[ends[:, 0]], part.vertices[ends[:, 1]]
    by_low = np.argsort(low[:, 2], kind="stable")
    sorted_low = low[by_low, 2]
    starts = layers.ring_starts[layers.layer_starts]
    reach_mm = float(np.nextafter(tolerance_mm, np.inf))

    def work(first: int, last: int) -> None:
        for k in range(first, last):
            z, rows = float(layers.heights[k]), np.arange(starts[k], starts[k + 1])
            begun = by_low[: int(np.searchsorted(sorted_low, z, side="right"))]
            cut = begun[high[begun, 2] > z]
            if not cut.size or not rows.size:
                continue
            t = (z - low[cut, 2]) / (high[cut, 2] - low[cut, 2])
            places = low[cut, :2] + t[:, None] * (high[cut] - low[cut])[:, :2]
            away, nearest = cKDTree(places).query(layers.points[rows], distance_upper_bound=reach_mm)
            near = np.isfinite(away)
            chosen = np.asarray(nearest)[near]
            edge[rows[near]], edge_t[rows[near]] = ends[cut[chosen]], t[chosen]

    run_blocks(work, len(layers))
    if count and np.count_nonzero(edge[:, 0] >= 0) < 0.5 * count:
        return None  # traced from a raster
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

"""Facets above and below each node of the grid, in float64.

A node lies under a facet if just one edge of the facet's projection passes to the right of it. Facets that
share an edge decide about it by the same numbers, so over a closed mesh entries and exits balance at every
node, steep facets and nodes on edges included.
"""

from __future__ import annotations

import numpy as np

from ebamcheck.kernels import kernel
from ebamcheck_embree.crossings import Bools, repeated_hit
from ebamcheck_embree.knots import Lattice, node_after
from ebamcheck_embree.scene import Facets, Floats, Ints


@kernel
def _edges_at(vertices: Floats, faces: Facets, f: int, y: float) -> tuple[float, float, int]:
    """Abscissas between which the line at y lies in a facet's projection, and +1 if the facet looks up.

    0 in the place of the latter where the line misses the facet.
    """
    left, right, facing = np.inf, -np.inf, 0
    for k in range(3):
        a, b = faces[f, k], faces[f, (k + 1) % 3]
        rising = vertices[a, 1] <= y
        if rising == (vertices[b, 1] <= y):
            continue
        low, high = (a, b) if rising else (b, a)
        t = (y - vertices[low, 1]) / (vertices[high, 1] - vertices[low, 1])
        x = vertices[low, 0] + t * (vertices[high, 0] - vertices[low, 0])
        left = min(left, x)
        if x > right:
            right, facing = x, 1 if rising else -1
    return left, right, facing


@kernel
def _rows_across(vertices: Floats, faces: Facets, f: int, grid: Lattice) -> tuple[int, int]:
    """First row of nodes at or beyond a facet's lowest y, and the first at or beyond its highest."""
    _, y0, cell, _, rows = grid
    a, b, c = vertices[faces[f, 0], 1], vertices[faces[f, 1], 1], vertices[faces[f, 2], 1]
    return (
        node_after(min(a, b, c), y0, cell, rows),
        node_after(max(a, b, c), y0, cell, rows),
    )


@kernel
def facet_counts(vertices: Floats, faces: Facets, grid: Lattice) -> Ints:
    """Facets over and under each node (rows * columns,)."""
    x0, y0, cell, columns, rows = grid
    counts = np.zeros(rows * columns, np.int64)
    for f in range(len(faces)):
        first, past = _rows_across(vertices, faces, f, grid)
        for j in range(first, past):
            left, right, _ = _edges_at(vertices, faces, f, y0 + cell * j)
            for i in range(node_after(left, x0, cell, columns), node_after(right, x0, cell, columns)):
                counts[j * columns + i] += 1
    return counts


@kernel
def facets_at(
    vertices: Floats, faces: Facets, grid: Lattice, wanted: Bools, starts: Ints, facets: Facets
) -> None:
    """File the facets over and under the `wanted` nodes in `facets`, from `starts` of each node on."""
    x0, y0, cell, columns, _ = grid
    fill = starts[:-1].copy()
    for f in range(len(faces)):
        first, past = _rows_across(vertices, faces, f, grid)
        for j in range(first, past):
            left, right, _ = _edges_at(vertices, faces, f, y0 + cell * j)
            for i in range(node_after(left, x0, cell, columns), node_after(right, x0, cell, columns)):
                node = j * columns + i
                if wanted[node]:
                    facets[fill[node]] = f
                    fill[node] += 1


@kernel
def heights_on_facets(
    vertices: Floats, faces: Facets, x: Floats, y: Floats, starts: Ints, facets: Facets
) -> tuple[Floats, Ints]:
    """Height (H,) at which each ray meets each facet it hit, and +1 where it enters, -1 where it leaves.

    A hit that float64 does not confirm, or a repeated one, has the sign 0.
    """
    along = np.zeros(facets.size)
    sign = np.zeros(facets.size, np.int64)
    for r in range(starts.size - 1):
        for n in range(starts[r], starts[r + 1]):
            left, right, facing = _edges_at(vertices, faces, facets[n], y[r])
            if left <= x[r] < right and not repeated_hit(facets, n, starts[r]):
                along[n], sign[n] = _height_at(vertices, faces, facets[n], x[r], y[r]), -facing
    return along, sign


@kernel
def _height_at(vertices: Floats, faces: Facets, f: int, x: float, y: float) -> float:
    """Height of a facet at a place under or over it.

    Weights and height are kept within the facet: a steep one gives no height beyond its own, a level one
    exactly its own.
    """
    a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
    ax, ay = vertices[a, 0] - x, vertices[a, 1] - y
    bx, by = vertices[b, 0] - x, vertices[b, 1] - y
    cx, cy = vertices[c, 0] - x, vertices[c, 1] - y
    wa, wb, wc = bx * cy - cx * by, cx * ay - ax * cy, ax * by - bx * ay
    total = wa + wb + wc
    za, zb, zc = vertices[a, 2], vertices[b, 2], vertices[c, 2]
    low, high = min(za, zb, zc), max(za, zb, zc)
    if total == 0.0:
        return float(0.5 * (low + high))
    wa, wb, wc = max(wa / total, 0.0), max(wb / total, 0.0), max(wc / total, 0.0)
    height = (wa * za + wb * zb + wc * zc) / (wa + wb + wc)
    return float(min(max(height, low), high))


@kernel
def doubtful_nodes(starts: Ints, sign: Ints, counts: Ints) -> Bools:
    """Nodes (R,) whose rays were not given just as many facets as there are."""
    doubtful = np.zeros(counts.size, np.bool_)
    for r in range(counts.size):
        confirmed = 0
        for n in range(starts[r], starts[r + 1]):
            confirmed += sign[n] != 0
        doubtful[r] = confirmed != counts[r]
    return doubtful

"""Facets above and below each node of the grid, in float64.

A node lies under a facet if just one edge of the facet's projection passes to the right of it. Facets that
share an edge decide about it by the same numbers, so over a closed mesh entries and exits balance at every
node, steep facets and nodes on edges included.
"""

from __future__ import annotations

import numpy as np

from ebamcheck.numeric.kernels import kernel
from ebamcheck_embree.grid import Lattice
from ebamcheck_embree.hits import Hits, add, is_among
from ebamcheck_embree.knots import node_after
from ebamcheck_embree.scene import Bools, Facets, Ints, Singles, UnderWay, go_on
from ebamcheck_embree.section import Mesh


@kernel
def _edges_at(mesh: Mesh, f: int, y: float) -> tuple[float, float, int]:
    """Abscissas between which the line at y lies in a facet's projection, and +1 if the facet looks up.

    0 in the place of the latter where the line misses the facet.
    """
    vertices, faces = mesh
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
def _rows_across(mesh: Mesh, f: int, grid: Lattice) -> tuple[int, int]:
    """First row of nodes at or beyond a facet's lowest y, and the first at or beyond its highest."""
    vertices, faces = mesh
    _, y0, cell, _, rows = grid
    a, b, c = vertices[faces[f, 0], 1], vertices[faces[f, 1], 1], vertices[faces[f, 2], 1]
    return (
        node_after(min(a, b, c), y0, cell, rows),
        node_after(max(a, b, c), y0, cell, rows),
    )


@kernel
def facet_counts(mesh: Mesh, grid: Lattice) -> tuple[Ints, Bools]:
    """Facets over and under each node (rows * columns,), and whether each facet (F,) is one of them anywhere."""
    x0, y0, cell, columns, rows = grid
    counts = np.zeros(rows * columns, np.int64)
    is_counted = np.zeros(len(mesh.faces), np.bool_)
    for f in range(len(mesh.faces)):
        first, past = _rows_across(mesh, f, grid)
        for j in range(first, past):
            left, right, _ = _edges_at(mesh, f, y0 + cell * j)
            for i in range(node_after(left, x0, cell, columns), node_after(right, x0, cell, columns)):
                counts[j * columns + i] += 1
                is_counted[f] = True
    return counts, is_counted


@kernel
def take_heights(
    mesh: Mesh, grid: Lattice, met: Facets, distance: Singles, rays: UnderWay, hits: Hits
) -> int:
    """File where rays meet facets, as far as float64 confirms it; rays that have not met all of theirs go on."""
    x0, y0, cell, columns, _ = grid
    going_on = 0
    for n in range(met.size):
        facet = met[n]
        if not 0 <= facet < len(mesh.faces):
            continue
        node = rays.ray[n]
        if facet != rays.last[n] and not is_among(hits.facet, hits.starts[node], hits.known[node], facet):
            row = node // columns
            x, y = x0 + cell * (node - row * columns), y0 + cell * row
            left, right, facing = _edges_at(mesh, facet, y)
            if left <= x < right:
                add(hits, node, facet, _height_at(mesh, facet, x, y), -facing)
        if hits.known[node] < hits.starts[node + 1] - hits.starts[node]:
            go_on(rays, n, going_on, facet, distance[n], 2)
            going_on += 1
    return going_on


@kernel
def take_from_facets(mesh: Mesh, grid: Lattice, short: Bools, hits: Hits) -> None:
    """Fill the hits of nodes whose rays fell short of their number from all facets over and under them."""
    x0, y0, cell, columns, _ = grid
    for f in range(len(mesh.faces)):
        first, past = _rows_across(mesh, f, grid)
        for j in range(first, past):
            y = y0 + cell * j
            left, right, facing = _edges_at(mesh, f, y)
            for i in range(node_after(left, x0, cell, columns), node_after(right, x0, cell, columns)):
                node = j * columns + i
                if short[node]:
                    add(hits, node, f, _height_at(mesh, f, x0 + cell * i, y), -facing)


@kernel
def _height_at(mesh: Mesh, f: int, x: float, y: float) -> float:
    """Height of a facet at a place under or over it.

    Weights and height are kept within the facet: a steep one gives no height beyond its own, a level one
    exactly its own.
    """
    vertices, faces = mesh
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

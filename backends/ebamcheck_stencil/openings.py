"""Openings of a surface, and caps that close them.

A ray through an opening enters the solid without leaving it, or leaves without entering, and the layers above would be
wrong. A fan of facets from the middle of each opening's border balances every ray. A cap stays within the heights of its
border, so a layer that does not cut an opening is exactly that of the closed surface; one that does is closed along the
cap. A flipped facet counts as an opening whose border runs twice along it, and its caps outweigh it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ebamcheck.mesh.part import Part

# Of the random numbers by which a surface is seen to be closed: the same part is always told the same
WEIGHT_SEED = 7


def is_closed(faces: NDArray[np.integer[Any]]) -> bool:
    """Whether facets (F, 3) use every edge as often in one direction as in the other.

    A weight for each directed edge, the negative of that of the opposite one, follows from two random numbers of each
    end, as their determinant: an open surface passes for closed by a chance of about 2^-63.
    """
    size = 2, int(faces.max(initial=-1)) + 1
    numbers = np.random.default_rng(WEIGHT_SEED).integers(0, 2**64, size, np.uint64)
    (ax, ay), (bx, by), (cx, cy) = (numbers[:, faces[:, corner]] for corner in range(3))
    return not int((ax * by - ay * bx + bx * cy - by * cx + cx * ay - cy * ax).sum())


def border(faces: NDArray[np.integer[Any]]) -> NDArray[np.int64]:
    """Directed edges (n, 2) that facets (F, 3) use more often in this direction than in the other, once per excess use."""
    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64)
    ends = ends[ends[:, 0] != ends[:, 1]]
    low, high = ends.min(axis=1), ends.max(axis=1)
    base = int(high.max(initial=0)) + 1
    edges, edge_of = np.unique(low * base + high, return_inverse=True)
    surplus = np.bincount(edge_of, np.where(ends[:, 0] < ends[:, 1], 1.0, -1.0)).astype(np.int64)
    pairs = np.column_stack([edges // base, edges % base])
    pairs[surplus < 0] = pairs[surplus < 0, ::-1]
    return np.repeat(pairs, np.abs(surplus), axis=0)


def capped(part: Part) -> Part:
    """Close every opening of a part by a fan from the mean of the points of its border."""
    # A part made from arrays may be unwelded: then every facet would be an opening.
    vertices, welded = np.unique(part.vertices + 0.0, axis=0, return_inverse=True)
    part = replace(part, vertices=vertices, faces=welded.reshape(-1)[part.faces].astype(np.int32))
    edges = border(part.faces)
    if not len(edges):
        return part
    from scipy.sparse import coo_array  # slow to import, and only open meshes need it
    from scipy.sparse.csgraph import connected_components

    used, local = np.unique(edges, return_inverse=True)
    local = local.reshape(-1, 2)
    graph = coo_array((np.ones(len(local)), (local[:, 0], local[:, 1])), shape=(len(used), len(used)))
    count, opening = connected_components(graph, directed=False)
    sizes = np.bincount(opening)
    points = part.vertices[used]
    reference = points[0]
    middles = np.column_stack(
        [np.bincount(opening, points[:, axis] - reference[axis]) / sizes for axis in range(3)]
    )
    # Rounding must not move a middle outside the heights of its border.
    lowest, highest = np.full(count, np.inf), np.full(count, -np.inf)
    np.minimum.at(lowest, opening, points[:, 2])
    np.maximum.at(highest, opening, points[:, 2])
    middles += reference
    middles[:, 2] = np.clip(middles[:, 2], lowest, highest)
    apex = len(part.vertices) + opening[local[:, 0]]
    caps = np.column_stack([edges[:, 1], edges[:, 0], apex])
    return replace(
        part,
        vertices=np.vstack([part.vertices, middles]),
        faces=np.vstack([part.faces, caps]).astype(np.int32),
    )

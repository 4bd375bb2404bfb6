"""Openings of a surface, and caps that close them.

A fan of facets from the middle of each opening's border balances every ray. A cap stays within the heights of its border, so a
layer that cuts no opening is that of the closed surface. A flipped facet is an opening whose border runs twice along it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ebamcheck.mesh.part import Part
from ebamcheck.mesh.topology import direction_balance, edge_groups


def border(faces: NDArray[np.int32]) -> NDArray[np.int32]:
    """Directed edges (n, 2) that facets (F, 3) use more often in this direction than in the other, once per excess use."""
    groups = edge_groups(faces, int(faces.max(initial=-1)) + 1)
    surplus = direction_balance(faces, groups)
    first = groups.half_edges[groups.starts[:-1]]
    corners = faces.ravel()
    after = corners[np.where(first % 3 == 2, first - 2, first + 1)]
    edges = np.sort(np.column_stack([corners[first], after]), axis=1)
    edges[surplus < 0] = edges[surplus < 0, ::-1]
    return np.repeat(edges, np.abs(surplus), axis=0)


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

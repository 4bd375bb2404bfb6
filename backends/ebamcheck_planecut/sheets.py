"""Sheets of a surface: facets that hang together across edges at which exactly two of them meet.

A body that touches no other one is a sheet. Where welded bodies share an edge, more than two facets meet there, and sheets end.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ebamcheck.mesh.topology import edge_groups

SEVERAL = -1
"""In place of the sheet of a vertex, point or side that several sheets share."""


def sheets_of_vertices(faces: NDArray[np.int32], count: int) -> NDArray[np.int32]:
    """Return the sheet of each vertex.

    Parameters
    ----------
    faces
        (F, 3) vertices of each facet; those with a repeated vertex belong to no sheet.
    count
        Number V of vertices.

    Returns
    -------
    NDArray[np.int32]
        (V,) number of the sheet of all facets at a vertex; :data:`SEVERAL` where they belong to different ones, or there are none.
    """
    # Few meshes need them, and loading them takes longer than slicing a small part.
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    groups = edge_groups(faces, count)
    two = groups.starts[:-1][np.diff(groups.starts) == 2]
    a, b = groups.half_edges[two] // 3, groups.half_edges[two + 1] // 3
    graph = coo_array((np.ones(len(a), np.bool_), (a, b)), shape=(len(faces), len(faces)))
    _, sheet = connected_components(graph, directed=False)
    tails = faces.reshape(-1)[groups.half_edges]
    found = sheet[groups.half_edges // 3].astype(np.int32)
    result = np.full(count, SEVERAL, np.int32)
    result[tails] = found
    result[tails[result[tails] != found]] = SEVERAL
    return result

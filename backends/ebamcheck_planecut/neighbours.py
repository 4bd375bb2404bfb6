"""Neighbours of the facets of a mesh that is sorted by height.

An edge is found at its lower vertex. Facets begin with their lowest vertex and are sorted by it, so two edges of each are found
there directly. The third edge begins at the middle vertex, which has a linked list of its facets. So no half-edges need
sorting, and ranges of vertices can be shared among threads.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ebamcheck.mesh.topology import NO_TWIN, pair_fan
from ebamcheck.numeric.kernels import kernel, run_blocks
from ebamcheck.numeric.sorting import as_floats, put_in_order, stable_order

Floats = NDArray[np.float64]
Index = NDArray[np.int32]

SMALLEST_BLOCK = 16384
"""Fewest vertices worth a thread."""

NONE = -1
"""End of a linked list of facets."""

FEW = 64
"""Most half-edges at a vertex that are sorted by insertion."""


class Neighbours(NamedTuple):
    """Which facets meet at which edges."""

    twin: Index
    """(3 F,) half-edge across each half-edge, :data:`ebamcheck.mesh.topology.NO_TWIN` at an open one."""
    is_open: bool
    """Whether any half-edge has no twin, so that there are open paths."""
    mixed: bool
    """Whether any two neighbours run in the same direction along their edge, because one of them is flipped."""
    fans: bool
    """Whether more than two facets meet at any edge; which of them are neighbours depends on their angles."""


def neighbours(vertices: Floats, faces: Index, first: Index) -> Neighbours:
    """Find the neighbours of all facets; more than two at an edge are paired as in :func:`~ebamcheck.mesh.topology.twins`.

    Parameters
    ----------
    vertices, faces, first
        Columns of a :class:`~ebamcheck_planecut.sorted_mesh.SortedMesh`.
    """
    twin = np.empty(3 * len(faces), np.int32)
    chain, following = np.full(len(vertices), NONE, np.int32), np.empty(len(faces), np.int32)
    _chain(faces, chain, following)
    found = run_blocks(
        lambda a, b: _match(vertices, faces, first, chain, following, twin, a, b),
        len(vertices),
        SMALLEST_BLOCK,
    )
    is_open, mixed, fans = (any(block[k] for block in found) for k in range(3))
    return Neighbours(twin, is_open, mixed, fans)


@kernel
def _chain(faces: Index, chain: Index, following: Index) -> None:
    """Chain the facets of each middle vertex, rising: the first in `chain`, the one after each in `following`."""
    for f in range(faces.shape[0] - 1, -1, -1):
        middle = min(faces[f, 1], faces[f, 2])
        following[f] = chain[middle]
        chain[middle] = f


@kernel
def _match(
    vertices: Floats,
    faces: Index,
    first: Index,
    chain: Index,
    following: Index,
    twin: Index,
    start: int,
    stop: int,
) -> tuple[bool, bool, bool]:
    """Write the twins at edges whose lower vertex is one of ``[start, stop)``; tells if any is open, mixed or a fan."""
    corners = faces.reshape(-1)
    is_open = mixed = fans = False
    half_edges, upper = np.empty(FEW, np.int32), np.empty(FEW, np.int32)
    for v in range(start, stop):
        most = 2 * (first[v + 1] - first[v])
        f = chain[v]
        while f != NONE:
            most += 1
            f = following[f]
        if most > upper.size:
            half_edges, upper = np.empty(2 * most, np.int32), np.empty(2 * most, np.int32)
        count = 0
        # Facets of which v is the middle vertex begin lower, and so have lesser numbers than those that begin here.
        f = chain[v]
        while f != NONE:
            half_edges[count], upper[count] = 3 * f + 1, max(corners[3 * f + 1], corners[3 * f + 2])
            count += 1
            f = following[f]
        for f in range(first[v], first[v + 1]):
            half_edges[count], upper[count] = 3 * f, corners[3 * f + 1]
            half_edges[count + 1], upper[count + 1] = 3 * f + 2, corners[3 * f + 2]
            count += 2
        _sort(half_edges[:count], upper[:count])
        at = 0
        while at < count:
            past = at + 1
            while past < count and upper[past] == upper[at]:
                past += 1
            if past - at == 2:
                g, h = half_edges[at], half_edges[at + 1]
                twin[g], twin[h] = h, g
                mixed |= corners[g] == corners[h]
            else:
                fans |= past - at > 2
                pair_fan(vertices, faces, half_edges[at:past], twin)
                for g in half_edges[at:past]:
                    is_open |= twin[g] == NO_TWIN
                    mixed |= twin[g] != NO_TWIN and corners[g] == corners[twin[g]]
            at = past
    return is_open, mixed, fans


@kernel
def _sort(half_edges: Index, upper: Index) -> None:
    """Order half-edges by their upper vertex, keeping those of one edge as they stand."""
    if upper.size > FEW:
        order = stable_order(as_floats(upper))
        put_in_order(half_edges, order)
        put_in_order(upper, order)
        return
    for i in range(1, upper.size):
        key, value = upper[i], half_edges[i]
        k = i
        while k > 0 and upper[k - 1] > key:
            upper[k], half_edges[k] = upper[k - 1], half_edges[k - 1]
            k -= 1
        upper[k], half_edges[k] = key, value

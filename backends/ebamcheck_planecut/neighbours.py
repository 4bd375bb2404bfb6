"""Neighbours of the facets of a mesh that is sorted by height.

An edge is found at its lower vertex. Facets begin with their lowest vertex and are sorted by it, so two edges of each are found
there directly. The third edge begins at the middle vertex, which has a linked list of its facets. So no half-edges need
sorting, and ranges of vertices can be shared among threads.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ebamcheck.kernels import kernel
from ebamcheck.mesh.topology import NO_TWIN, pair_fan
from ebamcheck.threads import run_blocks

Floats = NDArray[np.float64]
Index = NDArray[np.int32]
Ints = NDArray[np.int64]

SMALLEST_BLOCK = 16384  # fewest vertices worth a thread
NONE = -1  # end of a linked list of facets


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
    """Find the neighbours of all facets of a sorted mesh; of more than two at an edge pairs by their angles."""
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
    edges, half_edges = np.empty(64, np.int64), np.empty(64, np.int32)
    for v in range(start, stop):
        most = 2 * (first[v + 1] - first[v])
        f = chain[v]
        while f != NONE:
            most += 1
            f = following[f]
        if most > edges.size:
            edges, half_edges = np.empty(2 * most, np.int64), np.empty(2 * most, np.int32)
        # Each by its upper vertex, then by its number.
        count = 0
        f = chain[v]
        while f != NONE:
            edges[count] = (np.int64(max(corners[3 * f + 1], corners[3 * f + 2])) << 32) | (3 * f + 1)
            count += 1
            f = following[f]
        for f in range(first[v], first[v + 1]):
            edges[count] = (np.int64(corners[3 * f + 1]) << 32) | (3 * f)
            edges[count + 1] = (np.int64(corners[3 * f + 2]) << 32) | (3 * f + 2)
            count += 2
        _sort(edges, count)
        for n in range(count):
            half_edges[n] = edges[n] & 0xFFFFFFFF
        at = 0
        while at < count:
            past = at + 1
            while past < count and edges[past] >> 32 == edges[at] >> 32:
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
def _sort(keys: Ints, count: int) -> None:
    """Sort the first `count` keys: by insertion if they are few, else by Shell's method."""
    gap = 1
    while gap < count // 64:
        gap = 3 * gap + 1
    while gap > 0:
        for i in range(gap, count):
            key = keys[i]
            k = i
            while k >= gap and keys[k - gap] > key:
                keys[k] = keys[k - gap]
                k -= gap
            keys[k] = key
        gap //= 3

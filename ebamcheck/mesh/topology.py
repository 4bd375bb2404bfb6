"""Topology of a mesh: the facets that meet at each edge, the twin of each half-edge, and the facets that hang together.

Half-edge ``3 f + i`` is the edge from corner i to corner i + 1 of facet f, in the facet's own direction.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ebamcheck.kernels import kernel

Index = NDArray[np.int32]
Ints = NDArray[np.int64]

NO_TWIN = -1


class EdgeGroups(NamedTuple):
    """Half-edges grouped by the undirected edge that they lie on."""

    half_edges: Index
    """(H,) half-edges, those of one edge next to each other; facets with a repeated corner have none."""
    starts: Index
    """(E + 1,) index in `half_edges` of the first of each edge."""


@kernel
def edge_groups(faces: Index, vertex_count: int) -> EdgeGroups:
    """Group the half-edges of all non-degenerate facets by edge; O(F), without hashing."""
    count = faces.shape[0]
    # Bucket half-edges by their lesser vertex: there are six in a bucket on average.
    bucket = np.zeros(vertex_count + 1, np.int32)
    for f in range(count):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        if a == b or b == c or c == a:
            continue
        bucket[min(a, b)] += 1
        bucket[min(b, c)] += 1
        bucket[min(c, a)] += 1
    total = 0
    for v in range(vertex_count + 1):
        size = bucket[v]
        bucket[v] = total
        total += size
    half_edges = np.empty(total, np.int32)
    other = np.empty(total, np.int32)
    fill = bucket.copy()
    for f in range(count):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        if a == b or b == c or c == a:
            continue
        for i in range(3):
            tail, head = faces[f, i], faces[f, (i + 1) % 3]
            at = fill[min(tail, head)]
            fill[min(tail, head)] += 1
            half_edges[at] = 3 * f + i
            other[at] = max(tail, head)
    starts = np.empty(total + 1, np.int32)
    edges = 0
    for v in range(vertex_count):
        first, last = bucket[v], bucket[v + 1]
        # By insertion, as they are few; where a crowd of facets meets by Shell's method. Half-edges of one edge keep their order.
        gap = 1
        while gap < (last - first) // 64:
            gap = 3 * gap + 1
        while gap > 0:
            for i in range(first + gap, last):
                key, value = other[i], half_edges[i]
                j = i - gap
                while j >= first and (other[j] > key or (other[j] == key and half_edges[j] > value)):
                    other[j + gap], half_edges[j + gap] = other[j], half_edges[j]
                    j -= gap
                other[j + gap], half_edges[j + gap] = key, value
            gap //= 3
        for i in range(first, last):
            if i == first or other[i] != other[i - 1]:
                starts[edges] = i
                edges += 1
    starts[edges] = total
    return EdgeGroups(half_edges, starts[: edges + 1].copy())


@kernel
def twins(vertices: NDArray[np.float64], faces: Index, half_edges: Index, starts: Index) -> Index:
    """Half-edge across each half-edge (3 F,), :data:`NO_TWIN` at an open one.

    Two facets at an edge are each other's neighbours, whatever way they are turned. More are paired
    around the edge so that the solid lies between the two of a pair: bodies that touch along an edge stay
    apart. What is left over (an odd number, or sheets without an inside) stays open.
    """
    result = np.full(3 * faces.shape[0], NO_TWIN, np.int32)
    for e in range(starts.size - 1):
        a, b = starts[e], starts[e + 1]
        if b - a == 2:
            result[half_edges[a]] = half_edges[a + 1]
            result[half_edges[a + 1]] = half_edges[a]
        else:
            pair_fan(vertices, faces, half_edges[a:b], result)
    return result


@kernel
def pair_fan(vertices: NDArray[np.float64], faces: Index, fan: Index, result: Index) -> None:
    """Write the twins (3 F,) of the half-edges of one edge, where it has one or more than two; see :func:`twins`."""
    n = fan.size
    for h in fan:
        result[h] = NO_TWIN
    if n < 2:
        return
    tail, head = faces[fan[0] // 3, fan[0] % 3], faces[fan[0] // 3, (fan[0] % 3 + 1) % 3]
    low, high = min(tail, head), max(tail, head)
    axis, u, w, angle = np.empty(3), np.zeros(3), np.empty(3), np.empty(n)
    for k in range(3):
        axis[k] = vertices[high, k] - vertices[low, k]
    _normalise(axis)
    # Two directions across the edge span the plane in which angles are measured.
    least = 0
    for k in range(1, 3):
        if abs(axis[k]) < abs(axis[least]):
            least = k
    u[least] = 1.0
    along = u[0] * axis[0] + u[1] * axis[1] + u[2] * axis[2]
    for k in range(3):
        u[k] -= axis[k] * along
    _normalise(u)
    w[0] = axis[1] * u[2] - axis[2] * u[1]
    w[1] = axis[2] * u[0] - axis[0] * u[2]
    w[2] = axis[0] * u[1] - axis[1] * u[0]
    # Facets at one angle: those that close a solid come first, and copies nest as they stand in the mesh, so that each body
    # stays apart at all of its edges.
    order, placed = np.empty(n, np.int32), 0
    forward = np.empty(n, np.bool_)
    for turn in range(2 * n):
        i = n - 1 - turn if turn < n else turn - n
        h = fan[i]
        forward[i] = faces[h // 3, h % 3] == low
        if forward[i] != (turn < n):
            continue
        third = faces[h // 3, (h % 3 + 2) % 3]
        x, y, z = (
            vertices[third, 0] - vertices[low, 0],
            vertices[third, 1] - vertices[low, 1],
            vertices[third, 2] - vertices[low, 2],
        )
        angle[i] = np.arctan2(x * w[0] + y * w[1] + z * w[2], x * u[0] + y * u[1] + z * u[2])
        k = placed
        while k > 0 and angle[order[k - 1]] > angle[i]:
            order[k] = order[k - 1]
            k -= 1
        order[k] = i
        placed += 1
    # A facet that runs low -> high has the normal axis x across, towards growing angles: its solid lies before it,
    # that of a backward facet behind it. Backward opens and forward closes a solid wedge; wedges nest like brackets.
    stack = np.empty(2 * n, np.int32)
    paired = np.zeros(n, np.bool_)
    depth = 0
    for step in range(2 * n):
        i = order[step % n]
        if paired[i]:
            continue
        if not forward[i]:
            if step < n:
                stack[depth] = i
                depth += 1
        elif depth > 0:
            depth -= 1
            k = stack[depth]
            paired[i] = paired[k] = True
            result[fan[i]] = fan[k]
            result[fan[k]] = fan[i]


@kernel
def _normalise(vector: NDArray[np.float64]) -> None:
    length = math.sqrt(vector[0] * vector[0] + vector[1] * vector[1] + vector[2] * vector[2])
    for k in range(3):
        vector[k] = vector[k] / length


def split_corners(faces: Index, twin: Index) -> Index:
    """Number the corners of facets (F, 3) so that two share a number only where neighbours by `twin` do.

    Bodies that touch along an edge or at a vertex come apart: each gets vertices of its own at the same places.
    Neighbours that run the same way along their edge are left apart.
    """
    corners = faces.ravel()
    h = np.flatnonzero(twin > np.arange(twin.size))
    h = h[corners[h] != corners[twin[h]]]
    g = twin[h].astype(np.int64)
    after_h, after_g = (np.where(k % 3 == 2, k - 2, k + 1) for k in (h, g))
    return _components(corners.size, np.concatenate([h, after_h]), np.concatenate([after_g, g])).reshape(
        -1, 3
    )


def body_labels(faces: Index, groups: EdgeGroups) -> Index:
    """Body of each facet (F,): facets that share an edge are one body; -1 for degenerate facets."""
    facets = groups.half_edges // 3
    first = np.repeat(facets[groups.starts[:-1]], np.diff(groups.starts))
    label = _components(len(faces), first.astype(np.int64), facets.astype(np.int64))
    known = np.zeros(len(faces), np.bool_)
    known[facets] = True
    if known.all():
        return label
    label[~known] = -1
    used = np.zeros(len(faces) + 1, np.int32)
    used[label[known]] = 1
    label[known] = (np.cumsum(used) - 1)[label[known]]
    return label


@kernel
def _components(count: int, a: Ints, b: Ints) -> Index:
    """Component (count,) of each item where items `a` and `b` (N,) hang together; numbered by their first items."""
    root = np.arange(count)
    for n in range(a.size):
        i, j = a[n], b[n]
        while root[i] != i:
            root[i] = root[root[i]]
            i = root[i]
        while root[j] != j:
            root[j] = root[root[j]]
            j = root[j]
        root[max(i, j)] = min(i, j)
    label = np.empty(count, np.int32)
    found = 0
    for i in range(count):
        # Roots are lesser than their members, so the parent is labelled by now.
        if root[i] == i:
            label[i] = found
            found += 1
        else:
            label[i] = label[root[i]]
    return label


def direction_balance(faces: Index, groups: EdgeGroups) -> Index:
    """Difference between the numbers of facets in the two directions of each edge (E,): 0 if they pair."""
    half_edge, corners = groups.half_edges, faces.ravel()
    ends = corners[np.where(half_edge % 3 == 2, half_edge - 2, half_edge + 1)]
    way = np.where(corners[half_edge] < ends, np.int32(1), np.int32(-1))
    return np.add.reduceat(way, groups.starts[:-1], dtype=np.int32) if len(way) else way


def duplicates(faces: Index) -> int:
    """Number of facets with the same three vertices as an earlier one, in any order."""
    if not len(faces):
        return 0
    least, greatest = faces.min(axis=1).astype(np.int64), faces.max(axis=1).astype(np.int64)
    middle = faces.sum(axis=1, dtype=np.int64) - least - greatest
    bits = 21
    if greatest.max() < 1 << bits:
        keys = np.sort((least << (2 * bits)) | (middle << bits) | greatest)
        return int(np.count_nonzero(keys[1:] == keys[:-1]))
    return len(faces) - len(np.unique(np.stack([least, middle, greatest], axis=1), axis=0))

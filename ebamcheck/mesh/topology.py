"""Topology of a mesh: the facets that meet at each edge, the twin of each half-edge, and the facets that hang together.

Half-edge ``3 f + i`` is the edge from corner i to corner i + 1 of facet f, in the facet's own direction.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.sorting import as_floats, put_in_order, stable_order

Index = NDArray[np.int32]

NO_TWIN = -1


class EdgeGroups(NamedTuple):
    """Half-edges grouped by the undirected edge that they lie on."""

    half_edges: Index
    """(H,) half-edges, those of one edge next to each other; facets with a repeated corner have none."""
    starts: Index
    """(E + 1,) index in `half_edges` of the first of each edge."""


def edge_groups(faces: Index, vertex_count: int) -> EdgeGroups:
    """Group the half-edges of all non-degenerate facets by edge; O(F), without sorting or hashing.

    Examples
    --------
    >>> two = np.array([[0, 1, 2], [2, 1, 3]], np.int32)
    >>> groups = edge_groups(two, 4)
    >>> sorted(np.diff(groups.starts).tolist())
    [1, 1, 1, 1, 2]
    """
    return EdgeGroups(*_group(faces, vertex_count))


@kernel
def _group(faces: Index, vertex_count: int) -> tuple[Index, Index]:
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
        if last - first > 64:
            order = stable_order(as_floats(other[first:last]))
            put_in_order(half_edges[first:last], order)
            put_in_order(other[first:last], order)
        else:
            for i in range(first + 1, last):
                key, value = other[i], half_edges[i]
                j = i - 1
                while j >= first and other[j] > key:
                    other[j + 1], half_edges[j + 1] = other[j], half_edges[j]
                    j -= 1
                other[j + 1], half_edges[j + 1] = key, value
        for i in range(first, last):
            if i == first or other[i] != other[i - 1]:
                starts[edges] = i
                edges += 1
    starts[edges] = total
    return half_edges, starts[: edges + 1].copy()


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
    for h in fan:
        result[h] = NO_TWIN
    if fan.size > 1:
        _pair_around(*_fan(vertices, faces, fan), fan, result)


@kernel
def _fan(
    vertices: NDArray[np.float64], faces: Index, fan: Index
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Ends of the edge of some half-edges and the third corners of their facets, (2 + n, 3), and which run low to high."""
    h = fan[0]
    tail, head = faces[h // 3, h % 3], faces[h // 3, (h % 3 + 1) % 3]
    low, high = min(tail, head), max(tail, head)
    corners, forward = np.empty((2 + fan.size, 3)), np.empty(fan.size, np.bool_)
    for axis in range(3):
        corners[0, axis], corners[1, axis] = vertices[low, axis], vertices[high, axis]
        for i in range(fan.size):
            corners[2 + i, axis] = vertices[faces[fan[i] // 3, (fan[i] % 3 + 2) % 3], axis]
    for i in range(fan.size):
        forward[i] = faces[fan[i] // 3, fan[i] % 3] == low
    return corners, forward


@kernel
def _pair_around(corners: NDArray[np.float64], forward: NDArray[np.bool_], fan: Index, result: Index) -> None:
    """Pair the half-edges of one edge by the angle of their facets around it; see :func:`_fan`."""
    n = fan.size
    axis, u, w, angle = np.empty(3), np.zeros(3), np.empty(3), np.empty(n)
    for k in range(3):
        axis[k] = corners[1, k] - corners[0, k]
    _normalise(axis)
    # Two directions across the edge span the plane in which angles are measured.
    least = 0
    for k in range(1, 3):
        if abs(axis[k]) < abs(axis[least]):
            least = k
    u[least] = 1.0
    along = _dot(u, axis)
    for k in range(3):
        u[k] -= axis[k] * along
    _normalise(u)
    w[0] = axis[1] * u[2] - axis[2] * u[1]
    w[1] = axis[2] * u[0] - axis[0] * u[2]
    w[2] = axis[0] * u[1] - axis[1] * u[0]
    across = np.empty(3)
    for i in range(n):
        for k in range(3):
            across[k] = corners[2 + i, k] - corners[0, k]
        angle[i] = np.arctan2(_dot(across, w), _dot(across, u))
    # Facets at one angle: those that close a solid come first, and copies nest as they stand in the mesh, so that each body
    # stays apart at all of its edges.
    first = np.empty(n, np.int32)
    closing = 0
    for i in range(n - 1, -1, -1):
        if forward[i]:
            first[closing] = i
            closing += 1
    opening = closing
    for i in range(n):
        if not forward[i]:
            first[opening] = i
            opening += 1
    order = first[stable_order(angle[first])]
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
def _dot(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    return float(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


@kernel
def _normalise(vector: NDArray[np.float64]) -> None:
    length = math.sqrt(_dot(vector, vector))
    for k in range(3):
        vector[k] = np.true_divide(vector[k], length)


@kernel
def split_corners(faces: Index, twin: Index) -> Index:
    """Number the corners of facets (F, 3) so that two share a number only where neighbours by `twin` do.

    Bodies that touch along an edge or at a vertex come apart: each gets vertices of its own at the same places.
    Neighbours that run the same way along their edge are left apart.
    """
    count = 3 * faces.shape[0]
    root = np.arange(count)
    for h in range(count):
        g = twin[h]
        if g < h or faces[h // 3, h % 3] == faces[g // 3, g % 3]:
            continue
        after_h, after_g = 3 * (h // 3) + (h % 3 + 1) % 3, 3 * (g // 3) + (g % 3 + 1) % 3
        for side in range(2):
            a, b = (h, after_g) if side == 0 else (after_h, g)
            while root[a] != a:
                root[a] = root[root[a]]
                a = root[a]
            while root[b] != b:
                root[b] = root[root[b]]
                b = root[b]
            root[max(a, b)] = min(a, b)
    label = np.full(count, -1, np.int32)
    corners = 0
    for c in range(count):
        r = c
        while root[r] != r:
            r = root[r]
        if label[r] < 0:
            label[r] = corners
            corners += 1
        label[c] = label[r]
    return label.reshape(-1, 3)


def body_labels(faces: Index, groups: EdgeGroups) -> Index:
    """Body of each facet (F,): facets that share an edge are one body; -1 for degenerate facets."""
    return _bodies(len(faces), groups.half_edges, groups.starts)


@kernel
def _bodies(count: int, half_edges: Index, starts: Index) -> Index:
    """Union-find over the facets of every edge; bodies are numbered by their first facet."""
    root = np.full(count, -1, np.int32)
    for h in half_edges:
        root[h // 3] = h // 3
    for e in range(starts.size - 1):
        for i in range(starts[e] + 1, starts[e + 1]):
            a, b = half_edges[starts[e]] // 3, half_edges[i] // 3
            while root[a] != a:
                root[a] = root[root[a]]
                a = root[a]
            while root[b] != b:
                root[b] = root[root[b]]
                b = root[b]
            # The lesser facet stays the root, so that a body's root is its first facet.
            if a < b:
                root[b] = a
            else:
                root[a] = b
    label = np.full(count, -1, np.int32)
    bodies = 0
    for f in range(count):
        if root[f] < 0:
            continue
        if root[f] == f:
            label[f] = bodies
            bodies += 1
        else:
            # Roots are lesser than their members, so the parent is labelled by now.
            label[f] = label[root[f]]
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

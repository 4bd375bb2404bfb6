"""Topology of a mesh: equal vertices merged, the facets that meet at each edge, the twin of each half-edge, and the facets that
hang together.

Half-edge ``3 f + i`` is the edge from corner i to corner i + 1 of facet f, in the facet's own direction.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ebamcheck.kernels import Floats, Ints, ShortInts, kernel
from ebamcheck.threads import run_blocks

Index = NDArray[np.int32]

NO_TWIN = -1


class EdgeGroups(NamedTuple):
    """Half-edges grouped by the undirected edge that they lie on."""

    half_edges: Index  # (H,) half-edges, those of one edge next to each other; facets with a repeated corner have none
    starts: Index  # (E + 1,) index in `half_edges` of the first of each edge


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
def twins(vertices: Floats, faces: Index, half_edges: Index, starts: Index) -> Index:
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
def pair_fan(vertices: Floats, faces: Index, fan: Index, result: Index) -> None:
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
    length = math.sqrt(axis[0] * axis[0] + axis[1] * axis[1] + axis[2] * axis[2])
    for k in range(3):
        axis[k] /= length
    # Two directions across the edge span the plane in which angles are measured.
    least = 0
    for k in range(1, 3):
        if abs(axis[k]) < abs(axis[least]):
            least = k
    u[least] = 1.0
    along = u[0] * axis[0] + u[1] * axis[1] + u[2] * axis[2]
    for k in range(3):
        u[k] -= axis[k] * along
    length = math.sqrt(u[0] * u[0] + u[1] * u[1] + u[2] * u[2])
    for k in range(3):
        u[k] /= length
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


def split_corners(faces: Index, twin: Index) -> Index:
    """Number the corners of facets (F, 3) by body: two share a number only where `twin` makes them neighbours."""
    corners = faces.ravel()
    h = np.flatnonzero(twin > np.arange(twin.size))
    h = h[corners[h] != corners[twin[h]]]
    g = twin[h].astype(np.int64)
    after_h, after_g = (np.where(k % 3 == 2, k - 2, k + 1) for k in (h, g))
    number = components(corners.size, np.concatenate([h, after_h]), np.concatenate([after_g, g]))
    return number.reshape(-1, 3)


def body_labels(faces: Index, groups: EdgeGroups) -> Index:
    """Body of each facet (F,): facets that share an edge are one body; -1 for degenerate facets."""
    facets = groups.half_edges // 3
    first = np.repeat(facets[groups.starts[:-1]], np.diff(groups.starts))
    label = components(len(faces), first, facets)
    known = np.zeros(len(faces), np.bool_)
    known[facets] = True
    if known.all():
        return label
    label[~known] = -1
    used = np.zeros(len(faces) + 1, np.int32)
    used[label[known]] = 1
    label[known] = (np.cumsum(used) - 1)[label[known]]
    return label


def components(count: int, a: NDArray[np.integer], b: NDArray[np.integer]) -> Index:
    """Component (count,) of each item where items `a` and `b` (N,) hang together; numbered by their first items."""
    return _components(count, *(np.ascontiguousarray(items, np.int64) for items in (a, b)))


@kernel
def _components(count: int, a: Ints, b: Ints) -> Index:
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
    least, middle, greatest = np.sort(faces, axis=1).astype(np.int64).T
    bits = 21
    if greatest.max() >= 1 << bits:
        return len(faces) - len(np.unique(np.sort(faces, axis=1), axis=0))
    keys = np.sort((least << (2 * bits)) | (middle << bits) | greatest)
    return int(np.count_nonzero(keys[1:] == keys[:-1]))


# Approximate number of corners of a share: with their hash table they fit in the second-level cache of a core
SHARE = 4096

MOST_SHARES = 1024  # most shares: writing to more streams at once costs more than it saves
SMALLEST_BLOCK = 16384  # fewest corners worth a thread

EMPTY = -1

Corners = NDArray[Any]
Keys = NDArray[Any]
Rows = ShortInts


def weld(triangles: NDArray[np.float32] | Floats) -> tuple[Floats, ShortInts]:
    """Merge corners (F, 3, 3) of equal bits (0 and -0 are equal): vertices (V, 3) by first appearance, faces (F, 3)."""
    corners = np.ascontiguousarray(triangles).reshape(-1, 3)
    earliest = _earliest(corners)
    is_first = earliest == np.arange(len(earliest))
    number = np.cumsum(is_first, dtype=np.int32) - np.int32(1)
    return corners[is_first].astype(np.float64) + 0.0, number[earliest].reshape(-1, 3)


def _earliest(corners: Corners) -> Rows:
    """First row that equals each row, (N,)."""
    count = len(corners)
    keys = corners.view(np.uint32 if corners.dtype == np.float32 else np.uint64)
    shares = min(1 << (count // SHARE).bit_length(), MOST_SHARES)
    share = np.empty(count, np.uint16)
    sizes: dict[int, Ints] = {}

    def choose(start: int, stop: int) -> None:
        sizes[start] = _choose(corners, keys, share, shares, start, stop)

    run_blocks(choose, count, SMALLEST_BLOCK)
    # Within a share, rows of an earlier block come before those of a later one.
    by_block = np.stack([sizes[start] for start in sorted(sizes)])
    starts = np.concatenate([[0], np.cumsum(by_block.sum(axis=0))])
    places = dict(zip(sorted(sizes), starts[:-1] + np.cumsum(by_block, axis=0) - by_block, strict=True))
    dealt = np.empty((count, 4), keys.dtype)
    run_blocks(lambda a, b: _deal(corners, keys, share, places[a], dealt, a, b), count, SMALLEST_BLOCK)
    result = np.empty(count, np.int32)
    run_blocks(lambda a, b: _weld_shares(dealt, starts[a : b + 1], result), shares)
    return result


@kernel
def _bits(corners: Corners, keys: Keys, i: int) -> tuple[np.uint64, np.uint64, np.uint64]:
    """Bits of the coordinates of a corner; those of 0 for -0."""
    zero = np.uint64(0)
    x = np.uint64(keys[i, 0]) if corners[i, 0] != 0.0 else zero
    y = np.uint64(keys[i, 1]) if corners[i, 1] != 0.0 else zero
    return x, y, np.uint64(keys[i, 2]) if corners[i, 2] != 0.0 else zero


@kernel
def _hash(x: np.uint64, y: np.uint64, z: np.uint64) -> np.uint64:
    mixed = (x * np.uint64(0x9E3779B97F4A7C15)) ^ (y * np.uint64(0xC2B2AE3D27D4EB4F))
    mixed = (mixed ^ (mixed >> np.uint64(29))) * np.uint64(0xBF58476D1CE4E5B9)
    mixed = (mixed ^ (z * np.uint64(0x94D049BB133111EB))) * np.uint64(0xFF51AFD7ED558CCD)
    return mixed ^ (mixed >> np.uint64(32))


@kernel
def _choose(corners: Corners, keys: Keys, share: NDArray[np.uint16], shares: int, start: int, stop: int) -> Ints:
    """Write the share of each of the rows ``[start, stop)``; returns how many fell to each share."""
    sizes = np.zeros(shares, np.int64)
    last = np.uint64(shares - 1)
    for i in range(start, stop):
        x, y, z = _bits(corners, keys, i)
        mixed = _hash(x, y, z)
        # The upper half chooses the share, the lower one the place in its table.
        s = np.int64((mixed >> np.uint64(40)) & last)
        share[i] = s
        sizes[s] += 1
    return sizes


@kernel
def _deal(
    corners: Corners, keys: Keys, share: NDArray[np.uint16], places: Ints, dealt: Keys, start: int, stop: int
) -> None:
    """Copy bits and number of the rows ``[start, stop)`` to the `places` of their shares, which move on."""
    for i in range(start, stop):
        at = places[share[i]]
        places[share[i]] += 1
        dealt[at, 0], dealt[at, 1], dealt[at, 2] = _bits(corners, keys, i)
        dealt[at, 3] = i


@kernel
def _weld_shares(dealt: Keys, starts: Ints, earliest: Rows) -> None:
    """Find the first equal row of each row of some shares: an open-addressing hash for each share."""
    most = 0
    for s in range(starts.size - 1):
        most = max(most, starts[s + 1] - starts[s])
    size = 16
    while size < 2 * most:
        size *= 2
    table = np.empty(size, np.int32)
    mask = np.uint64(size - 1)
    for s in range(starts.size - 1):
        table[:] = EMPTY
        for i in range(starts[s], starts[s + 1]):
            x, y, z = np.uint64(dealt[i, 0]), np.uint64(dealt[i, 1]), np.uint64(dealt[i, 2])
            slot = _hash(x, y, z) & mask
            while True:
                k = table[slot]
                if k == EMPTY:
                    table[slot] = k = i
                if dealt[k, 0] == dealt[i, 0] and dealt[k, 1] == dealt[i, 1] and dealt[k, 2] == dealt[i, 2]:
                    break
                slot = (slot + np.uint64(1)) & mask
            earliest[dealt[i, 3]] = dealt[k, 3]

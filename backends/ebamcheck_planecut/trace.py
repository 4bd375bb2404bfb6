"""Kernels that cut facets and walk around each ring of a layer.

A vertex is *above* plane k if z > h_k, which is the same as ``level > k`` for the number `level` of heights under
z. A facet is cut by the planes between its least and greatest level; those are integers, so every facet and every
neighbour agrees on every cut, and the section is that of z = h + 0 exactly. A cut point depends on the edge alone
(from its lower to its upper vertex), so both facets of an edge get the same bits.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ebamcheck.kernels import kernel

Floats = NDArray[np.float64]
Index = NDArray[np.int32]
Ints = NDArray[np.int64]


@kernel
def facet_spans(levels: Index, faces: Index) -> tuple[Index, Index]:
    """First layer that cuts each facet (F,), and the one after the last."""
    count = faces.shape[0]
    first = np.empty(count, np.int32)
    last = np.empty(count, np.int32)
    for f in range(count):
        a, b, c = levels[faces[f, 0]], levels[faces[f, 1]], levels[faces[f, 2]]
        first[f] = min(a, b, c)
        last[f] = max(a, b, c)
    return first, last


@kernel
def facets_by_layer(first: Index, last: Index, start: int, stop: int) -> tuple[Ints, Index]:
    """Facets cut by each of the layers ``start .. stop - 1``: starts (n + 1,) and facets, by counting sort."""
    change = np.zeros(stop - start + 1, np.int64)
    for f in range(first.size):
        a, b = max(first[f], start), min(last[f], stop)
        if a < b:
            change[a - start] += 1
            change[b - start] -= 1
    starts = np.zeros(stop - start + 1, np.int64)
    active = 0
    for k in range(stop - start):
        active += change[k]
        starts[k + 1] = starts[k] + active
    facets = np.empty(starts[-1], np.int32)
    fill = starts[:-1].copy()
    for f in range(first.size):
        a, b = max(first[f], start), min(last[f], stop)
        for k in range(a - start, b - start):
            facets[fill[k]] = f
            fill[k] += 1
    return starts, facets


@kernel
def mixed_directions(faces: Index, twin: Index) -> bool:
    """Whether two neighbours run the same way along their edge, as they do where one of them is flipped."""
    for h in range(twin.size):
        g = twin[h]
        if g > h and faces[h // 3, h % 3] == faces[g // 3, g % 3]:
            return True
    return False


@kernel
def _cut_edges(levels: Index, faces: Index, f: int, k: int) -> tuple[int, int]:
    """Corners of facet `f` whose half-edges the section enters (running down) and leaves by (running up).

    With the normal outwards, the solid then lies to the left of the way from entry to exit.
    """
    a = levels[faces[f, 0]] > k
    b = levels[faces[f, 1]] > k
    c = levels[faces[f, 2]] > k
    down = 0 if a and not b else (1 if b and not c else 2)
    up = 0 if b and not a else (1 if c and not b else 2)
    return down, up


@kernel
def trace_layers(
    vertices: Floats,
    faces: Index,
    levels: Index,
    twin: Index,
    heights: Floats,
    start: int,
    layer_starts: Ints,
    layer_facets: Index,
    open_mesh: bool,
    mixed: bool,
) -> tuple[Floats, Index, Floats, Ints, Ints, NDArray[np.bool_]]:
    """Trace the rings and open paths of layers ``start .. start + n - 1``.

    Returns
    -------
    points (N, 2), edge (N, 2), edge_t (N,), ring_starts (R + 1,), rings_of_layer (n + 1,), closed (R,)
        Rings in the order of their first facets; solid on the left.
    """
    layers = layer_starts.size - 1
    segments = layer_facets.size
    # A closed ring has a point a segment, an open path one more.
    capacity = 2 * segments if open_mesh else segments
    points = np.empty((capacity, 2))
    edge = np.empty((capacity, 2), np.int32)
    edge_t = np.empty(capacity)
    ring_starts = np.empty(segments + 1, np.int64)
    closed = np.empty(segments, np.bool_)
    rings_of_layer = np.zeros(layers + 1, np.int64)
    seen = np.full(faces.shape[0], -1, np.int32)
    ring_starts[0] = 0
    rings = 0
    filled = 0
    for n in range(layers):
        k = start + n
        h = heights[k]
        # Open paths first, from their ends, so that no walk starts in the middle of one; an end where the section
        # enters a facet is the natural start, one where it leaves is a start only between flipped facets.
        for phase in range(0 if open_mesh else 2, 3):
            for s in range(layer_starts[n], layer_starts[n + 1]):
                seed = layer_facets[s]
                if seen[seed] == k:
                    continue
                down, up = _cut_edges(levels, faces, seed, k)
                enter, leave = down, up
                if phase == 0 and twin[3 * seed + down] >= 0:
                    continue
                if phase == 1:
                    if twin[3 * seed + up] >= 0:
                        continue
                    enter, leave = up, down
                first = filled
                f = seed
                with_facets = 0.0
                against = 0.0
                is_closed = phase == 2
                if not is_closed:
                    filled = _emit(vertices, faces, 3 * f + enter, h, points, edge, edge_t, filled)
                while True:
                    seen[f] = k
                    filled = _emit(vertices, faces, 3 * f + leave, h, points, edge, edge_t, filled)
                    if mixed and filled - first > 1:
                        length = np.hypot(
                            points[filled - 1, 0] - points[filled - 2, 0],
                            points[filled - 1, 1] - points[filled - 2, 1],
                        )
                        if leave == up:
                            with_facets += length
                        else:
                            against += length
                    across = twin[3 * f + leave]
                    if across < 0 or seen[across // 3] == k:
                        break
                    f = across // 3
                    enter = across % 3
                    down, up = _cut_edges(levels, faces, f, k)
                    leave = up if enter == down else down
                # A ring through flipped facets runs the way that the greater length of its facets says: one flipped
                # facet never outweighs the rest, as a side of a polygon is shorter than all others together.
                if against > with_facets:
                    _reverse(points, edge, edge_t, first, filled)
                closed[rings] = is_closed
                rings += 1
                ring_starts[rings] = filled
        rings_of_layer[n + 1] = rings
    return (
        points[:filled],
        edge[:filled],
        edge_t[:filled],
        ring_starts[: rings + 1].copy(),
        rings_of_layer,
        closed[:rings].copy(),
    )


@kernel
def _emit(
    vertices: Floats,
    faces: Index,
    half_edge: int,
    h: float,
    points: Floats,
    edge: Index,
    edge_t: Floats,
    at: int,
) -> int:
    """Write the point where plane `h` cuts the edge of a half-edge; returns the next free row."""
    f, i = half_edge // 3, half_edge % 3
    v, w = faces[f, i], faces[f, i + 1 if i < 2 else 0]
    low, high = (v, w) if vertices[v, 2] <= h else (w, v)
    z = vertices[low, 2]
    t = (h - z) / (vertices[high, 2] - z)
    points[at, 0] = vertices[low, 0] + t * (vertices[high, 0] - vertices[low, 0])
    points[at, 1] = vertices[low, 1] + t * (vertices[high, 1] - vertices[low, 1])
    edge[at, 0] = low
    edge[at, 1] = high
    edge_t[at] = t
    return at + 1


@kernel
def _reverse(points: Floats, edge: Index, edge_t: Floats, first: int, stop: int) -> None:
    i, j = first, stop - 1
    while i < j:
        for c in range(2):
            points[i, c], points[j, c] = points[j, c], points[i, c]
            edge[i, c], edge[j, c] = edge[j, c], edge[i, c]
        edge_t[i], edge_t[j] = edge_t[j], edge_t[i]
        i += 1
        j -= 1

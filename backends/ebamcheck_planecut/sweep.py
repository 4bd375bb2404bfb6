"""The kernel that cuts a block of layers, and finishes each while its points are in the processor's cache.

A vertex is *above* a plane if z > h, those from row `under` on; a facet is cut if it has vertices above and others. So the section
is that of z = h + 0 exactly. A cut point depends on the edge alone, so both facets of an edge get the same bits."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ebamcheck.kernels import Bools, Floats, Ints, kernel
from ebamcheck.layers.canonical_form import DROPPED, next_distinct, ring_form
from ebamcheck_planecut.overlaps import classify_layer, overlap_search
from ebamcheck_planecut.sorted_mesh import Index, SortedMesh, facets_across, raise_plane


class Columns(NamedTuple):
    """Columns of points to which all blocks of a stack write, each from a start row of its own."""

    points: Floats
    edge: Index
    edge_t: Floats


class Block(NamedTuple):
    """Columns of a block of layers other than its points."""

    ring_starts: Ints  # (R + 1,) first row of each ring in the shared columns
    layer_starts: Ints  # (L + 1,) first ring of each layer
    closed: Bools  # (R,) false for an open path
    dropped: Ints  # (L,) number of rings without area that were left out
    kinds: NDArray[np.int8]  # (L,) class of each layer by `classify_layer`; all clean if not requested


# Passes of the trace: open paths first, from the ends at which the section enters a facet, then, among flipped facets, from those
# at which it leaves one, so that no walk starts in the middle of a path; closed rings last
FROM_ENTRY, FROM_EXIT, RINGS = 0, 1, 2


class Tracks(NamedTuple):
    """Working memory for the rings and open paths of one layer."""

    points: Floats  # (N, 2) mm
    edge: Index  # (N, 2) the part's numbers of the lower and upper vertex of the edge that is cut
    edge_t: Floats  # (N,) parameter on that edge, 0 at the lower vertex, 1 at the upper
    starts: Ints  # (N + 1,) first row of each ring
    closed: Bools  # (N,) false for an open path


@kernel
def cut_block(
    mesh: SortedMesh, heights: Floats, under: Index, seen: Index, columns: Columns, row: int, classify: bool,
    reach_mm: float,
) -> Block:  # fmt: skip
    """Cut layers at increasing heights (L,), over `under` (L,) vertices, and write their rings in canonical form from `row` on.

    `seen` (F,) has zeros. With `classify`, shells that overlap, or touch within the reach, are looked for.
    """
    room = mesh.crossed[under]
    total, most = int(room.sum()), int(room.max())
    active = np.empty(most, np.int32)
    points, edge, edge_t = np.empty((most, 2)), np.empty((most, 2), np.int32), np.empty(most)
    track = Tracks(points, edge, edge_t, np.zeros(most + 1, np.int64), np.empty(most, np.bool_))
    forms, order = np.empty((most, 3), np.int64), np.empty(most, np.int64)
    search = overlap_search(most if classify else 0, reach_mm)
    ring_starts, closed = np.empty(total + 1, np.int64), np.empty(total, np.bool_)
    layer_starts = np.zeros(heights.size + 1, np.int64)
    dropped, kinds = np.zeros(heights.size, np.int64), np.zeros(heights.size, np.int8)
    ring_starts[0] = row
    count = facets_across(mesh, under[0], active)
    for n in range(heights.size):
        if n > 0:
            count = raise_plane(mesh, under[n - 1], under[n], active, count)
        traced = trace_layer(mesh, heights[n], under[n], active, count, seen, n + 1, track)
        a = layer_starts[n]
        b = a + _write_layer(track, traced, forms, order, columns, ring_starts[a:], closed[a:])
        layer_starts[n + 1] = b
        dropped[n] = traced - (b - a)
        if classify:
            kinds[n] = classify_layer(columns.points, ring_starts, closed, a, b, search)
    rings = layer_starts[-1]
    return Block(ring_starts[: rings + 1].copy(), layer_starts, closed[:rings].copy(), dropped, kinds)


@kernel
def _write_layer(
    track: Tracks, traced: int, forms: Ints, order: Ints, columns: Columns, ring_starts: Ints, closed: Bools
) -> int:
    """Write the traced rings of one layer in canonical form from row ``ring_starts[0]`` on; returns their number."""
    points = track.points
    kept = 0
    for r in range(traced):
        forms[r, 0], forms[r, 1], forms[r, 2] = ring_form(points, track.starts[r], track.starts[r + 1], track.closed[r])
        if forms[r, 0] != DROPPED:
            order[kept] = r
            kept += 1
    # By first point, next point and size: by insertion, or by Shell's method where there are many.
    gap = 1
    while gap < kept // 64:
        gap = 3 * gap + 1
    while gap > 0:
        for n in range(gap, kept):
            r = order[n]
            k = n
            while k >= gap and _stands_before(points, forms, r, order[k - gap]):
                order[k] = order[k - gap]
                k -= gap
            order[k] = r
        gap //= 3
    at = ring_starts[0]
    for n in range(kept):
        r = order[n]
        a, b, i = track.starts[r], track.starts[r + 1], forms[r, 0]
        distinct = forms[r, 1] == b - a
        for k in range(at, at + forms[r, 1]):
            for c in range(2):
                columns.points[k, c] = points[i, c]
                columns.edge[k, c] = track.edge[i, c]
            columns.edge_t[k] = track.edge_t[i]
            step = i + 1 if i + 1 < b else a
            i = step if distinct else next_distinct(points, i, a, b)
        at += forms[r, 1]
        ring_starts[n + 1] = at
        closed[n] = track.closed[r]
    return kept


@kernel
def _stands_before(points: Floats, forms: Ints, r: int, s: int) -> bool:
    """Whether ring `r` stands before ring `s` in their layer: by first point, next point, size and number."""
    for at in (0, 2):
        i, j = forms[r, at], forms[s, at]
        for c in range(2):
            if points[i, c] != points[j, c]:
                return bool(points[i, c] < points[j, c])
    return bool(forms[r, 1] < forms[s, 1] or (forms[r, 1] == forms[s, 1] and r < s))


@kernel
def trace_layer(
    mesh: SortedMesh, h: float, under: int, active: Index, count: int, seen: Index, mark: int, track: Tracks
) -> int:
    """Trace the rings and open paths of one layer, which cuts the facets ``active[:count]``, solid on the left; returns their
    number."""
    rings = 0
    for phase in range(FROM_ENTRY if mesh.around.is_open else RINGS, RINGS + 1):
        forwards = phase != FROM_EXIT
        for n in range(count):
            seed = int(np.int64(active[n]))
            if seen[seed] == mark:
                continue
            if phase != RINGS and _left_by(mesh, seed, under, not forwards)[2] >= 0:
                continue
            filled = _walk(mesh, h, under, seed, forwards, phase == RINGS, seen, mark, track, track.starts[rings])
            track.closed[rings] = phase == RINGS
            rings += 1
            track.starts[rings] = filled
    return rings


# Ten parameters: a tuple of them would be made for every path.
@kernel
def _walk(
    mesh: SortedMesh, h: float, under: int, f: int, forwards: bool, is_ring: bool, seen: Index, mark: int,
    track: Tracks, first: int,
) -> int:  # fmt: skip
    """Follow the section from facet `f`, passed from entry to exit if `forwards`, until it ends or closes; returns the row after
    it."""
    filled = first
    if not is_ring:
        low, high, _ = _left_by(mesh, f, under, not forwards)
        _write_point(mesh, h, low, high, track, filled)
        filled += 1
    with_facets = against = 0.0
    while True:
        seen[f] = mark
        low, high, across = _left_by(mesh, f, under, forwards)
        _write_point(mesh, h, low, high, track, filled)
        filled += 1
        if mesh.around.mixed and filled - first > 1:
            p, q = track.points[filled - 1], track.points[filled - 2]
            length = np.hypot(p[0] - q[0], p[1] - q[1])
            if forwards:
                with_facets += length
            else:
                against += length
        if across < 0:
            break
        f = across // 3
        if seen[f] == mark:
            break
        if mesh.around.mixed:
            # A facet that is flipped against the one before it is passed the other way.
            forwards = across % 3 == (2 if mesh.faces[f, 2] >= under else 1)
    # A ring through flipped facets runs the way that the greater length of its facets says: one flipped
    # facet never outweighs the rest, as a side of a polygon is shorter than all others together.
    if against > with_facets:
        i, j = first, filled - 1
        while i < j:
            for c in range(2):
                track.points[i, c], track.points[j, c] = track.points[j, c], track.points[i, c]
                track.edge[i, c], track.edge[j, c] = track.edge[j, c], track.edge[i, c]
            track.edge_t[i], track.edge_t[j] = track.edge_t[j], track.edge_t[i]
            i += 1
            j -= 1
    return filled


@kernel
def _left_by(mesh: SortedMesh, f: int, under: int, forwards: bool) -> tuple[int, int, int]:
    """Lower and upper vertex of the edge by which facet `f` is left, and the half-edge across it.

    Forwards, a facet is left by the half-edge that runs up across the plane: the solid then lies to the left of the way.
    """
    # Loads stand in the branches: the processor foretells these, and need not wait for what they depend on.
    if forwards:
        if mesh.faces[f, 1] >= under:
            return mesh.faces[f, 0], mesh.faces[f, 1], mesh.around.twin[3 * f]
        return mesh.faces[f, 1], mesh.faces[f, 2], mesh.around.twin[3 * f + 1]
    if mesh.faces[f, 2] >= under:
        return mesh.faces[f, 0], mesh.faces[f, 2], mesh.around.twin[3 * f + 2]
    return mesh.faces[f, 2], mesh.faces[f, 1], mesh.around.twin[3 * f + 1]


@kernel
def _write_point(mesh: SortedMesh, h: float, low: int, high: int, track: Tracks, at: int) -> None:
    """Write the point where plane `h` cuts the edge from vertex `low` to vertex `high`."""
    x, y, z = mesh.vertices[low, 0], mesh.vertices[low, 1], mesh.vertices[low, 2]
    t = (h - z) / (mesh.vertices[high, 2] - z)
    track.points[at, 0] = x + t * (mesh.vertices[high, 0] - x)
    track.points[at, 1] = y + t * (mesh.vertices[high, 1] - y)
    track.edge[at, 0] = np.int32(mesh.vertices[low, 3])
    track.edge[at, 1] = np.int32(mesh.vertices[high, 3])
    track.edge_t[at] = t

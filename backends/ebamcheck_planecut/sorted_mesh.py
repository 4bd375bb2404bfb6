"""A mesh in the order in which a plane that rises meets it.

Vertices stand by height and facets by their lowest vertex, so that what a layer needs lies together in memory in
whatever order the file had it, and so that the facets above a plane need no look. Of those below, runs of facets that
end under the plane are passed over at once.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ebamcheck.mesh.part import Part
from ebamcheck.mesh.topology import edge_groups, twins
from ebamcheck.numeric.kernels import kernel, run_blocks

Floats = NDArray[np.float64]
Index = NDArray[np.int32]
Ints = NDArray[np.int64]

RUN = 256
"""Facets of a run that a plane passes over at once: the look at all runs then costs as little as that at one."""

RUNS_A_BLOCK = 128
FACETS_A_BLOCK = RUN * RUNS_A_BLOCK
"""What a thread takes at least: less does not pay for handing it over."""

VERTICES_A_BIN = 4
"""Vertices in a bin of the sort by height, on average: a few are put in order by insertion."""


class SortedMesh(NamedTuple):
    """Columns that the kernels walk over; facets with a repeated vertex have no section and are left out."""

    vertices: Floats
    """(V, 4) x, y, z and the part's number of each vertex, by z; rows of 32 bytes never straddle a cache line."""
    faces: Index
    """(F, 3) rows of `vertices`, by the lowest of the three."""
    numbers: Index
    """(F,) the part's number of each facet."""
    twin: Index
    """(3 F,) half-edge across each half-edge, :data:`ebamcheck.mesh.topology.NO_TWIN` at an open one."""
    spans: Floats
    """(F, 2) least and greatest z of each facet."""
    tallest: Floats
    """Greatest z of each :data:`RUN` facets."""
    crossed: Ints
    """(V + 1,) points, at most, on a plane above 0, 1, .. V vertices."""
    is_open: bool
    """Whether a half-edge has no twin, so that there are open paths."""
    mixed: bool
    """Whether two neighbours run the same way along their edge, as they do where one of them is flipped."""
    fans: bool
    """Whether more than two facets meet at an edge; which of them are neighbours depends on angles."""


def sorted_mesh(part: Part) -> SortedMesh:
    """Sort a part's mesh and find the neighbours of its facets."""
    vertices, faces, numbers = _sorted(part)
    groups = edge_groups(faces, len(vertices))
    twin = twins(vertices[:, :3], faces, groups.half_edges, groups.starts)
    fans = bool((np.diff(groups.starts) > 2).any())
    found = run_blocks(lambda a, b: _odd_neighbours(faces, twin, a, b), len(faces), FACETS_A_BLOCK)
    is_open, mixed = (any(block[k] for block in found) for k in range(2))
    return _measured(vertices, faces, numbers, twin, is_open, mixed, fans)


def turned_mesh(part: Part, before: SortedMesh) -> SortedMesh:
    """Sort a mesh that has the facets of another one, under vertices in other places; neighbours stay what they were."""
    if before.fans:
        return sorted_mesh(part)
    vertices, faces, numbers = _sorted(part)
    place = np.empty(len(part.faces), np.int32)
    place[numbers] = np.arange(len(numbers), dtype=np.int32)
    moved = place[before.numbers]
    twin = np.empty_like(before.twin)
    run_blocks(lambda a, b: _move_twins(before.twin, moved, twin, a, b), len(faces), FACETS_A_BLOCK)
    return _measured(vertices, faces, numbers, twin, before.is_open, before.mixed, fans=False)


def _sorted(part: Part) -> tuple[Floats, Index, Index]:
    """Vertices by height, facets by their lowest vertex, and the number each facet had."""
    original = height_order(np.ascontiguousarray(part.vertices[:, 2]))
    vertices, rank = _ranked(part.vertices, original)
    faces, numbers = _by_lowest_vertex(part.faces, rank)
    return vertices, faces, numbers


def _measured(
    vertices: Floats, faces: Index, numbers: Index, twin: Index, is_open: bool, mixed: bool, fans: bool
) -> SortedMesh:
    """Complete a sorted mesh by the spans of its facets and the points that they give to planes."""
    count = len(faces)
    spans = np.empty((count, 2))
    tallest = np.empty(-(-count // RUN))
    run_blocks(lambda a, b: _measure_runs(vertices, faces, spans, tallest, a, b), tallest.size, RUNS_A_BLOCK)
    crossed = _crossed(faces, twin, len(vertices), is_open)
    return SortedMesh(vertices, faces, numbers, twin, spans, tallest, crossed, is_open, mixed, fans)


@kernel
def height_order(z: Floats) -> Index:
    """Vertices by z (V,), those of equal z in the order given.

    Bins of equal height first, then each by itself: three passes for a part whose vertices are spread over its height.
    """
    order = np.empty(z.size, np.int32)
    if z.size == 0:
        return order
    low, high = z.min(), z.max()
    bins = z.size // VERTICES_A_BIN + 1
    # A part without height, or of more than a float64 holds, has one bin.
    scale = (bins - 1) / (high - low) if 1e-290 < high - low < 1e290 else 0.0
    starts = np.zeros(bins + 1, np.int64)
    for v in range(z.size):
        starts[_bin(z[v], low, scale) + 1] += 1
    for b in range(bins):
        starts[b + 1] += starts[b]
    fill = starts[:-1].copy()
    for v in range(z.size):
        b = _bin(z[v], low, scale)
        order[fill[b]] = v
        fill[b] += 1
    for b in range(bins):
        _sort_bin(z, order[starts[b] : starts[b + 1]])
    return order


@kernel
def _bin(z: float, low: float, scale: float) -> int:
    """Bin of a height; a higher one has the same bin or a later one."""
    return int((z - low) * scale) if scale > 0.0 else 0


@kernel
def _sort_bin(z: Floats, order: Index) -> None:
    """Order a few vertices by z, keeping those of equal z as they stand."""
    moves = 0
    for i in range(1, order.size):
        v = order[i]
        k = i
        while k > 0 and z[order[k - 1]] > z[v]:
            order[k] = order[k - 1]
            k -= 1
        order[k] = v
        moves += i - k
        if moves > 16 * order.size:
            break
    if moves > 16 * order.size:
        # A crowded bin; the numbers of the vertices give back the order of those of equal z.
        order.sort()
        order[:] = order[np.argsort(z[order], kind="mergesort")]


@kernel
def _ranked(points: Floats, original: Index) -> tuple[Floats, Index]:
    """Rows (V, 4) of :attr:`SortedMesh.vertices` and the place of each of the part's vertices among them."""
    vertices = np.empty((original.size, 4))
    rank = np.empty(original.size, np.int32)
    for v in range(original.size):
        number = original[v]
        rank[number] = v
        for c in range(3):
            vertices[v, c] = points[number, c]
        vertices[v, 3] = number
    return vertices, rank


@kernel
def _by_lowest_vertex(faces: Index, rank: Index) -> tuple[Index, Index]:
    """Facets with three vertices, renumbered and by their lowest vertex (F', 3), and the number each had (F',)."""
    starts = np.zeros(rank.size + 1, np.int32)
    for f in range(faces.shape[0]):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        if a != b and b != c and c != a:
            starts[min(rank[a], rank[b], rank[c]) + 1] += 1
    for v in range(rank.size):
        starts[v + 1] += starts[v]
    sorted_faces = np.empty((starts[-1], 3), np.int32)
    order = np.empty(starts[-1], np.int32)
    for f in range(faces.shape[0]):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        if a != b and b != c and c != a:
            a, b, c = rank[a], rank[b], rank[c]
            low = min(a, b, c)
            at = starts[low]
            starts[low] += 1
            sorted_faces[at, 0], sorted_faces[at, 1], sorted_faces[at, 2] = a, b, c
            order[at] = f
    return sorted_faces, order


@kernel
def _move_twins(twin: Index, moved: Index, result: Index, start: int, stop: int) -> None:
    """Neighbours of the facets ``[start, stop)`` under the new numbers `moved` (F,) of all facets."""
    for f in range(start, stop):
        for i in range(3):
            across = twin[3 * f + i]
            result[3 * moved[f] + i] = 3 * moved[across // 3] + across % 3 if across >= 0 else across


@kernel
def _measure_runs(
    vertices: Floats, faces: Index, spans: Floats, tallest: Floats, start: int, stop: int
) -> None:
    """Write the spans of the facets of the runs ``[start, stop)``, and the greatest z of each run."""
    for run in range(start, stop):
        top = -np.inf
        for f in range(run * RUN, min((run + 1) * RUN, faces.shape[0])):
            a, b, c = vertices[faces[f, 0], 2], vertices[faces[f, 1], 2], vertices[faces[f, 2], 2]
            spans[f, 0] = min(a, b, c)
            spans[f, 1] = max(a, b, c)
            top = max(top, spans[f, 1])
        tallest[run] = top


@kernel
def _odd_neighbours(faces: Index, twin: Index, start: int, stop: int) -> tuple[bool, bool]:
    """Whether a facet of ``[start, stop)`` has an open half-edge, and whether one has a neighbour turned over."""
    is_open = mixed = False
    for f in range(start, stop):
        for i in range(3):
            across = twin[3 * f + i]
            if across < 0:
                is_open = True
            elif faces[f, i] == faces[across // 3, across % 3]:
                mixed = True
    return is_open, mixed


@kernel
def _crossed(faces: Index, twin: Index, vertex_count: int, is_open: bool) -> Ints:
    """Count the points that the facets give to a plane above 0, 1, .. V vertices, (V + 1,).

    A closed ring has a point a facet; an open path one more, which counts for the facets with an open half-edge.
    """
    change = np.zeros(vertex_count + 1, np.int64)
    for f in range(faces.shape[0]):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        points = 1
        if is_open and (twin[3 * f] < 0 or twin[3 * f + 1] < 0 or twin[3 * f + 2] < 0):
            points = 2
        change[min(a, b, c) + 1] += points
        change[max(a, b, c) + 1] -= points
    for v in range(vertex_count):
        change[v + 1] += change[v]
    return change


@kernel
def points_at_most(mesh: SortedMesh, heights: Floats) -> Ints:
    """Points of each layer, at most (L,); none fewer where no two of them are equal and no ring lacks area."""
    result = np.empty(heights.size, np.int64)
    low = 0
    for n in range(heights.size):
        high = mesh.vertices.shape[0]
        while low < high:
            middle = (low + high) // 2
            if mesh.vertices[middle, 2] <= heights[n]:
                low = middle + 1
            else:
                high = middle
        result[n] = mesh.crossed[low]
    return result


@kernel
def facets_across(mesh: SortedMesh, h: float, active: Index) -> tuple[int, int]:
    """List the facets with least z <= h < greatest z in `active`; returns their number and the first facet above h."""
    count = 0
    low, high = 0, mesh.faces.shape[0]
    while low < high:
        middle = (low + high) // 2
        if mesh.spans[middle, 0] <= h:
            low = middle + 1
        else:
            high = middle
    for run in range((low + RUN - 1) // RUN):
        if mesh.tallest[run] <= h:
            continue
        for f in range(run * RUN, min((run + 1) * RUN, low)):
            if mesh.spans[f, 1] > h:
                active[count] = f
                count += 1
    return count, low


@kernel
def raise_plane(mesh: SortedMesh, h: float, active: Index, count: int, following: int) -> tuple[int, int]:
    """Turn the list of facets across a lower plane into that of plane `h`; as :func:`facets_across`."""
    kept = 0
    for n in range(count):
        if mesh.spans[active[n], 1] > h:
            active[kept] = active[n]
            kept += 1
    while following < mesh.faces.shape[0] and mesh.spans[following, 0] <= h:
        if mesh.spans[following, 1] > h:
            active[kept] = following
            kept += 1
        following += 1
    return kept, following

"""A mesh in the order in which a rising plane meets it: vertices by height, facets by their lowest vertex.

Neighbours of facets are found at the lower vertex of each edge. Facets begin with their lowest vertex and are sorted by it, so two
edges of each are found there; the third begins at the middle vertex, which has a linked list of its facets.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ebamcheck.kernels import Floats, Ints, kernel
from ebamcheck.mesh.part import Part
from ebamcheck.mesh.topology import NO_TWIN, pair_fan
from ebamcheck.threads import run_blocks, thread_count

Index = NDArray[np.int32]
Levels = NDArray[np.uint8]

# Facets of a run that is skipped as a whole: so many that testing all runs costs as little as going through one
RUN = 256
RUNS_A_BLOCK = 128
FACETS_A_BLOCK = RUN * RUNS_A_BLOCK  # fewest runs, and facets, worth a thread
FLAT = -1  # first corner of a facet that is left out
VERTICES_A_BIN = 4  # mean number of vertices in a bin of the sort by height: few enough to sort by insertion
# Most planes at a time, so that a level fits into a byte: the levels of a million facets then stay in a core's cache
MOST_PLANES = 255


class SortedMesh(NamedTuple):
    """Columns that the kernels read; facets with a repeated vertex have no section and are left out."""

    vertices: Floats  # (V, 4) x, y, z and the part's number of each vertex, by z; rows of 32 bytes never straddle a cache line
    faces: Index  # (F, 3) rows of `vertices`, by the lowest of the three, which is the first
    numbers: Index  # (F,) the part's number of each facet
    begins: NDArray[np.uint8]  # (F,) which corner of the part's facet stands first, 0 .. 2
    first: Index  # (V + 1,) first facet whose lowest vertex is 0, 1, .. or a later one; the number of facets
    highest: Index  # (F,) highest vertex of each facet
    tallest: Index  # highest vertex of each `RUN` facets
    crossed: Ints  # (V + 1,) points, at most, on a plane above 0, 1, .. V vertices
    around: Neighbours  # neighbours of the facets


def sorted_mesh(part: Part, before: SortedMesh | None = None) -> SortedMesh:
    """Sort a part's mesh; its neighbours are found, or taken over from a mesh of the same facets with other vertex coordinates."""
    original = height_order(np.ascontiguousarray(part.vertices[:, 2]))
    count = original.size
    vertices, rank = np.empty((count, 4)), np.empty(count, np.int32)
    run_blocks(lambda a, b: _rank(part.vertices, original, vertices, rank, a, b), count, FACETS_A_BLOCK)
    ranked = np.empty_like(part.faces)
    run_blocks(lambda a, b: _rank_facets(part.faces, rank, ranked, a, b), len(ranked), FACETS_A_BLOCK)
    # Each thread reads all facets and takes those that begin in its range of heights.
    share = max(1, count // thread_count())
    lowest = np.zeros(count + 1, np.int32)
    run_blocks(lambda a, b: _count_lowest(ranked, lowest, a, b), count, share)
    first = np.cumsum(lowest, dtype=np.int32)
    kept = int(first[-1])
    faces, numbers, begins = np.empty((kept, 3), np.int32), np.empty(kept, np.int32), np.empty(kept, np.uint8)
    run_blocks(lambda a, b: _take_lowest(ranked, first, faces, numbers, begins, a, b), count, share)
    if before is None or before.around.fans:
        around = neighbours(vertices, faces, first)
    else:
        twin, old = np.empty_like(before.around.twin), before
        place = np.empty(len(part.faces), np.int32)
        place[numbers] = np.arange(kept, dtype=np.int32)
        moved = place[old.numbers]
        turn = (old.begins + np.uint8(3) - begins[moved]) % np.uint8(3)
        run_blocks(lambda a, b: _move_twins(old.around.twin, moved, turn, twin, a, b), kept, FACETS_A_BLOCK)
        around = old.around._replace(twin=twin)
    highest, tallest = np.empty(kept, np.int32), np.empty(-(-kept // RUN), np.int32)
    run_blocks(lambda a, b: _measure_runs(faces, highest, tallest, a, b), tallest.size, RUNS_A_BLOCK)
    crossed = _crossed(first, highest, around)
    return SortedMesh(vertices, faces, numbers, begins, first, highest, tallest, crossed, around)


def crossed_mesh(part: Part, heights: Floats) -> SortedMesh:
    """Sort only the facets that some planes (L,), increasing, cross; at these heights it is cut like the whole mesh, bit for
    bit."""
    level = np.empty(len(part.vertices), np.uint8)
    run_blocks(lambda a, b: _levels(part.vertices, heights, level, a, b), level.size, FACETS_A_BLOCK)
    crossed = np.concatenate(run_blocks(lambda a, b: _across(part.faces, level, a, b), len(part.faces), FACETS_A_BLOCK))
    corners, faces = np.unique(part.faces[crossed], return_inverse=True)
    mesh = sorted_mesh(Part(part.vertices[corners], faces.reshape(-1, 3).astype(np.int32)))
    mesh.vertices[:, 3] = corners[mesh.vertices[:, 3].astype(np.int64)]
    return mesh._replace(numbers=crossed[mesh.numbers])


@kernel
def height_order(z: Floats) -> Index:
    """Vertices by z (V,), those of equal z in the order given: first by bins of equal height, then each bin by itself."""
    order = np.empty(z.size, np.int32)
    if z.size == 0:
        return order
    low, high = z.min(), z.max()
    bins = z.size // VERTICES_A_BIN + 1
    # A part without height, or of more than a float64 holds, has one bin.
    scale = (bins - 1) / (high - low) if 1e-290 < high - low < 1e290 else 0.0
    starts = np.zeros(bins + 1, np.int64)
    for v in range(z.size):
        starts[(int((z[v] - low) * scale) if scale > 0.0 else 0) + 1] += 1
    for b in range(bins):
        starts[b + 1] += starts[b]
    fill = starts[:-1].copy()
    for v in range(z.size):
        b = int((z[v] - low) * scale) if scale > 0.0 else 0
        order[fill[b]] = v
        fill[b] += 1
    for b in range(bins):
        first, stop = starts[b], starts[b + 1]
        # By insertion; a crowded bin by Shell's method, first at wide gaps.
        gap = 1
        while gap < (stop - first) // 64:
            gap = 3 * gap + 1
        while gap > 0:
            for i in range(first + gap, stop):
                v = order[i]
                k = i
                while k >= first + gap and (
                    z[order[k - gap]] > z[v] or (z[order[k - gap]] == z[v] and order[k - gap] > v)
                ):
                    order[k] = order[k - gap]
                    k -= gap
                order[k] = v
            gap //= 3
    return order


@kernel
def _rank(points: Floats, original: Index, vertices: Floats, rank: Index, start: int, stop: int) -> None:
    """Write the rows ``[start, stop)`` of :attr:`SortedMesh.vertices`, and where each of the part's vertices stands."""
    for v in range(start, stop):
        number = original[v]
        rank[number] = v
        for c in range(3):
            vertices[v, c] = points[number, c]
        vertices[v, 3] = number


@kernel
def _rank_facets(faces: Index, rank: Index, ranked: Index, start: int, stop: int) -> None:
    """Renumber the corners of the facets ``[start, stop)``; a facet with a repeated one gets :data:`FLAT` as the first."""
    for f in range(start, stop):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        flat = a == b or b == c or c == a
        ranked[f, 0], ranked[f, 1], ranked[f, 2] = FLAT if flat else rank[a], rank[b], rank[c]


@kernel
def _count_lowest(ranked: Index, lowest: Index, start: int, stop: int) -> None:
    """Count the facets whose lowest vertex is each of ``[start, stop)``, one place behind it."""
    for f in range(ranked.shape[0]):
        low = min(ranked[f, 0], ranked[f, 1], ranked[f, 2])
        if start <= low < stop:
            lowest[low + 1] += 1


@kernel
def _take_lowest(
    ranked: Index, first: Index, faces: Index, numbers: Index, begins: NDArray[np.uint8], start: int,
    stop: int,
) -> None:  # fmt: skip
    """Put the facets whose lowest vertex, which comes first, is one of ``[start, stop)`` to their places, in their order."""
    fill = first[start:stop].copy()
    for f in range(ranked.shape[0]):
        a, b, c = ranked[f, 0], ranked[f, 1], ranked[f, 2]
        low = min(a, b, c)
        if start <= low < stop:
            at = fill[low - start]
            fill[low - start] += 1
            i = 0 if low == a else (1 if low == b else 2)
            faces[at, 0] = low
            faces[at, 1] = b if i == 0 else (c if i == 1 else a)
            faces[at, 2] = c if i == 0 else (a if i == 1 else b)
            numbers[at] = f
            begins[at] = i


@kernel
def _move_twins(twin: Index, moved: Index, turn: NDArray[np.uint8], result: Index, start: int, stop: int) -> None:
    """Write to `result` the twins (3 F,) of the facets ``[start, stop)`` under new numbers; `moved` and `turn` (F,) are
    the new number of each facet, and the new place of the corner that stood first."""
    for f in range(start, stop):
        for i in range(3):
            across = twin[3 * f + i]
            other = across // 3
            result[3 * moved[f] + (i + turn[f]) % 3] = (
                3 * moved[other] + (across % 3 + turn[other]) % 3 if across >= 0 else across
            )


@kernel
def _measure_runs(faces: Index, highest: Index, tallest: Index, start: int, stop: int) -> None:
    """Write the highest vertex of each facet of the runs ``[start, stop)``, and that of each run."""
    for run in range(start, stop):
        top = np.int32(0)
        for f in range(run * RUN, min((run + 1) * RUN, faces.shape[0])):
            highest[f] = max(faces[f, 1], faces[f, 2])
            top = max(top, highest[f])
        tallest[run] = top


@kernel
def _crossed(first: Index, highest: Index, around: Neighbours) -> Ints:
    """Count the points, (V + 1,), that the facets give to a plane above 0, 1, .. V vertices: one each, two at an open edge."""
    change = np.zeros(first.size, np.int64)
    low = 0
    for f in range(highest.size):
        points = 1
        if around.is_open and min(around.twin[3 * f], around.twin[3 * f + 1], around.twin[3 * f + 2]) < 0:
            points = 2
        while first[low + 1] <= f:
            low += 1
        change[low + 1] += points
        change[highest[f] + 1] -= points
    for v in range(first.size - 1):
        change[v + 1] += change[v]
    return change


@kernel
def vertices_under(mesh: SortedMesh, heights: Floats) -> Index:
    """Vertices that do not lie above each of some rising heights, (L,)."""
    return np.searchsorted(mesh.vertices[:, 2], heights, side="right").astype(np.int32)


@kernel
def facets_across(mesh: SortedMesh, under: int, active: Index) -> int:
    """List the facets that reach from the first `under` vertices to the others in `active`; returns their number."""
    count = 0
    past = mesh.first[under]
    for run in range((past + RUN - 1) // RUN):
        if mesh.tallest[run] < under:
            continue
        for f in range(run * RUN, min((run + 1) * RUN, past)):
            if mesh.highest[f] >= under:
                active[count] = f
                count += 1
    return count


@kernel
def raise_plane(mesh: SortedMesh, before: int, under: int, active: Index, count: int) -> int:
    """Turn the list of facets across the plane over `before` vertices into that of :func:`facets_across`."""
    kept = 0
    for n in range(count):
        if mesh.highest[active[n]] >= under:
            active[kept] = active[n]
            kept += 1
    for f in range(mesh.first[before], mesh.first[under]):
        if mesh.highest[f] >= under:
            active[kept] = f
            kept += 1
    return kept


@kernel
def _levels(vertices: Floats, heights: Floats, level: Levels, start: int, stop: int) -> None:
    """Count the planes that each of the vertices ``[start, stop)`` lies above."""
    for v in range(start, stop):
        below = 0
        for n in range(heights.size):
            below += vertices[v, 2] > heights[n]
        level[v] = below


@kernel
def _across(faces: Index, level: Levels, start: int, stop: int) -> Index:
    """List the facets of ``[start, stop)`` whose corners do not lie above the same planes."""
    found = np.empty(stop - start, np.int32)
    count = 0
    for f in range(start, stop):
        a, b, c = level[faces[f, 0]], level[faces[f, 1]], level[faces[f, 2]]
        # Written always and kept where it counts: no branch that a processor could foretell wrongly.
        found[count] = f
        count += (a != b) | (b != c)
    return found[:count].copy()


SMALLEST_BLOCK = 16384  # fewest vertices worth a thread
NONE = -1  # end of a linked list of facets


class Neighbours(NamedTuple):
    """Which facets meet at which edges."""

    twin: Index  # (3 F,) half-edge across each half-edge, `ebamcheck.mesh.topology.NO_TWIN` at an open one
    is_open: bool  # whether any half-edge has no twin, so that there are open paths
    mixed: bool  # whether any two neighbours run in the same direction along their edge, because one of them is flipped
    fans: bool  # whether more than two facets meet at any edge; which of them are neighbours depends on their angles


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
    vertices: Floats, faces: Index, first: Index, chain: Index, following: Index, twin: Index, start: int,
    stop: int,
) -> tuple[bool, bool, bool]:  # fmt: skip
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
        # By insertion if they are few, else by Shell's method.
        gap = 1
        while gap < count // 64:
            gap = 3 * gap + 1
        while gap > 0:
            for n in range(gap, count):
                edge = edges[n]
                k = n
                while k >= gap and edges[k - gap] > edge:
                    edges[k] = edges[k - gap]
                    k -= gap
                edges[k] = edge
            gap //= 3
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

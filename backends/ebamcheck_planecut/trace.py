"""Kernels that walk from facet to facet around each ring of a layer.

A vertex is *above* a plane if z > h; a facet is cut if it has vertices above and others. Every facet and every
neighbour makes the same comparison, so that they agree on every cut, and the section is that of z = h + 0 exactly. As
vertices stand by height, those from row `under` on are above. A cut point depends on the edge alone (from its lower to
its upper vertex), so both facets of an edge get the same bits.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ebamcheck.numeric.kernels import kernel
from ebamcheck_planecut.sorted_mesh import Floats, Index, Ints, SortedMesh

FROM_ENTRY, FROM_EXIT, RINGS = 0, 1, 2
"""Passes of the trace. Open paths come first, from their ends, so that no walk starts in the middle of one. The usual start is
an end at which the section enters a facet; one at which it leaves is a start only among flipped facets. Closed rings come
last."""


class Tracks(NamedTuple):
    """Working memory for the rings and open paths of one layer."""

    points: Floats
    """(N, 2) mm."""
    edge: Index
    """(N, 2) the part's numbers of the lower and upper vertex of the edge that is cut."""
    edge_t: Floats
    """(N,) parameter on that edge, 0 at the lower vertex, 1 at the upper."""
    starts: Ints
    """(N + 1,) first row of each ring."""
    closed: NDArray[np.bool_]
    """(N,) false for an open path."""


@kernel
def tracks(size: int) -> Tracks:
    """Room for `size` points."""
    return Tracks(
        np.empty((size, 2)),
        np.empty((size, 2), np.int32),
        np.empty(size),
        np.zeros(size + 1, np.int64),
        np.empty(size, np.bool_),
    )


@kernel
def trace_layer(
    mesh: SortedMesh, h: float, under: int, active: Index, count: int, seen: Index, mark: int, track: Tracks
) -> int:
    """Trace the rings and open paths of one layer, in the order of their first facets; solid on the left.

    Parameters
    ----------
    mesh, h, under
        The mesh, the height of the layer, and the vertices that do not lie above it.
    active, count
        The facets that are cut are ``active[:count]``.
    seen, mark
        (F,) the walk writes `mark` at each facet it has passed; nowhere must it stand before.
    track
        Where to write.

    Returns
    -------
    int
        Rings and open paths.
    """
    rings = 0
    for phase in range(FROM_ENTRY if mesh.around.is_open else RINGS, RINGS + 1):
        forwards = phase != FROM_EXIT
        for n in range(count):
            seed = active[n]
            if seen[seed] == mark:
                continue
            if phase != RINGS and _left_by(mesh, seed, under, not forwards)[2] >= 0:
                continue
            filled = _walk(
                mesh, h, under, seed, forwards, phase == RINGS, seen, mark, track, track.starts[rings]
            )
            track.closed[rings] = phase == RINGS
            rings += 1
            track.starts[rings] = filled
    return rings


# Ten parameters: a tuple of them would be made for every path.
@kernel
def _walk(
    mesh: SortedMesh,
    h: float,
    under: int,
    f: int,
    forwards: bool,
    is_ring: bool,
    seen: Index,
    mark: int,
    track: Tracks,
    first: int,
) -> int:
    """Follow the section from facet to facet until it ends or closes; returns the row after its last point.

    It begins in facet `f`, which it passes from its entry to its exit if `forwards`.
    """
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
            length = _last_length(track, filled)
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
        _reverse(track, first, filled)
    return filled


@kernel
def _left_by(mesh: SortedMesh, f: int, under: int, forwards: bool) -> tuple[int, int, int]:
    """Lower and upper vertex of the edge by which facet `f` is left, and the half-edge across it.

    The first corner is the lowest, and never above. Forwards, a facet is entered by the half-edge that runs down across the
    plane and left by the one that runs up: with the normal outwards, the solid then lies to the left of the way.
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


@kernel
def _last_length(track: Tracks, filled: int) -> float:
    """Distance between the last two points."""
    p = track.points
    return float(np.hypot(p[filled - 1, 0] - p[filled - 2, 0], p[filled - 1, 1] - p[filled - 2, 1]))


@kernel
def _reverse(track: Tracks, first: int, stop: int) -> None:
    i, j = first, stop - 1
    while i < j:
        for c in range(2):
            track.points[i, c], track.points[j, c] = track.points[j, c], track.points[i, c]
            track.edge[i, c], track.edge[j, c] = track.edge[j, c], track.edge[i, c]
        track.edge_t[i], track.edge_t[j] = track.edge_t[j], track.edge_t[i]
        i += 1
        j -= 1

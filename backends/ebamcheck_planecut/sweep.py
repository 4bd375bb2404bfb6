"""The kernel that cuts a block of layers, and finishes each while its points are in the processor's cache."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ebamcheck.layers.canonical_form import ring_form, sort_rings, write_ring
from ebamcheck.numeric.kernels import kernel
from ebamcheck_planecut.overlaps import classify_layer, overlap_search
from ebamcheck_planecut.sorted_mesh import Floats, Index, Ints, SortedMesh, facets_across, raise_plane
from ebamcheck_planecut.trace import Tracks, trace_layer, tracks


class Columns(NamedTuple):
    """Columns of points to which all blocks of a stack write, each from a start row of its own."""

    points: Floats
    edge: Index
    edge_t: Floats


class Forms(NamedTuple):
    """Canonical form of the rings of one layer, and their order."""

    first: Ints
    size: Ints
    after: Ints
    order: Ints


class Block(NamedTuple):
    """Columns of a block of layers other than its points."""

    ring_starts: Ints
    """(R + 1,) first row of each ring in the shared columns."""
    layer_starts: Ints
    """(L + 1,) first ring of each layer."""
    closed: NDArray[np.bool_]
    """(R,) false for an open path."""
    dropped: Ints
    """(L,) number of rings without area that were left out."""
    kinds: NDArray[np.int8]
    """(L,) class of each layer by :func:`~ebamcheck_planecut.overlaps.classify_layer`; all clean if not requested."""


@kernel
def cut_block(
    mesh: SortedMesh,
    heights: Floats,
    under: Index,
    seen: Index,
    columns: Columns,
    row: int,
    classify: bool,
    reach_mm: float,
) -> Block:
    """Cut consecutive layers and write their rings in canonical form.

    Parameters
    ----------
    mesh, heights
        The mesh, and the heights of the layers (L,), increasing.
    under
        (L,) vertices that do not lie above each layer.
    seen
        (F,) zeros; written over.
    columns, row
        Where to write, and from which row on.
    classify
        Whether to look for shells that overlap or touch.
    reach_mm
        How near to each other shells touch.
    """
    room = mesh.crossed[under]
    total = int(room.sum())
    most = int(room.max())
    active = np.empty(most, np.int32)
    track = tracks(most)
    forms = _forms(most)
    search = overlap_search(most if classify else 0, reach_mm)
    ring_starts = np.empty(total + 1, np.int64)
    closed = np.empty(total, np.bool_)
    layer_starts = np.zeros(heights.size + 1, np.int64)
    dropped = np.zeros(heights.size, np.int64)
    kinds = np.zeros(heights.size, np.int8)
    ring_starts[0] = row
    count = 0
    for n in range(heights.size):
        if n == 0:
            count = facets_across(mesh, under[0], active)
        else:
            count = raise_plane(mesh, under[n - 1], under[n], active, count)
        traced = trace_layer(mesh, heights[n], under[n], active, count, seen, n + 1, track)
        a = layer_starts[n]
        b = a + _write_layer(track, traced, forms, columns, ring_starts[a:], closed[a:])
        layer_starts[n + 1] = b
        dropped[n] = traced - (b - a)
        if classify:
            kinds[n] = classify_layer(columns.points, ring_starts, closed, a, b, search)
    rings = layer_starts[-1]
    return Block(ring_starts[: rings + 1].copy(), layer_starts, closed[:rings].copy(), dropped, kinds)


@kernel
def _forms(rings: int) -> Forms:
    """Room for the forms of so many rings."""
    return Forms(
        np.empty(rings, np.int64),
        np.empty(rings, np.int64),
        np.empty(rings, np.int64),
        np.empty(rings, np.int64),
    )


@kernel
def _write_layer(
    track: Tracks, traced: int, forms: Forms, columns: Columns, ring_starts: Ints, closed: NDArray[np.bool_]
) -> int:
    """Write the traced rings of one layer in canonical form from row ``ring_starts[0]`` on; returns their number."""
    for r in range(traced):
        forms.first[r], forms.size[r], forms.after[r] = ring_form(
            track.points, track.starts[r], track.starts[r + 1], track.closed[r]
        )
    kept = sort_rings(track.points, forms.first, forms.size, forms.after, 0, traced, forms.order)
    at = ring_starts[0]
    for n in range(kept):
        r = forms.order[n]
        a, b, first, size = track.starts[r], track.starts[r + 1], forms.first[r], forms.size[r]
        write_ring(track.points, a, b, first, size, track.points, columns.points, at)
        write_ring(track.points, a, b, first, size, track.edge, columns.edge, at)
        write_ring(track.points, a, b, first, size, track.edge_t, columns.edge_t, at)
        at += size
        ring_starts[n + 1] = at
        closed[n] = track.closed[r]
    return kept

"""Marching squares on a raster of nodes, 64 to a word, through the middles of the crossed grid edges.

Middles of edges lie at whole numbers of half cells, so straight runs are recognised exactly, and the points within
them are left out. Nodes of the material that touch only at a corner stay separate.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ebamcheck.numeric.kernels import kernel
from ebamcheck_embree.grid import Lattice
from ebamcheck_embree.marching import links
from ebamcheck_embree.scene import Bools, Floats, Ints

Raster = NDArray[np.uint64]
"""(rows, words): bit i of word w is set if node 64 w + i of the row is in the material."""

HalfCells = NDArray[np.int32]

FIRST_KNOTS = 4096
"""Initial room for knots; it doubles as needed."""

_ONE = np.uint64(1)
_TOP = np.uint64(63)
_ALL = np.uint64(0xFFFFFFFFFFFFFFFF)


@kernel
def empty_raster(lattice: Lattice) -> Raster:
    """No node in the material."""
    _, _, _, columns, rows = lattice
    return np.zeros((rows, (columns + 63) // 64), np.uint64)


@kernel
def turn_over(raster: Raster, nodes: Ints, lattice: Lattice) -> None:
    """Put nodes (row * columns + column) on the other side."""
    _, _, _, columns, _ = lattice
    for node in nodes:
        row = node // columns
        column = node - row * columns
        raster[row, column >> 6] ^= _ONE << np.uint64(column & 63)


@kernel
def _lowest_bit(word: np.uint64) -> int:
    """Place of the lowest set bit of a word that is not 0."""
    place = 0
    for width in (32, 16, 8, 4, 2, 1):
        if word & (_ALL >> np.uint64(64 - width)) == 0:
            word >>= np.uint64(width)
            place += width
    return place


@kernel
def _append_set(bits: np.uint64, first: int, nodes: Ints, size: int) -> tuple[Ints, int]:
    """Append the places of the set bits of a word whose bit 0 is node `first`; the column grows as needed."""
    if size + 64 > nodes.size:
        nodes = np.concatenate((nodes, np.empty_like(nodes)))
    while bits != 0:
        nodes[size] = first + _lowest_bit(bits)
        size += 1
        bits &= bits - _ONE
    return nodes, size


@kernel
def _row_knots(raster: Raster) -> tuple[Ints, Ints]:
    """First knot of each row (rows + 1,), and the node at the right end of each crossed edge."""
    starts = np.zeros(len(raster) + 1, np.int64)
    node = np.empty(FIRST_KNOTS, np.int64)
    size = 0
    for j in range(len(raster)):
        carry = np.uint64(0)
        for w in range(raster.shape[1]):
            word = raster[j, w]
            changes = word ^ ((word << _ONE) | carry)  # bit i: node i differs from the one before it
            if changes != 0:
                node, size = _append_set(changes, 64 * w, node, size)
            carry = word >> _TOP
        starts[j + 1] = size
    return starts, node[:size]


@kernel
def _column_knots(raster: Raster) -> tuple[Ints, Ints, Bools]:
    """First knot over each row (rows + 1,), the column of each, and whether that enters the material there."""
    rows = len(raster)
    starts = np.zeros(rows + 1, np.int64)
    node = np.empty(FIRST_KNOTS, np.int64)
    size = 0
    for j in range(rows - 1):
        for w in range(raster.shape[1]):
            changes = raster[j, w] ^ raster[j + 1, w]
            if changes != 0:
                node, size = _append_set(changes, 64 * w, node, size)
        starts[j + 1] = size
    starts[rows] = size
    up = np.empty(size, np.bool_)
    for j in range(rows - 1):
        for n in range(starts[j], starts[j + 1]):
            up[n] = (raster[j + 1, node[n] >> 6] >> np.uint64(node[n] & 63)) & _ONE != 0
    return starts, node[:size], up


@kernel
def _half_cells(row_starts: Ints, row_node: Ints, column_starts: Ints, column_node: Ints) -> HalfCells:
    """Places of all knots (K, 2), in half cells from the first node, rows' before columns'."""
    places = np.empty((row_node.size + column_node.size, 2), np.int32)
    for j in range(row_starts.size - 1):
        for n in range(row_starts[j], row_starts[j + 1]):
            places[n, 0], places[n, 1] = 2 * row_node[n] - 1, 2 * j
        for n in range(column_starts[j], column_starts[j + 1]):
            k = row_node.size + n
            places[k, 0], places[k, 1] = 2 * column_node[n], 2 * j + 1
    return places


@kernel
def _is_corner(places: HalfCells, before: int, k: int, after: int) -> bool:
    """Whether a contour turns at knot `k`."""
    return bool(
        places[k, 0] - places[before, 0] != places[after, 0] - places[k, 0]
        or places[k, 1] - places[before, 1] != places[after, 1] - places[k, 1]
    )


@kernel
def contours(raster: Raster, lattice: Lattice) -> tuple[Floats, Ints]:
    """Rings around the material: their corners (N, 2), mm about the centre of the part, and starts (R + 1,)."""
    x0, y0, cell, _, _ = lattice
    row_starts, row_node = _row_knots(raster)
    column_starts, column_node, up = _column_knots(raster)
    after, _ = links(row_starts, row_node, column_starts, column_node, up, np.empty((0, 2)))
    places = _half_cells(row_starts, row_node, column_starts, column_node)
    points = np.empty((after.size, 2))
    ring_starts = np.zeros(after.size // 4 + 1, np.int64)  # the shortest rings have four knots
    seen = np.zeros(after.size, np.bool_)
    size = rings = 0
    for first in range(after.size):
        if seen[first]:
            continue
        before, k = first, after[first]
        while not seen[k]:
            seen[k] = True
            if _is_corner(places, before, k, after[k]):
                points[size, 0] = x0 + cell * (0.5 * places[k, 0])
                points[size, 1] = y0 + cell * (0.5 * places[k, 1])
                size += 1
            before, k = k, after[k]
        rings += 1
        ring_starts[rings] = size
    return points[:size], ring_starts[: rings + 1]

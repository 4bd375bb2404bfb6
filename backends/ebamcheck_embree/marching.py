"""Marching squares on the few cells that a contour passes.

Source: the marching squares of the paper (section 3.1), with the measured crossing of each grid edge instead
of the interpolated one of its formula 4.
"""

from __future__ import annotations

import math

import numpy as np

from ebamcheck.numeric.kernels import kernel
from ebamcheck_embree.grid import Lattice
from ebamcheck_embree.knots import NO_FACET, ColumnKnots, RowKnots
from ebamcheck_embree.scene import Bools, Facets, Floats, Ints
from ebamcheck_embree.section import Mesh, edge_point

SADDLE = -1
"""Cell of a link in a cell with four knots: no corner of the section is added to such a link."""


@kernel
def links(
    row_starts: Ints, row_node: Ints, col_starts: Ints, col_node: Ints, up: Bools, points: Floats
) -> tuple[Ints, Ints]:
    """Knot that follows each knot, material on the left; rows' knots come before columns'; and the cell between.

    The second column, (K, 2), is the cell's column and row, :data:`SADDLE` where four knots meet. There the shorter
    way is taken between their `points` (K, 2), mm; where those are left out (0, 2), the two corners of the material
    stay apart.

    Cells are swept band by band between two rows, from left to right, by three pointers: into the lower row, the
    upper row and the columns.
    """
    base = row_node.size
    after = np.full(base + col_node.size, -1, np.int64)
    cells = np.full((after.size, 2), SADDLE, np.int64)
    into = np.empty(2, np.int64)
    out_of = np.empty(2, np.int64)
    far = np.iinfo(np.int64).max
    for j in range(row_starts.size - 2):
        p, q, c = row_starts[j], row_starts[j + 1], col_starts[j]
        p_end, q_end, c_end = row_starts[j + 1], row_starts[j + 2], col_starts[j + 1]
        least = -1  # cells left of this one are done
        while True:
            cell = far
            if p < p_end:
                cell = min(cell, row_node[p] - 1)
            if q < q_end:
                cell = min(cell, row_node[q] - 1)
            if c < c_end:
                cell = min(cell, max(col_node[c] - 1, least))
            if cell == far:
                break
            ins = outs = 0
            # Leaving the material rightwards in the lower row, the contour goes up; entering it upwards, right.
            if p < p_end and row_node[p] - 1 == cell:
                ins, outs = _add(p, (p - row_starts[j]) % 2 == 1, into, out_of, ins, outs)
                p += 1
            if q < q_end and row_node[q] - 1 == cell:
                ins, outs = _add(q, (q - row_starts[j + 1]) % 2 == 0, into, out_of, ins, outs)
                q += 1
            if c < c_end and col_node[c] == cell:
                ins, outs = _add(base + c, up[c], into, out_of, ins, outs)
                c += 1
            if c < c_end and col_node[c] == cell + 1:  # of the next cell, too
                ins, outs = _add(base + c, not up[c], into, out_of, ins, outs)
            straight = ins < 2 or _goes_straight(into, out_of, base, points)
            for n in range(ins):
                after[into[n]] = out_of[n if straight else 1 - n]
                if ins == 1:
                    cells[into[n], 0], cells[into[n], 1] = cell, j
            least = cell + 1
    return after, cells


@kernel
def _add(knot: int, enters: bool, into: Ints, out_of: Ints, ins: int, outs: int) -> tuple[int, int]:
    """Note a knot by which the contour enters or leaves a cell; how many of both there are."""
    if enters:
        into[ins] = knot
        return ins + 1, outs
    out_of[outs] = knot
    return ins, outs + 1


@kernel
def _goes_straight(into: Ints, out_of: Ints, base: int, points: Floats) -> bool:
    """Whether, of two ways into a cell and two out of it, the first goes with the first: see :func:`links`."""
    if not points.size:
        # In by a row's edge: the material lies lower left and upper right, and straight goes around either.
        return bool(into[0] < base)
    straight = _gap(points, into[0], out_of[0]) + _gap(points, into[1], out_of[1])
    return bool(straight <= _gap(points, into[0], out_of[1]) + _gap(points, into[1], out_of[0]))


@kernel
def _gap(points: Floats, a: int, b: int) -> float:
    return math.hypot(points[a, 0] - points[b, 0], points[a, 1] - points[b, 1])


@kernel
def _knot_points(grid: Lattice, rows: RowKnots, columns: ColumnKnots) -> Floats:
    """Places of all knots (K, 2), mm, rows' before columns'."""
    x0, y0, cell, _, row_count = grid
    count = rows.along.size
    points = np.empty((count + columns.along.size, 2))
    for j in range(row_count):
        for k in range(rows.starts[j], rows.starts[j + 1]):
            points[k, 0], points[k, 1] = rows.along[k], y0 + cell * j
    for k in range(columns.along.size):
        points[count + k, 0] = x0 + cell * columns.node[k]
        points[count + k, 1] = columns.along[k]
    return points


@kernel
def _shared_corner(vertices: Floats, faces: Facets, f: int, g: int, z: float) -> tuple[bool, float, float]:
    """Point at which the plane cuts the mesh edge that two facets share, if it cuts one."""
    for m in range(3):
        a, b = faces[f, m], faces[f, (m + 1) % 3]
        if (vertices[a, 2] <= z) == (vertices[b, 2] <= z):
            continue
        for n in range(3):
            if faces[g, n] == b and faces[g, (n + 1) % 3] == a:
                low, high = (a, b) if vertices[a, 2] <= z else (b, a)
                x, y = edge_point(vertices, low, high, z)
                return True, x, y
    return False, 0.0, 0.0


@kernel
def _chain(
    grid: Lattice,
    after: Ints,
    cells: Ints,
    points: Floats,
    facet: Facets,
    mesh: Mesh,
    z: float,
    corners: bool,
) -> tuple[Floats, Ints]:
    """Rings along the links; with `corners`, the section's own vertex between two knots of a cell.

    Where the facets of two linked knots share an edge, the contour between the knots turns exactly where
    the plane cuts that edge; the turn is kept if it lies in the cell. Of knots in a row on one facet only
    the first and the last are kept: the others lie on the line between.
    """
    x0, y0, size, _, _ = grid
    vertices, faces = mesh
    out_points = np.empty((2 * after.size, 2))
    ring_starts = np.zeros(after.size + 1, np.int64)
    seen = np.zeros(after.size, np.bool_)
    out = rings = 0
    for first in range(after.size):
        if seen[first]:
            continue
        k = first
        previous = NO_FACET
        while not seen[k]:
            seen[k] = True
            f, g = facet[k], facet[after[k]]
            if f == NO_FACET or f != previous or f != g:
                out_points[out, 0], out_points[out, 1] = points[k, 0], points[k, 1]
                out += 1
            previous = f
            if corners and f != g and f != NO_FACET and g != NO_FACET and cells[k, 0] != SADDLE:
                found, x, y = _shared_corner(vertices, faces, f, g, z)
                left, bottom = x0 + size * cells[k, 0], y0 + size * cells[k, 1]
                if found and left < x < left + size and bottom < y < bottom + size:
                    out_points[out, 0], out_points[out, 1] = x, y
                    out += 1
            k = after[k]
        rings += 1
        ring_starts[rings] = out
    return out_points[:out], ring_starts[: rings + 1]


@kernel
def rings_of_layer(
    grid: Lattice, rows: RowKnots, columns: ColumnKnots, mesh: Mesh, z: float, corners: bool
) -> tuple[Floats, Ints]:
    """Rings of one layer: points (N, 2), mm about the centre of the part, and ring starts (R + 1,)."""
    points = _knot_points(grid, rows, columns)
    after, cells = links(rows.starts, rows.node, columns.starts, columns.node, columns.up, points)
    facet = np.concatenate((rows.facet, columns.facet))
    return _chain(grid, after, cells, points, facet, mesh, z, corners)

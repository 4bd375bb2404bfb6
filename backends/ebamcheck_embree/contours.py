"""Marching squares (the paper, section 3.1) on the few cells that a contour passes, with the measured crossing of each grid edge.

The rows of the grid decide which nodes are inside; where two neighbouring rows differ, the contour crosses the grid edge between
them. Every cell then has 0, 2 or 4 crossed edges whatever rounding did, so contours close. A crossing is a *knot* of a contour.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ebamcheck.kernels import Bools, Floats, Ints, kernel
from ebamcheck_embree.grid import Grid
from ebamcheck_embree.scene import Facets, Mesh

# The columns `starts`, `along`, `facet` and `paired` of `ebamcheck_embree.crossings.Borders`
RayColumns = tuple[Ints, Floats, Facets, Bools]
NO_FACET = -1  # facet of a knot without a crossing, which lies at the middle or an end of its grid edge
SADDLE = -1  # cell of a link in a cell with four knots: no corner of the section is added to such a link


class Knots(NamedTuple):
    """Crossed grid edges: along each row, entering, leaving, entering, leaving; or from each row to the next."""

    starts: Ints  # (rows + 1,) first knot of each row, or between row j and row j + 1
    node: Ints  # (K,) column of the node at the right end of the crossed edge, or on which the knot lies; ascending in a row
    along: Floats  # (K,) x of the knot, or y, mm
    facet: Facets


@kernel
def rings_of_layer(
    grid: Grid, rows: RayColumns, columns: RayColumns, mesh: Mesh, z: float, corners: bool
) -> tuple[Floats, Ints]:
    """Rings of one layer from the borders on its rays: points (N, 2), mm about the part's centre, and ring starts (R + 1,)."""
    x0, y0, cell, _, row_count = grid
    across = row_knots(grid, rows, columns)
    upwards, up = column_knots(grid, across, columns)
    count = across.along.size
    points = np.empty((count + upwards.along.size, 2))
    facet = np.empty(points.shape[0], np.int32)
    for j in range(row_count):
        for k in range(across.starts[j], across.starts[j + 1]):
            points[k, 0], points[k, 1], facet[k] = across.along[k], y0 + cell * j, across.facet[k]
    for k in range(upwards.along.size):
        points[count + k, 0], points[count + k, 1] = x0 + cell * upwards.node[k], upwards.along[k]
        facet[count + k] = upwards.facet[k]
    after, cells = links(across, upwards, up, points)
    return _chain(grid, after, cells, points, facet, mesh, z, corners)


@kernel
def row_knots(grid: Grid, rows: RayColumns, columns: RayColumns) -> Knots:
    """Crossed edges along rows: those with an odd number of borders of the row's ray.

    The nodes of a row whose ray does not pair are mended: by the columns, and where those fail as the row below.
    """
    x0, y0, cell, column_count, row_count = grid
    row_starts, row_along, row_facet, row_paired = rows
    col_starts, col_along, _, col_paired = columns
    starts = np.zeros(row_count + 1, np.int64)
    room = row_along.size + column_count * (row_count - row_paired.sum())
    node, along, facet = np.empty(room, np.int64), np.empty(room), np.empty(room, np.int32)
    inside = np.zeros(column_count, np.bool_)
    out = 0
    for j in range(row_count):
        if row_paired[j]:
            n = row_starts[j]
            while n < row_starts[j + 1]:
                k = min(max(int(np.ceil((row_along[n] - x0) / cell)), 0), column_count)
                while k > 0 and x0 + cell * (k - 1) >= row_along[n]:
                    k -= 1
                while k < column_count and x0 + cell * k < row_along[n]:
                    k += 1
                m = n + 1
                while m < row_starts[j + 1] and row_along[m] <= x0 + cell * k:
                    m += 1
                if (m - n) % 2 == 1:
                    pick = (n + m) // 2
                    node[out], along[out], facet[out] = k, row_along[pick], row_facet[pick]
                    out += 1
                n = m
            starts[j + 1] = out
            continue
        inside[:] = False
        for n in range(starts[j - 1] if j > 0 else 0, out - 1, 2):  # the row below
            for k in range(node[n], node[n + 1]):
                inside[k] = True
        for i in range(column_count):
            if col_paired[i]:
                ray = col_along[col_starts[i] : col_starts[i + 1]]
                inside[i] = np.searchsorted(ray, y0 + cell * j, side="right") % 2 == 1
        inside[0] = inside[-1] = False
        first, past = row_starts[j], row_starts[j + 1]
        for i in range(1, column_count):
            if inside[i] != inside[i - 1]:
                low, high = x0 + cell * (i - 1), x0 + cell * i
                a = first + np.searchsorted(row_along[first:past], low, side="right")
                b = first + np.searchsorted(row_along[first:past], high, side="right")
                node[out] = i
                along[out], k = _middle(row_along, first, past, a, b, low, high)
                facet[out] = row_facet[k] if k >= 0 else NO_FACET
                out += 1
        starts[j + 1] = out
    return Knots(starts, node[:out], along[:out], facet[:out])


@kernel
def column_knots(grid: Grid, rows: Knots, columns: RayColumns) -> tuple[Knots, Bools]:
    """Crossed edges along columns, where the sides of a row's nodes differ from the next row's, and whether each enters the
    material."""
    row_starts, row_node = rows.starts, rows.node
    _, y0, cell, _, row_count = grid
    col_starts, col_along, col_facet, _ = columns
    starts = np.zeros(row_count + 1, np.int64)
    node, up = np.empty(0, np.int64), np.empty(0, np.bool_)
    for counted in (False, True):
        if counted:
            node, up = np.empty(starts[row_count], np.int64), np.empty(starts[row_count], np.bool_)
        out = 0
        for j in range(row_count - 1):
            p, p_end = row_starts[j], row_starts[j + 1]
            q, q_end = row_starts[j + 1], row_starts[j + 2]
            lower = upper = False
            here = 0
            while p < p_end or q < q_end:
                a = row_node[p] if p < p_end else row_node[q]
                following = min(a, row_node[q]) if q < q_end else a
                if lower != upper:
                    if counted:
                        for i in range(here, following):
                            node[out + i - here], up[out + i - here] = i, upper
                    out += following - here
                if p < p_end and row_node[p] == following:
                    lower = not lower
                    p += 1
                if q < q_end and row_node[q] == following:
                    upper = not upper
                    q += 1
                here = following
            starts[j + 1] = out
        starts[row_count] = out
    along, facet = np.empty(node.size), np.empty(node.size, np.int32)
    above = col_starts[:-1].copy()  # of each column the first border above the row
    for j in range(row_count - 1):
        low, high = y0 + cell * j, y0 + cell * (j + 1)
        for k in range(starts[j], starts[j + 1]):
            first, past = col_starts[node[k]], col_starts[node[k] + 1]
            a = above[node[k]]
            while a < past and col_along[a] <= low:
                a += 1
            b = a
            while b < past and col_along[b] <= high:
                b += 1
            above[node[k]] = b
            along[k], border = _middle(col_along, first, past, a, b, low, high)
            facet[k] = col_facet[border] if border >= 0 else NO_FACET
    return Knots(starts, node, along, facet), up


@kernel
def _middle(along: Floats, first: int, past: int, a: int, b: int, low: float, high: float) -> tuple[float, int]:
    """Place and number of the middle border, of `a` to `b - 1`, of a ray on the grid edge (low, high].

    Where there is none, the number is -1, and a border of the ray within half an edge beyond an end counts as at that end.
    """
    if b > a:
        return along[(a + b) // 2], (a + b) // 2
    reach = 0.5 * (high - low)
    if a > first and low - along[a - 1] <= reach:
        return low, -1
    if b < past and along[b] - high <= reach:
        return high, -1
    return 0.5 * (low + high), -1


@kernel
def links(rows: Knots, columns: Knots, up: Bools, points: Floats) -> tuple[Ints, Ints]:
    """Knot that follows each knot, material on the left, those of rows before those of columns; and column and row of the cell
    between.

    Where four knots meet, the cell is :data:`SADDLE`, and the shorter way is taken between their `points` (K, 2), mm. Three
    pointers, into the lower row, the upper row and the columns, sweep the cells of each band.
    """
    row_starts, row_node, col_starts, col_node = rows.starts, rows.node, columns.starts, columns.node
    base = row_node.size
    after = np.full(base + col_node.size, -1, np.int64)
    cells = np.full((after.size, 2), SADDLE, np.int64)
    into, out_of = np.empty(2, np.int64), np.empty(2, np.int64)
    for j in range(row_starts.size - 2):
        p, q, c = row_starts[j], row_starts[j + 1], col_starts[j]
        p_end, q_end, c_end = row_starts[j + 1], row_starts[j + 2], col_starts[j + 1]
        least = -1  # cells left of this one are done
        while p < p_end or q < q_end or c < c_end:
            cell = row_node[p] - 1 if p < p_end else np.iinfo(np.int64).max
            if q < q_end:
                cell = min(cell, row_node[q] - 1)
            if c < c_end:
                cell = min(cell, max(col_node[c] - 1, least))
            ins = outs = 0
            for side in range(4):
                # Leaving the material rightwards in the lower row, the contour goes up; entering it upwards, right.
                if side == 0 and p < p_end and row_node[p] - 1 == cell:
                    knot, enters = p, (p - row_starts[j]) % 2 == 1
                    p += 1
                elif side == 1 and q < q_end and row_node[q] - 1 == cell:
                    knot, enters = q, (q - row_starts[j + 1]) % 2 == 0
                    q += 1
                elif side == 2 and c < c_end and col_node[c] == cell:
                    knot, enters = base + c, up[c]
                    c += 1
                elif side == 3 and c < c_end and col_node[c] == cell + 1:  # of the next cell, too
                    knot, enters = base + c, not up[c]
                else:
                    continue
                if enters:
                    into[ins] = knot
                    ins += 1
                else:
                    out_of[outs] = knot
                    outs += 1
            first = 0
            if ins == 2:
                ways = np.zeros(2)
                for n in range(2):
                    for m in range(2):
                        a, b = points[into[m]], points[out_of[m ^ n]]
                        ways[n] += math.hypot(a[0] - b[0], a[1] - b[1])
                first = 0 if ways[0] <= ways[1] else 1
            for n in range(ins):
                after[into[n]] = out_of[n ^ first]
                if ins == 1:
                    cells[into[n], 0], cells[into[n], 1] = cell, j
            least = cell + 1
    return after, cells


@kernel
def _chain(
    grid: Grid, after: Ints, cells: Ints, points: Floats, facet: Facets, mesh: Mesh, z: float, corners: bool
) -> tuple[Floats, Ints]:
    """Rings along the links; of knots in a row on one facet the first and the last.

    With `corners`, the point where the plane cuts the edge that the facets of two linked knots share is kept, if in the cell.
    """
    x0, y0, size, _, _ = grid
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
                x, y = _shared_corner(mesh, f, g, z)
                left, bottom = x0 + size * cells[k, 0], y0 + size * cells[k, 1]
                if left < x < left + size and bottom < y < bottom + size:
                    out_points[out, 0], out_points[out, 1] = x, y
                    out += 1
            k = after[k]
        rings += 1
        ring_starts[rings] = out
    return out_points[:out], ring_starts[: rings + 1]


@kernel
def _shared_corner(mesh: Mesh, f: int, g: int, z: float) -> tuple[float, float]:
    """Point at which the plane cuts the mesh edge that two facets share; NaN if it cuts none."""
    vertices, faces = mesh
    for m in range(3):
        a, b = faces[f, m], faces[f, (m + 1) % 3]
        if (vertices[a, 2] <= z) == (vertices[b, 2] <= z):
            continue
        for n in range(3):
            if faces[g, n] == b and faces[g, (n + 1) % 3] == a:
                low, high = (a, b) if vertices[a, 2] <= z else (b, a)
                t = (z - vertices[low, 2]) / (vertices[high, 2] - vertices[low, 2])
                x = vertices[low, 0] + t * (vertices[high, 0] - vertices[low, 0])
                return x, vertices[low, 1] + t * (vertices[high, 1] - vertices[low, 1])
    return np.nan, np.nan

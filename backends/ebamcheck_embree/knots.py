"""Where the contour crosses the grid: the knots that marching squares joins.

The rows of the grid decide which nodes are inside; where two neighbouring rows differ, the contour crosses the
grid edge between them. Every cell then has 0, 2 or 4 crossed edges whatever rounding did, so contours close.
A crossing is one *knot* of a contour: on a row at the border of its ray, on a column where that column's ray has one.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ebamcheck.numeric.kernels import kernel
from ebamcheck_embree.grid import Lattice
from ebamcheck_embree.scene import Bools, Facets, Floats, Ints

RayColumns = tuple[Ints, Floats, Facets, Bools]
"""The columns `starts`, `along`, `facet` and `paired` of :class:`ebamcheck_embree.hits.Borders`."""

NO_FACET = -1
"""Facet of a knot without a crossing, which lies at the middle or an end of its grid edge."""


class RowKnots(NamedTuple):
    """Crossed grid edges of all rows: entering, leaving, entering, leaving along each row."""

    starts: Ints
    """(rows + 1,) first knot of each row."""
    node: Ints
    """(K,) column of the node at the right end of the crossed edge."""
    along: Floats
    """(K,) x of the knot, mm."""
    facet: Facets


class ColumnKnots(NamedTuple):
    """Crossed grid edges between each row and the next."""

    starts: Ints
    """(rows + 1,) first knot between row j and row j + 1."""
    node: Ints
    """(K,) column on which the knot lies, ascending within each pair of rows."""
    along: Floats
    """(K,) y of the knot, mm."""
    facet: Facets
    up: Bools
    """(K,) whether the column enters the material there."""


@kernel
def node_after(place: float, first: float, cell: float, count: int) -> int:
    """Index of the first node at or beyond `place`, at most `count`, by the nodes' own coordinates."""
    k = min(max(int(np.ceil((place - first) / cell)), 0), count)
    while k > 0 and first + cell * (k - 1) >= place:
        k -= 1
    while k < count and first + cell * k < place:
        k += 1
    return k


@kernel
def _middle(
    along: Floats, first: int, past: int, a: int, b: int, low: float, high: float
) -> tuple[float, int]:
    """Place and number of the border of a ray on the grid edge (low, high]; the number is -1 where it has none.

    Of several, `a` to `b - 1`, the middle one; else a border of the ray, `first` to `past - 1`, within half an edge
    beyond an end counts as at that end: float64 put it on the other side. Else the edge's middle.
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
def middle_border(
    starts: Ints, along: Floats, facet: Facets, line: int, low: float, high: float
) -> tuple[float, int]:
    """Border of a ray on the grid edge (low, high], and its facet: see :func:`_middle`."""
    first, past = starts[line], starts[line + 1]
    a = first + np.searchsorted(along[first:past], low, side="right")
    b = first + np.searchsorted(along[first:past], high, side="right")
    place, k = _middle(along, first, past, a, b, low, high)
    return place, (facet[k] if k >= 0 else NO_FACET)


@kernel
def _column_inside(starts: Ints, along: Floats, line: int, place: float) -> bool:
    """Whether a paired ray is inside the material at `place`."""
    ray = along[starts[line] : starts[line + 1]]
    return bool(np.searchsorted(ray, place, side="right") % 2 == 1)


@kernel
def _mended_row(
    y: float,
    below: NDArray[np.bool_],
    col_starts: Ints,
    col_along: Floats,
    col_paired: Bools,
) -> NDArray[np.bool_]:
    """Nodes of a row whose own ray does not pair: by the columns, and where those fail as the row below."""
    inside = np.zeros(below.size, np.bool_)
    for i in range(below.size):
        inside[i] = _column_inside(col_starts, col_along, i, y) if col_paired[i] else below[i]
    inside[0] = inside[-1] = False
    return inside


@kernel
def row_knots(grid: Lattice, rows: RayColumns, columns: RayColumns) -> RowKnots:
    """Crossed edges along rows from the borders of row rays.

    An edge with an even number of borders joins nodes of the same side and is not crossed: what lies
    between is thinner than the cell. A row that does not pair is mended.
    """
    x0, y0, cell, column_count, row_count = grid
    row_starts, row_along, row_facet, row_paired = rows
    col_starts, col_along, _, col_paired = columns
    starts = np.zeros(row_count + 1, np.int64)
    room = row_along.size + column_count + 2
    node = np.empty(room, np.int64)
    along = np.empty(room)
    facet = np.empty(room, np.int32)
    inside = np.zeros(column_count, np.bool_)
    last_mended = -2
    out = 0
    for j in range(row_count):
        if out + column_count + row_starts[j + 1] - row_starts[j] + 2 > room:
            room = 2 * room + column_count
            node = _grown(node, out, room)
            along = _grown(along, out, room)
            facet = _grown(facet, out, room)
        if row_paired[j]:
            n = row_starts[j]
            while n < row_starts[j + 1]:
                k = node_after(row_along[n], x0, cell, column_count)
                m = n + 1
                while m < row_starts[j + 1] and row_along[m] <= x0 + cell * k:
                    m += 1
                if (m - n) % 2 == 1:
                    pick = (n + m) // 2
                    node[out], along[out], facet[out] = k, row_along[pick], row_facet[pick]
                    out += 1
                n = m
        else:
            if last_mended != j - 1:
                inside = _nodes_of_row(node[starts[j - 1] : out], column_count) if j > 0 else inside
            inside = _mended_row(y0 + cell * j, inside, col_starts, col_along, col_paired)
            last_mended = j
            for i in range(1, column_count):
                if inside[i] != inside[i - 1]:
                    node[out] = i
                    along[out], facet[out] = middle_border(
                        row_starts, row_along, row_facet, j, x0 + cell * (i - 1), x0 + cell * i
                    )
                    out += 1
        starts[j + 1] = out
    return RowKnots(starts, node[:out], along[:out], facet[:out])


@kernel
def _nodes_of_row(toggles: Ints, count: int) -> NDArray[np.bool_]:
    inside = np.zeros(count, np.bool_)
    for n in range(0, toggles.size - 1, 2):
        inside[toggles[n] : toggles[n + 1]] = True
    return inside


@kernel
def _grown(old: NDArray[Any], used: int, room: int) -> NDArray[Any]:
    new = np.empty(room, old.dtype)
    new[:used] = old[:used]
    return new


@kernel
def column_knots(grid: Lattice, rows: RowKnots, columns: RayColumns) -> ColumnKnots:
    """Crossed edges along columns: where the sides of a row's nodes differ from the next row's."""
    row_starts, row_node = rows.starts, rows.node
    _, y0, cell, column_count, row_count = grid
    col_starts, col_along, col_facet, _ = columns
    starts = np.zeros(row_count + 1, np.int64)
    room = col_along.size + column_count
    node = np.empty(room, np.int64)
    up = np.empty(room, np.bool_)
    out = 0
    for j in range(row_count - 1):
        if out + column_count > room:
            room = 2 * room
            node, up = _grown(node, out, room), _grown(up, out, room)
        p, p_end = row_starts[j], row_starts[j + 1]
        q, q_end = row_starts[j + 1], row_starts[j + 2]
        lower = upper = False
        here = 0
        while p < p_end or q < q_end:
            a = row_node[p] if p < p_end else row_node[q]
            b = row_node[q] if q < q_end else row_node[p]
            following = min(a, b)
            if lower != upper:
                for i in range(here, following):
                    node[out], up[out] = i, upper
                    out += 1
            if p < p_end and row_node[p] == following:
                lower = not lower
                p += 1
            if q < q_end and row_node[q] == following:
                upper = not upper
                q += 1
            here = following
        starts[j + 1] = out
    starts[row_count] = out
    along = np.empty(out)
    facet = np.empty(out, np.int32)
    following = col_starts[:-1].copy()  # of each column the first border above the row
    for j in range(row_count - 1):
        low, high = y0 + cell * j, y0 + cell * (j + 1)
        for k in range(starts[j], starts[j + 1]):
            first, past = col_starts[node[k]], col_starts[node[k] + 1]
            a = following[node[k]]
            while a < past and col_along[a] <= low:
                a += 1
            b = a
            while b < past and col_along[b] <= high:
                b += 1
            following[node[k]] = b
            along[k], border = _middle(col_along, first, past, a, b, low, high)
            facet[k] = col_facet[border] if border >= 0 else NO_FACET
    return ColumnKnots(starts, node[:out], along, facet, up[:out])

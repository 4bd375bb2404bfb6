"""The canonical form of rings, see :class:`~ebamcheck.layers.stack.Layers`: where each starts, what it keeps, and their order."""

from __future__ import annotations

import numpy as np

from ebamcheck.geometry.rings import EPSILON
from ebamcheck.kernels import Bools, Floats, Ints, kernel

DROPPED = -1  # first row of a ring that is left out of the canonical form


@kernel
def next_distinct(points: Floats, i: int, a: int, b: int) -> int:
    """Row after `i` on the closed ring ``[a, b)`` that holds another point than row `i`."""
    k = i
    for _ in range(b - a):
        k = k + 1 if k + 1 < b else a
        if points[k, 0] != points[i, 0] or points[k, 1] != points[i, 1]:
            return k
    return i


@kernel
def ring_form(points: Floats, a: int, b: int, closed: bool) -> tuple[int, int, int]:
    """Row of the first point of ring ``[a, b)`` in canonical form, its points there, and the row of its next distinct point.

    A closed ring starts at its lexicographically least point; among equal ones, at that with the least
    next point. It is dropped, with :data:`DROPPED` as first row, where it has under three distinct points or no area within
    the rounding of its coordinates. An open path keeps its start; it is dropped where it is one point.
    """
    if b == a:
        return DROPPED, 0, a
    x0, y0 = points[a, 0], points[a, 1]
    least, least_x, least_y = a, x0, y0
    kept, again = 1, False
    largest = max(abs(x0), abs(y0))
    length = area = 0.0
    before_x, before_y = x0, y0
    for i in range(a + 1, b):
        x, y = points[i, 0], points[i, 1]
        dx, dy = x - before_x, y - before_y
        if dx == 0.0 and dy == 0.0:
            continue
        kept += 1
        length += abs(dx) + abs(dy)
        largest = max(largest, abs(x), abs(y))
        area += (before_x - x0) * dy - (before_y - y0) * dx
        if x <= least_x and (x < least_x or y <= least_y):
            again = x == least_x and y == least_y
            if not again:
                least, least_x, least_y = i, x, y
        before_x, before_y = x, y
    if not closed:
        return (a, kept, next_distinct(points, a, a, b)) if kept > 1 else (DROPPED, 0, a)
    if kept > 1 and points[b - 1, 0] == x0 and points[b - 1, 1] == y0:
        kept -= 1
    length += abs(x0 - points[b - 1, 0]) + abs(y0 - points[b - 1, 1])
    if kept < 3 or abs(area) <= 4.0 * EPSILON * largest * length:
        return DROPPED, 0, a
    after = next_distinct(points, least, a, b)
    if again:
        for i in range(a, b):
            if i != least and points[i, 0] == least_x and points[i, 1] == least_y:
                k = next_distinct(points, i, a, b)
                if (points[k, 0], points[k, 1]) < (points[after, 0], points[after, 1]):
                    least, after = i, k
    return least, kept, after


@kernel
def ring_forms(points: Floats, ring_starts: Ints, closed: Bools, start: int, stop: int, forms: Ints) -> None:
    """Write :func:`ring_form` of the rings ``[start, stop)`` to the rows of `forms` (R, 3)."""
    for r in range(start, stop):
        a, b = ring_starts[r], ring_starts[r + 1]
        forms[r, 0], forms[r, 1], forms[r, 2] = ring_form(points, a, b, closed[r])


def ring_order(points: Floats, layer_starts: Ints, forms: Ints) -> tuple[Ints, Ints]:
    """Rings that are kept, by layer, first point, next point and size (R',), and the first of each layer (L + 1,)."""
    layer = np.repeat(np.arange(layer_starts.size - 1), np.diff(layer_starts))
    kept = np.flatnonzero(forms[:, 0] != DROPPED)
    first, after = points[forms[kept, 0]], points[forms[kept, 2]]
    order = np.lexsort((forms[kept, 1], after[:, 1], after[:, 0], first[:, 1], first[:, 0], layer[kept]))
    sizes = np.bincount(layer[kept], minlength=layer_starts.size - 1)
    return kept[order], np.concatenate([[0], np.cumsum(sizes)])


@kernel
def rows_in_form(
    points: Floats, ring_starts: Ints, forms: Ints, order: Ints, new_starts: Ints, start: int, stop: int, rows: Ints
) -> None:  # fmt: skip
    """Write the rows of the rings ``order[start:stop]`` in canonical form to `rows`, each ring from ``new_starts[n]`` on."""
    for n in range(start, stop):
        r = order[n]
        a, b, i = ring_starts[r], ring_starts[r + 1], forms[r, 0]
        distinct = forms[r, 1] == b - a
        for k in range(new_starts[n], new_starts[n + 1]):
            rows[k] = i
            step = i + 1 if i + 1 < b else a
            i = step if distinct else next_distinct(points, i, a, b)

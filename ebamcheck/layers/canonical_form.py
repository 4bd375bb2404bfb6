"""Kernels that bring rings into the canonical form of :class:`~ebamcheck.layers.stack.Layers`.

Three steps, each for one ring or for the rings of one layer, so that a slicer can do them while the points of a
layer are still in the processor's cache: :func:`ring_form` finds the first point of a ring and the number that it keeps,
:func:`sort_rings` orders the rings of a layer, :func:`write_ring` copies a ring's columns.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import EPSILON, Bools, Floats, Ints
from ebamcheck.numeric.sorting import as_floats, stable_order

DROPPED = -1  # first row of a ring that is left out of the canonical form


@kernel
def lower(points: Floats, i: int, k: int) -> bool:
    """Whether point `i` is lexicographically less than point `k`."""
    return bool(points[i, 0] < points[k, 0] or (points[i, 0] == points[k, 0] and points[i, 1] < points[k, 1]))


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
    """Find where ring ``[a, b)`` starts in canonical form and how many points it keeps.

    A closed ring starts at its lexicographically least point; among equal ones, at that with the least
    next point. It is dropped where it has under three distinct points or no area within
    the rounding of its coordinates. An open path keeps its start; it is dropped where it is one point.

    Told are the row of the first point (:data:`DROPPED` for a ring that is left out), the points that remain once consecutive
    equal ones are gone, and the row of the next distinct point, which orders rings that start at the same point.
    """
    if b == a:
        return DROPPED, 0, a
    kept, least, again, largest, length, area = _measures(points, a, b)
    if not closed:
        return (a, kept, next_distinct(points, a, a, b)) if kept > 1 else (DROPPED, 0, a)
    if kept > 1 and points[b - 1, 0] == points[a, 0] and points[b - 1, 1] == points[a, 1]:
        kept -= 1
    length += abs(points[a, 0] - points[b - 1, 0]) + abs(points[a, 1] - points[b - 1, 1])
    if kept < 3 or abs(area) <= 4.0 * EPSILON * largest * length:
        return DROPPED, 0, a
    after = next_distinct(points, least, a, b)
    if again:
        for i in range(a, b):
            if i != least and points[i, 0] == points[least, 0] and points[i, 1] == points[least, 1]:
                k = next_distinct(points, i, a, b)
                if lower(points, k, after):
                    least, after = i, k
    return least, kept, after


@kernel
def _measures(points: Floats, a: int, b: int) -> tuple[int, int, bool, float, float, float]:
    """Measure a path in one pass.

    Told are the points without those equal to the one before, the row of the least point, whether the path comes back to it, the
    largest coordinate, the length (sum norm), and twice the area.
    """
    x0, y0 = points[a, 0], points[a, 1]
    least, least_x, least_y = a, x0, y0
    kept, again = 1, False
    largest = max(abs(x0), abs(y0))
    length = 0.0
    area = 0.0
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
    return kept, least, again, largest, length, area


@kernel
def sort_rings(points: Floats, first: Ints, size: Ints, after: Ints, a: int, b: int, order: Ints) -> int:
    """Put the rings ``[a, b)`` that are kept into `order` (b - a,), as they stand in their layer; returns their number.

    They stand by their first point, then by the next one, then by size; `first`, `size` and `after` (R,) are as of :func:`ring_form`.
    """
    count = 0
    for r in range(a, b):
        if first[r] != DROPPED:
            order[count] = r
            count += 1
    if count < 2:
        return count
    kept = order[:count]
    kept[:] = kept[stable_order(as_floats(size[kept]))]
    for rows in (after, first):
        for axis in (1, 0):
            kept[:] = kept[stable_order(points[rows[kept], axis])]
    return count


@kernel
def write_ring(
    points: Floats, a: int, b: int, first: int, size: int, column: NDArray[Any], out: NDArray[Any], at: int
) -> None:
    """Copy the (N, 2) or (N,) `column` of ring ``[a, b)`` to rows ``at .. at + size - 1`` of `out`, in canonical form."""
    if size == b - a:
        out[at : at + b - first] = column[first:b]
        out[at + b - first : at + size] = column[a:first]
        return
    i = first
    for k in range(size):
        out[at + k] = column[i]
        i = next_distinct(points, i, a, b)


# -- whole stacks ------------------------------------------------------------------------------------


@kernel
def ring_forms(
    points: Floats,
    ring_starts: Ints,
    closed: Bools,
    start: int,
    stop: int,
    first: Ints,
    size: Ints,
    after: Ints,
) -> None:
    """Write :func:`ring_form` of the rings ``[start, stop)`` into `first`, `size` and `after`, (R,) each."""
    for r in range(start, stop):
        first[r], size[r], after[r] = ring_form(points, ring_starts[r], ring_starts[r + 1], closed[r])


@kernel
def ring_order(points: Floats, layer_starts: Ints, first: Ints, size: Ints, after: Ints) -> tuple[Ints, Ints]:
    """Rings that are kept, by layer and in their order in it (R',), and the first of each layer (L + 1,)."""
    order = np.empty(first.size, np.int64)
    new_starts = np.zeros(layer_starts.size, np.int64)
    kept = 0
    for layer in range(layer_starts.size - 1):
        a, b = layer_starts[layer], layer_starts[layer + 1]
        kept += sort_rings(points, first, size, after, a, b, order[kept:])
        new_starts[layer + 1] = kept
    return order[:kept].copy(), new_starts


@kernel
def gather(
    points: Floats, ring_starts: Ints, first: Ints, order: Ints, new_starts: Ints, column: NDArray[Any],
    out: NDArray[Any], start: int, stop: int,
) -> None:  # fmt: skip
    """:func:`write_ring` of the rings ``order[start:stop]``, each to its place by `new_starts`."""
    for n in range(start, stop):
        r = order[n]
        size = new_starts[n + 1] - new_starts[n]
        write_ring(points, ring_starts[r], ring_starts[r + 1], first[r], size, column, out, new_starts[n])

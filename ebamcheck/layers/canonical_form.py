"""Kernels that bring rings into the canonical form of :class:`~ebamcheck.layers.stack.Layers`.

Three steps, each for one ring or for the rings of one layer, so that a slicer can do them while the points of a
layer are still in the processor's cache: :func:`ring_form` finds the first point of a ring and the number that it keeps,
:func:`sort_rings` orders the rings of a layer, :func:`write_pairs` and :func:`write_numbers` copy a ring's columns.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import EPSILON, Bools, Floats, Ints

DROPPED = -1
"""First row of a ring that is left out of the canonical form."""

FEW_RINGS = 16
"""Most rings that are sorted by insertion; more are sorted by merging."""


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

    Returns
    -------
    first, size, after
        Row of the first point (:data:`DROPPED` for a ring that is left out), points that remain once consecutive
        equal ones are gone, row of the next distinct point (orders rings that start at the same point).
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

    Returns
    -------
    kept, least, again, largest, length, area
        Points without those equal to the one before, row of the least point, whether the path comes back to it, largest
        coordinate, length (sum norm), twice the area.
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
def _before(points: Floats, first: Ints, size: Ints, after: Ints, r: int, s: int) -> bool:
    """Whether ring `r` stands before ring `s` in its layer: by first point, then by the next, then by size."""
    i, k = first[r], first[s]
    if points[i, 0] != points[k, 0] or points[i, 1] != points[k, 1]:
        return lower(points, i, k)
    i, k = after[r], after[s]
    if points[i, 0] != points[k, 0] or points[i, 1] != points[k, 1]:
        return lower(points, i, k)
    return bool(size[r] < size[s])


@kernel
def sort_rings(
    points: Floats, first: Ints, size: Ints, after: Ints, a: int, b: int, order: Ints, spare: Ints
) -> int:
    """Put the rings ``[a, b)`` that are kept into `order`, as they stand in their layer; returns their number.

    Parameters
    ----------
    points
        (N, 2) points of the rings.
    first, size, after
        (R,) each, as :func:`ring_form` tells them.
    a, b
        Rings of one layer.
    order, spare
        (b - a,) at least each; written over.
    """
    count = 0
    for r in range(a, b):
        if first[r] != DROPPED:
            order[count] = r
            count += 1
    for start in range(0, count, FEW_RINGS):
        _insert(points, first, size, after, order, start, min(start + FEW_RINGS, count))
    width = FEW_RINGS
    while width < count:
        for start in range(0, count, 2 * width):
            middle, stop = min(start + width, count), min(start + 2 * width, count)
            _merge(points, first, size, after, order, start, middle, stop, spare)
        width *= 2
    return count


@kernel
def _insert(points: Floats, first: Ints, size: Ints, after: Ints, order: Ints, start: int, stop: int) -> None:
    for i in range(start + 1, stop):
        r = order[i]
        k = i
        while k > start and _before(points, first, size, after, r, order[k - 1]):
            order[k] = order[k - 1]
            k -= 1
        order[k] = r


@kernel
def _merge(
    points: Floats,
    first: Ints,
    size: Ints,
    after: Ints,
    order: Ints,
    start: int,
    middle: int,
    stop: int,
    spare: Ints,
) -> None:
    """Merge the two ordered runs ``[start, middle)`` and ``[middle, stop)``; equal rings keep their order."""
    for i in range(start, middle):
        spare[i - start] = order[i]
    i, k, left = 0, middle, middle - start
    for at in range(start, stop):
        if i == left:
            break
        if k < stop and _before(points, first, size, after, order[k], spare[i]):
            order[at] = order[k]
            k += 1
        else:
            order[at] = spare[i]
            i += 1


@kernel
def write_pairs(
    points: Floats, a: int, b: int, first: int, size: int, column: NDArray[Any], out: NDArray[Any], at: int
) -> None:
    """Copy the (N, 2) `column` of ring ``[a, b)`` to rows ``at .. at + size - 1`` of `out`, in canonical form."""
    if size == b - a:
        _copy_pairs(column[first:b], out[at : at + b - first])
        _copy_pairs(column[a:first], out[at + b - first : at + size])
        return
    i = first
    for k in range(size):
        out[at + k, 0] = column[i, 0]
        out[at + k, 1] = column[i, 1]
        i = next_distinct(points, i, a, b)


@kernel
def write_numbers(
    points: Floats, a: int, b: int, first: int, size: int, column: NDArray[Any], out: NDArray[Any], at: int
) -> None:
    """Copy the (N,) `column` of ring ``[a, b)`` to rows ``at .. at + size - 1`` of `out`, in canonical form."""
    if size == b - a:
        _copy_numbers(column[first:b], out[at : at + b - first])
        _copy_numbers(column[a:first], out[at + b - first : at + size])
        return
    i = first
    for k in range(size):
        out[at + k] = column[i]
        i = next_distinct(points, i, a, b)


@kernel
def _copy_pairs(column: NDArray[Any], out: NDArray[Any]) -> None:
    # From row 0 of a view: the compiler then knows that no index is negative, and copies many rows at a time.
    for k in range(column.shape[0]):
        out[k, 0] = column[k, 0]
        out[k, 1] = column[k, 1]


@kernel
def _copy_numbers(column: NDArray[Any], out: NDArray[Any]) -> None:
    for k in range(column.size):
        out[k] = column[k]


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
    spare = np.empty(first.size, np.int64)
    new_starts = np.zeros(layer_starts.size, np.int64)
    kept = 0
    for layer in range(layer_starts.size - 1):
        a, b = layer_starts[layer], layer_starts[layer + 1]
        kept += sort_rings(points, first, size, after, a, b, order[kept:], spare)
        new_starts[layer + 1] = kept
    return order[:kept].copy(), new_starts


@kernel
def gather_pairs(
    points: Floats, ring_starts: Ints, first: Ints, order: Ints, new_starts: Ints, column: NDArray[Any],
    out: NDArray[Any], start: int, stop: int,
) -> None:  # fmt: skip
    """:func:`write_pairs` of the rings ``order[start:stop]``, each to its place by `new_starts`."""
    for n in range(start, stop):
        r = order[n]
        size = new_starts[n + 1] - new_starts[n]
        write_pairs(points, ring_starts[r], ring_starts[r + 1], first[r], size, column, out, new_starts[n])


@kernel
def gather_numbers(
    points: Floats, ring_starts: Ints, first: Ints, order: Ints, new_starts: Ints, column: NDArray[Any],
    out: NDArray[Any], start: int, stop: int,
) -> None:  # fmt: skip
    """:func:`write_numbers` of the rings ``order[start:stop]``, each to its place by `new_starts`."""
    for n in range(start, stop):
        r = order[n]
        size = new_starts[n + 1] - new_starts[n]
        write_numbers(points, ring_starts[r], ring_starts[r + 1], first[r], size, column, out, new_starts[n])

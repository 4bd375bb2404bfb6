"""Kernels on rings of points: area, length, canonical form, point location.

A *ring* is a run of rows of a ``(N, 2)`` point array; it closes implicitly (no repeated end point).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ebamcheck.kernels import kernel

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

EPSILON = 2.0**-52
"""Spacing of float64 at 1."""

OUTSIDE, INSIDE, ON_BOUNDARY = 0, 1, 2
"""Answers of :func:`locate`."""


class CanonicalOrder(NamedTuple):
    """What :func:`canonical_order` finds for each ring (all ``(R,)``)."""

    first: Ints
    """Row of the point at which the ring starts, -1 where the ring is dropped."""
    size: Ints
    """Points that remain once consecutive equal ones are gone."""
    following: Floats
    """``(R, 2)``: the point after the first (orders rings that start at the same point)."""


@kernel
def signed_areas(points: Floats, ring_starts: Ints, closed: Bools) -> Floats:
    """Signed area of each ring (R,), mm2: counter-clockwise positive, 0 for open paths.

    Summed about the ring's first point, so that a ring far from the origin loses no digits.
    """
    count = ring_starts.size - 1
    areas = np.zeros(count)
    for r in range(count):
        a, b = ring_starts[r], ring_starts[r + 1]
        if not closed[r] or b - a < 3:
            continue
        x0, y0 = points[a, 0], points[a, 1]
        total = 0.0
        for i in range(a + 1, b - 1):
            total += (points[i, 0] - x0) * (points[i + 1, 1] - y0) - (points[i + 1, 0] - x0) * (
                points[i, 1] - y0
            )
        areas[r] = 0.5 * total
    return areas


@kernel
def lengths(points: Floats, ring_starts: Ints, closed: Bools) -> Floats:
    """Length of each ring (R,), mm; a closed ring includes its closing segment."""
    count = ring_starts.size - 1
    result = np.zeros(count)
    for r in range(count):
        a, b = ring_starts[r], ring_starts[r + 1]
        total = 0.0
        for i in range(a + 1, b):
            total += np.hypot(points[i, 0] - points[i - 1, 0], points[i, 1] - points[i - 1, 1])
        if closed[r] and b - a > 1:
            total += np.hypot(points[a, 0] - points[b - 1, 0], points[a, 1] - points[b - 1, 1])
        result[r] = total
    return result


@kernel
def bounds(points: Floats, ring_starts: Ints) -> Floats:
    """Bounding box of each ring, (R, 4): xmin, ymin, xmax, ymax; NaN for an empty ring."""
    count = ring_starts.size - 1
    boxes = np.full((count, 4), np.nan)
    for r in range(count):
        for i in range(ring_starts[r], ring_starts[r + 1]):
            x, y = points[i, 0], points[i, 1]
            if i == ring_starts[r]:
                boxes[r, 0] = boxes[r, 2] = x
                boxes[r, 1] = boxes[r, 3] = y
            else:
                boxes[r, 0] = min(boxes[r, 0], x)
                boxes[r, 1] = min(boxes[r, 1], y)
                boxes[r, 2] = max(boxes[r, 2], x)
                boxes[r, 3] = max(boxes[r, 3], y)
    return boxes


@kernel
def locate(x: float, y: float, points: Floats, start: int, stop: int) -> int:
    """Where (x, y) lies with respect to the closed ring ``points[start:stop]`` (even-odd rule)."""
    inside = False
    j = stop - 1
    for i in range(start, stop):
        xi, yi, xj, yj = points[i, 0], points[i, 1], points[j, 0], points[j, 1]
        if (yi > y) != (yj > y):
            side = (xj - xi) * (y - yi) - (x - xi) * (yj - yi)
            if side == 0.0:
                return ON_BOUNDARY
            if (side > 0.0) == (yj > yi):
                inside = not inside
        elif yi == y and ((xi == x) or (yj == y and (xi > x) != (xj > x))):
            return ON_BOUNDARY
        j = i
    return INSIDE if inside else OUTSIDE


@kernel
def ring_in_ring(points: Floats, a: int, b: int, c: int, d: int) -> bool:
    """Whether ring ``[a, b)`` lies inside ring ``[c, d)``; the two may touch but do not cross."""
    for i in range(a, b):
        where = locate(points[i, 0], points[i, 1], points, c, d)
        if where != ON_BOUNDARY:
            return bool(where == INSIDE)
    for i in range(a, b):
        k = i + 1 if i + 1 < b else a
        x, y = 0.5 * (points[i, 0] + points[k, 0]), 0.5 * (points[i, 1] + points[k, 1])
        where = locate(x, y, points, c, d)
        if where != ON_BOUNDARY:
            return bool(where == INSIDE)
    return False


@kernel
def parents(points: Floats, ring_starts: Ints, layer_starts: Ints, areas: Floats, boxes: Floats) -> Ints:
    """Index of the smallest ring that encloses each ring in its layer (R,), -1 for none.

    Open paths and other rings without area enclose nothing and are enclosed by nothing.
    """
    result = np.full(ring_starts.size - 1, -1, np.int64)
    for layer in range(layer_starts.size - 1):
        for r in range(layer_starts[layer], layer_starts[layer + 1]):
            size = abs(areas[r])
            if size == 0.0:
                continue
            for s in range(layer_starts[layer], layer_starts[layer + 1]):
                other = abs(areas[s])
                if other <= size or (result[r] >= 0 and other >= abs(areas[result[r]])):
                    continue
                if (
                    boxes[s, 0] <= boxes[r, 0]
                    and boxes[s, 1] <= boxes[r, 1]
                    and boxes[s, 2] >= boxes[r, 2]
                    and boxes[s, 3] >= boxes[r, 3]
                    and ring_in_ring(
                        points, ring_starts[r], ring_starts[r + 1], ring_starts[s], ring_starts[s + 1]
                    )
                ):
                    result[r] = s
    return result


@kernel
def _next_distinct(points: Floats, i: int, a: int, b: int) -> int:
    """Row after `i` on the closed ring ``[a, b)`` that holds another point than row `i`."""
    k = i
    for _ in range(b - a):
        k = k + 1 if k + 1 < b else a
        if points[k, 0] != points[i, 0] or points[k, 1] != points[i, 1]:
            return k
    return i


@kernel
def _lower(points: Floats, i: int, k: int) -> bool:
    """Whether point `i` is lexicographically less than point `k`."""
    return bool(points[i, 0] < points[k, 0] or (points[i, 0] == points[k, 0] and points[i, 1] < points[k, 1]))


@kernel
def canonical_order(points: Floats, ring_starts: Ints, closed: Bools) -> tuple[Ints, Ints, Floats]:
    """Find where each ring starts in canonical form and how many points it keeps.

    A closed ring starts at its lexicographically least point; among equal ones, at that with the least
    next point. It is dropped (``first = -1``) where it has under three distinct points or no area within
    the rounding of its coordinates. An open path keeps its start; it is dropped where it is one point.
    """
    count = ring_starts.size - 1
    first = np.full(count, -1, np.int64)
    size = np.zeros(count, np.int64)
    following = np.zeros((count, 2))
    for r in range(count):
        a, b = ring_starts[r], ring_starts[r + 1]
        if b == a:
            continue
        kept = 1
        least = a
        largest = max(abs(points[a, 0]), abs(points[a, 1]))
        length = 0.0
        area = 0.0
        for i in range(a + 1, b):
            dx, dy = points[i, 0] - points[i - 1, 0], points[i, 1] - points[i - 1, 1]
            if dx == 0.0 and dy == 0.0:
                continue
            kept += 1
            length += abs(dx) + abs(dy)
            largest = max(largest, abs(points[i, 0]), abs(points[i, 1]))
            area += (points[i - 1, 0] - points[a, 0]) * dy - (points[i - 1, 1] - points[a, 1]) * dx
            if _lower(points, i, least):
                least = i
        if not closed[r]:
            if kept > 1:
                first[r], size[r] = a, kept
                k = _next_distinct(points, a, a, b)
                following[r, 0], following[r, 1] = points[k, 0], points[k, 1]
            continue
        if kept > 1 and points[b - 1, 0] == points[a, 0] and points[b - 1, 1] == points[a, 1]:
            kept -= 1
        length += abs(points[a, 0] - points[b - 1, 0]) + abs(points[a, 1] - points[b - 1, 1])
        if kept < 3 or abs(area) <= 4.0 * EPSILON * largest * length:
            continue
        after = _next_distinct(points, least, a, b)
        for i in range(a, b):
            if i != least and points[i, 0] == points[least, 0] and points[i, 1] == points[least, 1]:
                k = _next_distinct(points, i, a, b)
                if _lower(points, k, after):
                    least, after = i, k
        first[r], size[r] = least, kept
        following[r, 0], following[r, 1] = points[after, 0], points[after, 1]
    return first, size, following


@kernel
def gather_rows(
    points: Floats, ring_starts: Ints, closed: Bools, rings: Ints, first: Ints, new_starts: Ints
) -> Ints:
    """Source row of every point of the canonical form (N',): `rings` in order, each from its `first` row."""
    rows = np.empty(new_starts[-1], np.int64)
    for n in range(rings.size):
        r = rings[n]
        a, b = ring_starts[r], ring_starts[r + 1]
        out = new_starts[n]
        i = first[r]
        previous = -1
        for _ in range(b - a):
            if out == new_starts[n + 1]:
                break
            if previous < 0 or points[i, 0] != points[previous, 0] or points[i, 1] != points[previous, 1]:
                rows[out] = i
                out += 1
                previous = i
            i = i + 1 if i + 1 < b else a
    return rows

"""Kernels on rings of points: area, length, bounds, nesting, point location; and on their columns: order, rotation.

A *ring* is a run of rows of a ``(N, 2)`` point array; it closes implicitly (no repeated end point).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ebamcheck.kernels import Bools, Floats, Ints, kernel

EPSILON = 2.0**-52
"""Spacing of float64 at 1."""

OUTSIDE, INSIDE, ON_BOUNDARY = 0, 1, 2
"""Answers of :func:`locate`."""


@kernel
def signed_area(points: Floats, a: int, b: int) -> float:
    """Signed area of the closed ring ``[a, b)``, mm2, summed about its first point."""
    if b - a < 3:
        return 0.0
    x0, y0 = points[a, 0], points[a, 1]
    total = 0.0
    x, y = points[a + 1, 0] - x0, points[a + 1, 1] - y0
    for i in range(a + 2, b):
        next_x, next_y = points[i, 0] - x0, points[i, 1] - y0
        total += x * next_y - next_x * y
        x, y = next_x, next_y
    return 0.5 * total


@kernel
def signed_areas(points: Floats, ring_starts: Ints, closed: Bools) -> Floats:
    """Signed area of each ring (R,), mm2: counter-clockwise positive, 0 for open paths.

    Summed about the ring's first point, so that a ring far from the origin loses no digits.
    """
    areas = np.zeros(ring_starts.size - 1)
    for r in range(areas.size):
        if closed[r]:
            areas[r] = signed_area(points, ring_starts[r], ring_starts[r + 1])
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
def stable_order(keys: Floats) -> Ints:
    """Places (n,) of keys (n,) from the least to the greatest; equal ones stay as they stand."""
    return np.argsort(keys, kind="mergesort")


@kernel
def rotate_to(values: NDArray[Any], first: int) -> None:
    """Let values (n,) that close on themselves begin with another one, in place."""
    before = values.copy()
    k = first
    for i in range(values.size):
        values[i] = before[k]
        k = k + 1 if k + 1 < values.size else 0

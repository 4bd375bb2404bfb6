"""Kernels on rings of points: area, length, bounds, nesting, point location; and the order of columns.

A *ring* is a run of rows of a ``(N, 2)`` point array; it closes implicitly (no repeated end point).
"""

from __future__ import annotations

import numpy as np

from ebamcheck.kernels import Bools, Floats, Ints, kernel

EPSILON = 2.0**-52  # spacing of float64 at 1
OUTSIDE, INSIDE, ON_BOUNDARY = 0, 1, 2  # answers of `locate`


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


def lengths(points: Floats, ring_starts: Ints, closed: Bools) -> Floats:
    """Length of each ring (R,), mm; a closed ring includes its closing segment."""
    following = np.arange(1, len(points) + 1)
    last, filled = ring_starts[1:] - 1, np.diff(ring_starts) > 0
    following[last[filled]] = np.where(closed, ring_starts[:-1], last)[filled]
    steps = np.hypot(*(points[following] - points).T) if len(points) else np.zeros(0)
    result = np.zeros(len(closed))
    if filled.any():
        result[filled] = np.add.reduceat(steps, ring_starts[:-1][filled])
    return result


def bounds(points: Floats, ring_starts: Ints) -> Floats:
    """Bounding box of each ring, (R, 4): xmin, ymin, xmax, ymax; NaN for an empty ring."""
    result = np.full((ring_starts.size - 1, 4), np.nan)
    filled = np.diff(ring_starts) > 0
    if filled.any():
        first = ring_starts[:-1][filled]
        inside = points[: ring_starts[-1]]
        result[filled, :2] = np.minimum.reduceat(inside, first)
        result[filled, 2:] = np.maximum.reduceat(inside, first)
    return result


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
                    and ring_in_ring(points, ring_starts[r], ring_starts[r + 1], ring_starts[s], ring_starts[s + 1])
                ):
                    result[r] = s
    return result


@kernel
def stable_order(values: Floats) -> Ints:
    """Places (n,) of values (n,) in ascending order, equal ones as they stand: runs that rise or fall are found, then merged.

    Columns of contours have few runs, but long ones.
    """
    count = values.size
    order, merged = np.empty(count, np.int64), np.empty(count, np.int64)
    borders = np.empty(count + 1, np.int64)
    runs, start = 0, 0
    while start < count:
        stop = start + 1
        if stop < count and values[stop] < values[start]:
            while stop < count and values[stop] < values[stop - 1]:
                stop += 1
            for k in range(start, stop):
                order[k] = start + stop - 1 - k
        else:
            while stop < count and values[stop] >= values[stop - 1]:
                stop += 1
            for k in range(start, stop):
                order[k] = k
        borders[runs] = start
        runs += 1
        start = stop
    borders[runs] = count
    while runs > 1:
        for run in range(0, runs, 2):
            a, b, c = borders[run], borders[min(run + 1, runs)], borders[min(run + 2, runs)]
            i, j = a, b
            for n in range(a, c):
                if j == c or (i < b and values[order[i]] <= values[order[j]]):
                    merged[n] = order[i]
                    i += 1
                else:
                    merged[n] = order[j]
                    j += 1
            borders[run // 2] = a
        runs = (runs + 1) // 2
        borders[runs] = count
        order, merged = merged, order
    return order

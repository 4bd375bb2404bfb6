"""The contours of one layer made ready for measuring: segments, a grid over them, and sweep edges.

A layer is made ready once and then measured against any number of others. All outlines that are measured
against each other share one origin, so that parts far from the origin keep their digits.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ebamcheck.kernels import kernel
from ebamcheck.layers import Layers
from ebamcheck.rings import EPSILON, Bools, Floats, Ints

CELLS_PER_SEGMENT = 6
"""Grid cells per segment: few segments in a cell, and a grid that is small to build."""

MOST_ENTRIES_PER_SEGMENT = 64
"""A grid in which segments cross more cells than this on average is made coarser."""

ROUNDING = 4.0 * EPSILON
"""Deviation, relative to the largest coordinate, below which a point on a straight run is dropped."""


class Outline(NamedTuple):
    """The contours of one layer, mm, from a shared origin.

    Parameters
    ----------
    segments
        (S, 4) ``x0, y0, x1, y1`` in the order of the contours; those of closed rings come first.
    enclosing
        How many segments, from the first on, belong to closed rings; the rest are those of open paths.
    length
        Length of all contours.
    edges
        (E, 4) ``x, y`` of the lower and of the upper end of each segment that encloses area and is not
        level, sorted by lower y, then lower x.
    steps
        (E,) change of the winding number where an edge is crossed from left to right.
    levels
        Strictly increasing y of all ends of `edges`.
    x_mm, y_mm, cell_mm, columns, rows
        Lower left corner of the grid, side of its cells, and their numbers.
    cell_starts, cell_items
        Segments that pass through each cell (row by row), as a ragged column.
    """

    segments: Floats
    enclosing: int
    length: float
    edges: Floats
    steps: Ints
    levels: Floats
    x_mm: float
    y_mm: float
    cell_mm: float
    columns: int
    rows: int
    cell_starts: Ints
    cell_items: Ints


def outline(layers: Layers, layer: int, origin_mm: tuple[float, float]) -> Outline:
    """Make one layer of a stack ready for measuring, in coordinates from `origin_mm`."""
    r0, r1 = int(layers.layer_starts[layer]), int(layers.layer_starts[layer + 1])
    starts = layers.ring_starts[r0 : r1 + 1]
    points = layers.points[starts[0] : starts[-1]]
    return _outline(points, starts - starts[0], layers.closed[r0:r1], origin_mm[0], origin_mm[1])


@kernel
def _outline(points: Floats, starts: Ints, closed: Bools, x_mm: float, y_mm: float) -> Outline:
    """Build an outline from the rings of one layer."""
    segments, enclosing = _segments(points, starts, closed, x_mm, y_mm)
    edges, steps, levels = _sweep_edges(segments[:enclosing])
    length = 0.0
    for i in range(len(segments)):
        length += math.hypot(segments[i, 2] - segments[i, 0], segments[i, 3] - segments[i, 1])
    x0, y0, cell, columns, rows = _grid_frame(segments)
    cell_starts, cell_items = _grid_cells(segments, x0, y0, cell, columns, rows)
    while cell_items.size > MOST_ENTRIES_PER_SEGMENT * len(segments) and columns * rows > 1:
        cell *= 2.0
        columns, rows = (columns + 1) // 2, (rows + 1) // 2
        cell_starts, cell_items = _grid_cells(segments, x0, y0, cell, columns, rows)
    return Outline(
        segments,
        enclosing,
        length,
        edges,
        steps,
        levels,
        x0,
        y0,
        cell,
        columns,
        rows,
        cell_starts,
        cell_items,
    )


@kernel
def _segments(points: Floats, starts: Ints, closed: Bools, x_mm: float, y_mm: float) -> tuple[Floats, int]:
    """Segments of all paths without the points inside straight runs; closed rings first."""
    largest = abs(x_mm) + abs(y_mm)
    for i in range(len(points)):
        largest = max(largest, abs(points[i, 0]), abs(points[i, 1]))
    tolerance = ROUNDING * largest
    segments = np.empty((len(points), 4))
    count = 0
    enclosing = 0
    for want_closed in (True, False):
        for r in range(starts.size - 1):
            a, b = starts[r], starts[r + 1]
            if closed[r] != want_closed or b - a < 2:
                continue
            x, y = points[a, 0], points[a, 1]
            last = b if want_closed else b - 1
            for i in range(a + 1, last + 1):
                k = i if i < b else a
                if i < last:
                    n = i + 1 if i + 1 < b else a
                    if _is_between(x, y, points[k, 0], points[k, 1], points[n, 0], points[n, 1], tolerance):
                        continue
                segments[count, 0], segments[count, 1] = x - x_mm, y - y_mm
                segments[count, 2], segments[count, 3] = points[k, 0] - x_mm, points[k, 1] - y_mm
                count += 1
                x, y = points[k, 0], points[k, 1]
        if want_closed:
            enclosing = count
    return segments[:count].copy(), enclosing


@kernel
def _is_between(ax: float, ay: float, bx: float, by: float, cx: float, cy: float, tolerance: float) -> bool:
    """Whether b lies on the way straight from a to c, within the rounding of the coordinates."""
    ux, uy, vx, vy = bx - ax, by - ay, cx - bx, cy - by
    chord = math.hypot(cx - ax, cy - ay)
    return ux * vx + uy * vy > 0.0 and abs(ux * vy - uy * vx) <= tolerance * chord


@kernel
def _sweep_edges(segments: Floats) -> tuple[Floats, Ints, Floats]:
    """Edges by lower end, their winding steps, and the levels of all ends."""
    count = 0
    for i in range(len(segments)):
        count += segments[i, 1] != segments[i, 3]
    edges = np.empty((count, 4))
    steps = np.empty(count, np.int64)
    n = 0
    for i in range(len(segments)):
        x0, y0, x1, y1 = segments[i]
        if y0 == y1:
            continue
        steps[n] = -1 if y1 > y0 else 1
        if y1 < y0:
            x0, y0, x1, y1 = x1, y1, x0, y0
        edges[n, 0], edges[n, 1], edges[n, 2], edges[n, 3] = x0, y0, x1, y1
        n += 1
    order = np.argsort(edges[:, 1])
    i = 0
    while i < count:
        j = i + 1
        while j < count and edges[order[j], 1] == edges[order[i], 1]:
            j += 1
        if j - i > 1:
            level = order[i:j].copy()
            order[i:j] = level[np.argsort(edges[level, 0], kind="mergesort")]
        i = j
    # Where rings close, every end of a segment is the start of one.
    return edges[order], steps[order], np.unique(segments[:, 1])


@kernel
def _grid_frame(segments: Floats) -> tuple[float, float, float, int, int]:
    """Corner, cell size, columns and rows of the grid over some segments."""
    if len(segments) == 0:
        return 0.0, 0.0, 1.0, 1, 1
    x0 = min(segments[:, 0].min(), segments[:, 2].min())
    y0 = min(segments[:, 1].min(), segments[:, 3].min())
    width = max(segments[:, 0].max(), segments[:, 2].max()) - x0
    height = max(segments[:, 1].max(), segments[:, 3].max()) - y0
    wanted = float(CELLS_PER_SEGMENT * len(segments) + 1)
    cell = max(math.sqrt(width * height / wanted), max(width, height) / wanted)
    if not cell > 0.0:
        return x0, y0, 1.0, 1, 1
    return x0, y0, cell, int(width / cell) + 1, int(height / cell) + 1


@kernel
def _cell(place: float, start: float, cell: float, count: int) -> int:
    """Row or column of the grid at a coordinate; the nearest one outside the grid."""
    at = (place - start) / cell
    if not at > 0.0:
        return 0
    return count - 1 if at >= count else int(at)


@kernel
def _grid_cells(
    segments: Floats, x0: float, y0: float, cell: float, columns: int, rows: int
) -> tuple[Ints, Ints]:
    """Segments in each cell: counted first, then filed."""
    starts = np.zeros(columns * rows + 1, np.int64)
    items = np.empty(0, np.int64)
    for filing in (False, True):
        for i in range(len(segments)):
            ax, ay, bx, by = segments[i]
            if by < ay:
                ax, ay, bx, by = bx, by, ax, ay
            for row in range(_cell(ay, y0, cell, rows), _cell(by, y0, cell, rows) + 1):
                left, right = ax, bx
                if by > ay:
                    slope = (bx - ax) / (by - ay)
                    if y0 + row * cell > ay:
                        left = ax + (y0 + row * cell - ay) * slope
                    if y0 + (row + 1) * cell < by:
                        right = ax + (y0 + (row + 1) * cell - ay) * slope
                if right < left:
                    left, right = right, left
                for column in range(_cell(left, x0, cell, columns), _cell(right, x0, cell, columns) + 1):
                    at = row * columns + column
                    if filing:
                        starts[at] -= 1
                        items[starts[at]] = i
                    else:
                        starts[at] += 1
        if not filing:
            # Running totals: each cell's end now, its start once filing has counted down.
            for at in range(1, starts.size):
                starts[at] += starts[at - 1]
            items = np.empty(starts[-1], np.int64)
    return starts, items


@kernel
def _square_distance(x: float, y: float, segments: Floats, i: int) -> float:
    """Square of the distance of (x, y) from segment `i`."""
    ux, uy = segments[i, 2] - segments[i, 0], segments[i, 3] - segments[i, 1]
    px, py = x - segments[i, 0], y - segments[i, 1]
    along = px * ux + py * uy
    if along > 0.0:
        square = ux * ux + uy * uy
        if along < square:
            across = px * uy - py * ux
            return float(across * across / square)
        px, py = px - ux, py - uy
    return float(px * px + py * py)


@kernel
def distance_to_segment(x: float, y: float, segments: Floats, i: int) -> float:
    """Distance of (x, y) from segment `i`."""
    return math.sqrt(_square_distance(x, y, segments, i))


@kernel
def nearest(o: Outline, x: float, y: float, guess: int) -> tuple[float, int]:
    """Distance of (x, y) from an outline, and the segment that is nearest; ``inf, -1`` for an empty one.

    The search starts from segment `guess` (-1 for none), which is worth giving where the last answer was near.
    """
    # Columns are taken out of the tuple once: each access to one costs a reference count.
    segments, starts, items = o.segments, o.cell_starts, o.cell_items
    x0, y0, cell, columns, rows = o.x_mm, o.y_mm, o.cell_mm, o.columns, o.rows
    best = np.inf
    found = guess
    if guess >= 0:
        best = _square_distance(x, y, segments, guess)
    column = _cell(x, x0, cell, columns)
    row = _cell(y, y0, cell, rows)
    reach = 0
    while True:
        for r in range(max(row - reach, 0), min(row + reach, rows - 1) + 1):
            below = y0 + r * cell
            aside = max(below - y, y - below - cell, 0.0)
            if aside * aside >= best:
                continue
            stride = 1 if abs(r - row) == reach else 2 * reach
            for c in range(column - reach, column + reach + 1, max(stride, 1)):
                if c < 0 or c >= columns:
                    continue
                before = x0 + c * cell
                aside = max(before - x, x - before - cell, 0.0)
                if aside * aside >= best:
                    continue
                at = r * columns + c
                for k in range(starts[at], starts[at + 1]):
                    square = _square_distance(x, y, segments, items[k])
                    if square < best:
                        best, found = square, items[k]
        beyond = np.inf
        if column - reach > 0:
            beyond = min(beyond, x - (x0 + (column - reach) * cell))
        if column + reach < columns - 1:
            beyond = min(beyond, x0 + (column + reach + 1) * cell - x)
        if row - reach > 0:
            beyond = min(beyond, y - (y0 + (row - reach) * cell))
        if row + reach < rows - 1:
            beyond = min(beyond, y0 + (row + reach + 1) * cell - y)
        if beyond == np.inf or beyond * beyond >= best:
            return math.sqrt(best), found
        reach += 1


@kernel
def winding(o: Outline, x: float, y: float) -> int:
    """Winding number of the closed rings of an outline about (x, y)."""
    total = 0
    for i in range(len(o.edges)):
        if o.edges[i, 1] > y:
            break
        if o.edges[i, 3] > y:
            left = (o.edges[i, 2] - o.edges[i, 0]) * (y - o.edges[i, 1]) - (x - o.edges[i, 0]) * (
                o.edges[i, 3] - o.edges[i, 1]
            )
            if left < 0.0:
                total += o.steps[i]
    return total

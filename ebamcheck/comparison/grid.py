"""A grid over segments, and the search in it for the segment nearest to a point."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Floats, ShortInts

CELLS_PER_SEGMENT = 12
"""Grid cells per segment: few segments in a cell, and a grid that is small to build."""

MOST_ENTRIES_PER_SEGMENT = 64
"""Most cells that a segment crosses on average; a finer grid is made coarser."""

CELLS_AT_ENDS = 8
"""Cells that a segment passes through beside those between which it crosses a border, at most."""


class Grid(NamedTuple):
    """Segments by the square cells that they pass through."""

    x_mm: float
    """x of the lower left corner of the grid; `y_mm` is its y."""
    y_mm: float
    cell_mm: float
    """Side of a cell."""
    columns: int
    rows: int
    starts: ShortInts
    """(columns x rows + 1,) into `items`, row by row."""
    items: ShortInts
    """Segments of each cell."""


@kernel
def grid_over(segments: Floats) -> Grid:
    """File segments (S, 4) by the cells of a grid."""
    x0, y0, cell, columns, rows = _frame(segments)
    starts, items = _filed(segments, x0, y0, cell, columns, rows)
    while items.size > MOST_ENTRIES_PER_SEGMENT * len(segments) and columns * rows > 1:
        cell *= 2.0
        columns, rows = (columns + 1) // 2, (rows + 1) // 2
        starts, items = _filed(segments, x0, y0, cell, columns, rows)
    return Grid(x0, y0, cell, columns, rows, starts, items)


@kernel
def nearest(segments: Floats, grid: Grid, x: float, y: float, guess: int) -> tuple[float, int]:
    """Distance of (x, y) from the nearest segment, and which one that is; ``inf, -1`` where there are none.

    The search starts from segment `guess` (-1 for none), which is worth giving where the last answer was near.
    """
    frame = (grid.x_mm, grid.y_mm, grid.cell_mm, grid.columns, grid.rows)
    return nearest_of(segments, grid.starts, grid.items, frame, x, y, guess)


@kernel
def nearest_of(
    segments: Floats, starts: ShortInts, items: ShortInts, frame: tuple[float, float, float, int, int],
    x: float, y: float, guess: int,
) -> tuple[float, int]:  # fmt: skip
    """As :func:`nearest`, for loops: columns taken out of a tuple in there would cost reference counts each time."""
    x0, y0, cell, columns, rows = frame
    best = square_distance(x, y, segments, guess) if guess >= 0 else np.inf
    column, row = _cell(x, x0, cell, columns), _cell(y, y0, cell, rows)
    return nearest_beyond(segments, starts, items, frame, x, y, column, row, guess, best, 0)


# Eleven parameters: columns taken out of a tuple would cost reference counts at every call.
@kernel
def nearest_beyond(
    segments: Floats, starts: ShortInts, items: ShortInts, frame: tuple[float, float, float, int, int],
    x: float, y: float, column: int, row: int, found: int, best: float, reach: int,
) -> tuple[float, int]:  # fmt: skip
    """As :func:`nearest`, where of the cells nearer than `reach` to the one of (x, y) segment `found` is the nearest.

    `best` is the square of its distance; no cells are nearer than 0.
    """
    x0, y0, cell, columns, rows = frame
    while True:
        for r in range(max(row - reach, 0), min(row + reach, rows - 1) + 1):
            below = y0 + r * cell
            aside = max(below - y, y - below - cell, 0.0)
            if aside * aside >= best:
                continue
            # All cells of the outermost rows, the two ends of the others.
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
                    square = square_distance(x, y, segments, items[k])
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
def square_distance(x: float, y: float, segments: Floats, i: int) -> float:
    """Square of the distance of (x, y) from segment `i`."""
    return square_between(x, y, segments[i, 0], segments[i, 1], segments[i, 2], segments[i, 3])


@kernel
def square_between(x: float, y: float, ax: float, ay: float, bx: float, by: float) -> float:
    """Square of the distance of (x, y) from the segment from a to b."""
    # All three are found and one is taken: which one it is cannot be foretold, and a wrong guess costs more.
    ux, uy, px, py = bx - ax, by - ay, x - ax, y - ay
    along, square, across = px * ux + py * uy, ux * ux + uy * uy, px * uy - py * ux
    qx, qy = px - ux, py - uy
    beyond = np.divide(across * across, square) if along < square else qx * qx + qy * qy
    return float(beyond if along > 0.0 else px * px + py * py)


@kernel
def distance_to_segment(x: float, y: float, segments: Floats, i: int) -> float:
    """Distance of (x, y) from segment `i`."""
    return math.sqrt(square_distance(x, y, segments, i))


@kernel
def farthest_coordinate(grid: Grid) -> float:
    """Largest coordinate within a grid, mm."""
    right, top = grid.x_mm + grid.columns * grid.cell_mm, grid.y_mm + grid.rows * grid.cell_mm
    return max(abs(grid.x_mm), abs(grid.y_mm), abs(right), abs(top))


@kernel
def _frame(segments: Floats) -> tuple[float, float, float, int, int]:
    """Corner, cell size, columns and rows of the grid over some segments."""
    if len(segments) == 0:
        return 0.0, 0.0, 1.0, 1, 1
    x0, y0 = segments[0, 0], segments[0, 1]
    x1, y1 = x0, y0
    for i in range(len(segments)):
        x0, x1 = min(x0, segments[i, 0], segments[i, 2]), max(x1, segments[i, 0], segments[i, 2])
        y0, y1 = min(y0, segments[i, 1], segments[i, 3]), max(y1, segments[i, 1], segments[i, 3])
    width, height = x1 - x0, y1 - y0
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
def _filed(
    segments: Floats, x0: float, y0: float, cell: float, columns: int, rows: int
) -> tuple[ShortInts, ShortInts]:
    """Segments in each cell: what is where is found and counted first, then filed."""
    starts = np.zeros(columns * rows + 1, np.int32)
    cells, owners = np.empty(_room(segments, cell), np.int32), np.empty(_room(segments, cell), np.int32)
    count = 0
    for i in range(len(segments)):
        ax, ay, bx, by = segments[i, 0], segments[i, 1], segments[i, 2], segments[i, 3]
        if by < ay:
            ax, ay, bx, by = bx, by, ax, ay
        low, high = _cell(ay, y0, cell, rows), _cell(by, y0, cell, rows)
        slope = (bx - ax) / (by - ay) if high > low else 0.0
        for row in range(low, high + 1):
            left = ax if row == low else ax + (y0 + row * cell - ay) * slope
            right = bx if row == high else ax + (y0 + (row + 1) * cell - ay) * slope
            if right < left:
                left, right = right, left
            for column in range(_cell(left, x0, cell, columns), _cell(right, x0, cell, columns) + 1):
                at = row * columns + column
                starts[at] += 1
                cells[count], owners[count] = at, i
                count += 1
    # Running totals: each cell's end now, its start once filing has counted down.
    total = 0
    for at in range(starts.size):
        total += starts[at]
        starts[at] = total
    items = np.empty(count, np.int32)
    for k in range(count):
        starts[cells[k]] -= 1
        items[starts[cells[k]]] = owners[k]
    return starts, items


@kernel
def _room(segments: Floats, cell: float) -> int:
    """Cells that segments pass through, counted once for each, at most."""
    through = 0.0
    for i in range(len(segments)):
        through += abs(segments[i, 2] - segments[i, 0]) + abs(segments[i, 3] - segments[i, 1])
    # One for each border that is crossed, and that in which it starts; rounding may add one at each end, in both directions.
    return int(through / cell) + CELLS_AT_ENDS * len(segments)

"""Rasters of regions: the exact share of each cell and face, and the samples that beads leave bare.

Areas and face lengths are sums over the border (Green's theorem), cell by cell. Nothing is sampled, so no
area is lost or gained, and a wall thinner than a cell still has one. Samples tell what many beads cover, which no sum can.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from ebamcheck.geometry.regions import mean_width_mm, ring_columns, valid_polygons
from ebamcheck.kernels import Floats, Ints, kernel

# Samples across a bead: the tip that a round bead leaves of a square corner then has thirty of them
SAMPLES_PER_BEAD = 24
SAMPLES_PER_WALL = 4  # samples across the section where it is narrower than a bead
# Samples on the rectangle around a section at least: a small one is known to about 0.1 % then, too
FEWEST_SAMPLES = 100_000
MOST_SAMPLES = 4_000_000  # samples on one layer; a larger one is sampled more coarsely
# Samples across a bead at most: a hair of metal, a thousand times narrower, lies under any bead
MOST_PER_BEAD = 1000


def covered_fraction(section: BaseGeometry, segments: Floats, bead_width_mm: float) -> float:
    """Share of the area of a section that lies within half a bead width of a segment; 1 for an empty one.

    Segments (S, 4) ``x0, y0, x1, y1``, mm, are the centre lines of the beads, which end in half discs.
    """
    return bare_samples(section, segments, bead_width_mm).covered


@dataclass(frozen=True, eq=False)
class BareSamples:
    """What beads leave of a section, on a grid."""

    grid: NDArray[np.uint8]
    """(rows, columns) 1 where the section is bare; sample (r, c) stands for the square from ``origin + step (c, r)`` to
    ``origin + step (c + 1, r + 1)``."""
    origin: Floats
    """(2,) lower left corner, mm."""
    step_mm: float
    covered: float
    """Share of the section's samples that are covered; 1 without any."""


def bare_samples(section: BaseGeometry, segments: Floats, bead_width_mm: float) -> BareSamples:
    """Sample what lies further than half a bead width from every segment; as :func:`covered_fraction`."""
    parts = valid_polygons(section)
    if not parts:
        return BareSamples(np.zeros((0, 0), np.uint8), np.zeros(2), bead_width_mm, 1.0)
    x0, y0, x1, y1 = shapely.total_bounds(parts)
    narrowest, box = min(mean_width_mm(p) for p in parts), (x1 - x0) * (y1 - y0)
    step = min(bead_width_mm / SAMPLES_PER_BEAD, narrowest / SAMPLES_PER_WALL, math.sqrt(box / FEWEST_SAMPLES))
    step = max(step, math.sqrt(box / MOST_SAMPLES), bead_width_mm / MOST_PER_BEAD)
    columns, rows = max(1, math.ceil((x1 - x0) / step)), max(1, math.ceil((y1 - y0) / step))
    polygons = np.empty(len(parts), object)
    polygons[:] = parts
    points, (ring_starts, _) = ring_columns(polygons)
    origin = np.array([x0, y0])
    grid = np.zeros((rows, columns), np.uint8)
    _mark_inside(grid, points - origin, ring_starts, step)
    solid = int(np.count_nonzero(grid))
    mark_beads(grid, segments - np.concatenate([origin, origin]), 0.5 * bead_width_mm, step)
    covered = 1.0 - int(np.count_nonzero(grid)) / solid if solid else 1.0
    return BareSamples(grid, origin, step, covered)


def oriented_rings(polygons: NDArray[np.object_], origin: Floats, step: Floats) -> tuple[Floats, tuple[Ints, Ints]]:
    """Points in units of cells, first row of each ring, first ring of each polygon; solid to the left."""
    points, starts = ring_columns(shapely.orient_polygons(polygons))
    return np.ascontiguousarray((points - origin) / step), starts


def each_of(count: Ints) -> tuple[Ints, Ints]:
    """Rows of a table that has `count` (n,) rows of each item: the item (m,), and the number of the row among those of it (m,).

    Examples
    --------
    >>> [column.tolist() for column in each_of(np.array([2, 0, 3]))]
    [[0, 0, 2, 2, 2], [0, 1, 0, 1, 2]]
    """
    owner = np.repeat(np.arange(len(count)), count)
    return owner, np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count)


def _sides(points: Floats, ring_starts: Ints) -> tuple[Floats, Floats]:
    """Both ends (S, 2) of the sides of rings."""
    inner = np.ones(max(len(points) - 1, 0), np.bool_)
    inner[ring_starts[1:-1] - 1] = False
    start = np.flatnonzero(inner)
    return points[start], points[start + 1]


def _mark_inside(grid: NDArray[np.uint8], points: Floats, ring_starts: Ints, step: float) -> None:
    """Set the samples to 1 that lie inside the rings (closed by a repeated point, even-odd)."""
    rows, columns = grid.shape
    a, b = _sides(points, ring_starts)
    low, high = np.minimum(a[:, 1], b[:, 1]), np.maximum(a[:, 1], b[:, 1])
    first, last = (np.clip(np.ceil(y / step - 0.5).astype(np.int64), 0, rows) for y in (low, high))
    # One more to either side: whether the middle of a row is between the ends of a side is asked of the very numbers.
    first, last = np.maximum(first - 1, 0), np.minimum(last + 1, rows)
    side, row = each_of(last - first)
    row += first[side]
    y = (row + 0.5) * step
    crossed = (low[side] <= y) & (y < high[side])
    side, row, y = side[crossed], row[crossed], y[crossed]
    a, b = a[side], b[side]
    x = a[:, 0] + (b[:, 0] - a[:, 0]) * ((y - a[:, 1]) / (b[:, 1] - a[:, 1]))
    column = np.maximum(np.ceil(x / step - 0.5).astype(np.int64), 0)
    # Every border flips the sample at its right; a running parity then tells inside.
    held = column < columns
    flips = np.bincount(row[held] * columns + column[held], minlength=grid.size).reshape(grid.shape)
    grid[:] = np.cumsum(flips, axis=1) & 1


@kernel
def mark_beads(grid: NDArray[np.uint8], segments: Floats, radius: float, step: float) -> None:
    """Set the samples to 0 that lie within a radius of a segment."""
    rows, columns = grid.shape
    for n in range(len(segments)):
        ax, ay, bx, by = segments[n, 0], segments[n, 1], segments[n, 2], segments[n, 3]
        length = np.hypot(bx - ax, by - ay)
        first = max(0, int(np.ceil((min(ay, by) - radius) / step - 0.5)))
        last = min(rows - 1, int(np.floor((max(ay, by) + radius) / step - 0.5)))
        for row in range(first, last + 1):
            # From left to right the row lies within reach of the segment, which is convex: first of its ends, then of its length.
            y = (row + 0.5) * step
            left, right = np.inf, -np.inf
            for cx, cy in ((ax, ay), (bx, by)):
                off = y - cy
                if abs(off) <= radius:
                    reach = np.sqrt(radius * radius - off * off)
                    left, right = min(left, cx - reach), max(right, cx + reach)
            if length > 0.0:
                ux, uy = (bx - ax) / length, (by - ay) / length
                # Along: 0 <= ux X + uy Y <= length; across: |ux Y - uy X| <= radius, with X, Y from (ax, ay).
                low, high = -np.inf, np.inf
                along, across = uy * (y - ay), ux * (y - ay)
                for slope, shift, least, most in ((ux, along, 0.0, length), (-uy, across, -radius, radius)):
                    if abs(slope) >= 1e-15:
                        a, b = (least - shift) / slope, (most - shift) / slope
                        low, high = max(low, min(a, b)), min(high, max(a, b))
                    elif not (least <= shift <= most):
                        high = -np.inf
                if low <= high:
                    left, right = min(left, ax + low), max(right, ax + high)
            start = max(0, int(np.ceil(left / step - 0.5))) if left <= right else columns
            stop = min(columns - 1, int(np.floor(right / step - 0.5))) if left <= right else -1
            if start <= stop:
                grid[row, start : stop + 1] = 0


def cell_shares(points: Floats, ring_starts: Ints, rows: int, columns: int) -> Floats:
    """Share of every cell inside the rings (closed by a repeated point, solid to the left)."""
    shares = np.zeros(rows * columns)
    every = np.array([0, len(ring_starts) - 1])
    _, place, share = islands_in_cells(points, ring_starts, every, (rows, columns))
    shares[place] = share
    return shares.reshape(rows, columns)


def face_shares(points: Floats, ring_starts: Ints, rows: int, columns: int) -> Floats:
    """Share of every upright face inside the rings, (rows, columns + 1); its sign is that of the rings."""
    a, b = _sides(points, ring_starts)
    low, high = np.minimum(a[:, 0], b[:, 0]), np.maximum(a[:, 0], b[:, 0])
    # A face on the border belongs to what lies to its right: low <= x < high.
    first, last = (np.clip(np.ceil(x).astype(np.int64), 0, columns + 1) for x in (low, high))
    side, column = each_of(last - first)
    column += first[side]
    a, b = a[side], b[side]
    y = a[:, 1] + (b[:, 1] - a[:, 1]) * ((column - a[:, 0]) / (b[:, 0] - a[:, 0]))
    row = np.clip(np.floor(y).astype(np.int64), 0, rows - 1)
    sign = np.where(b[:, 0] > a[:, 0], 1.0, -1.0)
    place = row * (columns + 1) + column
    gain = np.bincount(
        np.concatenate([place, place + columns + 1]),
        np.concatenate([sign * (row + 1 - y), sign * (y - row)]),
        minlength=(rows + 1) * (columns + 1),
    )
    return np.asarray(np.cumsum(gain.reshape(rows + 1, columns + 1), axis=0)[:rows], np.float64)


@kernel
def islands_in_cells(
    points: Floats, ring_starts: Ints, island_rings: Ints, shape: tuple[int, int]
) -> tuple[Ints, Ints, Floats]:
    """Islands, flat places of cells, and the share of each cell that lies in the island.

    A piece of the border of height dy (downwards: solid to its right) adds dy to all cells of its row beyond it and, to its own, dy
    times the part of the cell that lies to its right.
    """
    count = island_rings.size - 1
    boxes = np.zeros((count, 4), np.int64)
    total = 0
    for k in range(count):
        first, last = ring_starts[island_rings[k]], ring_starts[island_rings[k + 1]]
        if last <= first:
            continue
        boxes[k, 0] = max(int(np.floor(points[first:last, 0].min())), 0)
        boxes[k, 1] = max(int(np.floor(points[first:last, 1].min())), 0)
        boxes[k, 2] = min(int(np.ceil(points[first:last, 0].max())), shape[1])
        boxes[k, 3] = min(int(np.ceil(points[first:last, 1].max())), shape[0])
        total += max(boxes[k, 2] - boxes[k, 0], 0) * max(boxes[k, 3] - boxes[k, 1], 0)
    owner, place, share = np.empty(total, np.int64), np.empty(total, np.int64), np.empty(total)
    used = 0
    for k in range(count):
        x0, y0, x1, y1 = boxes[k]
        if x1 <= x0 or y1 <= y0:
            continue
        gain = np.zeros((y1 - y0, x1 - x0 + 1))
        for ring in range(island_rings[k], island_rings[k + 1]):
            for i in range(ring_starts[ring], ring_starts[ring + 1] - 1):
                ax, ay, bx, by = points[i, 0], points[i, 1], points[i + 1, 0], points[i + 1, 1]
                if ay == by:
                    continue
                slope = (bx - ax) / (by - ay)
                low, high = min(ay, by), max(ay, by)
                sign = 1.0 if by < ay else -1.0
                for row in range(max(int(np.floor(low)), y0), min(int(np.ceil(high)), y1)):
                    p, q = max(low, float(row)), min(high, float(row + 1))
                    if q <= p:
                        continue
                    xp, xq = ax + (p - ay) * slope, ax + (q - ay) * slope
                    left, right = min(xp, xq), max(xp, xq)
                    first = min(max(int(np.floor(left)), x0), x1 - 1)
                    last = min(max(int(np.ceil(right)) - 1, first), x1 - 1)
                    for column in range(first, last + 1):
                        u = left if column == first else float(column)
                        v = right if column == last else float(column + 1)
                        height = (q - p) if right == left else (q - p) * ((v - u) / (right - left))
                        beyond = 0.5 * (u + v) - column
                        gain[row - y0, column - x0] += sign * height * (1.0 - beyond)
                        gain[row - y0, column - x0 + 1] += sign * height * beyond
        for row in range(y1 - y0):
            running = 0.0
            for column in range(x1 - x0):
                running += gain[row, column]
                owner[used], place[used] = k, (row + y0) * shape[1] + column + x0
                share[used] = min(max(running, 0.0), 1.0)
                used += 1
    return owner, place, share

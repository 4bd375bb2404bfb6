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

SAMPLES_PER_BEAD = 24
"""Samples across a bead: the tip that a round bead leaves of a square corner then has thirty of them."""

SAMPLES_PER_WALL = 4
"""Samples across the section where it is narrower than a bead."""

FEWEST_SAMPLES = 100_000
"""Samples on the rectangle around a section at least: a small one is known to about 0.1 % then, too."""

MOST_SAMPLES = 4_000_000
"""Samples on one layer; a larger one is sampled more coarsely."""

MOST_PER_BEAD = 1000
"""Samples across a bead at most: a hair of metal, a thousand times narrower, lies under any bead."""


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
    step = min(
        bead_width_mm / SAMPLES_PER_BEAD, narrowest / SAMPLES_PER_WALL, math.sqrt(box / FEWEST_SAMPLES)
    )
    step = max(step, math.sqrt(box / MOST_SAMPLES), bead_width_mm / MOST_PER_BEAD)
    columns, rows = max(1, math.ceil((x1 - x0) / step)), max(1, math.ceil((y1 - y0) / step))
    polygons = np.empty(len(parts), object)
    polygons[:] = parts
    points, (ring_starts, _) = ring_columns(polygons)
    origin = np.array([x0, y0])
    grid = np.zeros((rows, columns), np.uint8)
    mark_inside(grid, points - origin, ring_starts, step)
    solid = int(np.count_nonzero(grid))
    mark_beads(grid, segments - np.concatenate([origin, origin]), 0.5 * bead_width_mm, step)
    covered = 1.0 - int(np.count_nonzero(grid)) / solid if solid else 1.0
    return BareSamples(grid, origin, step, covered)


def oriented_rings(
    polygons: NDArray[np.object_], origin: Floats, step: Floats
) -> tuple[Floats, tuple[Ints, Ints]]:
    """Points in units of cells, first row of each ring, first ring of each polygon; solid to the left."""
    points, starts = ring_columns(shapely.orient_polygons(polygons))
    return np.ascontiguousarray((points - origin) / step), starts


@kernel
def mark_inside(grid: NDArray[np.uint8], points: Floats, ring_starts: Ints, step: float) -> None:
    """Set the samples to 1 that lie inside the rings (closed by a repeated point, even-odd)."""
    rows, columns = grid.shape
    for ring in range(ring_starts.size - 1):
        for i in range(ring_starts[ring], ring_starts[ring + 1] - 1):
            ax, ay, bx, by = points[i, 0], points[i, 1], points[i + 1, 0], points[i + 1, 1]
            low, high = min(ay, by), max(ay, by)
            first = max(0, int(np.ceil(low / step - 0.5)))
            for row in range(first, rows):
                y = (row + 0.5) * step
                if not (low <= y < high):
                    if y >= high:
                        break
                    continue
                x = ax + (bx - ax) * ((y - ay) / (by - ay))
                # Every border flips the sample at its right; a running parity then tells inside.
                column = max(0, int(np.ceil(x / step - 0.5)))
                if column < columns:
                    grid[row, column] ^= 1
    for row in range(rows):
        inside = 0
        for column in range(columns):
            inside ^= grid[row, column]
            grid[row, column] = inside


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
            left, right = _capsule_row((row + 0.5) * step, ax, ay, bx, by, length, radius)
            start = max(0, int(np.ceil(left / step - 0.5)))
            stop = min(columns - 1, int(np.floor(right / step - 0.5)))
            if start <= stop:
                grid[row, start : stop + 1] = 0


@kernel
def _capsule_row(
    y: float, ax: float, ay: float, bx: float, by: float, length: float, radius: float
) -> tuple[float, float]:
    """Where the line at height y lies within a radius of a segment: from left to right, which is convex."""
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
            if abs(slope) < 1e-15:
                if not (least <= shift <= most):
                    return left, right
            else:
                a, b = (least - shift) / slope, (most - shift) / slope
                low, high = max(low, min(a, b)), min(high, max(a, b))
        if low <= high:
            left, right = min(left, ax + low), max(right, ax + high)
    return left, right


def cell_shares(points: Floats, ring_starts: Ints, rows: int, columns: int) -> Floats:
    """Share of every cell inside the rings (closed by a repeated point, solid to the left)."""
    gain = np.zeros((rows, columns + 1))
    _add_rings(gain, points, ring_starts)
    shares: Floats = np.clip(np.cumsum(gain, axis=1), 0.0, 1.0)
    return shares[:, :columns]


@kernel
def _add_rings(gain: Floats, points: Floats, ring_starts: Ints) -> None:
    for ring in range(ring_starts.size - 1):
        for i in range(ring_starts[ring], ring_starts[ring + 1] - 1):
            add_segment(gain, points[i, 0], points[i, 1], points[i + 1, 0], points[i + 1, 1], 0, 0)


@kernel
def add_segment(gain: Floats, ax: float, ay: float, bx: float, by: float, column0: int, row0: int) -> None:
    """Add what a segment of the border changes in the shares: all cells to its right, in its rows.

    A piece of height dy (downwards: solid to its right) adds dy to all cells beyond it and, to its own, dy
    times the part of the cell that lies to its right.
    """
    rows, columns = gain.shape[0], gain.shape[1] - 1
    if ay == by:
        return
    slope = (bx - ax) / (by - ay)
    low, high = min(ay, by), max(ay, by)
    sign = 1.0 if by < ay else -1.0
    for row in range(max(int(np.floor(low)), row0), min(int(np.ceil(high)), row0 + rows)):
        p, q = max(low, float(row)), min(high, float(row + 1))
        if q <= p:
            continue
        xp, xq = ax + (p - ay) * slope, ax + (q - ay) * slope
        left, right = min(xp, xq), max(xp, xq)
        first = min(max(int(np.floor(left)), column0), column0 + columns - 1)
        last = min(max(int(np.ceil(right)) - 1, first), column0 + columns - 1)
        for column in range(first, last + 1):
            u = left if column == first else float(column)
            v = right if column == last else float(column + 1)
            height = (q - p) if right == left else (q - p) * ((v - u) / (right - left))
            beyond = 0.5 * (u + v) - column
            gain[row - row0, column - column0] += sign * height * (1.0 - beyond)
            gain[row - row0, column - column0 + 1] += sign * height * beyond


@kernel
def face_shares(points: Floats, ring_starts: Ints, rows: int, columns: int) -> Floats:
    """Share of every upright face inside the rings, (rows, columns + 1); its sign is that of the rings."""
    gain = np.zeros((rows + 1, columns + 1))
    for ring in range(ring_starts.size - 1):
        for i in range(ring_starts[ring], ring_starts[ring + 1] - 1):
            ax, ay, bx, by = points[i, 0], points[i, 1], points[i + 1, 0], points[i + 1, 1]
            low, high = min(ax, bx), max(ax, bx)
            # A face on the border belongs to what lies to its right: low <= x < high.
            for column in range(max(int(np.ceil(low)), 0), min(int(np.ceil(high)), columns + 1)):
                y = ay + (by - ay) * ((column - ax) / (bx - ax))
                row = min(max(int(np.floor(y)), 0), rows - 1)
                sign = 1.0 if bx > ax else -1.0
                gain[row, column] += sign * (row + 1 - y)
                gain[row + 1, column] += sign * (y - row)
    for column in range(columns + 1):
        for row in range(1, rows + 1):
            gain[row, column] += gain[row - 1, column]
    return gain[:rows]


@kernel
def islands_in_cells(
    points: Floats, ring_starts: Ints, island_rings: Ints, shape: tuple[int, int]
) -> tuple[Ints, Ints, Floats]:
    """Islands, flat places of cells, and the share of each cell that lies in the island."""
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
                add_segment(gain, points[i, 0], points[i, 1], points[i + 1, 0], points[i + 1, 1], x0, y0)
        for row in range(y1 - y0):
            running = 0.0
            for column in range(x1 - x0):
                running += gain[row, column]
                owner[used], place[used] = k, (row + y0) * shape[1] + column + x0
                share[used] = min(max(running, 0.0), 1.0)
                used += 1
    return owner, place, share

"""How much of a section the beads cover, on a grid of samples."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from ebamcheck.layers.polygons import valid_polygons
from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Floats, Ints
from ebamcheck.scan.islands.regions import ARC_SEGMENTS, mean_width_mm, ring_columns

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

    Parameters
    ----------
    section
        Polygon or multi-polygon.
    segments
        (S, 4) x0, y0, x1, y1 of the centre lines of the beads, mm; beads end in half discs.
    bead_width_mm
        Width of the beads.
    """
    return bare_samples(section, segments, bead_width_mm).covered


@dataclass(frozen=True, eq=False)
class BareSamples:
    """What beads leave of a section, on a grid.

    Parameters
    ----------
    grid
        (rows, columns) 1 where the section is bare; sample (r, c) stands for the square from
        ``origin + step (c, r)`` to ``origin + step (c + 1, r + 1)``.
    origin
        (2,) lower left corner, mm.
    step_mm
        Distance of the samples.
    covered
        Share of the section's samples that are covered; 1 without any.
    """

    grid: NDArray[np.uint8]
    origin: Floats
    step_mm: float
    covered: float


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
    grid = np.zeros((rows, columns), np.uint8)
    origin = np.array([x0, y0])
    mark_inside(grid, points - origin, ring_starts, step)
    solid = int(np.count_nonzero(grid))
    mark_beads(grid, segments - np.concatenate([origin, origin]), 0.5 * bead_width_mm, step)
    covered = 1.0 - int(np.count_nonzero(grid)) / solid if solid else 1.0
    return BareSamples(grid, origin, step, covered)


def ground(lines: NDArray[np.object_], bead_width_mm: float) -> BaseGeometry:
    """Ground under beads along lines (S,); they end in half discs.

    Lines that follow each other are widened as one: ten times as fast as one by one.
    """
    of_points = lines[shapely.length(lines) == 0.0]  # merging would drop them
    chains = shapely.get_parts(shapely.line_merge(shapely.multilinestrings(lines)))
    beads = shapely.buffer([*chains, *of_points], 0.5 * bead_width_mm, quad_segs=2 * ARC_SEGMENTS)
    return shapely.union_all(beads)


def segments_of(region: BaseGeometry) -> Floats:
    """Border segments of a region, (S, 4) x0, y0, x1, y1."""
    polygons = valid_polygons(region)
    lines = [ring for p in polygons for ring in (p.exterior, *p.interiors)]
    found = [np.hstack([c[:-1], c[1:]]) for c in (shapely.get_coordinates(line) for line in lines)]
    return np.concatenate(found) if found else np.zeros((0, 4))


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

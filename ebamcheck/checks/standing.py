"""What stands while a program runs: the height of base plate, clamps and beads over a grid, motion by motion.

A bead stands as high as the tool ran, as wide as it is nominally; the metal's own unevenness is judged by
:mod:`ebamcheck.checks.metal`. The tool is a tip, the end of the wire, and above it the head, a cylinder around the
tool's axis. What a motion meets is what stood when it began: a bead does not support itself.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import shapely

from ebamcheck.nc.beads import Beads
from ebamcheck.nc.control import control
from ebamcheck.nc.motions import ARC, POLYNOMIAL, RAPID, SPLINE_SPAN, STRAIGHT, NCProgram
from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Floats, Ints
from ebamcheck.settings.config import Config
from ebamcheck.settings.process import KeepOut

CELLS_PER_BEAD = 6
"""Cells across a bead: its border is known to half a millimetre for a bead of 6 mm."""

MOST_CELLS = 16_000_000
"""Cells of a grid at most, 256 MiB in all; a larger plate gets coarser ones."""

NO_HEIGHT = KeepOut.model_fields["z_mm"].default
"""Heights of a keep-out zone for which nobody gave any."""

TOUCH_MM = 1e-3
"""Heights nearer than this are one: the decimals of a program, at their coarsest."""


@dataclass(frozen=True, eq=False)
class Standing:
    """What every motion of a program meets, as columns (B,); zero where it meets nothing.

    Parameters
    ----------
    into_mm
        How deep the tip goes into what stands.
    head_mm
        How deep the head does.
    under_mm
        How far a travel goes under the bead that it comes from and the one that it leads to.
    short_mm
        What a travel lacks of the clearance, where it is longer than a hop.
    lost
        Travels from or to a place that no block has given, lower than all that stands and the clearance.
    bare_mm
        Length of a bead within half a width of which nothing stands as high as the layer below.
    bare_from, bare_to
        Parameters of the motion between which that is.
    """

    into_mm: Floats
    head_mm: Floats
    under_mm: Floats
    short_mm: Floats
    lost: Floats
    bare_mm: Floats
    bare_from: Floats
    bare_to: Floats


def run_over(nc: NCProgram, beads: Beads, below_mm: Floats, config: Config, hop_mm: float) -> Standing:
    """Run a program over the grid of what stands.

    Parameters
    ----------
    below_mm
        (B,) Z of the layer below that of each motion.
    hop_mm
        A travel up to this length may stay at the height of the beads.
    """
    machine, bead_mm = config.machine, config.process.bead_width_mm
    origin, shape, cell = _grid(nc, beads, config)
    # A zone of the default height is one to stay out of, and no body of which the height is known.
    bodies = [zone for zone in config.process.keep_out if zone.z_mm != NO_HEIGHT]
    fixed = standing_of(bodies, origin, shape, cell, 0.0)
    around = standing_of(bodies, origin, shape, cell, machine.head_radius_mm)
    z = nc.end[beads.first, 2]
    ahead = np.searchsorted(beads.first, np.arange(len(nc)))
    sides = np.concatenate([[np.inf], z, [np.inf]])
    floor = np.minimum(sides[ahead], sides[ahead + 1]) if len(beads) else np.full(len(nc), -np.inf)
    out = np.zeros((8, len(nc)))
    tall = float(fixed.max())
    tool = _Tool(
        0.5 * bead_mm / cell, machine.head_radius_mm / cell, machine.head_above_tip_mm, machine.clearance_mm, hop_mm,
        float(control(nc.dialect).rapids_apart),
    )  # fmt: skip
    ground = _Ground(np.full(shape, config.base_mm), fixed, around, origin, cell, tall)
    _run(columns_of(nc), _Beads(beads.first, beads.last, floor, below_mm), ground, tool, out)
    return Standing(*out)


def _grid(nc: NCProgram, beads: Beads, config: Config) -> tuple[Floats, tuple[int, int], float]:
    """Lower left corner, (rows, columns) and width of the cells over all beads and clamps within the travel limits."""
    machine, bead_mm = config.machine, config.process.bead_width_mm
    points = [nc.start[beads.rows, :2], nc.end[beads.rows, :2]]
    points += [np.array(zone.outline_mm, np.float64) for zone in config.process.keep_out]
    every = np.concatenate(points)
    every = every[np.isfinite(every).all(axis=1)]
    if not len(every):
        return np.zeros(2), (1, 1), bead_mm / CELLS_PER_BEAD
    # Curves between two ends reach beyond them by less than what they are long.
    margin = bead_mm + machine.head_radius_mm + float(np.nan_to_num(nc.lengths[beads.rows]).max(initial=0.0))
    # On a part that is turned the limits of the machine mean other places.
    limits = np.array(machine.travel_min_mm[:2]), np.array(machine.travel_max_mm[:2])
    if nc.machine is not None:
        limits = np.full(2, -np.inf), np.full(2, np.inf)
    low = np.clip(every.min(axis=0) - margin, limits[0] - bead_mm, limits[1])
    high = np.clip(every.max(axis=0) + margin, limits[0], limits[1] + bead_mm)
    size = np.maximum(high - low, bead_mm)
    cell = max(bead_mm / CELLS_PER_BEAD, math.sqrt(float(size.prod()) / MOST_CELLS))
    columns, rows = (np.ceil(size / cell).astype(np.int64) + 1).tolist()
    return low, (rows, columns), cell


def standing_of(
    zones: Sequence[KeepOut], origin: Floats, shape: tuple[int, int], cell: float, grown_mm: float
) -> Floats:
    """Height (rows, columns) of what stands in keep-out zones, each grown by a distance; the base plate is 0."""
    result = np.zeros(shape)
    rows, columns = shape
    for zone in zones:
        outline = shapely.make_valid(shapely.Polygon(zone.outline_mm))
        x0, y0, x1, y1 = outline.bounds
        a, b = (np.clip(((v - origin[0]) / cell), 0, columns) for v in (x0 - grown_mm, x1 + grown_mm + cell))
        c, d = (np.clip(((v - origin[1]) / cell), 0, rows) for v in (y0 - grown_mm, y1 + grown_mm + cell))
        column, row = np.meshgrid(np.arange(int(a), int(b)), np.arange(int(c), int(d)))
        at = shapely.points(origin[0] + (column + 0.5) * cell, origin[1] + (row + 0.5) * cell)
        # A cell belongs to a zone that reaches into it.
        inside = np.asarray(shapely.distance(at, outline)) <= grown_mm + 0.5 * cell
        height = result[row[inside], column[inside]]
        result[row[inside], column[inside]] = np.maximum(height, zone.z_mm[1])
    return result


# -- kernels -----------------------------------------------------------------------------------------


class Columns(NamedTuple):
    """Columns of a program's motions, as :class:`~ebamcheck.nc.motions.NCProgram` has them."""

    kind: Ints
    start: Floats
    end: Floats
    coefficients: Floats
    arc: Floats
    length: Floats


def columns_of(nc: NCProgram) -> Columns:
    """Columns of a program for kernels; motions of unknown length have none."""
    return Columns(nc.kind, nc.start, nc.end, nc.coefficients, nc.arc, np.nan_to_num(nc.lengths))


class _Beads(NamedTuple):
    """Where beads begin and end, and heights around each motion (B,)."""

    first: Ints
    last: Ints
    floor: Floats
    """Z of the lower of the beads before and after."""
    below: Floats


class _Ground(NamedTuple):
    """What stands, (rows, columns) each."""

    top: Floats
    """Beads; it changes while the program runs."""
    fixed: Floats
    """Clamps."""
    around: Floats
    """Clamps grown by the radius of the head."""
    origin: Floats
    cell: float
    tallest: float
    """Height of the tallest clamp."""


class _Tool(NamedTuple):
    """The tool; radii in cells."""

    bead: float
    head: float
    above: float
    clearance: float
    hop: float
    apart: float
    """1 where the axes of a rapid may arrive one after the other, else 0."""


@kernel
def place_on(path: Columns, m: int, t: float) -> tuple[float, float]:
    """Position on one motion at a parameter from 0 to 1."""
    start, end, kind = path.start[m], path.end[m], path.kind[m]
    if kind == ARC:
        arc = path.arc[m]
        c, s = math.cos(arc[2] * t), math.sin(arc[2] * t)
        dx, dy = start[0] - arc[0], start[1] - arc[1]
        return arc[0] + c * dx - s * dy, arc[1] + s * dx + c * dy
    if kind in (POLYNOMIAL, SPLINE_SPAN):
        a, b = path.coefficients[m, 0], path.coefficients[m, 1]
        return ((a[3] * t + a[2]) * t + a[1]) * t + a[0], ((b[3] * t + b[2]) * t + b[1]) * t + b[0]
    return start[0] + t * (end[0] - start[0]), start[1] + t * (end[1] - start[1])


@kernel
def _highest(top: Floats, fixed: Floats, x: float, y: float, radius: float, enough: float) -> float:
    """Height of the highest cell within a radius (cells) of a place (cells); the search ends at one over `enough`."""
    rows, columns = top.shape
    best = 0.0
    for j in range(max(0, math.floor(y - radius)), min(rows, math.floor(y + radius) + 1)):
        for i in range(max(0, math.floor(x - radius)), min(columns, math.floor(x + radius) + 1)):
            dx, dy = i + 0.5 - x, j + 0.5 - y
            if dx * dx + dy * dy <= radius * radius:
                best = max(best, top[j, i], fixed[j, i])
                if best > enough:
                    return float(best)
    return float(best)


@kernel
def _under(top: Floats, fixed: Floats, x: float, y: float) -> float:
    """Height under a place; beside the grid there is the base plate."""
    rows, columns = top.shape
    i, j = math.floor(x), math.floor(y)
    if i < 0 or j < 0 or i >= columns or j >= rows:
        return 0.0
    return float(max(top[j, i], fixed[j, i]))


@kernel
def _lay(path: Columns, m: int, ground: _Ground, radius: float) -> None:
    """Raise the cells under a bead to its height."""
    rows, columns = ground.top.shape
    z = path.end[m, 2]
    parts = max(1, math.ceil(path.length[m] / ground.cell))
    for p in range(parts + 1):
        x, y = place_on(path, m, p / parts)
        if not (math.isfinite(x) and math.isfinite(y) and math.isfinite(z)):
            return
        x, y = (x - ground.origin[0]) / ground.cell, (y - ground.origin[1]) / ground.cell
        for j in range(max(0, math.floor(y - radius)), min(rows, math.floor(y + radius) + 1)):
            for i in range(max(0, math.floor(x - radius)), min(columns, math.floor(x + radius) + 1)):
                dx, dy = i + 0.5 - x, j + 0.5 - y
                if dx * dx + dy * dy <= radius * radius and ground.top[j, i] < z:
                    ground.top[j, i] = z


@kernel
def _touch(
    ground: _Ground, tool: _Tool, x: float, y: float, z: float, highest: float, m: int, out: Floats
) -> float:
    """Note how deep tip and head go into what stands at a place (cells); the height under it."""
    under = _under(ground.top, ground.fixed, x, y)
    if under > z + TOUCH_MM:
        out[0, m] = max(out[0, m], under - z)
    bottom = z + tool.above
    depth = _under(ground.top, ground.around, x, y) - bottom
    if highest > bottom + TOUCH_MM:
        depth = max(depth, _highest(ground.top, ground.top, x, y, tool.head, np.inf) - bottom)
    if depth > TOUCH_MM:
        out[1, m] = max(out[1, m], depth)
    return under


@kernel
def _meet(
    path: Columns, m: int, below: float, ground: _Ground, tool: _Tool, highest: float, out: Floats
) -> None:
    """Look at what one motion of a bead meets, and what it lies on."""
    z = min(path.start[m, 2], path.end[m, 2])
    support = below - TOUCH_MM
    parts = max(1, math.ceil(path.length[m] / ground.cell))
    for p in range(parts):
        x, y = place_on(path, m, (p + 0.5) / parts)
        if not (math.isfinite(x) and math.isfinite(y) and math.isfinite(z)):
            return
        x, y = (x - ground.origin[0]) / ground.cell, (y - ground.origin[1]) / ground.cell
        under = _touch(ground, tool, x, y, z, highest, m, out)
        if under >= support:
            continue
        if _highest(ground.top, ground.fixed, x, y, tool.bead, support) < support:
            if out[5, m] == 0.0:
                out[6, m] = p / parts
            out[5, m] += path.length[m] / parts
            out[7, m] = (p + 1.0) / parts


@kernel
def _meet_in_box(
    path: Columns, m: int, z: float, ground: _Ground, tool: _Tool, highest: float, out: Floats
) -> float:
    """Look at what a rapid may meet within the box around its ends; the most that it lacks of the clearance there, mm."""
    start, end = path.start[m], path.end[m]
    columns = max(1, math.ceil(abs(end[0] - start[0]) / ground.cell))
    rows = max(1, math.ceil(abs(end[1] - start[1]) / ground.cell))
    worst = 0.0
    for j in range(rows + 1):
        for i in range(columns + 1):
            x = (start[0] + (end[0] - start[0]) * i / columns - ground.origin[0]) / ground.cell
            y = (start[1] + (end[1] - start[1]) * j / rows - ground.origin[1]) / ground.cell
            _touch(ground, tool, x, y, z, highest, m, out)
            worst = max(
                worst, _highest(ground.top, ground.fixed, x, y, tool.bead, np.inf) + tool.clearance - z
            )
    return float(worst)


@kernel
def _travel(
    path: Columns,
    m: int,
    floor: float,
    ground: _Ground,
    tool: _Tool,
    highest: float,
    low_mm: float,
    out: Floats,
) -> float:
    """Look at what one travel meets; for how long travel has run under the clearance by then, mm."""
    start, end = path.start[m], path.end[m]
    # Axes that move at once need not arrive at once: the lower end counts for the whole way.
    z = end[2] if math.isnan(start[2]) else min(start[2], end[2])
    free = max(highest, ground.tallest) + tool.clearance - TOUCH_MM
    if z >= free:
        return 0.0
    if not (math.isfinite(z) and math.isfinite(start[0]) and math.isfinite(start[1])):
        out[4, m] = 1.0
        return low_mm
    if z < floor - TOUCH_MM:
        out[2, m] = floor - z
    way = math.hypot(end[0] - start[0], end[1] - start[1])
    if tool.apart > 0.0 and path.kind[m] == RAPID and start[0] != end[0] and start[1] != end[1]:
        lacks = _meet_in_box(path, m, z, ground, tool, highest, out)
        low_mm = low_mm + way if lacks > TOUCH_MM else 0.0
        if low_mm > tool.hop + TOUCH_MM:
            out[3, m] = max(out[3, m], lacks)
        return low_mm
    if path.kind[m] > STRAIGHT:
        way = path.length[m]
    parts = max(1, math.ceil(way / ground.cell))
    for p in range(parts + 1):
        x, y = place_on(path, m, p / parts)
        x, y = (x - ground.origin[0]) / ground.cell, (y - ground.origin[1]) / ground.cell
        _touch(ground, tool, x, y, z, highest, m, out)
        lacks = _highest(ground.top, ground.fixed, x, y, tool.bead, np.inf) + tool.clearance - z
        if lacks <= TOUCH_MM:
            low_mm = 0.0
            continue
        low_mm += way / parts if p > 0 else 0.0
        if low_mm > tool.hop + TOUCH_MM:
            out[3, m] = max(out[3, m], lacks)
    return low_mm


@kernel
def _run(path: Columns, beads: _Beads, ground: _Ground, tool: _Tool, out: Floats) -> None:
    """Run all motions; `out` (8, B) are the columns of :class:`Standing`."""
    highest, low_mm, bead, row = 0.0, 0.0, 0, 0
    while row < path.kind.size:
        if bead < beads.first.size and row == beads.first[bead]:
            stop = beads.last[bead] + 1
            for m in range(row, stop):
                _meet(path, m, beads.below[m], ground, tool, highest, out)
            for m in range(row, stop):
                _lay(path, m, ground, tool.bead)
                if path.end[m, 2] > highest:
                    highest = path.end[m, 2]
            row, low_mm = stop, 0.0
            bead += 1
        else:
            low_mm = _travel(path, row, beads.floor[row], ground, tool, highest, low_mm, out)
            row += 1

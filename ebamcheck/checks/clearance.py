"""Checks of the tool's path: it clears what stands, the wire does not plunge, and every bead is supported."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from ebamcheck.checks.checks import PLACE_MM, limit_check
from ebamcheck.kernels import Bools, Floats, Ints, kernel
from ebamcheck.layers.stack import Layers
from ebamcheck.nc.control import control
from ebamcheck.nc.motions import ARC, POLYNOMIAL, RAPID, SPLINE_SPAN, STRAIGHT, Beads, NCProgram
from ebamcheck.result import Check
from ebamcheck.settings.config import Config
from ebamcheck.settings.process import KeepOut

HOP_SPACINGS = 2.0  # Bead spacings of a hop: to the line after the next, over beads laid in one plane
PLACES = 32  # Places on each motion without support that are looked at
WHOLLY = 0.99  # Share of a bead's length over nothing from which on it has nothing to lie on
STEP_MM = 0.5  # Curved beads are looked at as straight parts of at most this length
CELLS_PER_BEAD = 6  # Cells across a bead: its border is known to half a millimetre for a bead of 6 mm
MOST_CELLS = 16_000_000  # Cells of a grid at most, 256 MiB in all; a larger plate gets coarser ones
NO_HEIGHT = KeepOut.model_fields["z_mm"].default  # Heights of a keep-out zone for which nobody gave any


def clearance_checks(nc: NCProgram, z_of: Floats, config: Config, layers: Layers | None = None) -> list[Check]:
    """Run a program over what stands, and check what it meets; where `layers` have metal under a bead, metal has to stand."""
    beads = nc.beads
    # Z (B,) of the layer below each motion; what stands for the first one, and 0 outside of layers.
    tops = z_of if z_of.size else nc.layer_heights
    under = np.concatenate([[config.base_mm], tops])
    below = np.nan_to_num(np.where(nc.layer >= 0, under[np.minimum(nc.layer, tops.size)], 0.0))
    found = run_over(nc, beads, below, config, HOP_SPACINGS * config.process.hatch_spacing_mm)
    in_air = beads_in_the_air(nc, beads, found.bare_mm, below, config.process.bead_width_mm)
    support = _in_the_air(nc, beads, in_air) or _support(nc, beads, found, config, layers)
    return [_collision(nc, found), _clearance(nc, found, config), support]


def _collision(nc: NCProgram, found: Standing) -> Check:
    """Depth to which tip or head go into what stands, or a travel goes under the beads around it; the first place."""
    depth = np.stack([found.into_mm, found.head_mm, found.under_mm])
    rows = np.flatnonzero(depth.max(axis=0) > 0.0)
    if not rows.size:
        return limit_check("collision", 0.0, 0.0, "mm", "tip and head stay clear of plate, clamps and beads")
    row = int(rows[0])
    which = int(np.argmax(depth[:, row]))
    where = "under the beads before and after it" if which == 2 else "into what stands"
    what = f"the {'head' if which == 1 else 'tip'} goes {depth[which, row]:.4g} mm {where}{_more(rows)}"
    return limit_check("collision", depth.max(), 0.0, "mm", what, nc.where(row))


def _clearance(nc: NCProgram, found: Standing, config: Config) -> Check:
    """What travel lacks of the clearance, where it is longer than a hop or leaves a place that is not known."""
    limit, lost = config.machine.clearance_mm, found.lost > 0.0
    rows = np.flatnonzero((found.short_mm > 0.0) | lost)
    if not rows.size:
        text = f"travel keeps {limit:g} mm over all that stands, hops keep to the height of the beads"
        return limit_check("clearance", 0.0, 0.0, "mm", text)
    row = int(rows[0])
    what = f"travel lacks {found.short_mm[row]:.4g} mm of the clearance of {limit:g} mm"
    unknown = "travel from a place or height that no block has given, lower than what stands and the clearance"
    what = unknown if lost[row] else what
    worst = np.where(lost, np.inf, found.short_mm).max()
    return limit_check("clearance", worst, 0.0, "mm", f"{what}{_more(rows)}", nc.where(row))


def _more(rows: Ints) -> str:
    return f" (and {rows.size - 1} more)" if rows.size > 1 else ""


def _in_the_air(nc: NCProgram, beads: Beads, in_air: Bools) -> Check | None:
    """Length of the beads of islands that touch nothing which stands, whatever the part is there; None where there are none."""
    if not in_air.any():
        return None
    rows = beads.rows[in_air[beads.bead]]
    value = float(np.nan_to_num(nc.lengths[rows]).sum())
    row, layers = int(rows[0]), np.unique(nc.layer[rows])
    more = f", on {layers.size} layers" if layers.size > 1 else ""
    text = f"{value:.4g} mm of beads begin in the air{more}: nothing stands under them, nor beside them"
    return Check("support", False, value, 0.0, "mm", nc.where(row), text)


def _support(nc: NCProgram, beads: Beads, found: Standing, config: Config, layers: Layers | None) -> Check:
    """Length of a bead over nothing, where the part has metal below it; over one bead width a pool bridges."""
    limit, missing = config.process.bead_width_mm, np.zeros(len(nc))
    bare = np.flatnonzero(found.bare_mm > 0.0)
    if layers is not None and bare.size:
        missing[bare] = found.bare_mm[bare] * _over_metal(nc, bare, found, layers)
    of_bead = beads.total(missing[beads.rows])
    over, value = np.flatnonzero(of_bead > limit), of_bead.max(initial=0.0)
    what, where = "beads lie on metal", ""
    if over.size:
        mine = beads.rows[beads.bead == over[0]]
        where = nc.where(int(mine[np.argmax(missing[mine] > 0.0)]))
        what = f"{of_bead[over[0]]:.4g} mm of a bead lie on nothing where the part has metal{_more(over)}"
    text = f"{what}; {found.bare_mm.sum() - missing.sum():.4g} mm of beads overhang with the part"
    return limit_check("support", value, limit, "mm", text, where)


def _over_metal(nc: NCProgram, rows: Ints, found: Standing, layers: Layers) -> Floats:
    """Share (n,) of what hangs of each motion that lies over the section of the layer below."""
    share = np.zeros(rows.size)
    t = (np.arange(PLACES) + 0.5) / PLACES
    for k in np.unique(nc.layer[rows]).tolist():
        mine = np.flatnonzero(nc.layer[rows] == k)
        section = layers.section(k - 1) if 0 < k <= len(layers) else shapely.Polygon()
        if section.is_empty:
            continue
        row = np.repeat(rows[mine], PLACES)
        along = found.bare_from[row] + np.tile(t, mine.size) * (found.bare_to - found.bare_from)[row]
        at = nc.evaluate(row, along)
        shapely.prepare(section)
        inside = shapely.intersects_xy(section, at[:, 0], at[:, 1])
        share[mine] = inside.reshape(-1, PLACES).mean(axis=1)
    return share


def beads_in_the_air(nc: NCProgram, beads: Beads, bare_mm: Floats, below_mm: Floats, width_mm: float) -> Bools:
    """Find beads (P,) of islands that touch no metal of the layer below, nor anything else that stands."""
    long = beads.total(np.nan_to_num(nc.lengths[beads.rows]))
    bare = beads.total(bare_mm[beads.rows])
    alone = (long > 0.0) & (bare >= WHOLLY * long)
    layer, top = nc.layer[beads.first], nc.end[beads.first, 2]
    result = np.zeros(len(beads), np.bool_)
    for k in np.unique(layer[alone]).tolist():
        mine = np.flatnonzero(layer == k)
        first = beads.first[mine[0]]
        under = np.flatnonzero((layer != k) & (beads.first < first) & (top >= below_mm[first] - PLACE_MM))
        stands = _metal(nc, beads, under, width_mm)
        for island in shapely.get_parts(_metal(nc, beads, mine, width_mm)):
            # What a first bead lies on may be a clamp, too: an island with a bead that lies on something is none.
            within = mine[shapely.intersects(island, shapely.points(nc.end[beads.first[mine], :2]))]
            if alone[within].any() and not shapely.intersects(island, stands):
                result[within] = True
    return result


def _metal(nc: NCProgram, beads: Beads, which: Ints, width_mm: float) -> BaseGeometry:
    rows = beads.rows[np.isin(beads.bead, which)]
    if not rows.size:
        return shapely.Polygon()
    index, points = nc.lines(rows, STEP_MM)
    lines = np.split(points, np.flatnonzero(np.diff(index)) + 1)
    known = [shapely.LineString(line) for line in lines if np.isfinite(line).all()]
    return shapely.union_all(shapely.buffer(known, 0.5 * width_mm))


@dataclass(frozen=True, eq=False)
class Standing:
    """What every motion of a program meets, as columns (B,); zero where it meets nothing. Depth to which tip and head go into what
    stands, and a travel under the beads around it; what a travel longer than a hop lacks of the clearance; travels at a place that
    no block has given (`lost`); length of a bead over nothing, and the parameters between which that is."""

    into_mm: Floats
    head_mm: Floats
    under_mm: Floats
    short_mm: Floats
    lost: Floats
    bare_mm: Floats
    bare_from: Floats
    bare_to: Floats


def run_over(nc: NCProgram, beads: Beads, below_mm: Floats, config: Config, hop_mm: float) -> Standing:
    """Run a program over the grid of what stands; a travel up to `hop_mm` may stay at the height of the beads."""
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
    path = Columns(nc.kind, nc.start, nc.end, nc.coefficients, nc.arc, np.nan_to_num(nc.lengths))
    _run(path, _Beads(beads.first, beads.last, floor, below_mm), ground, tool, out)
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


class Columns(NamedTuple):
    """Columns of a program's motions, as NCProgram has them; motions of unknown length have none."""

    kind: Ints
    start: Floats
    end: Floats
    coefficients: Floats
    arc: Floats
    length: Floats


class _Beads(NamedTuple):
    """Where beads begin and end, and heights around each motion (B,)."""

    first: Ints
    last: Ints
    floor: Floats  # Z of the lower of the beads before and after
    below: Floats


class _Ground(NamedTuple):
    """What stands, (rows, columns) each."""

    top: Floats  # Beads; it changes while the program runs
    fixed: Floats  # Clamps
    around: Floats  # Clamps grown by the radius of the head
    origin: Floats
    cell: float
    tallest: float  # Height of the tallest clamp


class _Tool(NamedTuple):
    """The tool; radii in cells."""

    bead: float
    head: float
    above: float
    clearance: float
    hop: float
    apart: float  # 1 where the axes of a rapid may arrive one after the other, else 0


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
def _touch(ground: _Ground, tool: _Tool, x: float, y: float, z: float, highest: float, m: int, out: Floats) -> float:
    """Note how deep tip and head go into what stands at a place (cells); the height under it, beside the grid that of the base
    plate."""
    rows, columns = ground.top.shape
    i, j = math.floor(x), math.floor(y)
    under, around = 0.0, 0.0
    if 0 <= i < columns and 0 <= j < rows:
        under = float(max(ground.top[j, i], ground.fixed[j, i]))
        around = float(max(ground.top[j, i], ground.around[j, i]))
    if under > z + PLACE_MM:
        out[0, m] = max(out[0, m], under - z)
    bottom = z + tool.above
    depth = around - bottom
    if highest > bottom + PLACE_MM:
        depth = max(depth, _highest(ground.top, ground.top, x, y, tool.head, np.inf) - bottom)
    if depth > PLACE_MM:
        out[1, m] = max(out[1, m], depth)
    return under


@kernel
def _travel(
    path: Columns, m: int, floor: float, ground: _Ground, tool: _Tool, highest: float, low_mm: float, out: Floats,
) -> float:  # fmt: skip
    """Look at what one travel meets; for how long travel has run under the clearance by then, mm."""
    start, end = path.start[m], path.end[m]
    # Axes that move at once need not arrive at once: the lower end counts for the whole way.
    z = end[2] if math.isnan(start[2]) else min(start[2], end[2])
    free = max(highest, ground.tallest) + tool.clearance - PLACE_MM
    if z >= free:
        return 0.0
    if not (math.isfinite(z) and math.isfinite(start[0]) and math.isfinite(start[1])):
        out[4, m] = 1.0
        return low_mm
    if z < floor - PLACE_MM:
        out[2, m] = floor - z
    way = math.hypot(end[0] - start[0], end[1] - start[1])
    if tool.apart > 0.0 and path.kind[m] == RAPID and start[0] != end[0] and start[1] != end[1]:
        # The rapid may go anywhere in the box around its ends.
        columns = max(1, math.ceil(abs(end[0] - start[0]) / ground.cell))
        rows = max(1, math.ceil(abs(end[1] - start[1]) / ground.cell))
        lacks = 0.0
        for j in range(rows + 1):
            for i in range(columns + 1):
                x = (start[0] + (end[0] - start[0]) * i / columns - ground.origin[0]) / ground.cell
                y = (start[1] + (end[1] - start[1]) * j / rows - ground.origin[1]) / ground.cell
                _touch(ground, tool, x, y, z, highest, m, out)
                top = _highest(ground.top, ground.fixed, x, y, tool.bead, np.inf)
                lacks = max(lacks, top + tool.clearance - z)
        low_mm = low_mm + way if lacks > PLACE_MM else 0.0
        if low_mm > tool.hop + PLACE_MM:
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
        if lacks <= PLACE_MM:
            low_mm = 0.0
            continue
        low_mm += way / parts if p > 0 else 0.0
        if low_mm > tool.hop + PLACE_MM:
            out[3, m] = max(out[3, m], lacks)
    return low_mm


@kernel
def _run(path: Columns, beads: _Beads, ground: _Ground, tool: _Tool, out: Floats) -> None:
    """Run all motions; `out` (8, B) are the columns of :class:`Standing`. A bead meets what stood before it, and is laid then."""
    rows, columns = ground.top.shape
    highest, low_mm, bead, row = 0.0, 0.0, 0, 0
    while row < path.kind.size:
        if bead >= beads.first.size or row != beads.first[bead]:
            low_mm = _travel(path, row, beads.floor[row], ground, tool, highest, low_mm, out)
            row += 1
            continue
        stop = beads.last[bead] + 1
        for m in range(row, stop):
            z = min(path.start[m, 2], path.end[m, 2])
            support = beads.below[m] - PLACE_MM
            parts = max(1, math.ceil(path.length[m] / ground.cell))
            for p in range(parts):
                x, y = place_on(path, m, (p + 0.5) / parts)
                if not (math.isfinite(x) and math.isfinite(y) and math.isfinite(z)):
                    break
                x, y = (x - ground.origin[0]) / ground.cell, (y - ground.origin[1]) / ground.cell
                under = _touch(ground, tool, x, y, z, highest, m, out)
                if under >= support:
                    continue
                if _highest(ground.top, ground.fixed, x, y, tool.bead, support) < support:
                    if out[5, m] == 0.0:
                        out[6, m] = p / parts
                    out[5, m] += path.length[m] / parts
                    out[7, m] = (p + 1.0) / parts
        radius = tool.bead
        for m in range(row, stop):
            z = path.end[m, 2]
            parts = max(1, math.ceil(path.length[m] / ground.cell))
            for p in range(parts + 1):
                x, y = place_on(path, m, p / parts)
                if not (math.isfinite(x) and math.isfinite(y) and math.isfinite(z)):
                    break
                x, y = (x - ground.origin[0]) / ground.cell, (y - ground.origin[1]) / ground.cell
                for j in range(max(0, math.floor(y - radius)), min(rows, math.floor(y + radius) + 1)):
                    for i in range(max(0, math.floor(x - radius)), min(columns, math.floor(x + radius) + 1)):
                        dx, dy = i + 0.5 - x, j + 0.5 - y
                        if dx * dx + dy * dy <= radius * radius and ground.top[j, i] < z:
                            ground.top[j, i] = z
            if path.end[m, 2] > highest:
                highest = path.end[m, 2]
        row, low_mm = stop, 0.0
        bead += 1

"""The metal that a program's text lays: a height field of each layer, the surface that it builds up, and the wire that each place
of a bead asks for.

Wire section, wire speed and feed give the metal; the pool, a half sphere as wide as the bead, spreads it; a place is levelled over
a bead width; the next layer begins on what is still too high or too low. Nothing is taken from the code that gives the wire of a
program its speed."""

from __future__ import annotations

import json
import math
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
import pyarrow as pa
import shapely
from numpy.typing import ArrayLike
from scipy import ndimage
from shapely.geometry.base import BaseGeometry

from ebamcheck.checks.matching import nearest_each
from ebamcheck.checks.narrow_features import NarrowFeature, narrow_features, thinnest_wall
from ebamcheck.columns_file import open_table, write_table
from ebamcheck.errors import InputError
from ebamcheck.geometry.nearest import distances, segments_of
from ebamcheck.geometry.regions import valid_polygons
from ebamcheck.heat.medium import width_limits_mm
from ebamcheck.json_values import parsed_json
from ebamcheck.kernels import Bools, Floats, Ints
from ebamcheck.layers.stack import Layers
from ebamcheck.metal import Surface, Target, bead_centres, levelled, target_of
from ebamcheck.metal.surface import FILM, HALF
from ebamcheck.metal.target import border_distance
from ebamcheck.nc.motions import NCProgram
from ebamcheck.nc.roles import nearest_layer
from ebamcheck.settings.config import Config
from ebamcheck.settings.process import ProcessSettings
from ebamcheck.threads import run_each

STEP_SHARE = 1.0 / 12.0  # Distance of the places at which metal is laid, over the bead width: half a cell
CLOSED = 0.5  # Share of a hole's area under metal from which on no tool finds it
HALF_LINE = 0.5  # Lines by which a zone may be off: its border runs through one
WINDOW_BEADS = 3.0  # Width of a window in bead widths: four lines, of which a missing one is a quarter
# Share of what lies too high or too low that a layer levels at most, and share of its height that this may come to. All layers together
# have the metal of the part: where sections taper, what their rims lack heaps up inside of them, and no wire levels it. So all between
# the layer's height and this is asked for; how far the surface may heap up is a check of its own (`surface`).
TO_LEVEL, MOST_TO_LEVEL = 0.3, 0.2
AT_LIMIT = 0.01  # A bead within this of the least or greatest wire cannot have less, or more
LEAST_OWN = 0.3  # Share of the metal over its width that a bead lays itself, at least
AT_ONCE = 8  # Layers whose metal is held at a time; they are measured on all threads
FIELD_FILE = "deposit_worst.parquet"  # Name of the field of the worst layer in a run folder
HOLE_COLUMNS = ("layer", "x_mm", "y_mm", "width_mm", "covered")
ZONES = ("inside", "edge", "zone")  # Of a layer: deep_cells, the others, and the worst window
# Figures of the zones of a layer that has none.
NO_ZONES = {
    "inside": math.nan, "edge": math.nan,
    **{f"{zone}_{column}": math.nan for zone in ZONES for column in ("settled", "owed")},
    **{f"{zone}_mm2": 0.0 for zone in ZONES},
    "zone_tolerance": math.nan, "zone_x_mm": math.nan, "zone_y_mm": math.nan,
}  # fmt: skip


def wire_section_mm2(config: Config) -> float:
    """Area of the wire's circular cross-section."""
    radius_mm = 0.5 * config.process.wire_diameter_mm
    return math.pi * radius_mm * radius_mm


def wanted_region(section: BaseGeometry, config: Config) -> BaseGeometry:
    """Region that the metal of a layer is to fill: its section, and what is left for machining around it."""
    around_mm = config.process.machining_allowance_mm
    # At an allowance of 3 mm the chords of a corner err by 4 um.
    return shapely.buffer(section, around_mm, quad_segs=16) if around_mm > 0.0 else section


def bead_height_mm(config: Config) -> float:
    """Height of one bead of the set wire and feed by itself: a parabola, two thirds of its width times its height."""
    process = config.process
    laid_mm2 = wire_section_mm2(config) * process.wire_speed_mm_s / process.travel_speed_mm_s
    return 1.5 * laid_mm2 / process.bead_width_mm


def bead_sections_mm2(nc: NCProgram, config: Config) -> Floats:
    """Section of the bead that each motion lays, (B,) mm2; NaN where wire or feed is not known, infinite without feed."""
    with np.errstate(divide="ignore", invalid="ignore"):
        mm3_s = nc.wire_mm_s * wire_section_mm2(config)
        return np.asarray(mm3_s / (nc.feed_mm_min / 60.0), np.float64)


@dataclass(frozen=True, eq=False)
class LayerField:
    """The metal of one layer in the cells (rows, columns) of its target: height laid, and height of the surface over that of the
    layer, mm."""

    target: Target
    laid_mm: Floats
    over_mm: Floats


@dataclass(frozen=True, eq=False)
class Asked:
    """What the places (n,) along the beads of a layer lay, and what they ask for, in program order. Columns of `laid`, `least` and
    `most` (n, 3), mm2: metal by the area of the section nearest to a place, the same with all that lies in the pool, and the metal
    over the width of the bead; `own` is what the bead lays itself over one bead width; `at_limit` is -1 where it has the least
    wire, 1 where it has the most, else 0."""

    row: Ints
    along_mm: Floats
    laid: Floats
    least: Floats
    most: Floats
    own: Floats
    at_limit: Floats


@dataclass(frozen=True, eq=False)
class Deposit:
    """The metal of a program: figures of its layers, closed holes, fields, surface, and narrow features."""

    # One row a layer: `layer`, `z_mm`, `wanted_mm3`, `laid_mm3`, `outside_mm3` (beside section and allowance), `inside_mm2` and
    # `edge_mm2` (cells of deep_cells, and the others), `inside` and `edge` (mean height of the metal there over that of the layer; NaN
    # without any), `inside_settled` and `edge_settled` (the same when the metal has levelled), `zone_settled`, `zone_mm2` and
    # `zone_tolerance` of the worst window, `inside_owed` ... `zone_owed` (the height that would make the surface right), `low_mm` and
    # `high_mm` (the surface under its height where beads run or could, and over it anywhere, when the layer is done), `reach_mm` (how far
    # from the section there is metal of FILM), `wall_mm` (the thinnest wall under a bead, on layers with too much metal beside them; else
    # NaN), and where these five are, `zone_x_mm` ... `wall_y_mm`.
    layers: pd.DataFrame
    first_row: Ints  # (L,) first motion of each layer that lays metal, -1 without one
    # Holes of sections of which metal covers more than CLOSED, without what stands in them: `layer`, `x_mm`, `y_mm` (middle of the widest
    # place), `width_mm` (of the greatest disc that fits in) and `covered` (share of the area).
    holes: pd.DataFrame
    # Layers that were asked for, and the worst one, by their index; the layer of which surface, reach or a window comes nearest to its
    # limit, or is furthest over it, -1 without any.
    fields: dict[int, LayerField]
    worst: int
    # What the program leaves; openings and walls of the part that are narrower than beads can build.
    surface: Surface
    narrow: tuple[NarrowFeature, ...]
    # Wire of the beads by their places, layer by layer, where that was asked for.
    asked: tuple[Asked, ...] = ()


class _Melted(NamedTuple):
    """Metal of one layer as it is laid: its place in the stack, motion, volume and cells of each place along the beads."""

    k: int
    z_mm: float
    height_mm: float
    section: BaseGeometry
    target: Target
    row: Ints
    volume: Floats
    cells: _Cells


class _Laid(NamedTuple):
    """Metal of one layer on the surface: cells that melt, heights laid, and heights of the surface before and after."""

    of: _Melted
    melted: Floats
    laid: Floats
    before: Floats
    over: Floats


def deposit(
    nc: NCProgram, layers: Layers, z_of: Floats, config: Config, keep: Collection[int] = (),
    stands: Surface | None = None, asked: bool = False,
) -> Deposit:  # fmt: skip
    """Lay the metal of a program, layer by layer, over the sections `layers` of a slicer that did not make it, if there is one. The
    layers lie at `z_of` (L,), the lowest on the surface `stands`, or level. The fields of the layers `keep` are returned, too, and,
    where it is `asked`, what the place of each bead asks for."""
    process = config.process
    rows = np.flatnonzero(nc.deposit & nc.wire)
    index = nearest_layer(nc.end[rows, 2], z_of)
    thickness = np.diff(z_of, prepend=config.base_mm)
    of_part = [layers.section(k) for k in range(len(layers))]
    sections = [wanted_region(section, config) for section in of_part]
    bounds = np.nan_to_num(np.asarray(shapely.total_bounds(sections), np.float64))
    surface = stands.copy() if stands else Surface(bounds, process.bead_width_mm)
    pool = pool_of(process.bead_width_mm, surface.step_mm)
    bead_mm2 = np.nan_to_num(bead_sections_mm2(nc, config), posinf=0.0)

    def melted(k: int) -> _Melted:
        target = target_of(sections[k], surface.step_mm, 2.0 * process.bead_width_mm)
        row, places = nc.samples(rows[index == k], process.bead_width_mm * STEP_SHARE)
        pieces = np.bincount(row, minlength=len(nc))[row]
        volume = bead_mm2[row] * np.nan_to_num(nc.lengths[row]) / pieces
        height_mm, cells = float(thickness[k]), _Cells(target, places)
        return _Melted(k, float(z_of[k]), height_mm, sections[k], target, row, volume, cells)

    def laid(of: _Melted) -> _Laid:
        target = of.target
        melts = of.cells.spread(of.volume) / surface.step_mm**2
        metal = ndimage.convolve(melts, pool, mode="constant") if melts.size else melts
        before = surface.over_mm(target)
        surface.add(target, metal, of.height_mm)
        return _Laid(of, melts, metal, before, surface.over_mm(target))

    def measured(layer: _Laid) -> tuple[dict[str, float], list[dict[str, float]], Asked | None]:
        figures = _figures(layer, process)
        closed = _closed_holes(layer) if figures["reach_mm"] > 0.0 else []
        return figures, closed, _asked(nc, layer, bead_mm2, config) if asked else None

    table, holes, wire = list[dict[str, float]](), list[dict[str, float]](), list[Asked]()
    fields: dict[int, LayerField] = {}
    worst, most = -1, -math.inf
    for first in range(0, len(layers), AT_ONCE):
        batch = run_each(melted, range(first, min(first + AT_ONCE, len(layers))))
        done = [laid(layer) for layer in batch]
        for layer, (figures, closed, places) in zip(done, run_each(measured, done), strict=True):
            k = layer.of.k
            table.append(figures)
            holes += closed
            wire += [] if places is None else [places]
            badness = over_limits(figures, process) if layer.of.section.area > 0.0 else -math.inf
            if badness > most:
                if worst not in keep:
                    fields.pop(worst, None)
                worst, most = k, badness
            if k in keep or k == worst:
                fields[k] = LayerField(layer.of.target, layer.laid, layer.over)
    some, at = np.unique(index, return_index=True)
    first_row = np.full(len(layers), -1, np.int64)
    first_row[some] = rows[at]
    return Deposit(
        pd.DataFrame(table), first_row, pd.DataFrame(holes, columns=list(HOLE_COLUMNS)), fields, worst, surface,
        tuple(narrow_features(of_part, config)), tuple(wire),
    )  # fmt: skip


class _Cells:
    """The four cells around each place (n, 2), and its share of each; what lies beside the grid is left out."""

    def __init__(self, target: Target, places: Floats) -> None:
        self.places, self._shape = places, target.share.shape
        rows, columns = self._shape
        at = (places - target.origin) / target.step_mm - 0.5
        at = np.where(np.isfinite(at), at, -2.0)  # a place whose axis nothing has given lies beside the grid, too
        corner = np.floor(at).astype(np.int64)
        part = at - corner
        self._corners: list[tuple[Bools, Ints, Floats, Floats]] = []
        for right in (0, 1):
            for up in (0, 1):
                column, row = corner[:, 0] + right, corner[:, 1] + up
                held = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
                shares = np.abs(1 - right - part[:, 0])[held], np.abs(1 - up - part[:, 1])[held]
                self._corners.append((held, (row * columns + column)[held], *shares))

    def spread(self, values: Floats) -> Floats:
        """Values (n,) of places by cell (rows, columns)."""
        found = np.zeros(math.prod(self._shape))
        for held, cell, along, across in self._corners:
            found += np.bincount(cell, values[held] * along * across, minlength=found.size)
        return found.reshape(self._shape)

    def read(self, field: Floats) -> Floats:
        """A field (rows, columns) at the places (n,)."""
        found = np.zeros(len(self.places))
        for held, cell, along, across in self._corners:
            found[held] += field.ravel()[cell] * along * across
        return found


def pool_of(bead_width_mm: float, step_mm: float) -> Floats:
    """Shares in which the pool, a half sphere as wide as the bead, spreads metal over the cells around it; their sum is 1."""
    radius = 0.5 * bead_width_mm / step_mm
    offset = np.arange(-math.ceil(radius), math.ceil(radius) + 1)
    pool = np.sqrt(np.maximum(radius**2 - (offset[:, None] ** 2 + offset**2), 0.0))
    return np.asarray(pool / pool.sum(), np.float64)


def _figures(layer: _Laid, process: ProcessSettings) -> dict[str, float]:
    """Row of one layer in :attr:`Deposit.layers`."""
    (of, melted, laid, before, over), target = layer, layer.of.target
    whole, row = float(of.volume.sum()), {"layer": of.k, "z_mm": of.z_mm}
    if not target.share.size:
        nowhere = ("mm", 0.0), ("x_mm", math.nan), ("y_mm", math.nan)
        zeros = {f"{name}_{part}": value for name in ("low", "high", "reach") for part, value in nowhere}
        figures = {"wanted_mm3": 0.0, "laid_mm3": whole, "outside_mm3": whole, **NO_ZONES, **zeros}
        return row | figures | _wall(of.section, figures, process)
    inside, bead_cells = target.share >= HALF, process.bead_width_mm / target.step_mm
    deep = deep_cells(inside, bead_cells)
    film = ~inside & (laid >= FILM * of.height_mm)
    runs = (melted > 0.0) | bead_centres(inside, bead_cells)
    figures = {
        # Not by the cells, which plan and check have in common.
        "wanted_mm3": float(of.section.area) * of.height_mm,
        "laid_mm3": whole,
        # What falls beside all cells is outside, too.
        "outside_mm3": float(whole - (laid * target.share).sum() * target.step_mm**2),
        **zone_figures(target, laid, before, (deep, inside & ~deep), of.height_mm, process),
        # Too low matters where a bead runs or could; the tip of a wedge, which none reaches, stays bare.
        **_extreme("low", np.where(runs, -over, 0.0), target),
        **_extreme("high", over, target),
        **_extreme("reach", _reaches_mm(film, inside, of.section, target), target),
    }
    return row | figures | _wall(of.section, figures, process)


def _extreme(name: str, height: Floats, target: Target) -> dict[str, float]:
    """Greatest value of a field, mm, and where it is."""
    row, column = np.unravel_index(int(np.argmax(height)), height.shape)
    x, y = target.origin + (np.array([column, row]) + 0.5) * target.step_mm
    greatest = max(float(height[row, column]), 0.0)
    return {f"{name}_mm": greatest, f"{name}_x_mm": float(x), f"{name}_y_mm": float(y)}


def _wall(section: BaseGeometry, figures: dict[str, float], process: ProcessSettings) -> dict[str, float]:
    """Thinnest wall under a bead of a layer with too much metal beside it, and where it is; else NaN."""
    beside = figures["outside_mm3"] > process.outside_share * figures["laid_mm3"]
    beside = beside or figures["reach_mm"] > process.outside_reach_mm
    wall = thinnest_wall(section, process.bead_width_mm) if beside else None
    return dict(zip(("wall_mm", "wall_x_mm", "wall_y_mm"), wall or (math.nan,) * 3, strict=True))


def over_limits(figures: dict[str, float], process: ProcessSettings) -> float:
    """Greatest of three ratios of a layer: its surface, reach and worst window, each over its limit."""
    off = zone_off(figures["zone_settled"], figures["zone_owed"])
    zone = float(off / zone_limit(figures["zone_tolerance"], figures["zone_mm2"], process))
    return max(
        max(figures["low_mm"], figures["high_mm"]) / process.largest_unevenness_mm,
        figures["reach_mm"] / process.outside_reach_mm,
        0.0 if math.isnan(zone) else zone,
    )


def _closed_holes(layer: _Laid) -> list[dict[str, float]]:
    """Holes of a section that metal covers for the most part."""
    found, whole = [], layer.of.target
    metal = layer.laid >= FILM * layer.of.height_mm
    for hole in _holes(valid_polygons(layer.of.section)):
        cells = target_of(hole, whole.step_mm, 0.0)
        column, row = np.round((cells.origin - whole.origin) / whole.step_mm).astype(np.int64)
        rows, columns = cells.share.shape
        covered = (cells.share * metal[row : row + rows, column : column + columns]).sum() / cells.share.sum()
        if covered > CLOSED:
            radius = shapely.maximum_inscribed_circle(hole, 0.01 * whole.step_mm)
            x_mm, y_mm = radius.coords[0]
            values = (layer.of.k, x_mm, y_mm, 2.0 * radius.length, float(covered))
            found.append(dict(zip(HOLE_COLUMNS, values, strict=True)))
    return found


def _holes(parts: list[shapely.Polygon]) -> list[shapely.MultiPolygon]:
    """What is free of each hole of the parts of a section: without the parts that stand in it, whose own holes are theirs."""
    filled = np.array([shapely.Polygon(part.exterior) for part in parts], object)
    tree = shapely.STRtree(filled)
    holes = [shapely.Polygon(ring) for part in parts for ring in part.interiors]
    free = [hole.difference(shapely.union_all(filled[tree.query(hole, "contains")])) for hole in holes]
    return [shapely.MultiPolygon(left) for left in map(valid_polygons, free) if left]


def _reaches_mm(film: Bools, inside: Bools, section: BaseGeometry, target: Target) -> Floats:
    """Distance of the cells (rows, columns) of a film from the section, mm; 0 in all others."""
    reach = np.zeros(film.shape)
    if inside.any():
        # From the border of a cell to the middle of the next it is half a cell.
        reach[film] = (border_distance(~inside)[film] - 0.5) * target.step_mm
    else:
        # A section thinner than a cell fills none to the half.
        row, column = np.nonzero(film)
        middles = target.origin + (np.column_stack([column, row]) + 0.5) * target.step_mm
        reach[film] = distances(middles, segments_of(section.boundary))
    return reach


def deep_cells(inside: Bools, bead_cells: float) -> Bools:
    """Cells of a section that lie further than a bead width from its border, where such cells are a bead wide or more.

    >>> wall, block = np.zeros((30, 60), bool), np.zeros((30, 60), bool)
    >>> wall[8:22, 1:59], block[1:29, 1:59] = True, True
    >>> [int(deep_cells(cells, 6.0).any(axis=1).sum()) for cells in (wall, block)]
    [0, 16]
    """
    centres = border_distance(inside) > 1.5 * bead_cells
    if not centres.any():
        return centres
    return np.asarray(inside & (border_distance(~centres) <= 0.5 * bead_cells), np.bool_)


def zone_figures(
    target: Target, laid_mm: Floats, before_mm: Floats, parts: tuple[Bools, Bools], thickness_mm: float, process: ProcessSettings
) -> dict[str, float]:  # fmt: skip
    """Figures of the zones of one layer: its `parts`, :func:`deep_cells` and the others, and the worst of all windows.
    `laid_mm` is the height of the metal in each cell, `before_mm` that of the surface under it over the layer below."""
    deep, rim = parts
    inside, bead_cells = deep | rim, process.bead_width_mm / target.step_mm
    wanted = target.share * thickness_mm
    found: dict[str, float] = dict(NO_ZONES)
    if not inside.any():
        return found
    metal = np.where(inside, target.share, 0.0)
    settled = metal * levelled(laid_mm / np.maximum(metal, HALF), metal, bead_cells)
    owed = metal * (thickness_mm - before_mm)
    for name, zone in (("inside", deep), ("edge", rim)):
        if zone.any():
            whole = float(wanted[zone].sum())
            found |= {
                name: float(laid_mm[zone].sum()) / whole,
                f"{name}_settled": float(settled[zone].sum()) / whole,
                f"{name}_owed": float(owed[zone].sum()) / whole,
                f"{name}_mm2": float(zone.sum()) * target.step_mm**2,
            }
    size = 2 * round(0.5 * WINDOW_BEADS * bead_cells) + 1
    tolerance = process.inside_tolerance * deep + process.edge_tolerance * rim
    area, laid, missing, cells, allowed = (
        ndimage.uniform_filter(np.where(inside, field, 0.0), size, mode="constant")[inside] * size**2
        for field in (wanted, settled, owed, np.ones_like(wanted), tolerance)
    )
    height, missing, allowed, mm2 = laid / area, missing / area, allowed / cells, cells * target.step_mm**2
    k = int(np.argmax(zone_off(height, missing) / zone_limit(allowed, mm2, process)))
    row, column = (int(at[k]) for at in np.nonzero(inside))
    x_mm, y_mm = (target.origin + (np.array([column, row]) + 0.5) * target.step_mm).tolist()
    values = zip(("settled", "owed", "mm2", "tolerance"), (height, missing, mm2, allowed), strict=True)
    worst = {f"zone_{name}": float(field[k]) for name, field in values}
    return found | worst | {"zone_x_mm": x_mm, "zone_y_mm": y_mm}


def zone_off(height: ArrayLike, owed: ArrayLike) -> Floats:
    """Distance of mean levelled heights, in layers, from the range between one layer and the height that the surface is owed."""
    height, owed = np.asarray(height, np.float64), np.asarray(owed, np.float64)
    over, under = height - np.maximum(owed, 1.0), np.minimum(owed, 1.0) - height
    return np.asarray(np.maximum(np.maximum(over, under), 0.0), np.float64)


def zone_limit(tolerance: Floats | float, area_mm2: ArrayLike, process: ProcessSettings) -> Floats:
    """Limit of :func:`zone_off`: the tolerance of a zone, plus half a line over the number of lines side by side in it."""
    width_mm = np.sqrt(np.maximum(np.asarray(area_mm2, np.float64), process.bead_width_mm**2))
    return np.asarray(tolerance + HALF_LINE * process.hatch_spacing_mm / width_mm, np.float64)


def _asked(nc: NCProgram, layer: _Laid, bead_mm2: Floats, config: Config) -> Asked | None:
    """What the places of a layer's beads ask for, on the surface that is there; None where no metal is laid or wanted."""
    of, target, height = layer.of, layer.of.target, layer.of.height_mm
    known = np.isfinite(nc.start[of.row]).all(axis=1)
    if not (target.share.size and known.any() and height > 0.0):
        return None
    row, volume, cells = of.row[known], of.volume[known], of.cells
    cells = cells if known.all() else _Cells(target, cells.places[known])
    bead_mm, step = config.process.bead_width_mm, target.step_mm
    pool, strip = pool_of(bead_mm, step), strip_of(bead_mm, step)
    over, laid = layer.before / height, layer.laid / height
    # Levelling moves metal within the layer, whose total stays that of the part.
    level = over - float(np.average(over, weights=target.share))
    level = 1.0 - np.clip(TO_LEVEL * level, -MOST_TO_LEVEL, MOST_TO_LEVEL)
    fields = target.share * np.minimum(level, 1.0), target.share * np.maximum(level, 1.0)
    along = nc.lengths[row] / np.bincount(row, minlength=len(nc))[row]

    def around(field: Floats, weights: Floats) -> Floats:
        return cells.read(ndimage.convolve(field, weights, mode="constant"))

    share = along / np.maximum(around(target.share, strip), LEAST_OWN)
    by_area = _nearest_areas(target, cells.places, fields)
    by_pool = (cells.read(laid) * step**2, *(around(cells.spread(area), pool) for area in by_area))
    laid_mm2, least_mm2, most_mm2 = (
        np.stack([area, in_pool * along, around(field, strip) * share], axis=1)
        for area, in_pool, field in zip((volume / height, *by_area), by_pool, (laid, *fields), strict=True)
    )
    width = bead_mm2[row] / height
    least, most = width_limits_mm(config, height)
    limit = 1.0 * (width >= most * (1.0 - AT_LIMIT)) - 1.0 * (width <= least * (1.0 + AT_LIMIT))
    return Asked(row, along, laid_mm2, least_mm2, most_mm2, width / bead_mm, limit)


def _nearest_areas(target: Target, places: Floats, fields: tuple[Floats, Floats]) -> Floats:
    """Sums of fields over the cells that are nearest to each place, mm2, (2, n)."""
    row, column = np.nonzero(target.share)
    # In the middle of its cell each, the points of a row would all fall to the same side of a line that runs along the grid. So two
    # points stand for a cell, and move from cell to cell by the sequence R2 (Roberts 2018), which fills the square evenly.
    one, two = 0.7548776662466927, 0.5698402909980532
    right, down = column * one + row * two, column * two + row * one
    x, y = (
        np.stack([at + (moved + across) % 1.0 for across in (0.0, 0.5)], axis=1).ravel()
        for at, moved in ((column, right), (row, down))
    )
    cells = target.origin + np.column_stack([x, y]) * target.step_mm
    near, _ = nearest_each(cells, np.hstack([places, places]))
    half_mm2 = 0.5 * target.step_mm**2
    sums = (np.bincount(near, np.repeat(f[row, column], 2), minlength=len(places)) for f in fields)
    return np.stack([half_mm2 * area for area in sums])


def strip_of(bead_mm: float, step_mm: float) -> Floats:
    """Weights of the cells around a place whose mean along a straight bead is that of the strip under it, one bead wide; their sum
    is 1. The inverse Abel transform of a strip: 1 / sqrt(R^2 - r^2) has the same integral along every line across its disc."""
    # By so many points across a cell its weight errs by less than a thousandth.
    radius, points = 0.5 * bead_mm / step_mm, 20
    cells = 2 * int(np.ceil(radius + 0.5)) + 1
    at = (np.arange(cells * points) + 0.5) / points - 0.5 * cells
    deep = radius**2 - (at[:, None] ** 2 + at**2)
    weight = np.where(deep > 0.0, 1.0 / np.sqrt(np.maximum(deep, 1.0 / points**2)), 0.0)
    weight = weight.reshape(cells, points, cells, points).sum(axis=(1, 3))
    return np.asarray(weight / weight.sum(), np.float64)


def field_table(field: LayerField, layer: int, thickness_mm: float) -> pa.Table:
    """Table of the field of a layer, one row a cell, in single precision."""
    target = field.target
    header = {
        "format": 1, "layer": layer, "thickness_mm": thickness_mm, "shape": field.laid_mm.shape, "origin_mm": target.origin.tolist(),
        "step_mm": target.step_mm,
    }  # fmt: skip
    columns = {"share": target.share, "laid_mm": field.laid_mm, "over_mm": field.over_mm}
    table = pa.table({name: pa.array(cells.ravel().astype(np.float32)) for name, cells in columns.items()})
    return table.replace_schema_metadata({"ebamcheck": json.dumps(header, sort_keys=True)})


def write_field(table: pa.Table, path: Path) -> None:
    """Write the table of a field."""
    # Many cells are alike, and a field is looked at, not computed with.
    write_table(table, path, use_dictionary=True, write_statistics=True, write_page_checksum=False)


def read_field(path: Path) -> tuple[LayerField, int, float]:
    """Field, layer and the height that the layer is to have, mm; an `InputError` if :func:`write_field` did not write the file."""
    try:
        with open_table(path) as file:
            table = file.read()
        header = parsed_json((table.schema.metadata or {})[b"ebamcheck"])
        shape = tuple(header["shape"])
        share, laid, over = (
            table.column(name).to_numpy().astype(np.float64).reshape(shape) for name in ("share", "laid_mm", "over_mm")
        )
        target = Target(np.array(header["origin_mm"]), float(header["step_mm"]), share)
        return LayerField(target, laid, over), int(header["layer"]), float(header["thickness_mm"])
    except (OSError, pa.ArrowException, KeyError, ValueError, TypeError) as error:
        raise InputError(f"{path}: is no field of metal: {error}; run the part again") from error

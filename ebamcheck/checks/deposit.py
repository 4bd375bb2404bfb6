"""The metal that a program's text lays, as a height field: layer by layer, and as the surface that is built up.

Every motion with beam and wire on counts, whatever a comment says of it. The wire's section, speed and the feed give its
metal; the pool, a half sphere as wide as the bead, spreads it (:mod:`ebamcheck.metal.footprints` plans by the same
physics, in other code). A place stays molten while the beam is within a bead width of it, and is levelled over that
distance; what is still too high or too low then is where the next layer begins.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
import pandas as pd
import shapely
from scipy import ndimage
from shapely.geometry.base import BaseGeometry

from ebamcheck.checks.bead_metal import bead_sections_mm2, wanted_region
from ebamcheck.checks.metal_field import LayerField
from ebamcheck.checks.metal_zones import NO_ZONES, deep_cells, zone_figures, zone_limit, zone_off
from ebamcheck.checks.narrow_features import NarrowFeature, narrow_features, thinnest_wall
from ebamcheck.geometry.nearest import distances, segments_of
from ebamcheck.geometry.regions import valid_polygons
from ebamcheck.layers.stack import Layers
from ebamcheck.metal import Surface, Target, bead_centres, target_of
from ebamcheck.metal.distances import border_distance
from ebamcheck.metal.surface import FILM, HALF
from ebamcheck.nc.motions import NCProgram
from ebamcheck.nc.roles import nearest_layer
from ebamcheck.numeric.rings import Bools, Floats, Ints
from ebamcheck.settings.config import Config
from ebamcheck.settings.process import ProcessSettings

STEP_SHARE = 1.0 / 12.0
"""Distance of the places at which metal is laid, over the bead width: half a cell."""


HOLE_COLUMNS = ("layer", "x_mm", "y_mm", "width_mm", "covered")
"""Columns of the holes that are closed."""

NO_SECTION = {
    "wanted_mm3": 0.0, **NO_ZONES,
    **{f"{name}_mm": 0.0 for name in ("low", "high", "reach")},
    **{f"{name}_{axis}_mm": math.nan for name in ("low", "high", "reach") for axis in "xy"},
}  # fmt: skip
"""Figures of a layer without a section."""

CLOSED = 0.5
"""Share of a hole's area under metal from which on it counts as closed: what is left is no hole that a tool finds."""

WIDTH_SHARE = 0.01
"""Of a cell: the error of the width of a hole that is told."""


@dataclass(frozen=True, eq=False)
class Deposit:
    """What the metal of a program comes to.

    Parameters
    ----------
    layers
        One row a layer: ``layer``, ``z_mm``, ``wanted_mm3``, ``laid_mm3``, ``outside_mm3`` (beside section and allowance),
        ``inside_mm2`` and ``edge_mm2`` (cells further than a bead width from the border, where they are a bead wide or more, and the
        others), ``inside`` and
        ``edge`` (mean height of the metal there over that of the layer; NaN without any), ``inside_settled`` and
        ``edge_settled`` (the same when the metal has levelled), ``zone_settled``, ``zone_mm2`` and ``zone_tolerance`` of the
        worst window (:mod:`ebamcheck.checks.metal_zones`), ``inside_owed`` ... ``zone_owed`` (the height that would make the
        surface right), ``low_mm`` and ``high_mm`` (the surface under its height where beads run or could, and over it
        anywhere, when the layer is done), ``reach_mm`` (how far from the section there is metal of
        :data:`~ebamcheck.metal.surface.FILM`), ``wall_mm`` (the thinnest wall under a bead, on layers with too much metal
        beside them; else NaN), and where these five are, ``zone_x_mm`` ... ``wall_y_mm``.
    first_row
        (L,) first motion of each layer that lays metal, -1 without one.
    holes
        Holes of sections of which metal covers more than :data:`CLOSED`: ``layer``, ``x_mm``, ``y_mm`` (middle of the widest
        place), ``width_mm`` (of the greatest disc that fits in) and ``covered`` (share of the area). What stands in a hole, such
        as a hub in a ring, is no part of it.
    fields
        Layers that were asked for, and the worst one, by their index.
    worst
        The layer of which surface, reach or a window comes nearest to its limit, or is furthest over it; -1 without any.
    surface
        What the program leaves; that of further layers begins on it.
    narrow
        Openings and walls of the part that are narrower than beads can build.
    """

    layers: pd.DataFrame
    first_row: Ints
    holes: pd.DataFrame
    fields: dict[int, LayerField]
    worst: int
    surface: Surface
    narrow: tuple[NarrowFeature, ...]


def deposit(
    nc: NCProgram,
    layers: Layers,
    z_of: Floats,
    config: Config,
    keep: Collection[int] = (),
    stands: Surface | None = None,
) -> Deposit:
    """Lay the metal of a program, layer by layer.

    Parameters
    ----------
    layers
        (L,) sections by a slicer, best by one that did not make the program.
    z_of
        (L,) Z of each in the program, mm.
    keep
        Layers whose fields are returned, too.
    stands
        Surface of what the lowest layer lies on; None: level.
    """
    process = config.process
    rows = np.flatnonzero(nc.deposit & nc.wire)
    index = nearest_layer(nc.end[rows, 2], z_of)
    thickness = np.diff(z_of, prepend=config.base_mm)
    of_part = [layers.section(k) for k in range(len(layers))]
    sections = [wanted_region(section, config) for section in of_part]
    some = [s for s in sections if not s.is_empty]
    bounds = np.asarray(shapely.total_bounds(some), np.float64) if some else np.zeros(4)
    field = _Field(stands.copy() if stands else Surface(bounds, process.bead_width_mm), process)
    bead_mm2 = np.nan_to_num(bead_sections_mm2(nc, config), posinf=0.0)
    found, holes, first = [], [], np.full(len(layers), -1, np.int64)
    fields: dict[int, LayerField] = {}
    worst, most = -1, -math.inf
    for k, section in enumerate(sections):
        mine = rows[index == k]
        if mine.size:
            first[k] = mine[0]
        places, volume, _ = metal_places(nc, mine, bead_mm2, process.bead_width_mm * STEP_SHARE)
        figures, laid = field.add(section, places, volume, float(thickness[k]))
        badness = over_limits(figures, process) if section.area > 0.0 else -math.inf
        if badness > most:
            if worst not in keep:
                fields.pop(worst, None)
            worst, most = k, badness
        if k in keep or k == worst:
            fields[k] = laid
        found.append({"layer": k, "z_mm": float(z_of[k]), **figures, **_wall(section, figures, process)})
        if figures["reach_mm"] > 0.0:
            holes += [{"layer": k, **hole} for hole in _closed_holes(section, laid, float(thickness[k]))]
    table = pd.DataFrame(holes, columns=list(HOLE_COLUMNS))
    narrow = tuple(narrow_features(of_part, config))
    return Deposit(pd.DataFrame(found), first, table, fields, worst, field.surface, narrow)


def _wall(section: BaseGeometry, figures: dict[str, float], process: ProcessSettings) -> dict[str, float]:
    """Thinnest wall under a bead of a layer with too much metal beside it, and where it is; else NaN."""
    beside = figures["outside_mm3"] > process.outside_share * figures["laid_mm3"]
    wall = None
    if beside or figures["reach_mm"] > process.outside_reach_mm:
        wall = thinnest_wall(section, process.bead_width_mm)
    if wall is None:
        return {"wall_mm": math.nan, "wall_x_mm": math.nan, "wall_y_mm": math.nan}
    return {"wall_mm": wall.width_mm, "wall_x_mm": wall.x_mm, "wall_y_mm": wall.y_mm}


def over_limits(figures: dict[str, float], process: ProcessSettings) -> float:
    """Surface, reach and worst window of a layer over their limits: the greatest of the three."""
    off = zone_off(figures["zone_settled"], figures["zone_owed"])
    zone = float(off / zone_limit(figures["zone_tolerance"], figures["zone_mm2"], process))
    return max(
        max(figures["low_mm"], figures["high_mm"]) / process.largest_unevenness_mm,
        figures["reach_mm"] / process.outside_reach_mm,
        0.0 if math.isnan(zone) else zone,
    )


def metal_places(nc: NCProgram, rows: Ints, bead_mm2: Floats, step_mm: float) -> tuple[Floats, Floats, Ints]:
    """Places (n, 2) at which motions lay metal, its volume (n,) mm3, and the motion of each."""
    row, places = nc.samples(rows, step_mm)
    pieces = np.bincount(row, minlength=len(nc))[row]
    return places, bead_mm2[row] * np.nan_to_num(nc.lengths[row]) / pieces, row


def pool_of(bead_width_mm: float, step_mm: float) -> Floats:
    """Shares in which the pool, a half sphere as wide as the bead, spreads metal over the cells around it; their sum is 1."""
    radius = 0.5 * bead_width_mm / step_mm
    offset = np.arange(-math.ceil(radius), math.ceil(radius) + 1)
    pool = np.sqrt(np.maximum(radius**2 - (offset[:, None] ** 2 + offset**2), 0.0))
    return np.asarray(pool / pool.sum(), np.float64)


class _Field:
    """Metal laid on the surface of a part, layer by layer."""

    def __init__(self, surface: Surface, process: ProcessSettings) -> None:
        self._process, bead_width_mm = process, process.bead_width_mm
        self.surface = surface
        self._bead_mm = bead_width_mm
        self._pool = pool_of(bead_width_mm, self.surface.step_mm)

    def add(
        self, section: BaseGeometry, places: Floats, volume: Floats, thickness_mm: float
    ) -> tuple[dict[str, float], LayerField]:
        """Lay one layer; its figures by name, and its metal."""
        step = self.surface.step_mm
        target = target_of(section, step, 2.0 * self._bead_mm)
        if not target.share.size:
            self.surface.add(target, target.share, thickness_mm)
            figures = {**NO_SECTION, "laid_mm3": float(volume.sum()), "outside_mm3": float(volume.sum())}
            return figures, LayerField(target, target.share, target.share)
        share, inside = target.share, target.share >= HALF
        melted = spread(target, places, volume) / step**2
        laid = ndimage.convolve(melted, self._pool, mode="constant")
        before = self.surface.over_mm(target)
        self.surface.add(target, laid, thickness_mm)
        deep = deep_cells(inside, self._bead_mm / step)
        rim = inside & ~deep
        film = ~inside & (laid >= FILM * thickness_mm)
        reach = _reaches_mm(film, inside, section, target)
        over = self.surface.over_mm(target)
        runs = (melted > 0.0) | bead_centres(inside, self._bead_mm / step)
        figures = {
            # Not by the cells, which plan and check have in common.
            "wanted_mm3": float(section.area) * thickness_mm,
            "laid_mm3": float(volume.sum()),
            # What falls beside all cells is outside, too.
            "outside_mm3": float(volume.sum() - (laid * share).sum() * step**2),
            **zone_figures(target, laid, before, (deep, rim), thickness_mm, self._process),
            # Too low matters where a bead runs or could; the tip of a wedge, which none reaches, stays bare.
            **_extreme("low", np.where(runs, -over, 0.0), target),
            **_extreme("high", over, target),
            **_extreme("reach", reach, target),
        }
        return figures, LayerField(target, laid, over)


def _reaches_mm(film: Bools, inside: Bools, section: BaseGeometry, target: Target) -> Floats:
    """Distance of the cells (rows, columns) of a film from the section, mm; 0 in all others."""
    reach, step = np.zeros(film.shape), target.step_mm
    if inside.any():
        # From the border of a cell to the middle of the next it is half a cell.
        reach[film] = (border_distance(~inside)[film] - 0.5) * step
    else:
        # A section thinner than a cell fills none to the half.
        row, column = np.nonzero(film)
        middles = target.origin + (np.column_stack([column, row]) + 0.5) * step
        reach[film] = distances(middles, segments_of(section.boundary))
    return reach


def _closed_holes(section: BaseGeometry, laid: LayerField, thickness_mm: float) -> list[dict[str, float]]:
    """Holes of a section that metal covers for the most part."""
    found, whole = [], laid.target
    metal = laid.laid_mm >= FILM * thickness_mm
    for hole in _holes(valid_polygons(section)):
        cells = target_of(hole, whole.step_mm, 0.0)
        column, row = np.round((cells.origin - whole.origin) / whole.step_mm).astype(np.int64)
        rows, columns = cells.share.shape
        covered = (cells.share * metal[row : row + rows, column : column + columns]).sum() / cells.share.sum()
        if covered > CLOSED:
            radius = shapely.maximum_inscribed_circle(hole, WIDTH_SHARE * whole.step_mm)
            x_mm, y_mm = radius.coords[0]
            values = (x_mm, y_mm, 2.0 * radius.length, float(covered))
            found.append(dict(zip(HOLE_COLUMNS[1:], values, strict=True)))
    return found


def _holes(parts: list[shapely.Polygon]) -> list[shapely.MultiPolygon]:
    """What is free of each hole of the parts of a section: without the parts that stand in it, whose own holes are theirs."""
    filled = np.array([shapely.Polygon(part.exterior) for part in parts], object)
    tree = shapely.STRtree(filled)
    holes = [shapely.Polygon(ring) for part in parts for ring in part.interiors]
    free = [hole.difference(shapely.union_all(filled[tree.query(hole, "contains")])) for hole in holes]
    return [shapely.MultiPolygon(left) for left in map(valid_polygons, free) if left]


def spread(target: Target, places: Floats, volume: Floats) -> Floats:
    """Volume by cell, shared between the four cells around each place; what lies beside the grid is left out."""
    rows, columns = target.share.shape
    at = (places - target.origin) / target.step_mm - 0.5
    corner = np.floor(at).astype(np.int64)
    part = at - corner
    result = np.zeros(rows * columns)
    for right in (0, 1):
        for up in (0, 1):
            column, row = corner[:, 0] + right, corner[:, 1] + up
            weight = volume * np.abs(1 - right - part[:, 0]) * np.abs(1 - up - part[:, 1])
            held = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
            result += np.bincount((row * columns + column)[held], weight[held], minlength=result.size)
    return result.reshape(rows, columns)


def _extreme(name: str, height: Floats, target: Target) -> dict[str, float]:
    """Greatest value of a field, mm, and where it is."""
    if not height.size:
        return {f"{name}_mm": 0.0, f"{name}_x_mm": math.nan, f"{name}_y_mm": math.nan}
    row, column = np.unravel_index(int(np.argmax(height)), height.shape)
    x, y = target.origin + (np.array([column, row]) + 0.5) * target.step_mm
    return {
        f"{name}_mm": max(float(height[row, column]), 0.0),
        f"{name}_x_mm": float(x),
        f"{name}_y_mm": float(y),
    }

"""One layer before its islands are put in order: section -> regions -> islands -> lines."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from ebamcheck.geometry.raster import each_of
from ebamcheck.heat.island_heat import IslandHeat
from ebamcheck.heat.part_heat import Beads, uneven
from ebamcheck.kernels import Floats, Ints
from ebamcheck.scan.filling.fill import FilledLayer, fill_layer
from ebamcheck.scan.filling.hatch import Vectors
from ebamcheck.scan.filling.schedule import follows, island_schedule, turns_and_jumps_mm
from ebamcheck.scan.islands import clipping as cells
from ebamcheck.scan.islands.clipping import shared_borders
from ebamcheck.scan.islands.lattice import LATTICES, layer_place, planned_side_mm
from ebamcheck.scan.islands.regions import Regions, layer_regions
from ebamcheck.scan.order.entries import in_sequence
from ebamcheck.scan.order.orders import LayerIslands
from ebamcheck.settings.config import Config
from ebamcheck.settings.process import ProcessSettings


@dataclass(frozen=True, eq=False, kw_only=True)
class LaidLayer(FilledLayer):
    """One layer before its islands, numbered from 0, are put in order; columns of a plan of it in :class:`ScanPlan`."""

    layer: int
    height_mm: float
    side_mm: float
    regions: Regions
    centroid: Floats
    neighbours: Ints
    border_mm: Floats

    def driven(self, order: Ints, options: Ints) -> Vectors:
        """Lines of islands in an order, each entered by its option, see :func:`~ebamcheck.scan.order.entries.in_sequence`."""
        lines, count = self.lines, len(self.islands)
        first = np.concatenate([[0], np.cumsum(np.bincount(lines.island, minlength=count))]).astype(np.int64)
        rows, turned = in_sequence(lines.start, lines.end, first, order, self.chained, options)
        a, b, swap = lines.start[rows], lines.end[rows], turned[:, None]
        return Vectors(lines.island[rows], np.where(swap, b, a), np.where(swap, a, b))

    def choices(self, config: Config, seed: int, plate_mm: float = 0.0) -> LayerIslands:
        """What an order may know of the layer; `plate_mm` is the height of the base plate."""
        return LayerIslands(
            centroid=self.centroid,
            area_mm2=np.asarray(shapely.area(self.islands), np.float64),
            neighbours=self.neighbours,
            layer=self.layer,
            seed=seed,
            config=config,
            height_mm=self.height_mm - plate_mm,
            section=self.regions.section,
            polygons=self.islands,
            schedule=island_schedule(self.lines, self.chained, config),
            lines=self.lines,
        )


def lay_islands(
    section: BaseGeometry, config: Config, layer: int, height_mm: float, contour: BaseGeometry | None = None
) -> LaidLayer:
    """Divide one valid section into islands and fill them; `contour` as of :func:`layer_regions`."""
    regions, process = layer_regions(section, config, contour), config.process
    solids, side_mm = regions.solids, math.nan
    if solids:
        # The side of the hexagons that is set, else planned from the solids.
        area, border = float(shapely.area(solids).sum()), float(shapely.length(solids).sum())
        side_mm = config.scan.hexagon_side_mm or planned_side_mm(area, border, process.hatch_spacing_mm)
    if config.scan.partition == "whole" or not solids:
        divided = cells.undivided(solids)
    else:
        place = layer_place(shapely.get_coordinates(section), side_mm, config, layer)
        lattice = LATTICES[config.scan.partition](place, side_mm)
        divided = cells.partition(solids, lattice, process.bead_width_mm, process.hatch_spacing_mm)
    filled = fill_layer(regions, divided, config, layer)
    neighbours, border_mm = shared_borders(filled.islands)
    return LaidLayer(
        **vars(filled),
        layer=layer,
        height_mm=height_mm,
        side_mm=side_mm,
        regions=regions,
        centroid=shapely.get_coordinates(shapely.centroid(filled.islands)),
        neighbours=neighbours,
        border_mm=border_mm,
    )


# A move with the beam off of at most this many bead spacings stays at the layer's height; a longer one rises, as the program has it
NEAR_SPACINGS = 2.0


@dataclass(frozen=True, eq=False)
class ContourBeads:
    """The contour beads of a layer, which no order of its islands changes."""

    rings: list[shapely.LinearRing]  # (R,) centre lines from their least points on, in the canonical sequence
    pieces: Floats  # (K, P) modes in the middles of their pieces, less their means over the section
    count: Ints  # (R,) pieces of each
    length_mm: Floats  # (R,) lengths with what overlaps the start
    apart_mm: Floats  # (R - 1,) shortest ways from each to the next


def contour_beads(laid: LaidLayer, config: Config, heat: IslandHeat | None) -> ContourBeads:
    """Put the contours of a layer in sequence; `heat` as for :func:`bead_sequence`."""
    rings = []
    for ring in shapely.get_rings(shapely.get_parts(laid.regions.contour)):
        points = shapely.get_coordinates(ring)[:-1]
        least = int(np.lexsort((points[:, 1], points[:, 0]))[0])
        rings.append(shapely.LinearRing(np.roll(points, -least, axis=0)))
    rings.sort(key=lambda ring: ring.coords[0])
    # Pieces as long as a bead is wide: no mode changes within less.
    ring_mm = np.array([ring.length for ring in rings])
    count = np.maximum(1, np.rint(ring_mm / config.process.bead_width_mm)).astype(np.int64)
    ring_mm += np.minimum(config.process.overlap_mm, ring_mm)
    apart_mm = shapely.distance(np.array(rings[:-1], object), np.array(rings[1:], object))
    pieces = np.zeros((0 if heat is None else len(heat.modes.plane_rate), int(count.sum())))
    if heat is not None and rings:
        line, number = each_of(count)
        share = (number + 0.5) / count[line]
        middles = shapely.line_interpolate_point(np.array(rings, object)[line], share, normalized=True)
        pieces = uneven(heat.model.plane.at(shapely.get_coordinates(middles)).T, heat.model)
    return ContourBeads(rings, pieces, count, ring_mm, np.asarray(apart_mm, np.float64))


def bead_sequence(
    laid: LaidLayer,
    contours: ContourBeads,
    config: Config,
    heat: IslandHeat | None,
    order: Ints,
    options: Ints,
) -> tuple[Beads, float]:
    """Contours, and islands in an order, in the sequence in which the program drives them; and the jumps between islands, mm.

    `heat` is the model of the islands, in whose modes the beads are read; None where there are none. Without an `order` the
    contours alone are taken."""
    speed, rapid = config.process.travel_speed_mm_s, config.machine.rapid_mm_s
    count, ring_mm, rings = contours.count, contours.length_mm, len(contours.rings)
    island, start, end, bead_mm = _island_path(laid, order, options, config)
    columns, times = [contours.pieces], [np.repeat(ring_mm / speed / np.maximum(count, 1), count)]
    shares = [np.repeat(mean_power(ring_mm, config.process), count)]
    if heat is not None and len(order):
        columns.append(uneven(heat.modes.mean[:, island], heat.model))
        times.append(bead_mm / speed)
        shares.append(mean_power(bead_mm, config.process))
    # The shortest ways to each contour, from the last one to the first island, and between islands; to the first bead none is known.
    last = contours.rings[-1:] if len(start) else []
    to_island_mm = [shapely.distance(ring, shapely.Point(start[0])) for ring in last]
    none_known = np.zeros(min(1, rings + len(start)))
    between_mm = np.hypot(*(start[1:] - end[:-1]).T)
    move_mm = np.concatenate([none_known, contours.apart_mm, np.array(to_island_mm, np.float64), between_mm])
    up_and_down_mm = 2.0 * config.machine.safe_height_mm
    far = move_mm > NEAR_SPACINGS * config.process.hatch_spacing_mm
    far[:1] = True
    rises = np.where(far, up_and_down_mm, 0.0)
    inner = np.zeros(len(move_mm), np.bool_)
    inner[rings:] = np.diff(island, prepend=-1) == 0
    beads = Beads(
        pieces=np.ascontiguousarray(np.concatenate(columns, axis=1)),
        first=np.concatenate([[0], np.cumsum(np.concatenate([count, np.ones_like(island)]))]),
        move_s=(move_mm + rises) / rapid,
        rise_s=(up_and_down_mm - rises) / rapid,
        time_s=np.concatenate(times),
        on=np.concatenate(shares),
        rings=rings,
        islands=island,
        inner=inner,
    )
    between = np.flatnonzero(~inner[rings:])[1:] + rings
    return beads, float(move_mm[between].sum())


def mean_power(bead_mm: Floats, process: ProcessSettings) -> Floats:
    """Mean power of beads (n,) over the full one: on a ramp it is half-way between its ends, see `process.ramp_up_mm`.

    >>> mean_power(np.array([20.0, 5.0]), ProcessSettings(ramp_up_mm=6.0, crater_fill_mm=4.0, ramp_power=0.5))
    array([0.875, 0.75 ])
    """
    ramps_mm = process.ramp_up_mm + process.crater_fill_mm
    ramped = np.minimum(ramps_mm / np.maximum(bead_mm, np.finfo(float).tiny), 1.0)
    return np.asarray(1.0 - 0.5 * (1.0 - process.ramp_power) * ramped, np.float64)


def _island_path(laid: LaidLayer, order: Ints, options: Ints, config: Config) -> tuple[Ints, Floats, Floats, Floats]:
    """Beads of islands in sequence (n,): island, where each starts and ends, and its length with the turns in it, mm."""
    if not len(order):
        return np.zeros(0, np.int64), np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0)
    lines, spacing = laid.driven(order, options), config.process.hatch_spacing_mm
    island, a, b = lines.island, lines.start, lines.end
    turn, _ = turns_and_jumps_mm(island, a, b, spacing)
    begins = np.flatnonzero(~follows(island, a, b, spacing))
    ends = np.append(begins[1:], len(island)) - 1
    bead_mm = np.add.reduceat(np.hypot(*(b - a).T) + turn, begins)
    return island[begins], a[begins], b[ends], bead_mm

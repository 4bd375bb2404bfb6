"""Wire for each bead: the widths by which a layer gets its height everywhere.

A *width*, mm, is the metal of a bead in section over the height of the layer: one spacing for parallel beads, more along a contour,
whose bead lays the rim, less where beads overlap. A hatch bead has one width; a contour changes it along itself where walls get
thin."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from ebamcheck.geometry.regions import ARC_SEGMENTS
from ebamcheck.heat.medium import width_limits_mm
from ebamcheck.kernels import Bools, Floats, Ints
from ebamcheck.metal import Footprints, Surface, Target, balanced_widths, footprints, target_of
from ebamcheck.metal.footprints import pooled
from ebamcheck.metal.surface import HALF
from ebamcheck.metal.target import border_distance
from ebamcheck.nc.inputs import ScanColumns, interpass_of
from ebamcheck.scan.islands.clipping import THIN_WALL
from ebamcheck.settings.config import Config
from ebamcheck.threads import run_each
from ebamcheck.writing.bead_parts import ROUNDING_MM, Parts, Stretches, Tracks, cut, parts_of, snapped
from ebamcheck.writing.segments import segment_places
from ebamcheck.writing.tracks import Toolpath

# Length of contour, in bead widths, over which its wire is worked out: shorter ones would follow single hatch lines.
STRETCH_BEADS = 1.0
# Neighbouring stretches of a contour whose widths differ by less than this factor get one wire speed: the ends of hatch lines beside it
# make as much of a difference, and a wall half as thick makes more. On a surface that was measured, beads follow it more closely.
ALIKE, ALIKE_MAPPED = 1.15, 1.05
MOST_MENDED = 0.2  # Share of its height by which a layer is planned thicker or thinner for that at most
# Width of the rim, over the bead width, and how much it counts: a bead is a dome, whose flank is low whatever wire it gets.
RIM_BEADS, RIM_WEIGHT = 0.25, 0.4
# Distance, over the bead width, of the places along beads at which their metal is laid, and of those by which the surface that a layer
# leaves is worked out: at the tips of corners half a cell decides whether they are bare.
PLACE_SHARE, POOL_SHARE = 1.0 / 6.0, 1.0 / 12.0
WIDTH_DIGITS = 4  # Decimals of a width, mm: a hundred-thousandth of the metal


def metal_region(section: BaseGeometry, config: Config) -> BaseGeometry:
    """Region that a layer is to fill: its section, and the allowance for machining around it."""
    allowance_mm = config.process.machining_allowance_mm
    return shapely.buffer(section, allowance_mm, quad_segs=ARC_SEGMENTS) if allowance_mm > 0.0 else section


def with_wire(path: Toolpath, plan: ScanColumns, config: Config, decimals: int) -> Toolpath:
    """Give every bead of a path its width; where the plan does not know its sections, all keep theirs."""
    if plan.sections is None or not path.kind.size:
        return path
    stands: Surface | None = getattr(plan, "stands", None)
    surface = bare_surface(plan.sections, config) if stands is None else stands.copy()
    return cut(path, wired(path, plan, config, surface), decimals)


def wired(path: Toolpath, plan: ScanColumns, config: Config, surface: Surface) -> Parts:
    """Parts of the segments of a path, each of one width; `surface` is what the layers lie on, and they are laid on it."""
    tracks = Tracks.of(path)
    # On a surface that was measured the wire of every bead follows it; else hatch beads have one wire each, and those along walls change it.
    wall = np.append(np.asarray(plan.island_kind) == THIN_WALL, False)
    divided = np.asarray(surface.mapped | (path.ring >= 0) | wall[path.island], np.bool_)
    whole = config.machine.curve_form == "bspline" and not config.machine.poly_licensed
    stretch_mm = math.inf if whole else STRETCH_BEADS * config.process.bead_width_mm
    division = _Division.of(tracks, divided, stretch_mm)
    assert plan.sections is not None
    regions = [metal_region(section, config) for section in plan.sections]

    def laid_out(k: int) -> _LayerBeads:
        return _layer_beads(path, k, tracks, division, regions[k], surface.step_mm, config)

    shares, made = interpass_of(plan, config).power_share, list[Stretches]()
    for beads, h, share in zip(run_each(laid_out, range(len(path.z))), path.thickness, shares, strict=True):
        made.append(_flat(beads, surface, division, tracks, float(h), config, float(share)))
    columns = ([getattr(s, name) for s in made] for name in ("track", "low", "high", "lap", "width"))
    track, low, high, lap, width = (np.concatenate(column) for column in columns)
    return parts_of(path, tracks, Stretches(track, low, high, lap, width=width))


def bare_surface(sections: Iterable[BaseGeometry], config: Config) -> Surface:
    """Surface over the metal of all layers, of which none is laid yet."""
    regions = [metal_region(section, config) for section in sections]
    return Surface(np.nan_to_num(shapely.total_bounds(regions)), config.process.bead_width_mm)


def _flat(
    beads: _LayerBeads, surface: Surface, division: _Division, tracks: Tracks, thickness_mm: float, config: Config,
    power_share: float,
) -> Stretches:  # fmt: skip
    """Stretches of one layer with the widths that lay it flat, and mend a little of what lies too high or low under it."""
    target, cell_mm2 = beads.target, surface.step_mm**2
    nominal = np.full(beads.every.size, config.process.hatch_spacing_mm)
    if not (target.share.size and beads.every.size):
        surface.add(target, target.share, thickness_mm)
        return division.stretches(tracks, beads.every, beads.every, nominal)
    wanted, weight = _wanted(target, surface, thickness_mm, config)
    limits = width_limits_mm(config, thickness_mm, power_share)
    width = balanced_widths(beads.footprints, wanted, weight, cell_mm2, nominal, limits)
    alike = ALIKE_MAPPED if surface.mapped else ALIKE
    first = np.flatnonzero(runs_alike(division.track(beads.every), width, alike))
    runs = beads.footprints.joined(first)
    width = np.add.reduceat(width, first) / np.diff(np.append(first, width.size))
    width = balanced_widths(runs, wanted, weight, cell_mm2, width, limits)
    width = rounded_widths(width, limits)
    of_place = width[np.searchsorted(first, beads.stretch, side="right") - 1]
    radius = 0.5 * config.process.bead_width_mm / surface.step_mm
    laid = pooled(beads.cells, of_place * beads.length_mm, radius, wanted.shape, cell_mm2)
    surface.add(target, laid * thickness_mm, thickness_mm)
    last = np.append(first[1:], beads.every.size) - 1
    return division.stretches(tracks, beads.every[first], beads.every[last], width)


def rounded_widths(width: Floats, limits: tuple[float, float]) -> Floats:
    """Widths of so many decimals, none of which is rounded over a limit."""
    unit = 10.0**WIDTH_DIGITS
    least, most = math.ceil(limits[0] * unit) / unit, math.floor(limits[1] * unit) / unit
    return np.asarray(np.clip(np.round(width, WIDTH_DIGITS), least, max(least, most)), np.float64)


def _wanted(target: Target, surface: Surface, thickness_mm: float, config: Config) -> tuple[Floats, Floats]:
    """Metal that each cell of a layer is to get, layers high, and how much the cell counts."""
    over = surface.mended * surface.over_mm(target) / thickness_mm
    wanted = target.share * np.clip(1.0 - over, 1.0 - MOST_MENDED, 1.0 + MOST_MENDED)
    # Metal is moved; in all, the layer gets as much more or less as its tolerance leaves room for.
    # Tips of corners that no bead reaches stay bare: their metal would raise the rest.
    most = 0.9 * config.process.mass_tolerance
    mean = float(np.average(over, weights=target.share))
    wanted *= target.share.sum() * min(max(1.0 - mean, 1.0 - most), 1.0 + most) / wanted.sum()
    depth_mm = border_distance(target.share > HALF) * surface.step_mm
    rim = (target.share > 0.0) & (depth_mm <= RIM_BEADS * config.process.bead_width_mm)
    return wanted, np.where(rim, RIM_WEIGHT, 1.0)


@dataclass(frozen=True, eq=False)
class _Division:
    """Division of all tracks into stretches (S,), in order: contours and wall beads are divided evenly, others are one."""

    starts: Ints  # (T + 1,) first stretch of each track
    length: Floats  # (T,) mm of a stretch of each track

    @classmethod
    def of(cls, tracks: Tracks, divided: Bools, stretch_mm: float) -> _Division:
        """Divide some tracks (T,) into stretches of about a length."""
        count = np.where(divided, np.maximum(np.round(tracks.length / stretch_mm), 1.0), 1.0).astype(np.int64)
        return cls(np.concatenate([[0], np.cumsum(count)]), tracks.length / count)

    def at(self, track: Ints, along_mm: Floats) -> Ints:
        """Stretch of places along tracks, (n,)."""
        length = np.maximum(self.length[track], np.finfo(float).tiny)
        count = np.diff(self.starts)[track]
        return self.starts[track] + np.clip(along_mm / length, 0, count - 1).astype(np.int64)

    def track(self, stretch: Ints) -> Ints:
        """Track of stretches, (n,)."""
        return np.asarray(np.searchsorted(self.starts, stretch, side="right") - 1)

    def stretches(self, tracks: Tracks, first: Ints, last: Ints, width: Floats) -> Stretches:
        """What reaches from one stretch to another of the same track, each of one width."""
        track = self.track(first)
        number = np.stack([first, last + 1]) - self.starts[track]
        along = np.minimum(number * self.length[track], tracks.length[track])
        low, high = (tracks.low[track] + snapped(tracks, track, at) for at in along)
        kept = high - low > ROUNDING_MM
        lap = np.zeros(int(kept.sum()), np.int64)
        return Stretches(track[kept], low[kept], high[kept], lap, width=width[kept])


def runs_alike(track: Ints, width: Floats, factor: float) -> Bools:
    """Mark the first stretch of each run within which no two widths differ by more than a factor."""
    first = np.zeros(len(track), np.bool_)
    last, low, high = -1, 0.0, 0.0
    for n, (of, mm) in enumerate(zip(track.tolist(), width.tolist(), strict=True)):
        low, high = min(low, mm), max(high, mm)
        if of != last or high > factor * low:
            first[n] = True
            last, low, high = of, mm, mm
    return first


@dataclass(frozen=True, eq=False)
class _LayerBeads:
    """What one layer is to be, and where the metal of its stretches lies."""

    target: Target
    every: Ints  # (n,) stretches
    footprints: Footprints  # of each bead
    cells: Floats  # (m, 2) places along the beads, in cells of the target
    length_mm: Floats  # (m,) of path that each place stands for
    stretch: Ints  # (m,) its number among all


def _layer_beads(
    path: Toolpath, layer: int, tracks: Tracks, division: _Division, region: BaseGeometry, step_mm: float,
    config: Config,
) -> _LayerBeads:  # fmt: skip
    """Lay out the stretches of one layer over its region."""
    bead_mm = config.process.bead_width_mm
    a, b = int(path.layer_starts[layer]), int(path.layer_starts[layer + 1])
    target = target_of(region, step_mm, bead_mm)
    rows = slice(int(path.track_starts[a]), int(path.track_starts[b]))
    own = np.repeat(np.arange(a, b), np.diff(path.track_starts[a : b + 1]))
    points, lengths = path.points[rows], path.lengths[rows]

    def places(step: float) -> tuple[Floats, Floats, Ints]:
        """Places along the beads, in cells of the target, the length that each stands for, and its stretch."""
        owner, along, place, length = segment_places(path.kind[rows], points, lengths, step)
        track = own[owner]
        begin = (tracks.ends[rows] - lengths)[owner] - tracks.low[track]
        stretch = division.at(track, begin + along) - division.starts[a]
        return (place - target.origin) / step_mm, length, stretch

    every = np.arange(division.starts[a], division.starts[b])
    radius = 0.5 * bead_mm / step_mm
    by_bead = footprints(*places(bead_mm * PLACE_SHARE), every.size, radius, target.share.shape)
    return _LayerBeads(target, every, by_bead, *places(bead_mm * POOL_SHARE))

"""Wire for each bead: the widths by which a layer gets its height everywhere.

What a bead lays is told by a *width*, mm: its metal in section over the height of the layer. Parallel beads one spacing
apart lay one spacing each; the bead along a contour lays the rim outside of it, too; a bead that another one overlaps
lays less. A hatch bead has one width from its start to its end, a contour changes it along itself where walls get thin.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
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
from ebamcheck.writing.cuts import segment_places
from ebamcheck.writing.tracks import Toolpath

# Length of contour, in bead widths, over which its wire is worked out: shorter ones would follow single hatch lines.
STRETCH_BEADS = 1.0
# Neighbouring stretches of a contour whose widths differ by less than this factor get one wire speed: the ends of hatch lines beside it
# make as much of a difference, every change is a block, and a wall half as thick makes more.
ALIKE = 1.15
# The same of all beads on a surface that was measured: what is known is followed more closely.
ALIKE_MAPPED = 1.05
MOST_MENDED = 0.2  # Share of its height by which a layer is planned thicker or thinner for that at most
# Width of the rim, over the bead width, and how much it counts where wire is worked out: a bead is a dome, whose flank along a contour is
# low whatever wire it gets.
RIM_BEADS, RIM_WEIGHT = 0.25, 0.4
# Share of the tolerance on the mass of a layer that mending may use: tips of corners that no bead reaches stay bare, and their metal
# would raise the rest, layer by layer.
MASS_ROOM = 0.9
# Distance, over the bead width, of the places along beads at which their metal is laid.
PLACE_SHARE = 1.0 / 6.0
# The same where the surface that a layer leaves is worked out: at the tips of corners half a cell decides whether they are bare.
POOL_SHARE = 1.0 / 12.0
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
    """Parts of the segments of a path, each of one width; `surface` is what the layers lie on, and they are laid on it.

    The plan knows its sections.
    """
    tracks = Tracks.of(path)
    whole = config.machine.curve_form == "bspline" and not config.machine.poly_licensed
    # On a surface that was measured the wire of every bead follows it; else hatch beads have one wire each.
    divided = np.ones(tracks.low.size, np.bool_) if surface.mapped else _along_walls(path, plan)
    division = _Division.of(
        tracks, divided, math.inf if whole else STRETCH_BEADS * config.process.bead_width_mm
    )
    sections: Sequence[BaseGeometry] = () if plan.sections is None else list(plan.sections)
    regions = [metal_region(section, config) for section in sections]

    found = run_each(
        lambda k: _layer_beads(path, k, tracks, division, regions[k], surface.step_mm, config),
        range(len(path.z)),
    )
    made = [
        _flat(beads, surface, division, tracks, float(h), config, float(share))
        for beads, h, share in zip(found, path.thickness, interpass_of(plan, config).power_share, strict=True)
    ]
    return parts_of(path, tracks, joined(made))


def bare_surface(sections: Iterable[BaseGeometry], config: Config) -> Surface:
    """Surface over the metal of all layers, of which none is laid yet."""
    regions = [metal_region(section, config) for section in sections]
    return Surface(np.nan_to_num(shapely.total_bounds(regions)), config.process.bead_width_mm)


def _along_walls(path: Toolpath, plan: ScanColumns) -> Bools:
    """Tracks (T,) along walls, whose metal changes with the wall: contours, and the beads of thin walls."""
    wall = np.asarray(plan.island_kind) == THIN_WALL
    return np.asarray((path.ring >= 0) | (wall[path.island] if wall.size else False), np.bool_)


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
    most = MASS_ROOM * config.process.mass_tolerance
    mean = float(np.average(over, weights=target.share))
    wanted *= target.share.sum() * min(max(1.0 - mean, 1.0 - most), 1.0 + most) / wanted.sum()
    depth_mm = border_distance(target.share > HALF) * surface.step_mm
    rim = (target.share > 0.0) & (depth_mm <= RIM_BEADS * config.process.bead_width_mm)
    return wanted, np.where(rim, RIM_WEIGHT, 1.0)


class _Division:
    """Division of all tracks into stretches (S,), in order: contours and wall beads are divided evenly, others are one."""

    def __init__(self, starts: Ints, length: Floats) -> None:
        self.starts = starts
        """(T + 1,) first stretch of each track."""
        self.length = length
        """(T,) mm of a stretch of each track."""

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
    """What one layer is to be, its stretches `every` (n,), and where their metal lies: by bead, and place by place.

    `cells` (m, 2) are places along the beads in cells of the target, `length_mm` (m,) of path that each stands for, `stretch` (m,) its
    number among `every`.
    """

    target: Target
    every: Ints
    footprints: Footprints
    cells: Floats
    length_mm: Floats
    stretch: Ints


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


def joined(layers: Sequence[Stretches]) -> Stretches:
    """Stretches of all layers, one behind the other."""
    track, low, high, lap = (
        np.concatenate([getattr(s, name) for s in layers]) for name in ("track", "low", "high", "lap")
    )
    width = np.concatenate([s.width for s in layers if s.width is not None])
    return Stretches(track, low, high, lap, width=width)

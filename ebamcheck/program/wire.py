"""The wire of each bead: as much as makes the layer as high as it is to be, everywhere.

What a bead lays is told by a *width*, mm: its metal in section over the height of the layer. Parallel beads one spacing
apart lay one spacing each; the bead along a contour lays the rim outside of it, too; a bead that another one overlaps
lays less. A hatch bead has one width from its start to its end, a contour changes it along itself where walls get thin.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from ebamcheck.config import Config
from ebamcheck.kernels import kernel, run_blocks
from ebamcheck.metal import balanced_widths, footprints, target_of
from ebamcheck.metal.target import cell_mm
from ebamcheck.program.bead_parts import ROUNDING_MM, Stretches, Tracks, cut, parts_of, path_points, snapped
from ebamcheck.program.cuts import segment_lengths, segment_places
from ebamcheck.program.inputs import ScanColumns
from ebamcheck.program.templates import wire_speed_mm_s
from ebamcheck.program.toolpath import Toolpath
from ebamcheck.rings import Bools, Floats, Ints
from ebamcheck.scan.regions import ARC_SEGMENTS

STRETCH_BEADS = 2.0
"""Length of contour, in bead widths, over which its wire is worked out: shorter ones would follow single hatch lines."""

ALIKE = 1.3
"""Neighbouring stretches of a contour whose widths differ by less than this factor get one wire speed: the ends of hatch
lines beside it make as much of a difference, every change is a block, and a wall half as thick makes more."""

MOST_SPACINGS = 1.6
"""Greatest width over the bead spacing: a bead stands that much higher over the layer than its neighbours, which the
next layer still melts."""

PLACE_SHARE = 1.0 / 6.0
"""Distance, over the bead width, of the places along beads at which their metal is laid."""

WIDTH_DIGITS = 4
"""Decimals of a width, mm: a hundred-thousandth of the metal."""


def width_limits_mm(config: Config, thickness_mm: float) -> tuple[float, float]:
    """Least and greatest width that a bead can lay in a layer of this height: limits of the wire feed and of the pool."""
    process = config.process
    per_mm = wire_speed_mm_s(config, 1.0, thickness_mm)
    most = min(process.wire_speed_max_mm_s / per_mm, MOST_SPACINGS * process.hatch_spacing_mm)
    return process.wire_speed_min_mm_s / per_mm, most


def metal_region(section: BaseGeometry, config: Config) -> BaseGeometry:
    """Region that a layer is to fill: its section, and the allowance for machining around it."""
    allowance_mm = config.process.machining_allowance_mm
    return shapely.buffer(section, allowance_mm, quad_segs=ARC_SEGMENTS) if allowance_mm > 0.0 else section


def with_wire(path: Toolpath, plan: ScanColumns, config: Config, decimals: int) -> Toolpath:
    """Give every bead of a path its width; where the plan does not know its sections, all keep theirs."""
    sections = plan.sections
    if sections is None or not path.kind.size:
        return path
    points = path_points(path)
    lengths = segment_lengths(path.kind, points)
    tracks = Tracks.of(path, lengths)
    whole = config.machine.curve_form == "bspline" and not config.machine.poly_licensed
    division = _Division.of(path, tracks, math.inf if whole else STRETCH_BEADS * config.process.bead_width_mm)
    bounds = np.nan_to_num(shapely.total_bounds([metal_region(section, config) for section in sections]))
    step_mm = cell_mm(bounds, config.process.bead_width_mm)

    def some(first: int, last: int) -> list[Stretches]:
        return [
            _layer_stretches(path, k, points, lengths, tracks, division, sections[k], step_mm, config)
            for k in range(first, last)
        ]

    found = [layer for block in run_blocks(some, len(path.z)) for layer in block]
    return cut(path, points, lengths, parts_of(path, tracks, joined(found)), decimals)


class _Division:
    """Division of all tracks into stretches (S,), in order: a hatch track is one, a contour is divided evenly."""

    def __init__(self, starts: Ints, length: Floats) -> None:
        self.starts = starts
        """(T + 1,) first stretch of each track."""
        self.length = length
        """(T,) mm of a stretch of each track."""

    @classmethod
    def of(cls, path: Toolpath, tracks: Tracks, stretch_mm: float) -> _Division:
        """Divide the contours into stretches of about a length."""
        count = np.where(path.ring >= 0, np.maximum(np.round(tracks.length / stretch_mm), 1.0), 1.0).astype(
            np.int64
        )
        return cls(np.concatenate([[0], np.cumsum(count)]), tracks.length / count)

    def at(self, track: Ints, along_mm: Floats) -> Ints:
        """Stretch of places along tracks, (n,)."""
        length = np.maximum(self.length[track], np.finfo(float).tiny)
        count = np.diff(self.starts)[track]
        return self.starts[track] + np.clip(along_mm / length, 0, count - 1).astype(np.int64)

    def spans(self, tracks: Tracks, first: Ints, last: Ints) -> tuple[Ints, Floats, Floats]:
        """Track (n,) and ends (n,) mm along the stack of what reaches from one stretch to another of the same track."""
        track = np.searchsorted(self.starts, first, side="right") - 1
        number = np.stack([first, last + 1]) - self.starts[track]
        along = np.minimum(number * self.length[track], tracks.length[track])
        low, high = (tracks.low[track] + snapped(tracks, track, at) for at in along)
        return track, low, high


@kernel
def runs_alike(track: Ints, width: Floats, factor: float) -> Bools:
    """Mark the first stretch of each run within which no two widths differ by more than a factor."""
    first = np.zeros(len(track), np.bool_)
    low = high = 0.0
    for n in range(len(track)):
        new = n == 0 or track[n] != track[n - 1]
        if not new:
            low, high = min(low, width[n]), max(high, width[n])
            new = high > factor * low
        if new:
            first[n] = True
            low = high = width[n]
    return first


def _layer_stretches(
    path: Toolpath,
    layer: int,
    points: Floats,
    lengths: Floats,
    tracks: Tracks,
    division: _Division,
    section: BaseGeometry,
    step_mm: float,
    config: Config,
) -> Stretches:
    """Stretches of one layer with the widths that lay it flat: first of all, then of those that share one."""
    bead_mm = config.process.bead_width_mm
    a, b = int(path.layer_starts[layer]), int(path.layer_starts[layer + 1])
    target = target_of(metal_region(section, config), step_mm, bead_mm)
    rows = slice(int(path.track_starts[a]), int(path.track_starts[b]))
    owner, along, place, length = segment_places(
        path.kind[rows], points[rows], lengths[rows], bead_mm * PLACE_SHARE
    )
    track = np.repeat(np.arange(a, b), np.diff(path.track_starts[a : b + 1]))[owner]
    begin = (tracks.ends[rows] - lengths[rows])[owner] - tracks.low[track]
    stretch = division.at(track, begin + along)
    limits = width_limits_mm(config, float(path.thickness[layer]))

    def balanced(bead: Ints, width: Floats) -> Floats:
        if not (target.share.size and width.size):
            return width
        cells = (place - target.origin) / step_mm
        found = footprints(cells, length, bead, width.size, 0.5 * bead_mm / step_mm, target.share.shape)
        return balanced_widths(found, target.share, step_mm**2, width, *limits)

    every = np.arange(division.starts[a], division.starts[b])
    nominal = np.full(every.size, config.process.hatch_spacing_mm)
    owner_of = np.searchsorted(division.starts, every, side="right") - 1
    new = runs_alike(owner_of, balanced(stretch - division.starts[a], nominal), ALIKE)
    run, first = np.cumsum(new) - 1, every[new]
    width = balanced(run[stretch - division.starts[a]], nominal[: first.size])
    number, low, high = division.spans(
        tracks, first, np.append(first[1:], division.starts[b])[: first.size] - 1
    )
    kept = high - low > ROUNDING_MM
    lap, width = (
        np.zeros(int(kept.sum()), np.int64),
        np.asarray(np.round(width[kept], WIDTH_DIGITS), np.float64),
    )
    return Stretches(number[kept], low[kept], high[kept], lap, width=width)


def joined(layers: Sequence[Stretches]) -> Stretches:
    """Stretches of all layers, one behind the other."""
    return Stretches(
        np.concatenate([s.track for s in layers]),
        np.concatenate([s.low for s in layers]),
        np.concatenate([s.high for s in layers]),
        np.concatenate([s.lap for s in layers]),
        width=np.concatenate([s.width for s in layers if s.width is not None]),
    )

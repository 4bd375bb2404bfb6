"""The wire of each bead: as much as makes the layer as high as it is to be, everywhere.

What a bead lays is told by a *width*, mm: its metal in section over the height of the layer. Parallel beads one spacing
apart lay one spacing each; the bead along a contour lays the rim outside of it, too; a bead that another one overlaps
lays less. A hatch bead has one width from its start to its end, a contour changes it along itself where walls get thin.
"""

from __future__ import annotations

import math

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

ALIKE = 1.1
"""Neighbouring stretches of a contour whose widths differ by less than this factor get one wire speed: every change of
it is a block."""

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
    stretches = _Division.of(
        path, tracks, math.inf if whole else STRETCH_BEADS * config.process.bead_width_mm
    )
    bounds = np.nan_to_num(shapely.total_bounds([metal_region(section, config) for section in sections]))
    step_mm = cell_mm(bounds, config.process.bead_width_mm)

    def some(first: int, last: int) -> list[Floats]:
        return [
            _layer_widths(path, k, points, lengths, tracks, stretches, sections[k], step_mm, config)
            for k in range(first, last)
        ]

    found = [widths for block in run_blocks(some, len(path.z)) for widths in block]
    width = np.asarray(np.round(np.concatenate(found), WIDTH_DIGITS), np.float64)
    return cut(path, points, lengths, parts_of(path, tracks, stretches.runs(tracks, width)), decimals)


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

    def runs(self, tracks: Tracks, width: Floats) -> Stretches:
        """Stretches of one width each (S,): neighbours of one track that are alike share one."""
        track = np.repeat(np.arange(self.length.size), np.diff(self.starts))
        number = np.arange(track.size) - self.starts[track]
        first = runs_alike(track, width, ALIKE)
        begins = np.flatnonzero(first)
        run = np.cumsum(first) - 1
        # Stretches of one track are equally long: the mean keeps the metal.
        mean = np.round(np.bincount(run, width) / np.bincount(run), WIDTH_DIGITS)
        owner, last = track[begins], np.append(begins[1:], track.size) - 1
        ends = (number[begins] * self.length[owner], (number[last] + 1) * self.length[owner])
        low, high = (
            tracks.low[owner] + snapped(tracks, owner, np.minimum(e, tracks.length[owner])) for e in ends
        )
        kept = high - low > ROUNDING_MM
        lap = np.zeros(int(kept.sum()), np.int64)
        return Stretches(owner[kept], low[kept], high[kept], lap, width=mean[kept])


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


def _layer_widths(
    path: Toolpath,
    layer: int,
    points: Floats,
    lengths: Floats,
    tracks: Tracks,
    stretches: _Division,
    section: BaseGeometry,
    step_mm: float,
    config: Config,
) -> Floats:
    """Widths of the stretches of one layer that lay it flat."""
    bead_mm = config.process.bead_width_mm
    a, b = int(path.layer_starts[layer]), int(path.layer_starts[layer + 1])
    count = int(stretches.starts[b] - stretches.starts[a])
    nominal = np.full(count, config.process.hatch_spacing_mm)
    target = target_of(metal_region(section, config), step_mm, bead_mm)
    if not (count and target.share.size):
        return nominal
    rows = slice(int(path.track_starts[a]), int(path.track_starts[b]))
    owner, along, place, length = segment_places(
        path.kind[rows], points[rows], lengths[rows], bead_mm * PLACE_SHARE
    )
    track = np.repeat(np.arange(a, b), np.diff(path.track_starts[a : b + 1]))[owner]
    begin = (tracks.ends[rows] - lengths[rows])[owner] - tracks.low[track]
    bead = stretches.at(track, begin + along) - stretches.starts[a]
    cells = (place - target.origin) / step_mm
    found = footprints(cells, length, bead, count, 0.5 * bead_mm / step_mm, target.share.shape)
    limits = width_limits_mm(config, float(path.thickness[layer]))
    return balanced_widths(found, target.share, step_mm**2, nominal, *limits)

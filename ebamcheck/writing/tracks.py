"""The plain description of a program that every post-processor writes: tracks of beads, layer by layer, contour rings before hatch.

A track is one unbroken bead: the beam and the wire go on at its start and off at its end.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ebamcheck.errors import SettingsError
from ebamcheck.kernels import Bools, Floats, Ints
from ebamcheck.nc.inputs import (
    CurveColumns,
    ScanColumns,
    check_same_stack,
    deposition_heights,
    hatch_columns,
    layer_thickness,
)
from ebamcheck.scan.filling.schedule import follows
from ebamcheck.settings.config import Config
from ebamcheck.writing import segments
from ebamcheck.writing.segments import CIRCULAR, CUBIC, STRAIGHT, Circles, Form

# An arc that leaves its chord by less is written as a line: a tenth of what a path read back may be off by, and its centre would lie too
# far away for the numbers of a control.
STRAIGHT_SAGITTA_MM = 1e-5


@dataclass(frozen=True, eq=False)
class Toolpath:
    """Tracks of a whole stack, positions rounded as they will be printed, mm."""

    cut: Floats  # (L,) heights at which the layers were cut
    z: Floats  # (L,) tops of the layers, where the tool works
    layer_starts: Ints  # (L + 1,) first track of each layer
    track_starts: Ints  # (T + 1,) first segment of each track
    start: Floats  # (T, 2) where each track starts
    ring: Ints  # (T,) number of the contour ring or of the island; -1 for the other
    island: Ints
    kind: NDArray[np.uint8]  # (N,) STRAIGHT, CUBIC or CIRCULAR, and (N, 2) end of each segment
    end: Floats
    turn: Bools  # (N,) a turn between two hatch lines
    piece: Ints  # (N,) piece of the curves that each segment is of; -1 for hatch
    bezier: Floats  # (C, 4, 2) of the cubic segments alone, in their order; not rounded
    middle: Floats  # (A, 2) of the circular segments alone, in their order; not rounded
    power: Floats  # (N,) share of the full beam power
    goes_on: Bools  # (N,) a further part of the hatch line before
    width: Floats  # (N,) metal that is laid, in section over the height of the layer, mm
    base_mm: float = 0.0  # Z of what the lowest layer lies on

    @property
    def thickness(self) -> Floats:
        """Height of each layer, (L,) mm."""
        return layer_thickness(self.z, self.base_mm)

    @cached_property
    def segment_start(self) -> Floats:
        """(N, 2) where each segment starts."""
        begin = np.vstack([np.zeros((1, 2)), self.end[:-1]])[: len(self.end)]
        filled = np.diff(self.track_starts) > 0
        begin[self.track_starts[:-1][filled]] = self.start[filled]
        return begin

    @cached_property
    def points(self) -> Floats:
        """(N, 4, 2) points of each segment, as :mod:`ebamcheck.writing.segments` takes them."""
        points = np.stack([self.segment_start, self.segment_start, self.end, self.end], axis=1)
        points[self.kind == CUBIC] = self.bezier
        points[self.kind == CIRCULAR, 1:3] = self.middle[:, None]
        return points

    @cached_property
    def lengths(self) -> Floats:
        """(N,) length of each segment, mm."""
        return segments.segment_lengths(self.kind, self.points)

    @cached_property
    def circles(self) -> Circles:
        """Circles of the circular segments alone, in their order."""
        at = self.kind == CIRCULAR
        return segments.circles(self.segment_start[at], self.middle, self.end[at])


def toolpath(
    curves: CurveColumns, plan: ScanColumns, config: Config, decimals: int, form: Form, tolerance_mm: float
) -> Toolpath:
    """Lay out the tracks of a stack, each at one power from its start to its end, positions rounded to `decimals`.

    Splines become what `form` says, and leave their curve by at most `tolerance_mm`; SettingsError where heights do not rise.
    """
    check_same_stack(curves, plan)
    cut = np.asarray(curves.heights, dtype=np.float64)
    z = deposition_heights(cut, config.layer_height_mm, config.base_mm)
    if (layer_thickness(z, config.base_mm) <= 0.0).any():
        raise SettingsError("layer heights must rise from layer to layer: sort them and drop repeats")
    contours = _contour_tracks(curves, form, tolerance_mm, decimals)
    hatch = _hatch_tracks(plan, config.process.hatch_spacing_mm, decimals)
    path = _merged(cut, z, contours, hatch, config.process.bead_metal_mm)
    return cleaned(replace(path, base_mm=config.base_mm), decimals)


def cleaned(path: Toolpath, decimals: int) -> Toolpath:
    """Flat arcs made straight, and segments left out that vanish at the decimals of the program."""
    round_ = np.flatnonzero(path.kind == CIRCULAR)
    flat = ~(path.circles.sagitta_mm >= STRAIGHT_SAGITTA_MM)
    kind = path.kind.copy()
    kind[round_[flat]] = STRAIGHT
    keep = (path.end != path.segment_start).any(axis=1)
    bend = np.abs(path.bezier - path.bezier[:, :1]).max(axis=(1, 2), initial=0.0)
    keep[kind == CUBIC] = bend >= 0.5 * 10.0**-decimals
    return replace(
        path, track_starts=np.concatenate([[0], np.cumsum(keep)])[path.track_starts].astype(np.int64),
        kind=kind[keep], end=path.end[keep], turn=path.turn[keep], piece=path.piece[keep],
        bezier=path.bezier[keep[kind == CUBIC]], middle=path.middle[~flat][keep[kind == CIRCULAR]],
        power=path.power[keep], goes_on=path.goes_on[keep], width=path.width[keep],
    )  # fmt: skip


# Columns of the tracks of one sort, as a path has them, and the layer of each track.
_Columns = dict[str, np.ndarray[Any, Any]]


def _contour_tracks(curves: CurveColumns, form: Form, tolerance_mm: float, decimals: int) -> _Columns:
    made = segments.contour_segments(curves, form, tolerance_mm)
    ring_starts = np.asarray(curves.ring_starts, dtype=np.int64)
    ring = np.flatnonzero(np.diff(ring_starts) > 0)
    first = np.asarray(curves.control_starts)[ring_starts[ring]]
    return {
        "layer": np.repeat(np.arange(len(curves.heights)), np.diff(curves.layer_starts))[ring],
        "track_starts": np.append(made.starts[ring_starts[ring]], made.kind.size).astype(np.int64),
        "start": rounded(np.asarray(curves.control, dtype=np.float64)[first], decimals),
        "ring": ring,
        "island": np.full(ring.size, -1),
        "kind": made.kind,
        "end": rounded(made.end, decimals),
        "turn": np.zeros(made.kind.size, np.bool_),
        "piece": np.repeat(np.arange(len(curves.kind)), np.diff(made.starts)),
        "bezier": made.bezier,
        "middle": made.middle,
    }


def _hatch_tracks(plan: ScanColumns, spacing_mm: float, decimals: int) -> _Columns:
    """Hatch tracks: lines of one island that follow each other are one track, with the turns between them."""
    island, ends = hatch_columns(plan)
    ends = rounded(ends, decimals)
    layer = np.asarray(plan.island_layer, dtype=np.int64)[island]
    if (np.diff(layer) < 0).any():
        raise SettingsError("hatch vectors of the scan plan are not in the order of layers")
    joined = follows(island, ends[:, :2], ends[:, 2:], spacing_mm)
    # A vector is a line to its end, and a turn to its start before it where it is joined.
    turn = np.tile([True, False], len(ends))
    present = np.repeat(joined, 2) | ~turn
    first = np.flatnonzero(~joined)
    starts = np.append(np.concatenate([[0], np.cumsum(present)])[2 * first], present.sum())
    size = int(present.sum())
    return {
        "layer": layer[first],
        "track_starts": starts.astype(np.int64),
        "start": ends[first, :2],
        "ring": np.full(first.size, -1),
        "island": island[first],
        "kind": np.full(size, STRAIGHT, np.uint8),
        "end": ends.reshape(-1, 2)[present],
        "turn": turn[present],
        "piece": np.full(size, -1),
        "bezier": np.zeros((0, 4, 2)),
        "middle": np.zeros((0, 2)),
    }


def _merged(cut: Floats, z: Floats, contours: _Columns, hatch: _Columns, width_mm: float) -> Toolpath:
    """Contours of each layer before its hatch. Only contours have cubics and arcs, so that their order stays."""
    both = {name: np.concatenate([contours[name], hatch[name]]) for name in contours}
    order = np.argsort(both["layer"], kind="stable")
    begins = (contours["track_starts"], hatch["track_starts"] + contours["kind"].size)
    count = np.concatenate([np.diff(begin) for begin in begins])[order]
    first = np.concatenate([begin[:-1] for begin in begins])[order]
    starts = np.concatenate([[0], np.cumsum(count)]).astype(np.int64)
    rows = np.repeat(first - starts[:-1], count) + np.arange(starts[-1])
    tracks: dict[str, Any] = {name: both[name][order] for name in ("start", "ring", "island")}
    of_segments: dict[str, Any] = {name: both[name][rows] for name in ("kind", "end", "turn", "piece")}
    layers = np.searchsorted(both["layer"][order], np.arange(cut.size + 1)).astype(np.int64)
    return Toolpath(
        cut=cut, z=z, layer_starts=layers, track_starts=starts, **tracks, **of_segments, bezier=both["bezier"],
        middle=both["middle"], power=np.ones(rows.size), goes_on=np.zeros(rows.size, np.bool_), width=np.full(rows.size, width_mm),
    )  # fmt: skip


def rounded(values: Floats, decimals: int) -> Floats:
    """Values as they will be printed and read back; no negative zero."""
    return np.asarray(np.round(values, decimals) + 0.0)

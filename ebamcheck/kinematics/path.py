"""The path that the axes follow: motions in columns, and the stretches between stops."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ebamcheck.errors import SettingsError
from ebamcheck.kernels import Bools, Floats, Ints
from ebamcheck.layers.stack import Layers
from ebamcheck.nc.motions import ARC, RAPID, STRAIGHT
from ebamcheck.program import NCProgram
from ebamcheck.settings.config import Config

SWITCHES = ("beam_on", "beam_off", "wire_start", "wire_stop")
"""Events at which the axes stand still: the control waits for the switch."""

DEGENERATE = 1e-9
"""Share of a motion's length under which a derivative has no direction."""

INWARDS = 1e-3
"""Parameter, from the end, at which a curve without a direction at its end is asked for it."""


@dataclass(frozen=True, eq=False)
class DrivenPath:
    """Motions (B,) of positive length in their order, with what the feed profile needs of each."""

    row: Ints  # row of the program, or number of the segment of a polyline
    run: Ints  # number of the unbroken run; the axes stand still between runs
    layer: Ints  # -1 for none
    ring: Ints  # contour ring; -1 for none
    deposit: Bools  # beam and feed are on
    start: Floats  # (B, 3) mm
    end: Floats  # (B, 3) mm
    coefficients: Floats  # (B, 2, 4) powers of t in X and Y over 0 <= t <= 1
    radius_mm: Floats  # of an arc; infinite for others
    centre: Floats  # (B, 2) of an arc; NaN for others
    sweep_rad: Floats  # signed, of an arc; NaN for others
    feed_mm_s: Floats  # speed programmed
    length_mm: Floats

    def __len__(self) -> int:
        """Return the number of motions."""
        return int(self.row.size)

    @property
    def is_arc(self) -> Bools:
        """Motions (B,) around a centre."""
        return np.isfinite(self.sweep_rad)

    @cached_property
    def is_curved(self) -> Bools:
        """Motions (B,) whose direction changes."""
        return np.asarray(self.is_arc | (self.coefficients[:, :, 2:] != 0.0).any(axis=(1, 2)))

    def tangents(self, rows: Ints, t: Floats) -> Floats:
        """Unit directions of travel (n, 3) at the parameters `t` (n,) of the motions `rows` (n,)."""
        result, curved = (self.end - self.start)[rows], np.flatnonzero(self.is_curved[rows])
        at, rows = t[curved], rows[curved]
        found = self.derivatives(rows, at)[0]
        flat = np.hypot(*found) <= DEGENERATE * self.length_mm[rows]
        found[:, flat] = self.derivatives(rows[flat], np.clip(at[flat], INWARDS, 1.0 - INWARDS))[0]
        result[curved] = np.column_stack([*found, np.zeros(rows.size)])
        size = np.sqrt((result * result).sum(axis=1))
        return np.asarray(result / np.where(size > 0.0, size, 1.0)[:, None])

    def derivatives(self, rows: Ints, t: Floats) -> tuple[Floats, Floats]:
        """First and second derivative of X and Y by t, each (2, n), or (2, m, n) at several parameters `t` (m, n) of each motion."""
        powers = np.ascontiguousarray(self.coefficients[rows].transpose(2, 1, 0))
        _, b, c, d = powers[:, :, None] if t.ndim > 1 else powers
        first, second = b + t * (2.0 * c + 3.0 * t * d), 2.0 * c + 6.0 * t * d
        round_ = np.flatnonzero(self.is_arc[rows])
        if round_.size:
            r = rows[round_]
            sweep = self.sweep_rad[r]
            turn = sweep * t[..., round_]
            spoke = self.start[r, :2] - self.centre[r]
            cos, sin = np.cos(turn), np.sin(turn)
            x, y = cos * spoke[:, 0] - sin * spoke[:, 1], sin * spoke[:, 0] + cos * spoke[:, 1]
            first[..., round_] = sweep * np.stack([-y, x])
            second[..., round_] = -(sweep**2) * np.stack([x, y])
        return first, second


def program_path(nc: NCProgram, config: Config) -> DrivenPath:
    """Motions of a program that move an axis; the axes stop at rapids and where beam or wire switch.

    Raises SettingsError if a feed motion has no feed, or starts at an unknown position.
    """
    moved = np.isfinite(nc.start).all(axis=1) & (nc.lengths > 0.0)
    stopped = np.zeros(len(nc) + 1, np.bool_)
    stopped[nc.events.row[nc.events.named(*SWITCHES)]] = True
    rapid = nc.kind == RAPID
    stopped[:-1] |= rapid | np.append(False, rapid[:-1]) | (np.diff(nc.beam, prepend=nc.beam[:1]) != 0)
    rows = np.flatnonzero(moved)
    feed = np.where(rapid, config.machine.rapid_mm_s, nc.feed_mm_min / 60.0)[rows]
    bad = np.flatnonzero(~(feed > 0.0))
    if bad.size:
        raise SettingsError(f"{nc.where(int(rows[bad[0]]))}: a motion without a feed: it would never end")
    arc = nc.kind[rows] == ARC
    coefficients = np.where(np.isnan(nc.coefficients[rows]), 0.0, nc.coefficients[rows])
    straight = (nc.kind[rows] == STRAIGHT) | rapid[rows]
    coefficients[straight] = _line_coefficients(nc.start[rows[straight], :2], nc.end[rows[straight], :2])
    centre = np.where(arc[:, None], nc.arc[rows, :2], np.nan)
    return DrivenPath(
        row=rows,
        run=np.cumsum(stopped[:-1], dtype=np.int64)[rows],
        layer=nc.layer[rows],
        ring=nc.ring[rows],
        deposit=nc.deposit[rows],
        start=nc.start[rows],
        end=nc.end[rows],
        coefficients=coefficients,
        radius_mm=np.where(arc, np.linalg.norm(nc.start[rows, :2] - centre, axis=1), np.inf),
        centre=centre,
        sweep_rad=np.where(arc, nc.arc[rows, 2], np.nan),
        feed_mm_s=feed,
        length_mm=nc.lengths[rows],
    )


def polyline_path(layers: Layers, feed_mm_s: float) -> DrivenPath:
    """Path of one straight block for each point of a contour, every ring a run of its own."""
    points = layers.points
    after = np.arange(1, len(points) + 1)
    filled = np.diff(layers.ring_starts) > 0
    after[layers.ring_starts[1:][filled] - 1] = layers.ring_starts[:-1][filled]
    ring = np.repeat(np.arange(layers.closed.size), np.diff(layers.ring_starts))
    last = np.zeros(len(points), np.bool_)
    last[layers.ring_starts[1:][filled] - 1] = True
    start, end = points, points[after] if len(points) else points
    length = np.hypot(*(end - start).T)
    keep = np.flatnonzero((length > 0.0) & ~(last & ~layers.closed[ring]))
    layer = layers.ring_layer[ring[keep]]
    z = np.asarray(layers.heights)[layer][:, None]
    return DrivenPath(
        row=keep,
        run=ring[keep],
        layer=layer,
        ring=ring[keep],
        deposit=np.ones(keep.size, np.bool_),
        start=np.hstack([start[keep], z]),
        end=np.hstack([end[keep], z]),
        coefficients=_line_coefficients(start[keep], end[keep]),
        radius_mm=np.full(keep.size, np.inf),
        centre=np.full((keep.size, 2), np.nan),
        sweep_rad=np.full(keep.size, np.nan),
        feed_mm_s=np.full(keep.size, feed_mm_s),
        length_mm=length[keep],
    )


def _line_coefficients(start: Floats, end: Floats) -> Floats:
    result = np.zeros((len(start), 2, 4))
    result[:, :, 0], result[:, :, 1] = start, end - start
    return result

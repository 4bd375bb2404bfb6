"""The path that the axes follow, and the speeds that they allow: along its cells, and at the corners between motions."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ebamcheck.errors import SettingsError
from ebamcheck.kernels import Bools, Floats, Ints
from ebamcheck.layers.stack import Layers
from ebamcheck.nc.motions import ARC, RAPID, STRAIGHT
from ebamcheck.program import NCProgram
from ebamcheck.settings.config import Config
from ebamcheck.threads import block_edges, run_in_order

DEGENERATE = 1e-9  # Share of a motion's length under which a derivative has no direction


@dataclass(frozen=True, eq=False)
class DrivenPath:
    """Motions (B,) of positive length in their order, as the feed profile needs them."""

    row: Ints  # row of the program, or number of the segment of a polyline
    run: Ints  # number of the unbroken run; the axes stand still between runs
    layer: Ints  # -1 for none
    ring: Ints  # contour ring; -1 for none
    deposit: Bools  # beam and feed are on
    start: Floats  # (B, 3) mm
    end: Floats  # (B, 3) mm
    coefficients: Floats  # (B, 2, 4) powers of t in X and Y over 0 <= t <= 1
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
        # A curve without a direction at its end has one a little before.
        found[:, flat] = self.derivatives(rows[flat], np.clip(at[flat], 1e-3, 1.0 - 1e-3))[0]
        result[curved] = np.column_stack([*found, np.zeros(rows.size)])
        size = np.sqrt((result * result).sum(axis=1))
        return np.asarray(result / np.where(size > 0.0, size, 1.0)[:, None])

    def derivatives(self, rows: Ints, t: Floats) -> tuple[Floats, Floats]:
        """First and second derivative of X and Y by t, each (2, n), or (2, m, n) at several parameters `t` (m, n) of each
        motion."""
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
    # The control waits for the switch.
    stopped[nc.events.row[nc.events.named("beam_on", "beam_off", "wire_start", "wire_stop")]] = True
    rapid = nc.kind == RAPID
    stopped[:-1] |= rapid | np.append(False, rapid[:-1]) | (np.diff(nc.beam, prepend=nc.beam[:1]) != 0)
    rows = np.flatnonzero(moved)
    feed = np.where(rapid, config.machine.rapid_mm_s, nc.feed_mm_min / 60.0)[rows]
    bad = np.flatnonzero(~(feed > 0.0))
    if bad.size:
        raise SettingsError(f"{nc.where(int(rows[bad[0]]))}: a motion without a feed: it would never end")
    arc, coefficients = nc.kind[rows] == ARC, np.nan_to_num(nc.coefficients[rows], nan=0.0)
    straight = (nc.kind[rows] == STRAIGHT) | rapid[rows]
    coefficients[straight] = _line_coefficients(nc.start[rows[straight], :2], nc.end[rows[straight], :2])
    return DrivenPath(
        row=rows,
        run=np.cumsum(stopped[:-1], dtype=np.int64)[rows],
        layer=nc.layer[rows],
        ring=nc.ring[rows],
        deposit=nc.deposit[rows],
        start=nc.start[rows],
        end=nc.end[rows],
        coefficients=coefficients,
        centre=np.where(arc[:, None], nc.arc[rows, :2], np.nan),
        sweep_rad=np.where(arc, nc.arc[rows, 2], np.nan),
        feed_mm_s=feed,
        length_mm=nc.lengths[rows],
    )


def polyline_path(layers: Layers, feed_mm_s: float) -> DrivenPath:
    """Path of one straight block for each point of a contour, every ring a run of its own."""
    points, size = layers.points, np.diff(layers.ring_starts)
    ends = layers.ring_starts[1:][size > 0] - 1
    after, last = np.arange(1, len(points) + 1), np.zeros(len(points), np.bool_)
    after[ends], last[ends] = layers.ring_starts[:-1][size > 0], True
    ring = np.repeat(np.arange(layers.closed.size), size)
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
        centre=np.full((keep.size, 2), np.nan),
        sweep_rad=np.full(keep.size, np.nan),
        feed_mm_s=np.full(keep.size, feed_mm_s),
        length_mm=length[keep],
    )


def _line_coefficients(start: Floats, end: Floats) -> Floats:
    return np.stack([start, end - start, np.zeros_like(start), np.zeros_like(start)], axis=2)


# -- speeds ----------------------------------------------------------------------------------------

# Words by which the control rounds corners (SINUMERIK, continuous-path mode), and by which it stops in every one
SMOOTHING_WORDS = ("G641", "G642", "G643", "G644", "G645")
EXACT_STOP_WORDS = ("G60", "G9")
# Half a break of direction that is none: the last decimals of a program turn a short block by this
SMOOTH_RAD = 1e-5
STRAIGHT_RADIUS_MM = 1e9  # a corner that may be rounded with a larger radius is none


@dataclass(frozen=True, eq=False)
class Cells:
    """Stretches of the path, about as long as a ramp from rest to the feed, along each of which the greatest speed is held
    constant."""

    motion: Ints  # (C,) motion of the path
    length_mm: Floats  # (C,)
    most_mm_s: Floats  # (C,) greatest speed
    acceleration_mm_s2: Floats  # (C,) along the path
    jerk_mm_s3: Floats  # (C,) along the path
    entry_mm_s: Floats  # (C,) greatest speed at its start: 0 where a run begins
    first: Bools  # (C,) true where a run begins


def cells_of(path: DrivenPath, config: Config) -> Cells:
    """Divide a path, and find the speed that its curvature, its corners and the axes allow."""
    axes, feed = config.kinematics, path.feed_mm_s
    # Cells of a curved motion are half as long as a ramp from rest to the feed.
    least_a, j = min(axes.axis_acceleration_mm_s2[:2]), min(axes.axis_jerk_mm_s3[:2])
    slow_s, fast_s = 2.0 * np.sqrt(feed / j), feed / least_a + least_a / j
    ramp_s = np.where(feed * j < least_a * least_a, slow_s, fast_s)
    parts = np.clip(np.ceil(path.length_mm / (0.5 * feed * ramp_s)), 1, 64).astype(np.int64)
    parts = np.where(path.is_curved, parts, 1)
    motion = np.repeat(np.arange(len(path)), parts)
    starts = np.concatenate([[0], np.cumsum(parts)]).astype(np.int64)
    index = np.arange(motion.size) - starts[:-1][motion]
    t0, t1 = index / parts[motion], (index + 1) / parts[motion]
    curvature, length = np.zeros(motion.size), path.length_mm[motion]
    direction = np.abs(path.tangents(motion, t0))
    bent = np.flatnonzero(path.is_curved[motion])
    # The columns of so many cells stay in the cache of a processor.
    edges = block_edges(bent.size, largest=8192)
    rows, begin, end = motion[bent], t0[bent], t1[bent]
    bends = run_in_order(lambda a, b: _bends(path, rows[a:b], begin[a:b], end[a:b]), edges)
    curvature[bent], *axes_of, length[bent] = np.hstack(list(bends))
    direction[bent] = np.stack(axes_of, axis=1)
    # Those of one motion add up to its length.
    whole = np.bincount(motion, length, minlength=len(path))
    length *= (path.length_mm / np.where(whole > 0.0, whole, 1.0))[motion]
    feed = path.feed_mm_s[motion]
    most = np.minimum(feed, _along(direction, np.array(axes.axis_speed_mm_s)))
    # Speed around a curvature: v^2 k within its share of the acceleration, v^3 k^2 within the jerk. A cusp has no curvature, and the
    # axes go through it somehow.
    a = axes.curvature_share * least_a
    with np.errstate(divide="ignore"):
        around = np.minimum(np.sqrt(a / curvature), np.cbrt(j / curvature**2))
    most = np.minimum(most, np.maximum(around, 1e-3 * feed))
    acceleration = _along(direction, np.array(axes.axis_acceleration_mm_s2))
    jerk = _along(direction, np.array(axes.axis_jerk_mm_s3))
    curved = path.is_curved[motion]
    # Across any direction of travel in X and Y, the least of both axes holds; what curvature takes is not left.
    rest = math.sqrt(1.0 - axes.curvature_share**2)
    acceleration[curved], jerk[curved] = rest * least_a, rest * j
    entry = np.full(motion.size, np.inf)
    entry[starts[:-1]] = corner_speeds(path, config)
    first = np.zeros(motion.size, np.bool_)
    first[starts[:-1]] = np.diff(path.run, prepend=-1) != 0
    entry[first] = 0.0
    return Cells(motion, length, most, acceleration, jerk, entry, first)


def _along(direction: Floats, limits: Floats) -> Floats:
    """Limit along a direction (n, 3) whose axes have limits (3,): the axis that gets there first."""
    with np.errstate(divide="ignore"):
        return np.asarray((limits / np.abs(direction)).min(axis=1))


def _curvature(first: Floats, second: Floats) -> Floats:
    """Curvature (...) 1/mm, positive to the left, of derivatives (2, ...); infinite in a cusp."""
    (ax, ay), (bx, by) = first, second
    with np.errstate(divide="ignore", invalid="ignore"):
        found = (ax * by - ay * bx) / np.hypot(ax, ay) ** 3
    return np.asarray(np.where(np.isnan(found), np.inf, found))


def _bends(path: DrivenPath, rows: Ints, t0: Floats, t1: Floats) -> Floats:
    """Of stretches (n,) of curves, by columns (5, n): greatest curvature, 1/mm, greatest share of each axis in the direction,
    length, mm."""
    t = np.linspace(t0, t1, 5)
    first, second = path.derivatives(rows, t)
    speed = np.hypot(*first)
    share = np.divide(np.abs(first), speed, out=np.zeros_like(first), where=speed > 0.0)
    for k, n in zip(*np.nonzero(speed <= DEGENERATE * path.length_mm[rows]), strict=True):
        share[:, k, n] = np.abs(path.tangents(rows[[n]], t[k, [n]])[0, :2])
    # By 8-point Gauss quadrature.
    nodes, weights = np.polynomial.legendre.leggauss(8)
    at = t0 + (t1 - t0) * (0.5 * (nodes[:, None] + 1.0))
    length = 0.5 * (t1 - t0) * (weights @ np.hypot(*path.derivatives(rows, at)[0]))
    most = np.abs(_curvature(first, second)).max(axis=0)
    return np.stack([most, *share.max(axis=1), np.zeros(rows.size), length])


def corner_speeds(path: DrivenPath, config: Config) -> Floats:
    """Greatest speed (B,) at the start of each motion, from the tangents and curvatures that meet there: the one whose jump the
    axes take, or that of a rounding within the smoothing tolerance e. A break of direction p is rounded by an arc of radius r = e
    cos(p/2) / (1 - cos(p/2)) that takes at most half of either motion; a jump of curvature k by a clothoid of length sqrt(24 e /
    k), whose shift is e. The acceleration must stay within its share, its rise within the jerk."""
    axes, machine = config.kinematics, config.machine
    result = np.full(len(path), np.inf)
    if len(path) < 2:
        return result
    before, after = np.arange(len(path) - 1), np.arange(1, len(path))
    ends, begins = path.tangents(before, np.ones(before.size)), path.tangents(after, np.zeros(after.size))
    # Half the angle by the sine: the difference of unit vectors does not lose small angles, as their product does.
    half = np.arcsin(np.clip(0.5 * np.linalg.norm(begins - ends, axis=1), 0.0, 1.0))
    jump = np.abs(begins - ends).max(axis=1)
    with np.errstate(divide="ignore"):
        stepped = axes.speed_jump_mm_s / jump
    if any(word in EXACT_STOP_WORDS for word in machine.smoothing):
        result[1:] = np.where(half > SMOOTH_RAD, 0.0, np.inf)
        return result
    smooths = any(word in SMOOTHING_WORDS for word in machine.smoothing)
    tolerance_mm = machine.smoothing_tolerance_mm if smooths else 0.0
    a, j = axes.curvature_share * min(axes.axis_acceleration_mm_s2[:2]), min(axes.axis_jerk_mm_s3[:2])
    room = 0.5 * np.minimum(path.length_mm[:-1], path.length_mm[1:])
    with np.errstate(divide="ignore", invalid="ignore"):
        radius = tolerance_mm * np.cos(half) / (2.0 * np.sin(0.5 * half) ** 2)
        radius = np.minimum(np.minimum(radius, room / np.tan(half)), STRAIGHT_RADIUS_MM)
        radius = np.nan_to_num(radius, nan=0.0)
    # The acceleration v^2 / r rises over half the arc, r p / 2, and falls over the other half.
    rounded = np.minimum(np.sqrt(a * radius), np.cbrt(j * radius**2 * half))
    sides = (before, np.ones(before.size)), (after, np.zeros(after.size))
    bends = [np.where(path.is_curved[at], _curvature(*path.derivatives(at, t)), 0.0) for at, t in sides]
    # A cusp slows its own cell down.
    known = np.isfinite(bends[0]) & np.isfinite(bends[1])
    bend = np.abs(np.where(known, bends[1], 0.0) - np.where(known, bends[0], 0.0))
    # At a jump of curvature the acceleration is within its share, eased in within the jerk.
    with np.errstate(divide="ignore"):
        eased = np.sqrt(a / bend)
        if tolerance_mm > 0.0:
            eased = np.minimum(eased, np.cbrt(j * np.sqrt(24.0 * tolerance_mm / bend) / bend))
    result[1:] = np.minimum(np.where(half > SMOOTH_RAD, np.maximum(stepped, rounded), np.inf), eased)
    return result

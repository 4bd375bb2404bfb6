"""Bezier spans of splines, lines and arcs: the form in which curves are evaluated, sampled and written."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ebamcheck.columns_file import starts_of
from ebamcheck.curves.runs import ARC, LINE, SPLINE
from ebamcheck.geometry.raster import each_of
from ebamcheck.kernels import Bools, Floats, Ints, kernel

LARGEST_SPAN_RAD = math.radians(5.0)
"""Largest sweep of one cubic span of an arc: the span leaves the circle by less than 1e-11 of the radius."""


@dataclass(frozen=True, eq=False)
class BezierSpans:
    """Every knot span of every spline, every segment of every line, and arcs in short spans (n,), in the order of travel."""

    points: Floats  # (n, 4, 2) control points, mm; neighbours share their end bit for bit, a line's inner points lie at its thirds
    interval_mm: Floats  # knot interval; the length of a line. A POLY block's PL, before rescaling
    kind: NDArray[np.uint8]
    piece: Ints
    ring: Ints
    layer: Ints

    def __len__(self) -> int:
        """Return the number of spans."""
        return len(self.points)


class Arcs(NamedTuple):
    """Circles and sweeps of arcs, as columns."""

    centre: Floats  # (n, 2) mm
    radius: Floats  # (n,) mm; infinite where three points lie on a line
    start: Floats  # (n,) direction from the centre to the start, rad
    sweep: Floats  # (n,) signed angle from start to end, rad; positive counter-clockwise, under a full turn

    def at(self, share: Floats) -> Floats:
        """Points (n, 2) at a share 0 .. 1 of each sweep."""
        angle = self.start + share * self.sweep
        away = self.radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
        return np.asarray(self.centre + away)


def arcs_through(points: Floats) -> Arcs:
    """Arcs through start, middle and end each, (n, 3, 2); the middle need not lie half-way."""
    a, b = points[:, 0] - points[:, 1], points[:, 2] - points[:, 1]
    twice = 2.0 * (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    straight = twice == 0.0
    safe = np.where(straight, 1.0, twice)
    a2, b2 = (a * a).sum(axis=1), (b * b).sum(axis=1)
    off = np.column_stack([b[:, 1] * a2 - a[:, 1] * b2, a[:, 0] * b2 - b[:, 0] * a2]) / safe[:, None]
    centre = points[:, 1] + off
    start, end = (np.arctan2(*(points[:, k] - centre).T[::-1]) for k in (0, 2))
    sweep = end - start
    # The middle to the right of the chord: counter-clockwise.
    turn = np.where(twice < 0.0, 2.0 * np.pi, -2.0 * np.pi)
    sweep += np.where(sweep * turn <= 0.0, turn, 0.0)
    return Arcs(
        np.where(straight[:, None], np.inf, centre),
        np.where(straight, np.inf, np.hypot(*off.T)),
        np.where(straight, 0.0, start),
        np.where(straight, 0.0, sweep),
    )


def span_counts(kind: NDArray[np.uint8], control_starts: Ints, knots: Floats, knot_starts: Ints) -> Ints:
    """Number of NC blocks of each piece, (P,): knot spans of a spline, segments of a line, one for an arc."""
    counts: Ints = np.maximum(np.diff(control_starts) - 1, 0)
    counts[kind == ARC] = 1
    curved = np.flatnonzero(kind == SPLINE)
    if curved.size:
        rises = np.concatenate([[0], np.cumsum(np.diff(knots) > 0.0)])
        counts[curved] = rises[knot_starts[curved + 1] - 1] - rises[knot_starts[curved]]
    return counts


def span_points(
    kind: NDArray[np.uint8], control: Floats, control_starts: Ints, knots: Floats, knot_starts: Ints
) -> tuple[Floats, Floats, Ints]:
    """Bezier points (n, 4, 2) of the spans of all pieces, the knot interval and the piece of each, (n,)."""
    counts = span_counts(kind, control_starts, knots, knot_starts)
    arc = np.flatnonzero(kind == ARC)
    arcs = arcs_through(control[control_starts[arc][:, None] + np.arange(3)])
    counts[arc] = np.maximum(1, np.ceil(np.abs(arcs.sweep) / LARGEST_SPAN_RAD - 1e-9))
    starts = starts_of(counts)
    piece, place = each_of(counts)
    B, interval = np.empty((piece.size, 4, 2)), np.empty(piece.size)
    lines = np.flatnonzero(kind[piece] == LINE)
    row = control_starts[piece[lines]] + place[lines]
    p, q = control[row], control[row + 1]
    B[lines] = np.stack([p, p + (q - p) / 3.0, p + (q - p) * (2.0 / 3.0), q], axis=1)
    interval[lines] = np.hypot(*(q - p).T)
    splines = np.flatnonzero(kind[piece] == SPLINE)
    of = piece[splines]
    B[splines], interval[splines] = _spline_spans(control, control_starts[of], knots, knot_starts[of])
    round_ = np.flatnonzero(kind[piece] == ARC)
    of = piece[round_]
    arcs = Arcs(*(column[np.searchsorted(arc, of)] for column in arcs))
    points = control[control_starts[of][:, None] + np.arange(3)]
    B[round_], interval[round_] = _arc_spans(arcs, points, place[round_], counts[of])
    # The ends of curves are those given, bit for bit, and their spans meet.
    curved = kind != LINE
    B[starts[:-1][curved], 0] = control[control_starts[:-1][curved]]
    B[starts[1:][curved] - 1, 3] = control[control_starts[1:][curved] - 1]
    inner = np.flatnonzero(curved[piece] & (place > 0))
    B[inner, 0] = B[inner - 1, 3]
    return B, interval, piece


def _spline_spans(control: Floats, first_control: Ints, knots: Floats, first_knot: Ints) -> tuple[Floats, Floats]:
    """Bezier points of the non-empty knot spans of splines, by their blossoms (de Boor), and their knot intervals."""
    if not first_knot.size:
        return np.empty((0, 4, 2)), np.empty(0)
    j = np.flatnonzero(np.diff(knots) > 0.0)
    u = [knots[j + k] for k in range(-2, 4)]
    row = first_control + j - first_knot
    d = [control[row + k] for k in range(-3, 1)]
    a, b = u[2], u[3]

    def between(x: Floats, low: Floats, high: Floats, p: Floats, q: Floats) -> Floats:
        return np.asarray(p + (q - p) * ((x - low) / (high - low))[:, None])

    # The control points are f(u0, u1, a), f(u1, a, b), f(a, b, u4), f(b, u4, u5).
    aab, abb = between(a, u[1], u[4], d[1], d[2]), between(b, u[1], u[4], d[1], d[2])
    before, after = between(a, u[0], b, d[0], d[1]), between(b, a, u[5], d[2], d[3])
    B = np.stack([between(a, u[1], b, before, aab), aab, abb, between(b, a, u[4], abb, after)], axis=1)
    return B, b - a


def _arc_spans(arcs: Arcs, control: Floats, place: Ints, count: Ints) -> tuple[Floats, Floats]:
    """Bezier points and lengths of the spans of arcs, `place` of `count` each."""
    straight = np.isinf(arcs.radius)
    step = arcs.sweep / count
    with np.errstate(invalid="ignore"):
        leg = (4.0 / 3.0) * np.tan(0.25 * step) * arcs.radius
        ends = [arcs.at((place + k) / count) for k in (0, 1)]
        ways = [arcs.start + (place + k) * step for k in (0, 1)]
        legs = [leg[:, None] * np.column_stack([-np.sin(w), np.cos(w)]) for w in ways]
        B = np.stack([ends[0], ends[0] + legs[0], ends[1] - legs[1], ends[1]], axis=1)
        interval = np.abs(step) * arcs.radius
    share = (place[:, None] + np.arange(4) / 3.0) / count[:, None]
    line = control[:, :1] + (control[:, 2:] - control[:, :1]) * share[:, :, None]
    B[straight] = line[straight]
    interval[straight] = (np.hypot(*(control[:, 2] - control[:, 0]).T) / count)[straight]
    return B, interval


def places_along(B: Floats, count: int) -> Floats:
    """Points (count, n, 2) of Bezier spans (n, 4, 2) at the parameters 0, 1 / count, 2 / count and so on."""
    t = np.arange(count) / count
    s = 1.0 - t
    weights = np.stack([s * s * s, 3.0 * s * s * t, 3.0 * s * t * t, t * t * t], axis=1)
    return np.asarray(weights @ np.moveaxis(B, 1, 0).reshape(4, -1)).reshape(count, -1, 2)


def arc_lengths(B: Floats) -> Floats:
    """Arc length of each Bezier span, (n,); exact to rounding on the spans of a smooth fit."""
    nodes, shares = np.polynomial.legendre.leggauss(8)
    t = 0.5 * (nodes + 1.0)
    weights = np.stack([3.0 * (1.0 - t) ** 2, 6.0 * (1.0 - t) * t, 3.0 * t * t])
    speed = np.einsum("kt,nkd->ntd", weights, np.diff(B, axis=1))
    return np.asarray(np.hypot(speed[..., 0], speed[..., 1]) @ (0.5 * shares))


def chords_for_step(B: Floats, kind: NDArray[np.uint8], step: float) -> Ints:
    """Equal parameter steps of each span whose chords are at most `step` long, (n,).

    A Bezier curve is nowhere faster than three times the longest leg of its control polygon.
    """
    legs = np.diff(B, axis=1)
    speed = 3.0 * np.hypot(legs[..., 0], legs[..., 1]).max(axis=1, initial=0.0)
    speed = np.where(kind == LINE, np.hypot(*(B[:, 3] - B[:, 0]).T), speed)
    return _counts(speed / step)


def chords_for_tolerance(B: Floats, kind: NDArray[np.uint8], tolerance: float) -> Ints:
    """Equal parameter steps of each span whose chords stay within `tolerance` of the curve, (n,).

    The chord of a step t leaves the curve by at most t^2 / 8 times the largest second derivative,
    which is six times the largest second difference of the control points.
    """
    second = np.diff(B, n=2, axis=1)
    bend = 6.0 * np.hypot(second[..., 0], second[..., 1]).max(axis=1, initial=0.0)
    return _counts(np.sqrt(np.where(kind == LINE, 0.0, bend) / (8.0 * tolerance)))


def _counts(steps: Floats) -> Ints:
    return np.maximum(1, np.ceil(np.minimum(steps, 2.0**31))).astype(np.int64)


@kernel
def sample_spans(B: Floats, lines: Bools, chords: Ints) -> Floats:
    """The points at the starts of the chords of each span, (sum of chords, 2); `lines` tells spans that are straight."""
    count = 0
    for n in range(len(B)):
        count += chords[n]
    result = np.empty((count, 2))
    row = 0
    for n in range(len(B)):
        for k in range(chords[n]):
            t = k / chords[n]
            s = 1.0 - t
            for axis in range(2):
                a, b, c, d = B[n, 0, axis], B[n, 1, axis], B[n, 2, axis], B[n, 3, axis]
                curved = s * s * s * a + 3.0 * s * s * t * b + 3.0 * s * t * t * c + t * t * t * d
                result[row, axis] = a if k == 0 else a + (d - a) * t if lines[n] else curved
            row += 1
    return result

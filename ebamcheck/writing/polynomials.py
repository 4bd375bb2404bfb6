"""Cubic B-splines as polynomials: one per knot span, exactly, for POLY blocks and for chords."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ebamcheck.nc.inputs import DEGREE, SPLINE, CurveColumns
from ebamcheck.numeric.rings import Floats, Ints


@dataclass(frozen=True, eq=False)
class Spans:
    """Knot spans of all spline pieces, in order, each over 0 <= t <= 1."""

    starts: Ints
    """(P + 1,) first span of each piece; lines have none."""
    bezier: Floats
    """(S, 4, 2) Bezier points, mm."""

    @property
    def end(self) -> Floats:
        """(S, 2) where each span ends."""
        return self.bezier[:, 3]

    @property
    def quadratic(self) -> Floats:
        """(S, 2) coefficients of t^2."""
        b = self.bezier
        return np.asarray(3.0 * (b[:, 0] - 2.0 * b[:, 1] + b[:, 2]))

    @property
    def cubic(self) -> Floats:
        """(S, 2) coefficients of t^3."""
        b = self.bezier
        return np.asarray(b[:, 3] - b[:, 0] + 3.0 * (b[:, 1] - b[:, 2]))


def spans(curves: CurveColumns) -> Spans:
    """Split every spline piece at its knots into Bezier spans (blossoming; Farin, Curves and Surfaces)."""
    piece_of_knot = np.repeat(np.arange(len(curves.kind)), np.diff(curves.knot_starts))
    knots = np.asarray(curves.knots, dtype=np.float64)
    place = np.arange(knots.size) - np.asarray(curves.knot_starts)[:-1][piece_of_knot]
    count = np.diff(curves.control_starts)[piece_of_knot]
    inner = (place >= DEGREE) & (place < count) & (np.asarray(curves.kind)[piece_of_knot] == SPLINE)
    at = np.flatnonzero(inner)
    at = at[knots[at] < knots[np.minimum(at + 1, knots.size - 1)]]
    piece = piece_of_knot[at]
    first_control = np.asarray(curves.control_starts)[:-1][piece] + place[at] - DEGREE
    control = np.asarray(curves.control, dtype=np.float64)[first_control[:, None] + np.arange(4)]
    local = knots[at[:, None] + np.arange(-2, 4)]
    a, b = local[:, 2], local[:, 3]
    points = [_blossom(control, local, *t) for t in ((a, a, a), (a, a, b), (a, b, b), (b, b, b))]
    starts = np.searchsorted(piece, np.arange(len(curves.kind) + 1)).astype(np.int64)
    return Spans(starts, np.stack(points, axis=1) if at.size else np.zeros((0, 4, 2)))


def _blossom(control: Floats, local: Floats, t0: Floats, t1: Floats, t2: Floats) -> Floats:
    """Polar form of each span at three parameters; `local` (S, 6) are the knots around the span."""
    level = control
    for depth, t in enumerate((t0, t1, t2)):
        size = DEGREE - depth
        low = local[:, depth : depth + size]
        high = local[:, DEGREE : DEGREE + size]
        share = ((t[:, None] - low) / (high - low))[..., None]
        level = (1.0 - share) * level[:, :-1] + share * level[:, 1:]
    return level[:, 0]


def chords(found: Spans, tolerance_mm: float) -> tuple[Ints, Floats]:
    """Points on the spans such that their chords keep to `tolerance_mm`; the first point of a span is not given.

    The chord error of n equal parts is at most ``max |p''| / (8 n^2)``, and p'' of a cubic is largest at an end.

    Returns
    -------
    starts
        (P + 1,) first point of each piece.
    points
        (N, 2) mm.
    """
    bend = np.maximum(
        np.linalg.norm(2.0 * found.quadratic, axis=1),
        np.linalg.norm(2.0 * found.quadratic + 6.0 * found.cubic, axis=1),
    )
    parts = np.maximum(1, np.ceil(np.sqrt(bend / (8.0 * tolerance_mm)))).astype(np.int64)
    offset = np.concatenate([[0], np.cumsum(parts)]).astype(np.int64)
    span = np.repeat(np.arange(parts.size), parts)
    step = np.arange(offset[-1]) - offset[:-1][span] + 1
    t = (step / parts[span])[:, None]
    b = found.bezier[span]
    points = (
        (1.0 - t) ** 3 * b[:, 0]
        + 3.0 * t * (1.0 - t) ** 2 * b[:, 1]
        + 3.0 * t**2 * (1.0 - t) * b[:, 2]
        + t**3 * b[:, 3]
    )
    return offset[found.starts], np.asarray(points)


def refined(control: Floats, knots: Floats, blocks: int) -> tuple[Floats, Floats]:
    """Return the same spline with at least `blocks` control points after its first (Boehm's knot insertion).

    Knots go to the middle of the longest span; the curve does not change.
    """
    from scipy.interpolate import BSpline  # half of the time that this package takes to import

    spline = BSpline(knots, control, DEGREE)
    while len(spline.c) - 1 < blocks:
        longest = int(np.argmax(np.diff(spline.t)))
        spline = spline.insert_knot(0.5 * (spline.t[longest] + spline.t[longest + 1]))
    return np.asarray(spline.c), np.asarray(spline.t)


def halved(control: Floats, knots: Floats) -> tuple[Floats, Floats]:
    """Return the same spline with a further knot in the middle of every span, so that even knots stay even."""
    from scipy.interpolate import BSpline  # half of the time that this package takes to import

    spline = BSpline(knots, control, DEGREE)
    breaks = np.unique(knots)
    for knot in 0.5 * (breaks[1:] + breaks[:-1]):
        spline = spline.insert_knot(knot)
    return np.asarray(spline.c), np.asarray(spline.t)

"""Segments: lines, cubics and arcs in a row, from which the pieces of curves are made."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ebamcheck.curves.splitting import ARC, LINE, SPLINE
from ebamcheck.kernels import Bools, Floats, Ints, kernel

DEGREE = 3

UNEVEN = 4.0
"""Largest ratio of a knot interval to the length of its span, either way; beyond it a spline ends and the next begins."""


class Segments(NamedTuple):
    """Segments of rings, as columns."""

    points: Floats
    """(n, 4, 2) Bezier points of a cubic, mm. A line has its ends in the first and last place; an arc also its middle in the
    second."""
    kind: NDArray[np.uint8]
    """(n,) :data:`LINE`, :data:`SPLINE` (a cubic) or :data:`ARC`."""
    corner: Bools
    """(n,) whether there is a corner before the segment."""
    ring_starts: Ints
    """(R + 1,) first segment of each ring."""


class Pieces(NamedTuple):
    """Columns of :class:`~ebamcheck.curves.columns.Curves`."""

    ring_starts: Ints
    kind: NDArray[np.uint8]
    control_starts: Ints
    control: Floats
    knot_starts: Ints
    knots: Floats


@kernel
def leg_over_chord(start: float, end: float) -> float:
    """Length of the inner legs of a cubic over its chord, by the angles at its ends: that of a circle's (Stone, DeRose 1989)."""
    half = 0.5 * (abs(start) + abs(end))
    return float(2.0 / (3.0 * (1.0 + np.cos(min(half, 0.5 * np.pi)))))


@kernel
def set_cubic(B: Floats, p: Floats, q: Floats, start: float, end: float) -> None:
    """Write the cubic from p to q whose directions leave the chord by the given angles (rad; see :class:`OrientedContours`)."""
    x, y = q[0] - p[0], q[1] - p[1]
    leg = leg_over_chord(start, end)
    c, s = np.cos(start) * leg, np.sin(start) * leg
    B[0], B[3] = p, q
    B[1, 0], B[1, 1] = p[0] + c * x + s * y, p[1] + c * y - s * x
    c, s = np.cos(end) * leg, np.sin(end) * leg
    B[2, 0], B[2, 1] = q[0] - c * x + s * y, q[1] - c * y - s * x


def pieces_of(segments: Segments) -> Pieces:
    """Join segments into pieces: lines into polylines, cubics without a corner into splines, arcs each its own.

    A spline of cubics has double inner knots, whose intervals make it continuously differentiable.
    """
    count = len(segments.kind)
    rings = segments.ring_starts.size - 1
    kind = np.empty(count, np.uint8)
    control_starts, knot_starts = np.zeros(count + 1, np.int64), np.zeros(count + 1, np.int64)
    ring_starts = np.zeros(rings + 1, np.int64)
    control, knots = np.empty((4 * count, 2)), np.empty(8 * count)
    pieces = _join(segments, kind, control_starts, knot_starts, ring_starts, control, knots)
    control_starts, knot_starts = control_starts[: pieces + 1].copy(), knot_starts[: pieces + 1].copy()
    return Pieces(
        ring_starts,
        kind[:pieces].copy(),
        control_starts,
        control[: control_starts[-1]].copy(),
        knot_starts,
        knots[: knot_starts[-1]].copy(),
    )


@kernel
def _join(
    segments: Segments,
    kind: NDArray[np.uint8],
    control_starts: Ints,
    knot_starts: Ints,
    ring_starts: Ints,
    control: Floats,
    knots: Floats,
) -> int:
    """Write the pieces of all rings; returns their number."""
    p = 0
    for ring in range(ring_starts.size - 1):
        i = segments.ring_starts[ring]
        while i < segments.ring_starts[ring + 1]:
            end = _piece_end(segments, i, segments.ring_starts[ring + 1])
            C = control[control_starts[p] :]
            U = knots[knot_starts[p] :]
            kind[p] = segments.kind[i]
            controls = knot_count = 0
            if kind[p] == LINE:
                C[0] = segments.points[i, 0]
                for k in range(i, end):
                    C[k - i + 1] = segments.points[k, 3]
                controls = end - i + 1
            elif kind[p] == ARC:
                C[0], C[1], C[2] = segments.points[i, 0], segments.points[i, 1], segments.points[i, 3]
                controls = 3
            else:
                controls, knot_count = _write_spline(segments.points[i:end], C, U)
            control_starts[p + 1] = control_starts[p] + controls
            knot_starts[p + 1] = knot_starts[p] + knot_count
            p += 1
            i = end
        ring_starts[ring + 1] = p
    return p


@kernel
def _piece_end(segments: Segments, first: int, last: int) -> int:
    """Segment after the last one of the piece that begins at `first`."""
    if segments.kind[first] == ARC:
        return first + 1
    interval = 1.0
    for i in range(first + 1, last):
        if segments.kind[i] != segments.kind[first]:
            return i
        if segments.kind[first] == SPLINE:
            if segments.corner[i]:
                return i
            interval *= _growth(segments.points[i - 1], segments.points[i])
            even = _leg(segments.points[i], 0) / _leg(segments.points[first], 0)
            if not interval < UNEVEN * even or not interval > even / UNEVEN:
                return i
    return last


@kernel
def _leg(B: Floats, k: int) -> float:
    return float(np.hypot(B[k + 1, 0] - B[k, 0], B[k + 1, 1] - B[k, 1]))


@kernel
def _growth(B: Floats, following: Floats) -> float:
    """Ratio of the knot intervals of two cubics that makes the derivative continuous where they meet."""
    back = _leg(B, 2)
    return _leg(following, 0) / back if back > 0.0 else np.inf


@kernel
def _write_spline(B: Floats, C: Floats, U: Floats) -> tuple[int, int]:
    """Write the control points and knots of joined cubics; returns how many there are of each."""
    n = len(B)
    intervals = np.empty(n)
    intervals[0] = 1.0
    chords = 0.0
    for i in range(n):
        if i:
            intervals[i] = intervals[i - 1] * _growth(B[i - 1], B[i])
        chords += np.hypot(B[i, 3, 0] - B[i, 0, 0], B[i, 3, 1] - B[i, 0, 1])
    intervals *= chords / intervals.sum()
    C[0] = B[0, 0]
    U[: DEGREE + 1] = 0.0
    at = 0.0
    for i in range(n):
        C[1 + 2 * i], C[2 + 2 * i] = B[i, 1], B[i, 2]
        at += intervals[i]
        U[4 + 2 * i] = U[5 + 2 * i] = at
    C[2 * n + 1] = B[n - 1, 3]
    U[2 * n + 2 : 2 * n + 6] = at
    return 2 * n + 2, 2 * n + 6

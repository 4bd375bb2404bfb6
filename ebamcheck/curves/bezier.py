"""Bezier spans of splines and lines: the form in which curves are evaluated, sampled and written."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ebamcheck.curves.splitting import ARC, LINE, SPLINE
from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Floats, Ints

DEGREE = 3

QUADRATURE_NODES, QUADRATURE_WEIGHTS = np.polynomial.legendre.leggauss(8)
"""Gauss-Legendre rule for arc lengths; exact to rounding on the spans of a smooth fit."""


@dataclass(frozen=True, eq=False)
class BezierSpans:
    """Every knot span of every spline, every segment of every line, and arcs in short spans, in the order of travel.

    Parameters
    ----------
    points
        (n, 4, 2) Bezier control points, mm. Consecutive spans of a ring share their end point bit for
        bit; a line's inner points lie at its thirds.
    interval_mm
        (n,) knot interval of the span; the length of a line. A POLY block's PL, before rescaling.
    kind, piece, ring, layer
        (n,) kind, piece, ring and layer of each span.
    """

    points: Floats
    interval_mm: Floats
    kind: NDArray[np.uint8]
    piece: Ints
    ring: Ints
    layer: Ints

    def __len__(self) -> int:
        """Return the number of spans."""
        return len(self.points)


def span_counts(kind: NDArray[np.uint8], control_starts: Ints, knots: Floats, knot_starts: Ints) -> Ints:
    """Number of NC blocks of each piece, (P,): non-empty knot spans of a spline, segments of a line, one for an arc."""
    counts: Ints = np.maximum(np.diff(control_starts) - 1, 0)
    counts[kind == ARC] = 1
    curved = np.flatnonzero(kind == SPLINE)
    if curved.size:
        rises = np.concatenate([[0], np.cumsum(np.diff(knots) > 0.0)])
        counts[curved] = rises[knot_starts[curved + 1] - 1] - rises[knot_starts[curved]]
    return counts


def bezier_counts(
    kind: NDArray[np.uint8], control: Floats, control_starts: Ints, knots: Floats, knot_starts: Ints
) -> Ints:
    """Number of Bezier spans of each piece, (P,): as :func:`span_counts`, but an arc has several, to follow the circle."""
    counts = span_counts(kind, control_starts, knots, knot_starts)
    _count_arc_spans(kind, control, control_starts, counts)
    return counts


@kernel
def _count_arc_spans(kind: NDArray[np.uint8], control: Floats, control_starts: Ints, counts: Ints) -> None:
    for p in range(kind.size):
        if kind[p] == ARC:
            counts[p] = arc_span_count(control[control_starts[p] : control_starts[p + 1]])


@kernel
def fill_spans(
    kind: NDArray[np.uint8],
    control: Floats,
    control_starts: Ints,
    knots: Floats,
    knot_starts: Ints,
    span_starts: Ints,
    points: Floats,
    intervals: Floats,
) -> None:
    """Write the Bezier points and intervals of the spans of every piece."""
    for p in range(kind.size):
        C = control[control_starts[p] : control_starts[p + 1]]
        B = points[span_starts[p] : span_starts[p + 1]]
        h = intervals[span_starts[p] : span_starts[p + 1]]
        if kind[p] == LINE:
            _line_spans(C, B, h)
        elif kind[p] == ARC:
            arc_spans(C, B, h)
        else:
            _spline_spans(C, knots[knot_starts[p] : knot_starts[p + 1]], B, h)


@kernel
def _line_spans(C: Floats, B: Floats, h: Floats) -> None:
    for i in range(len(C) - 1):
        B[i, 0] = C[i]
        B[i, 1] = C[i] + (C[i + 1] - C[i]) / 3.0
        B[i, 2] = C[i] + (C[i + 1] - C[i]) * (2.0 / 3.0)
        B[i, 3] = C[i + 1]
        h[i] = np.hypot(C[i + 1, 0] - C[i, 0], C[i + 1, 1] - C[i, 1])


@kernel
def blossom(C: Floats, U: Floats, j: int, a: float, b: float, c: float, axis: int) -> float:
    """Value at (a, b, c) of the blossom of the cubic on the span ``[U[j], U[j + 1]]`` (de Boor)."""
    d0, d1, d2, d3 = C[j - 3, axis], C[j - 2, axis], C[j - 1, axis], C[j, axis]
    w = (a - U[j - 2]) / (U[j + 1] - U[j - 2])
    d0 += (d1 - d0) * w
    w = (a - U[j - 1]) / (U[j + 2] - U[j - 1])
    d1 += (d2 - d1) * w
    w = (a - U[j]) / (U[j + 3] - U[j])
    d2 += (d3 - d2) * w
    w = (b - U[j - 1]) / (U[j + 1] - U[j - 1])
    d0 += (d1 - d0) * w
    w = (b - U[j]) / (U[j + 2] - U[j])
    d1 += (d2 - d1) * w
    w = (c - U[j]) / (U[j + 1] - U[j])
    return float(d0 + (d1 - d0) * w)


@kernel
def _spline_spans(C: Floats, U: Floats, B: Floats, h: Floats) -> None:
    i = 0
    for j in range(DEGREE, U.size - DEGREE - 1):
        a, b = U[j], U[j + 1]
        if not b > a:
            continue
        for axis in range(2):
            B[i, 0, axis] = C[0, axis] if i == 0 else B[i - 1, 3, axis]
            B[i, 1, axis] = blossom(C, U, j, a, a, b, axis)
            B[i, 2, axis] = blossom(C, U, j, a, b, b, axis)
            B[i, 3, axis] = C[len(C) - 1, axis] if i == len(B) - 1 else blossom(C, U, j, b, b, b, axis)
        h[i] = b - a
        i += 1


@kernel
def evaluate_spline(C: Floats, U: Floats, at: Floats) -> Floats:
    """Points (n, 2) of one cubic B-spline at parameters within its knots."""
    result = np.empty((at.size, 2))
    for i in range(at.size):
        t = at[i]
        j = np.searchsorted(U, t, side="right") - 1
        j = min(max(j, DEGREE), len(C) - 1)
        while j > DEGREE and not U[j + 1] > U[j]:
            j -= 1
        for axis in range(2):
            result[i, axis] = blossom(C, U, j, t, t, t, axis)
    return result


@kernel
def evaluate_bezier(B: Floats, t: float, axis: int) -> float:
    """Coordinate at t in 0 .. 1 of one Bezier span (4, 2)."""
    s = 1.0 - t
    return float(
        s * s * s * B[0, axis]
        + 3.0 * s * s * t * B[1, axis]
        + 3.0 * s * t * t * B[2, axis]
        + t * t * t * B[3, axis]
    )


@kernel
def bezier_derivative(B: Floats, t: float, axis: int) -> float:
    """Derivative of a coordinate at t in 0 .. 1 of one Bezier span (4, 2)."""
    s = 1.0 - t
    return float(
        3.0 * s * s * (B[1, axis] - B[0, axis])
        + 6.0 * s * t * (B[2, axis] - B[1, axis])
        + 3.0 * t * t * (B[3, axis] - B[2, axis])
    )


@kernel
def arc_lengths(B: Floats, nodes: Floats, weights: Floats) -> Floats:
    """Arc length of each Bezier span, (n,)."""
    result = np.zeros(len(B))
    for i in range(len(B)):
        for k in range(nodes.size):
            t = 0.5 * (nodes[k] + 1.0)
            speed = np.hypot(bezier_derivative(B[i], t, 0), bezier_derivative(B[i], t, 1))
            result[i] += 0.5 * weights[k] * speed
    return result


@kernel
def chords_for_step(B: Floats, kind: NDArray[np.uint8], step: float) -> Ints:
    """Equal parameter steps of each span whose chords are at most `step` long, (n,).

    A Bezier curve is nowhere faster than three times the longest leg of its control polygon.
    """
    result = np.empty(len(B), dtype=np.int64)
    for i in range(len(B)):
        speed = 0.0
        for k in range(3):
            speed = max(speed, 3.0 * np.hypot(B[i, k + 1, 0] - B[i, k, 0], B[i, k + 1, 1] - B[i, k, 1]))
        if kind[i] == LINE:
            speed = np.hypot(B[i, 3, 0] - B[i, 0, 0], B[i, 3, 1] - B[i, 0, 1])
        result[i] = max(1, int(np.ceil(min(speed / step, 2.0**31))))
    return result


@kernel
def chords_for_tolerance(B: Floats, kind: NDArray[np.uint8], tolerance: float) -> Ints:
    """Equal parameter steps of each span whose chords stay within `tolerance` of the curve, (n,).

    The chord of a step t leaves the curve by at most t^2 / 8 times the largest second derivative,
    which is six times the largest second difference of the control points.
    """
    result = np.empty(len(B), dtype=np.int64)
    for i in range(len(B)):
        bend = 0.0
        if kind[i] != LINE:
            for k in range(2):
                x = B[i, k, 0] - 2.0 * B[i, k + 1, 0] + B[i, k + 2, 0]
                y = B[i, k, 1] - 2.0 * B[i, k + 1, 1] + B[i, k + 2, 1]
                bend = max(bend, 6.0 * np.hypot(x, y))
        result[i] = max(1, int(np.ceil(min(np.sqrt(bend / (8.0 * tolerance)), 2.0**31))))
    return result


@kernel
def sample_spans(B: Floats, kind: NDArray[np.uint8], chords: Ints, places: Ints, points: Floats) -> None:
    """Write the first ``chords[i]`` points of each span, without its end, from row ``places[i]`` on."""
    for i in range(len(B)):
        for k in range(chords[i]):
            t = k / chords[i]
            for axis in range(2):
                if kind[i] == LINE:
                    value = B[i, 0, axis] + (B[i, 3, axis] - B[i, 0, axis]) * t
                elif k == 0:
                    value = B[i, 0, axis]
                else:
                    value = evaluate_bezier(B[i], t, axis)
                points[places[i] + k, axis] = value


# -- Circular arcs given by three points: start, the point half-way along, and end -----------------------------


LARGEST_SPAN_RAD = math.radians(5.0)
"""Largest sweep of one cubic span of an arc: the span leaves the circle by less than 1e-11 of the radius."""


class Arc(NamedTuple):
    """Circle and sweep of an arc."""

    x: float
    """Centre, mm."""
    y: float
    radius: float
    """mm."""
    start: float
    """Direction from the centre to the start, rad."""
    sweep: float
    """Signed angle from start to end, rad; positive counter-clockwise, under a full turn."""


@kernel
def arc_through(C: Floats) -> Arc:
    """Arc through start, middle and end (3, 2); its middle need not lie half-way. Radius infinite where it is straight."""
    ax, ay = C[0, 0] - C[1, 0], C[0, 1] - C[1, 1]
    bx, by = C[2, 0] - C[1, 0], C[2, 1] - C[1, 1]
    twice = 2.0 * (ax * by - ay * bx)
    if twice == 0.0:
        return Arc(math.inf, math.inf, math.inf, 0.0, 0.0)
    a2, b2 = ax * ax + ay * ay, bx * bx + by * by
    ux, uy = (by * a2 - ay * b2) / twice, (ax * b2 - bx * a2) / twice
    x, y = C[1, 0] + ux, C[1, 1] + uy
    start = math.atan2(C[0, 1] - y, C[0, 0] - x)
    end = math.atan2(C[2, 1] - y, C[2, 0] - x)
    sweep = end - start
    if twice < 0.0:  # the middle lies to the right of the chord: counter-clockwise
        sweep += 2.0 * math.pi if sweep <= 0.0 else 0.0
    else:
        sweep -= 2.0 * math.pi if sweep >= 0.0 else 0.0
    return Arc(x, y, math.hypot(ux, uy), start, sweep)


@kernel
def arc_point(arc: Arc, share: float) -> tuple[float, float]:
    """Point at a share 0 .. 1 of the sweep."""
    angle = arc.start + share * arc.sweep
    return arc.x + arc.radius * math.cos(angle), arc.y + arc.radius * math.sin(angle)


@kernel
def arc_span_count(C: Floats) -> int:
    """Cubic spans that stand for an arc."""
    return max(1, math.ceil(abs(arc_through(C).sweep) / LARGEST_SPAN_RAD - 1e-9))


@kernel
def arc_spans(C: Floats, B: Floats, h: Floats) -> None:
    """Write the Bezier points (n, 4, 2) and lengths (n,) of the spans of an arc; the ends are those given, bit for bit."""
    arc = arc_through(C)
    n = len(B)
    if math.isinf(arc.radius):
        for i in range(n):
            for k in range(4):
                B[i, k] = C[0] + (C[2] - C[0]) * ((i + k / 3.0) / n)
            h[i] = math.hypot(C[2, 0] - C[0, 0], C[2, 1] - C[0, 1]) / n
        B[n - 1, 3] = C[2]
        return
    step = arc.sweep / n
    leg = 4.0 / 3.0 * math.tan(0.25 * step) * arc.radius
    for i in range(n):
        a, b = arc.start + i * step, arc.start + (i + 1) * step
        px, py = arc_point(arc, i / n)
        qx, qy = arc_point(arc, (i + 1) / n)
        B[i, 0, 0], B[i, 0, 1] = px, py
        B[i, 1, 0], B[i, 1, 1] = px - leg * math.sin(a), py + leg * math.cos(a)
        B[i, 2, 0], B[i, 2, 1] = qx + leg * math.sin(b), qy - leg * math.cos(b)
        B[i, 3, 0], B[i, 3, 1] = qx, qy
        h[i] = abs(step) * arc.radius
    B[0, 0] = C[0]
    B[n - 1, 3] = C[2]
    for i in range(1, n):
        B[i, 0] = B[i - 1, 3]

"""Clamped cubic B-splines through the points of curved runs (paper, equations 5 to 10).

The paper solves its tridiagonal system (10) for the control points. The same spline is found here
from the derivatives ``m_k`` at the points,

    h_k m_(k-1) + 2 (h_(k-1) + h_k) m_k + h_(k-1) m_(k+1)
        = 3 (h_k (V_k - V_(k-1)) / h_(k-1) + h_(k-1) (V_(k+1) - V_k) / h_k),

which states that the second derivative is continuous. That system is diagonally dominant for any
spacing of the points, serves clamped and periodic ends alike, and gives the control points as blossoms.

How far a curve can leave its chord: with centripetal steps ``h = sqrt(chord)`` the derivative at a
point is of the order of the shorter of the two steps beside it, so that each span stays within
:data:`BULGE_LIMIT` of its own chord however uneven the points are: corners are out of the way, and no
turn inside a run is over 40 degrees. (A corner angle near 0 lets cusps into the runs; the limit is then
three times that.) Steps by chord length do not keep that limit where points are uneven.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ebamcheck.curves.bezier import fill_spans, span_counts
from ebamcheck.curves.splitting import LINE, Runs
from ebamcheck.numeric.kernels import kernel, run_blocks
from ebamcheck.numeric.rings import Floats, Ints

DEGREE = 3

CENTRIPETAL, CHORD_LENGTH = 0.5, 1.0
"""Power of the chord length in the parameter step: centripetal (paper, equation 6; Lee 1989), and the one that keeps the
curvature of a circle."""

BULGE_LIMIT = 0.6
"""No span leaves its chord by more than this multiple of the chord's length, at the default corner angle.

The most found on random runs with chords of 1 um .. 100 mm and turns up to 40 degrees is 0.48."""

PIECES_A_BLOCK = 256
"""Fewest pieces worth a thread."""


def interpolate(runs: Runs, power: float = CENTRIPETAL) -> tuple[Floats, Ints, Floats, Ints]:
    """Control points and knots of every run, with steps that go as a power of the chords.

    A curved run of n + 1 points gets n + 3 control points and n + 7 knots, of which the first and the
    last four are equal. The paper's parameters 0 .. 1 are scaled to the length of the run's chords, mm,
    which leaves the curve as it is; a derivative is then about 1. A straight run keeps its points as
    control points and has no knots.

    At an end that is not tied to a straight neighbour the tangent is that of the circle through the
    last three points, and the speed is extrapolated from the lengths of its arcs.

    Returns
    -------
    control : (M, 2) mm
    control_starts : (P + 1,)
    knots : (K,) mm
    knot_starts : (P + 1,)
    """
    sizes = np.diff(runs.starts)
    curved = runs.kind != LINE
    control_starts = np.concatenate([[0], np.cumsum(sizes + 2 * curved)]).astype(np.int64)
    knot_starts = np.concatenate([[0], np.cumsum(np.where(curved, sizes + 6, 0))]).astype(np.int64)
    control = np.empty((int(control_starts[-1]), 2))
    knots = np.empty(int(knot_starts[-1]))

    def work(first: int, last: int) -> None:
        _interpolate(runs, power, first, last, control, control_starts, knots, knot_starts)

    run_blocks(work, sizes.size, PIECES_A_BLOCK)
    return control, control_starts, knots, knot_starts


@kernel
def _interpolate(
    runs: Runs,
    power: float,
    first: int,
    last: int,
    control: Floats,
    control_starts: Ints,
    knots: Floats,
    knot_starts: Ints,
) -> None:
    for p in range(first, last):
        V = runs.points[runs.starts[p] : runs.starts[p + 1]]
        C = control[control_starts[p] : control_starts[p + 1]]
        if runs.kind[p] == LINE:
            C[:] = V
            continue
        h, u = _steps(V, power)
        m = _periodic_derivatives(V, h) if runs.periodic[p] else _clamped_derivatives(V, h, runs.tangents[p])
        _control_points(V, m, h, C)
        U = knots[knot_starts[p] : knot_starts[p + 1]]
        U[: DEGREE + 1] = 0.0
        U[DEGREE : U.size - DEGREE] = u
        U[U.size - DEGREE - 1 :] = u[-1]


@kernel
def _steps(V: Floats, power: float) -> tuple[Floats, Floats]:
    """Knot intervals (n,) and parameters (n + 1,) of equation 6, scaled to the length of the chords."""
    n = len(V) - 1
    h = np.empty(n)
    length = total = 0.0
    for k in range(n):
        chord = np.hypot(V[k + 1, 0] - V[k, 0], V[k + 1, 1] - V[k, 1])
        h[k] = chord**power
        length += chord
        total += h[k]
    u = np.zeros(n + 1)
    for k in range(n):
        h[k] *= length / total
        u[k + 1] = u[k] + h[k]
    for k in range(n):  # the intervals as the rounded knots have them
        h[k] = u[k + 1] - u[k]
    return h, u


@kernel
def _clamped_derivatives(V: Floats, h: Floats, tangents: Floats) -> Floats:
    """Derivatives (n + 1, 2) with both end vectors given: F_0 and F_n of equation 8."""
    n = h.size
    m = np.empty((n + 1, 2))
    m[0] = _end_vector(V, h, tangents[0], tangents[1])
    back = _end_vector(V[::-1], h[::-1], -tangents[1], -tangents[0])
    m[n] = -back
    factor = np.empty(n + 1)
    factor[0] = 0.0
    for k in range(1, n):  # forward sweep of the tridiagonal system
        pivot = 2.0 * (h[k - 1] + h[k]) - h[k] * factor[k - 1]
        factor[k] = h[k - 1] / pivot
        for axis in range(2):
            m[k, axis] = (_right_side(V, h, k - 1, k, k + 1, axis) - h[k] * m[k - 1, axis]) / pivot
    for k in range(n - 1, 0, -1):
        m[k] -= factor[k] * m[k + 1]
    return m


@kernel
def _right_side(V: Floats, h: Floats, i: int, k: int, j: int, axis: int) -> float:
    """Right side of row k: neighbours i and j, intervals ``h[i]`` and ``h[k]``."""
    before = (V[k, axis] - V[i, axis]) / h[i]
    after = (V[j, axis] - V[k, axis]) / h[k]
    return float(3.0 * (h[k] * before + h[i] * after))


@kernel
def _periodic_derivatives(V: Floats, h: Floats) -> Floats:
    """Derivatives (n + 1, 2) of the closed curve; the first equals the last.

    The corner entries of the cyclic system are taken out by Sherman and Morrison's formula.
    """
    n = h.size
    pivot = np.empty(n)
    factor = np.empty(n)
    m = np.empty((n + 1, 2))
    z = np.zeros(n)
    gamma = -2.0 * (h[n - 1] + h[0])
    for k in range(n):
        i = k - 1 if k > 0 else n - 1
        diagonal = 2.0 * (h[i] + h[k])
        if k == 0:
            diagonal -= gamma
        elif k == n - 1:
            diagonal -= h[n - 2] * h[0] / gamma
        pivot[k] = diagonal - (h[k] * factor[k - 1] if k > 0 else 0.0)
        factor[k] = h[i] / pivot[k]
        for axis in range(2):
            carried = h[k] * m[k - 1, axis] if k > 0 else 0.0
            m[k, axis] = (_right_side(V, h, i, k, k + 1, axis) - carried) / pivot[k]
        column = gamma if k == 0 else (h[n - 2] if k == n - 1 else 0.0)
        z[k] = (column - (h[k] * z[k - 1] if k > 0 else 0.0)) / pivot[k]
    for k in range(n - 2, -1, -1):
        m[k] -= factor[k] * m[k + 1]
        z[k] -= factor[k] * z[k + 1]
    scale = 1.0 + z[0] + h[0] * z[n - 1] / gamma
    for axis in range(2):
        share = (m[0, axis] + h[0] * m[n - 1, axis] / gamma) / scale
        for k in range(n):
            m[k, axis] -= share * z[k]
    m[n] = m[0]
    return m


@kernel
def _end_vector(V: Floats, h: Floats, tangent: Floats, opposite: Floats) -> Floats:
    """Derivative at the first point: along the tangent if it is given, else of the circle there.

    With two points only, a free end mirrors the given tangent of the other end, as a circle would.
    """
    ax, ay = V[1, 0] - V[0, 0], V[1, 1] - V[0, 1]
    alone = len(V) == 2
    if alone:
        cx, cy = opposite[0], opposite[1]
        inscribed = np.arctan2(ax * cy - ay * cx, ax * cx + ay * cy) if np.isnan(tangent[0]) else 0.0
        next_angle = 0.0
    else:
        bx, by = V[2, 0] - V[1, 0], V[2, 1] - V[1, 1]
        cx, cy = V[2, 0] - V[0, 0], V[2, 1] - V[0, 1]
        inscribed = np.arctan2(cx * by - cy * bx, cx * bx + cy * by)
        next_angle = np.arctan2(ax * cy - ay * cx, ax * cx + ay * cy)
    result = np.empty(2)
    if np.isnan(tangent[0]):
        # The chord makes with the tangent the angle that it subtends at the third point.
        chord = np.hypot(ax, ay)
        c, s = np.cos(inscribed), np.sin(inscribed)
        result[0] = (ax * c + ay * s) / chord
        result[1] = (ay * c - ax * s) / chord
        angle = inscribed
    else:
        result[:] = tangent
        angle = np.arctan2(tangent[0] * ay - tangent[1] * ax, tangent[0] * ax + tangent[1] * ay)
    speed = np.hypot(ax, ay) * _arc_over_chord(angle) / h[0]
    if not alone:
        following = np.hypot(bx, by) * _arc_over_chord(next_angle) / h[1]
        speed += (speed - following) * h[0] / (h[0] + h[1])
    result *= max(speed, 0.0)
    return result


@kernel
def _arc_over_chord(angle: float) -> float:
    """Length of an arc over that of its chord, by the angle between tangent and chord (up to pi/2)."""
    angle = min(abs(angle), 0.5 * np.pi)
    return float(angle / np.sin(angle)) if angle > 1e-8 else 1.0


@kernel
def _control_points(V: Floats, m: Floats, h: Floats, C: Floats) -> None:
    """Control points from points and derivatives: the inner ones are blossoms f(u_(k-1), u_k, u_(k+1)).

    Each is extrapolated from the span beside it that is the longer, which never magnifies rounding.
    """
    n = h.size
    for axis in range(2):
        C[0, axis] = V[0, axis]
        C[1, axis] = V[0, axis] + m[0, axis] * h[0] / 3.0
        for k in range(1, n):
            if h[k] >= h[k - 1]:
                near = V[k, axis] + m[k, axis] * h[k] / 3.0
                far = V[k + 1, axis] - m[k + 1, axis] * h[k] / 3.0
                ratio = h[k - 1] / h[k]
            else:
                near = V[k, axis] - m[k, axis] * h[k - 1] / 3.0
                far = V[k - 1, axis] + m[k - 1, axis] * h[k - 1] / 3.0
                ratio = h[k] / h[k - 1]
            C[k + 1, axis] = near + (near - far) * ratio
        C[n + 1, axis] = V[n, axis] - m[n, axis] * h[n - 1] / 3.0
        C[n + 2, axis] = V[n, axis]


# -- Bulge: how far the spans of fitted curves leave the chords between the points that they interpolate -------


def bulges(
    control: Floats, control_starts: Ints, knots: Floats, knot_starts: Ints, kind: NDArray[np.uint8]
) -> Floats:
    """Greatest distance of each piece's curve from its chords, (P,) mm; 0 for lines.

    The distance of a cubic from the line through its ends is a cubic with two known roots, so its extremes are
    those of a quadratic: exact, without sampling.
    """
    counts = span_counts(kind, control_starts, knots, knot_starts)
    starts = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    spans, intervals = np.empty((int(starts[-1]), 4, 2)), np.empty(int(starts[-1]))
    fill_spans(kind, control, control_starts, knots, knot_starts, starts, spans, intervals)
    return _bulges(spans, starts, kind)


@kernel
def _bulges(spans: Floats, starts: Ints, kind: NDArray[np.uint8]) -> Floats:
    result = np.zeros(kind.size)
    for p in range(kind.size):
        if kind[p] == LINE:
            continue
        for i in range(starts[p], starts[p + 1]):
            result[p] = max(result[p], _bulge(spans[i]))
    return result


@kernel
def _bulge(B: Floats) -> float:
    dx, dy = B[3, 0] - B[0, 0], B[3, 1] - B[0, 1]
    chord = np.hypot(dx, dy)
    if chord == 0.0:
        return float(
            max(
                np.hypot(B[1, 0] - B[0, 0], B[1, 1] - B[0, 1]), np.hypot(B[2, 0] - B[0, 0], B[2, 1] - B[0, 1])
            )
        )
    d1 = ((B[1, 1] - B[0, 1]) * dx - (B[1, 0] - B[0, 0]) * dy) / chord
    d2 = ((B[2, 1] - B[0, 1]) * dx - (B[2, 0] - B[0, 0]) * dy) / chord
    # d(t) = 3 (1 - t)^2 t d1 + 3 (1 - t) t^2 d2; its derivative over 3 is a t^2 + b t + c.
    a, b, c = 3.0 * (d1 - d2), 2.0 * d2 - 4.0 * d1, d1
    largest = 0.0
    if a == 0.0:
        if b != 0.0:
            largest = _across(d1, d2, -c / b)
    else:
        root = np.sqrt(max(b * b - 4.0 * a * c, 0.0))
        largest = max(_across(d1, d2, (-b - root) / (2.0 * a)), _across(d1, d2, (-b + root) / (2.0 * a)))
    return largest


@kernel
def _across(d1: float, d2: float, t: float) -> float:
    """Distance from the chord's line at t, 0 outside of the span."""
    if not 0.0 < t < 1.0:
        return 0.0
    s = 1.0 - t
    return float(abs(3.0 * s * s * t * d1 + 3.0 * s * t * t * d2))

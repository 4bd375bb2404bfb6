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

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_banded

from ebamcheck.columns_file import starts_of
from ebamcheck.curves.bezier import span_points
from ebamcheck.curves.runs import LINE, Runs, angles
from ebamcheck.geometry.raster import each_of
from ebamcheck.kernels import Bools, Floats, Ints

CENTRIPETAL, CHORD_LENGTH = 0.5, 1.0
"""Power of the chord length in the parameter step: centripetal (paper, equation 6; Lee 1989), and the one that keeps the
curvature of a circle."""

BULGE_LIMIT = 0.6
"""No span leaves its chord by more than this multiple of the chord's length, at the default corner angle.

The most found on random runs with chords of 1 um .. 100 mm and turns up to 40 degrees is 0.48."""


def interpolate(runs: Runs, power: float = CENTRIPETAL) -> tuple[tuple[Ints, Floats], tuple[Ints, Floats]]:
    """Starts (P + 1,) of the control points (M, 2) of each run, and these; the same of the knots (K,); all in mm.

    A curved run of n + 1 points gets n + 3 control points and n + 7 knots, of which the first and the
    last four are equal. The paper's parameters 0 .. 1 are scaled to the length of the run's chords,
    which leaves the curve as it is; a derivative is then about 1. A straight run keeps its points as
    control points and has no knots.

    At an end that is not tied to a straight neighbour the tangent is that of the circle through the
    last three points, and the speed is extrapolated from the lengths of its arcs.
    """
    sizes = np.diff(runs.starts)
    curved = runs.kind != LINE
    control_starts = starts_of(sizes + 2 * curved)
    knot_starts = starts_of(np.where(curved, sizes + 6, 0))
    control, knots = np.empty((int(control_starts[-1]), 2)), np.empty(int(knot_starts[-1]))
    run, place = each_of(sizes)
    some = curved[run]
    control[(control_starts[run] + place)[~some]] = runs.points[~some]
    if some.any():
        rows = starts_of(sizes[curved])
        splines = _Splines(runs.points[some], rows, runs.periodic[curved], runs.tangents[curved], power)
        own, inside = each_of(sizes[curved] + 2)
        control[control_starts[:-1][curved][own] + inside] = splines.control_points()
        # Each run's parameters, its first and last three times more.
        own, inside = each_of(sizes[curved] + 6)
        knots[:] = splines.parameters[rows[own] + np.clip(inside - 3, 0, sizes[curved][own] - 1)]
    return (control_starts, control), (knot_starts, knots)


class _Splines:
    """Curved runs, one after the other, with a row for each point; run p has the rows ``starts[p] .. starts[p + 1] - 1``."""

    def __init__(self, points: Floats, starts: Ints, periodic: Bools, tangents: Floats, power: float) -> None:
        self.points, self.starts, self.periodic, self.tangents = points, starts, periodic, tangents
        self.first, self.last = starts[:-1], starts[1:] - 1
        self.run, _ = each_of(np.diff(starts))
        inner = np.ones(len(points), np.bool_)  # points after which an interval follows
        inner[self.last] = False
        chord = np.hypot(*np.diff(points, axis=0, append=points[-1:]).T) * inner
        step = np.where(inner, chord**power, 0.0)
        length, total = (np.bincount(self.run, w, minlength=self.first.size) for w in (chord, step))
        step *= (length / total)[self.run]
        self.parameters = np.zeros(len(points))
        for a, b in zip(self.first.tolist(), self.last.tolist(), strict=True):
            np.cumsum(step[a:b], out=self.parameters[a + 1 : b + 1])
        self.interval = np.where(inner, np.diff(self.parameters, append=0.0), 1.0)

    def derivatives(self) -> Floats:
        """Derivatives (n, 2) at all points: one banded system; the cyclic corners are taken out by Sherman and Morrison."""
        h, points, first, last = self.interval, self.points, self.first, self.last
        around = self.periodic[self.run]
        back = np.roll(h, 1)
        back[first] = h[last - 1]
        middle = np.ones(len(points), np.bool_)
        middle[last] = False
        middle[first] = self.periodic
        step = np.roll(points, -1, axis=0) - points
        ahead = step / h[:, None]
        behind = np.roll(ahead, 1, axis=0)
        behind[first] = ahead[last - 1]
        right = np.where(middle[:, None], 3.0 * (h[:, None] * behind + back[:, None] * ahead), 0.0)
        low, high = np.where(middle, h, 0.0), np.where(middle, back, 0.0)
        diagonal = np.where(middle, 2.0 * (back + h), 1.0)
        low[first] = 0.0
        column = np.zeros(len(points))
        a, b = first[self.periodic], last[self.periodic] - 1
        gamma = -2.0 * (h[b] + h[a])
        diagonal[a] -= gamma
        diagonal[b] -= back[b] * h[a] / gamma
        high[b] = 0.0
        column[a] += gamma
        column[b] += back[b]
        ends = first[~self.periodic], last[~self.periodic]
        right[ends[0]], right[ends[1]] = self._end_vectors()
        bands = np.stack([np.roll(high, 1), diagonal, np.roll(low, -1)])
        solved = solve_banded((1, 1), bands, np.column_stack([right, column]))
        m, z = solved[:, :2], solved[:, 2]
        if a.size:
            share = (m[a] + (h[a] / gamma)[:, None] * m[b]) / (1.0 + z[a] + h[a] * z[b] / gamma)[:, None]
            wide = np.zeros((self.first.size, 2))
            wide[self.periodic] = share
            m = np.where(around[:, None], m - wide[self.run] * z[:, None], m)
            m[b + 1] = m[a]
        return np.asarray(m)

    def _end_vectors(self) -> tuple[Floats, Floats]:
        """Derivatives at both ends of the runs that are not periodic."""
        open_ = ~self.periodic
        first, last, tangents = self.first[open_], self.last[open_], self.tangents[open_]
        alone = last == first + 1
        third, second = np.where(alone, first + 1, first + 2), np.where(alone, last - 1, last - 2)
        V, h = self.points, self.interval
        points, steps = (V[first], V[first + 1], V[third]), (h[first], h[third - 1])
        start = _end_vector(points, steps, tangents[:, 0], tangents[:, 1], alone)
        points, steps = (V[last], V[last - 1], V[second]), (h[last - 1], h[second])
        return start, -_end_vector(points, steps, -tangents[:, 1], -tangents[:, 0], alone)

    def control_points(self) -> Floats:
        """Control points of all runs: the inner ones are blossoms f(u_(k-1), u_k, u_(k+1)).

        Each is extrapolated from the span beside it that is the longer, which never magnifies rounding.
        """
        V, h = self.points, self.interval[:, None]
        m = self.derivatives()
        back, right = np.roll(h, 1, axis=0), h >= np.roll(h, 1, axis=0)
        ahead, arriving = V + m * h / 3.0, V - m * back / 3.0
        far = np.where(right, np.roll(arriving, -1, axis=0), np.roll(ahead, 1, axis=0))
        near = np.where(right, ahead, arriving)
        inner = near + (near - far) * np.where(right, back / h, h / back)
        more = 2 * np.arange(self.first.size)
        found = np.empty((len(V) + 2 * more.size, 2))
        found[np.arange(len(V)) + 2 * self.run + 1] = inner
        found[self.first + more], found[self.first + more + 1] = V[self.first], ahead[self.first]
        found[self.last + more + 1], found[self.last + more + 2] = arriving[self.last], V[self.last]
        return found


def _end_vector(
    points: Sequence[Floats], steps: Sequence[Floats], tangent: Floats, opposite: Floats, alone: Bools
) -> Floats:
    """Derivative at the first of three points: along the tangent if it is given, else of the circle there.

    With two points only, a free end mirrors the given tangent of the other end, as a circle would.
    """
    a, b, c = points[1] - points[0], points[2] - points[1], points[2] - points[0]
    free = np.isnan(tangent[:, 0])
    inscribed = np.where(alone, angles(a, opposite), angles(c, b))
    chord = np.hypot(*a.T)
    cosine, sine = np.cos(inscribed), np.sin(inscribed)
    # The chord makes with the tangent the angle that it subtends at the third point.
    round_ = np.column_stack([a[:, 0] * cosine + a[:, 1] * sine, a[:, 1] * cosine - a[:, 0] * sine])
    direction = np.where(free[:, None], round_ / chord[:, None], tangent)
    angle = np.where(free, inscribed, angles(tangent, a))
    speed = chord * _arc_over_chord(angle) / steps[0]
    following = np.hypot(*b.T) * _arc_over_chord(angles(a, c)) / steps[1]
    more = (speed - following) * steps[0] / (steps[0] + steps[1])
    return np.asarray(direction * np.maximum(speed + np.where(alone, 0.0, more), 0.0)[:, None])


def _arc_over_chord(angle: Floats) -> Floats:
    """Length of an arc over that of its chord, by the angle between tangent and chord (up to pi/2)."""
    angle = np.minimum(np.abs(angle), 0.5 * np.pi)
    return np.where(angle > 1e-8, angle / np.sin(np.maximum(angle, 1e-8)), 1.0)


def bulges(control: tuple[Ints, Floats], knots: tuple[Ints, Floats], kind: NDArray[np.uint8]) -> Floats:
    """Greatest distance of each piece's curve from the chords between its points, (P,) mm; 0 for lines.

    The distance of a cubic from the line through its ends is a cubic with two known roots, so its extremes are
    those of a quadratic: exact, without sampling.
    """
    B, _, piece = span_points(kind, control[1], control[0], knots[1], knots[0])
    chord = B[:, 3] - B[:, 0]
    length = np.hypot(*chord.T)
    legs = B[:, 1:3] - B[:, :1]
    with np.errstate(divide="ignore", invalid="ignore"):
        d1, d2 = ((legs[:, k, 1] * chord[:, 0] - legs[:, k, 0] * chord[:, 1]) / length for k in (0, 1))
        # d(t) = 3 (1 - t)^2 t d1 + 3 (1 - t) t^2 d2; its derivative over 3 is a t^2 + b t + c.
        a, b, c = 3.0 * (d1 - d2), 2.0 * d2 - 4.0 * d1, d1
        root = np.sqrt(np.maximum(b * b - 4.0 * a * c, 0.0))
        places = np.stack([np.where(a == 0.0, -c / b, (-b - root) / (2.0 * a)), (-b + root) / (2.0 * a)])
        off = np.abs(3.0 * (1.0 - places) * places * ((1.0 - places) * d1 + places * d2))
    inside = (places > 0.0) & (places < 1.0)
    largest = np.where(inside, off, 0.0).max(axis=0, initial=0.0)
    largest = np.where(length == 0.0, np.hypot(*legs.T).max(axis=0, initial=0.0), largest)
    found = np.zeros(kind.size)
    np.maximum.at(found, piece, np.where(kind[piece] == LINE, 0.0, largest))
    return found

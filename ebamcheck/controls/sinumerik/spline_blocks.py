"""What the control makes of BSPLINE blocks: knots from the intervals PL, one polynomial for each knot span."""

from __future__ import annotations

from typing import Literal

import numpy as np

from ebamcheck.numeric.rings import Floats, Ints

CUBIC = 3


def knot_vector(intervals: Floats, shift: Literal[2, 3], degree: int = CUBIC) -> Floats:
    """Knots (m + degree + 2,) of a spline of m + 1 control points from the m intervals PL of its blocks.

    Block i = 1 .. m of a cubic carries ``PL = U[i + shift] - U[i + shift - 1]``; one of degree 2 has a knot less
    before its first interval. The knots left over at the ends repeat their neighbours; the curve is tangential
    to the control polygon at both ends only if the outer degree + 1 coincide: else the program means the other convention, and is
    refused with a ValueError.
    """
    m = intervals.size
    _check_size(m, degree)
    if (intervals < 0.0).any():
        raise ValueError(f"PL={intervals.min():g} in a BSPLINE: intervals cannot be negative")
    before = shift - CUBIC + degree
    inner = np.concatenate([[0.0], np.cumsum(intervals)])
    knots = np.concatenate([np.zeros(before), inner, np.full(degree + 1 - before, inner[-1])])
    if knots[degree] != 0.0 or knots[m + 1] != knots[-1]:
        zeros = "first and last interval are" if shift == 2 else "last two intervals are"
        if degree < CUBIC:
            zeros = "first interval is" if shift == 2 else "last interval is"
        raise ValueError(f"BSPLINE read by the convention s={shift}: the {zeros} 0 there, but not here")
    if knots[-1] == 0.0:
        raise ValueError("a BSPLINE whose intervals PL are all 0 has no length")
    return knots


def even_knots(m: int, degree: int = CUBIC) -> Floats:
    """Clamped knots with intervals of 1, for m + 1 control points."""
    _check_size(m, degree)
    last = float(m + 1 - degree)
    return np.concatenate([np.zeros(degree), np.arange(last + 1.0), np.full(degree, last)])


def _check_size(m: int, degree: int) -> None:
    if m < degree:
        name = "cubic" if degree == CUBIC else "quadratic"
        raise ValueError(f"a BSPLINE of {m} blocks: a {name} needs at least {degree} after its first point")


def spline_spans(
    blocks: Floats, shift: Literal[2, 3, "uniform"], degree: int = CUBIC
) -> tuple[Ints, Floats, Floats]:
    """Split a spline of degree 2 or 3 into its knot spans, each over 0 <= t <= 1.

    `blocks` (m + 1, 3) are X, Y and PL of the control points; PL of the first, the position before, is not used, and none where the
    knots are uniform. Returns the block (S,) whose control point is the last to shape the span, its end (S, 2), mm, and the coefficients
    (S, 4) of t^2 and t^3 in X, then in Y.
    """
    m = len(blocks) - 1
    knots = even_knots(m, degree) if shift == "uniform" else knot_vector(blocks[1:, 2], shift, degree)
    from scipy.interpolate import BSpline  # half of the time that this package takes to import

    spline = BSpline(knots, blocks[:, :2], degree)
    index = degree + np.flatnonzero(np.diff(knots[degree : m + 2]) > 0.0)
    begin, h = knots[index], (knots[index + 1] - knots[index])[:, None]
    end = np.asarray(spline(knots[index + 1]), dtype=np.float64)
    end[-1] = blocks[-1, :2]
    # Taylor's series at the start of each span; the third derivative is that of the span to the right.
    curve = np.stack([spline(begin, 2) * h**2 / 2.0, spline(begin, 3) * h**3 / 6.0], axis=2)
    return index.astype(np.int64), end, curve.reshape(-1, 4)

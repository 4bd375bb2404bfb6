"""What the control makes of BSPLINE blocks: knots from the intervals PL, one polynomial for each knot span."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import BSpline

from ebamcheck.rings import Floats, Ints

DEGREE = 3


def knot_vector(intervals: Floats, shift: int) -> Floats:
    """Knots (m + 5,) of a spline of m + 1 control points from the m intervals PL of its blocks.

    Block i = 1 .. m carries ``PL = U[i + shift] - U[i + shift - 1]``. The knots left over at the ends repeat
    their neighbours; the curve is tangential to the control polygon at both ends only if the outer four
    coincide.

    Raises
    ------
    ValueError
        If an interval is negative, or the ends are not clamped: the program means the other convention.
    """
    m = intervals.size
    if m < DEGREE:
        raise ValueError(f"a BSPLINE of {m} blocks: a cubic needs at least {DEGREE} after its first point")
    if (intervals < 0.0).any():
        raise ValueError(f"PL={intervals.min():g} in a BSPLINE: intervals cannot be negative")
    inner = np.concatenate([[0.0], np.cumsum(intervals)])
    knots = np.concatenate([np.zeros(shift), inner, np.full(DEGREE + 1 - shift, inner[-1])])
    if knots[DEGREE] != 0.0 or knots[m + 1] != knots[-1]:
        zeros = "first and last interval are" if shift == 2 else "last two intervals are"
        raise ValueError(f"BSPLINE read by the convention s={shift}: the {zeros} 0 there, but not here")
    if knots[-1] == 0.0:
        raise ValueError("a BSPLINE whose intervals PL are all 0 has no length")
    return knots


def spline_spans(blocks: Floats, shift: int) -> tuple[Ints, Floats, Floats]:
    """Split a spline into its knot spans, each over 0 <= t <= 1.

    Parameters
    ----------
    blocks
        (m + 1, 3) X, Y and PL of the control points; PL of the first, the position before, is not used.
    shift
        Convention of PL, 2 or 3.

    Returns
    -------
    index
        (S,) block whose control point is the last to shape the span.
    end
        (S, 2) end points, mm.
    curve
        (S, 4) coefficients of t^2 and t^3 in X, then in Y.
    """
    knots = knot_vector(blocks[1:, 2], shift)
    spline = BSpline(knots, blocks[:, :2], DEGREE)
    index = DEGREE + np.flatnonzero(np.diff(knots[DEGREE : len(blocks) + 1]) > 0.0)
    begin, h = knots[index], (knots[index + 1] - knots[index])[:, None]
    end = np.asarray(spline(knots[index + 1]), dtype=np.float64)
    end[-1] = blocks[-1, :2]
    # Taylor's series at the start of each span; the third derivative is that of the span to the right.
    curve = np.stack([spline(begin, 2) * h**2 / 2.0, spline(begin, 3) * h**3 / 6.0], axis=2)
    return index.astype(np.int64), end, curve.reshape(-1, 4)

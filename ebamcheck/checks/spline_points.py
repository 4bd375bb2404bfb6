"""Points of a cubic B-spline by de Boor's algorithm, all at once."""

from __future__ import annotations

import numpy as np

from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Floats, Ints

DEGREE = 3


def spline_points(knots: Floats, control: Floats, at: Floats) -> Floats:
    """Points of a clamped cubic B-spline, (S, n, 2).

    Parameters
    ----------
    knots, control
        (m + 4,) and (m, 2).
    at
        (S, n) parameters: row s lies in the s-th span between two different knots, its ends included.

    References
    ----------
    C. de Boor, "On calculating with B-splines", J. Approx. Theory 6 (1972) 50.
    """
    span = np.flatnonzero(knots[1:] > knots[:-1])
    knots, control, at = (np.ascontiguousarray(column, np.float64) for column in (knots, control, at))
    return _blended(knots, control, at, span)


@kernel
def _blended(knots: Floats, control: Floats, at: Floats, span: Ints) -> Floats:
    """Points (S, n, 2): the control points of each span, blended three times."""
    result = np.empty((at.shape[0], at.shape[1], 2))
    place = np.empty((DEGREE + 1, 2))
    for s in range(at.shape[0]):
        first = span[s] - DEGREE
        for n in range(at.shape[1]):
            for k in range(DEGREE + 1):
                place[k, 0], place[k, 1] = control[first + k, 0], control[first + k, 1]
            for r in range(1, DEGREE + 1):
                for k in range(DEGREE, r - 1, -1):
                    low, high = knots[first + k], knots[span[s] + 1 + k - r]
                    share = (at[s, n] - low) / (high - low)
                    for axis in range(2):
                        place[k, axis] = (1.0 - share) * place[k - 1, axis] + share * place[k, axis]
            result[s, n, 0], result[s, n, 1] = place[DEGREE, 0], place[DEGREE, 1]
    return result

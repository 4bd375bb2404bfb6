"""Points of a cubic B-spline by de Boor's algorithm, all at once."""

from __future__ import annotations

import numpy as np

from ebamcheck.numeric.rings import Floats

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
    place = [control[span - DEGREE + k][:, None, :] for k in range(DEGREE + 1)]
    for r in range(1, DEGREE + 1):
        for k in range(DEGREE, r - 1, -1):
            low, high = knots[span - DEGREE + k], knots[span + 1 + k - r]
            share = ((at - low[:, None]) / (high - low)[:, None])[:, :, None]
            place[k] = (1.0 - share) * place[k - 1] + share * place[k]
    return np.asarray(place[DEGREE], np.float64)

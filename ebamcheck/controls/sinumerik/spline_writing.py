"""Splines as BSPLINE blocks of the SINUMERIK.

Repeated inner knots are written as they are, with an interval PL=0: the end blocks carry PL=0 in any case, by
either convention, so that a control that did not take it could drive no clamped spline at all.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from ebamcheck.nc.inputs import DEGREE
from ebamcheck.numeric.rings import Floats
from ebamcheck.writing.blocks import BlockFormat

# The control wants at least 6 spline blocks among any 10; shorter splines get further knots, exactly.
LEAST_SPLINE_BLOCKS = 6
EVEN_SHARE = 1e-9  # Knot intervals that differ by less, as a share of the longest, are even
# Curves move on by at most about so many mm for each mm of their knots, or the rounding of the knots would count; those of a fit run at
# 1.
FASTEST = 2.0


def spline_blocks(
    control: Floats, knots: Floats, form: BlockFormat, shift: Literal[2, 3, "uniform"]
) -> list[str]:
    """Blocks of one spline: its own G1, so that the control starts it anew, BSPLINE, and the control points."""
    opening = ["G1", f"BSPLINE SD={DEGREE}"]
    if shift == "uniform":
        while len(control) - 1 < LEAST_SPLINE_BLOCKS:
            control, knots = halved(control, knots)
        return opening + form.even_control_points(control)
    control, knots = refined(control, knots, LEAST_SPLINE_BLOCKS)
    return opening + form.control_points(control, knots * _stretch(control, knots), shift)


def even(knots: Floats) -> bool:
    """Whether the intervals of a clamped knot vector are all alike."""
    intervals = np.diff(knots[DEGREE : knots.size - DEGREE])
    return bool(np.ptp(intervals) <= EVEN_SHARE * intervals.max())


def _stretch(control: Floats, knots: Floats) -> float:
    """Factor of the knots such that the curve is nowhere much faster than they; the curve stays as it is.

    The derivative lies in the hull of ``3 (C[i+1] - C[i]) / (U[i+4] - U[i+1])``.
    """
    length = knots[DEGREE + 1 : DEGREE + len(control)] - knots[1 : len(control)]
    leg = np.hypot(*np.diff(control, axis=0).T)
    fastest = float(np.max(DEGREE * leg[length > 0.0] / length[length > 0.0]))
    return fastest if fastest > FASTEST else 1.0


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

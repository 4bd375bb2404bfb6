"""Bulge: how far the spans of fitted curves leave the chords between the points that they interpolate."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ebamcheck.curves.bezier import fill_spans, span_counts
from ebamcheck.curves.splitting import LINE
from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Floats, Ints


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

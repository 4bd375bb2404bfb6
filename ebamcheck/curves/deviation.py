"""Deviation: how far fitted curves lie from the contours that they were fitted to."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd

from ebamcheck.curves.bezier import bezier_derivative, evaluate_bezier
from ebamcheck.curves.cleaning import clean
from ebamcheck.curves.columns import Curves
from ebamcheck.errors import SettingsError
from ebamcheck.geometry.nearest import nearest, segments_along, tree_over
from ebamcheck.layers.stack import Layers
from ebamcheck.numeric.kernels import kernel, run_blocks
from ebamcheck.numeric.rings import Bools, Floats, Ints
from ebamcheck.settings.stages import CurveSettings

CHORDS_A_SPAN = 8
"""Chords by which a span is searched and at whose ends its distance is taken."""

REFINEMENTS = 6
"""Gauss-Newton steps by which the nearest point is moved along the true curve; each gains several digits."""

LAYERS_A_STEP = 64
"""Layers measured at a time; bounds the working memory."""


def fit_deviation(curves: Curves, layers: Layers) -> pd.DataFrame:
    """Distance between curves and their contours, one row a layer.

    Returns
    -------
    DataFrame with the columns ``layer``, ``height_mm``, ``kept_points_mm`` (greatest distance of a point
    that the cleaning kept from the curve: rounding, for a fit that interpolates), ``points_mm`` (of any
    point of the contour; the curve leaves the inner points of a chord as far as it bulges), ``bulge_mm`` (greatest distance of the curve
    from the contour's segments) and ``blocks`` (NC blocks). A layer without contours has zeros.

    Raises
    ------
    SettingsError
        If the curves were not fitted to these layers: other heights or rings.
    """
    same = np.array_equal(curves.heights, layers.heights) and np.array_equal(
        curves.layer_starts, layers.layer_starts
    )
    if not same or not np.array_equal(curves.closed, layers.closed):
        raise SettingsError(
            f"curves of {len(curves)} layers and {curves.closed.size} rings were not fitted to these "
            f"{len(layers)} layers and {layers.closed.size} rings: give the layers of the fit"
        )
    settings = CurveSettings.model_validate(dict(curves.settings))

    def work(start: int, stop: int) -> list[Floats]:
        steps = range(start, stop, LAYERS_A_STEP)
        return [
            _block_deviation(
                curves.block(a, min(a + LAYERS_A_STEP, stop)),
                layers.block(a, min(a + LAYERS_A_STEP, stop)),
                settings,
            )
            for a in steps
        ]

    blocks = [found for block in run_blocks(work, len(curves)) for found in block]
    of_ring = np.concatenate(blocks) if blocks else np.zeros((0, 3))
    of_layer = np.zeros((len(curves), 3))
    np.maximum.at(of_layer, curves.ring_layer, of_ring)
    piece_layer = curves.ring_layer[curves.piece_ring]
    return pd.DataFrame(
        {
            "layer": np.arange(len(curves)),
            "height_mm": curves.heights,
            "kept_points_mm": of_layer[:, 0],
            "points_mm": of_layer[:, 1],
            "bulge_mm": of_layer[:, 2],
            "blocks": np.bincount(piece_layer, curves.block_counts(), minlength=len(curves)).astype(np.int64),
        }
    )


def _block_deviation(curves: Curves, layers: Layers, settings: CurveSettings) -> Floats:
    """Greatest distances (R, 3) of each ring of a block."""
    cleaned = clean(
        layers.points, layers.ring_starts, layers.closed, settings.near_point_mm, settings.collinear_mm
    )
    kept = np.zeros(len(layers.points), dtype=np.bool_)
    kept[cleaned.rows] = True
    spans = curves.bezier_spans()
    span_starts = np.concatenate(
        [[0], np.cumsum(np.bincount(spans.ring, minlength=curves.closed.size))]
    ).astype(np.int64)
    result = np.zeros((curves.closed.size, 3))
    _ring_deviations(
        np.ascontiguousarray(layers.points),
        layers.ring_starts,
        layers.closed,
        kept,
        spans.points,
        span_starts,
        result,
    )
    return result


@kernel
def _ring_deviations(
    points: Floats,
    ring_starts: Ints,
    closed: Bools,
    kept: Bools,
    spans: Floats,
    span_starts: Ints,
    result: Floats,
) -> None:
    for r in range(closed.size):
        a, b = ring_starts[r], ring_starts[r + 1]
        B = spans[span_starts[r] : span_starts[r + 1]]
        if b - a < 2 or len(B) == 0:
            continue
        along = np.empty((len(B) * CHORDS_A_SPAN + 1, 2))
        for i in range(len(along) - 1):
            for axis in range(2):
                along[i, axis] = evaluate_bezier(
                    B[i // CHORDS_A_SPAN], (i % CHORDS_A_SPAN) / CHORDS_A_SPAN, axis
                )
        along[len(along) - 1] = B[len(B) - 1, 3]
        curve = tree_over(segments_along(along, False))
        guess = 0
        for i in range(a, b):
            found = nearest(curve, points[i, 0], points[i, 1], guess)
            guess = found.segment
            t = (found.segment % CHORDS_A_SPAN + found.t) / CHORDS_A_SPAN
            d = _refined(B[found.segment // CHORDS_A_SPAN], t, points[i, 0], points[i, 1])
            if kept[i]:
                result[r, 0] = max(result[r, 0], d)
            result[r, 1] = max(result[r, 1], d)
        contour = tree_over(segments_along(points[a:b], closed[r]))
        guess = 0
        for i in range(len(along)):
            found = nearest(contour, along[i, 0], along[i, 1], guess)
            guess = found.segment
            result[r, 2] = max(result[r, 2], found.distance)


@kernel
def _refined(B: Floats, t: float, x: float, y: float) -> float:
    """Distance of (x, y) from a span, by steps of Gauss and Newton from a parameter near the foot point."""
    best = np.inf
    for _ in range(REFINEMENTS + 1):
        px, py = evaluate_bezier(B, t, 0) - x, evaluate_bezier(B, t, 1) - y
        best = min(best, math.hypot(px, py))
        dx, dy = bezier_derivative(B, t, 0), bezier_derivative(B, t, 1)
        square = dx * dx + dy * dy
        if square == 0.0:
            break
        t = min(max(t - (px * dx + py * dy) / square, 0.0), 1.0)
    return best

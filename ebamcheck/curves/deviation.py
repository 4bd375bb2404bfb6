"""Deviation: how far curves lie from the contours that they were fitted to, and the contours' points from them."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import pandas as pd

from ebamcheck.columns_file import starts_of
from ebamcheck.curves.bezier import BezierSpans, places_along
from ebamcheck.curves.columns import Curves
from ebamcheck.curves.runs import clean
from ebamcheck.errors import SettingsError
from ebamcheck.geometry.nearest import nearest, segments_along, tree_over
from ebamcheck.kernels import Bools, Floats, Ints, kernel
from ebamcheck.layers.stack import Layers
from ebamcheck.settings.stages import CurveSettings
from ebamcheck.threads import run_blocks

CHORDS_A_SPAN = 8  # Chords of a span at whose ends its distance is taken
LAYERS_A_STEP = 64  # Layers measured at a time; bounds the working memory


class Deviation(NamedTuple):
    """Distances between curves and contours of the same rings."""

    of_point: Floats  # (N,) distance of each point of the contours from the curves, mm
    places: Floats  # (n, 2) places along the curves, mm
    starts: Ints  # (R + 1,) first place of each ring
    of_place: Floats  # (n,) distance of each place from the contour, mm
    segment: Ints  # (n,) number of the contour's nearest segment, that of the point where it begins
    share: Floats  # (n,) where along that segment, 0 .. 1.


def deviation_of(curves: Curves, layers: Layers, spans: BezierSpans | None = None) -> Deviation:
    """Measure curves against their contours; rings of less than two points, or without curves, have no places and distance 0.

    `spans` are those of the curves, where they are known.
    """
    spans = spans or curves.bezier_spans()
    count = curves.closed.size
    of_ring = np.bincount(spans.ring, minlength=count)
    span_starts = starts_of(of_ring)
    measured = (of_ring > 0) & (np.diff(layers.ring_starts) > 1)
    starts = starts_of(np.where(measured, CHORDS_A_SPAN * of_ring + 1, 0))
    total = int(starts[-1])
    places = np.empty((total, 2))
    some = np.flatnonzero(measured[spans.ring])
    rows = CHORDS_A_SPAN * (some - span_starts[spans.ring[some]]) + starts[spans.ring[some]]
    for k, along in enumerate(places_along(spans.points[some], CHORDS_A_SPAN)):
        places[rows + k] = along
    places[starts[1:][measured] - 1] = spans.points[span_starts[1:][measured] - 1, 3]
    of_point, of_place, share = np.zeros(len(layers.points)), np.empty(total), np.empty(total)
    found = Deviation(of_point, places, starts, of_place, np.empty(total, np.int64), share)
    points, closed = np.ascontiguousarray(layers.points), layers.closed

    def work(first: int, last: int) -> None:
        _measure_rings(points, layers.ring_starts, closed, spans.points, span_starts, first, last, found)

    run_blocks(work, count, 16)
    return found


@kernel
def _measure_rings(
    points: Floats,
    ring_starts: Ints,
    closed: Bools,
    spans: Floats,
    span_starts: Ints,
    first: int,
    last: int,
    found: Deviation,
) -> None:
    for r in range(first, last):
        a, b = ring_starts[r], ring_starts[r + 1]
        low, high = found.starts[r], found.starts[r + 1]
        if low == high:
            continue
        curve = tree_over(segments_along(found.places[low:high], False))
        guess = 0
        for i in range(a, b):
            near = nearest(curve, points[i, 0], points[i, 1], guess)
            guess = near.segment
            B = spans[span_starts[r] + guess // CHORDS_A_SPAN]
            t = (guess % CHORDS_A_SPAN + near.t) / CHORDS_A_SPAN
            # Six steps of Gauss and Newton along the true curve, while they bring it nearer; each gains several digits.
            best = np.inf
            for _ in range(7):
                s = 1.0 - t
                off = along = square = 0.0
                for axis in range(2):
                    p, q, u, v = B[0, axis], B[1, axis], B[2, axis], B[3, axis]
                    away = s * s * (s * p + 3.0 * t * q) + t * t * (3.0 * s * u + t * v) - points[i, axis]
                    rate = 3.0 * (s * s * (q - p) + 2.0 * s * t * (u - q) + t * t * (v - u))
                    off += away * away
                    along += away * rate
                    square += rate * rate
                if not off < best or square == 0.0:
                    break
                best = off
                t = min(max(t - along / square, 0.0), 1.0)
            found.of_point[i] = math.sqrt(min(best, off))
        contour = tree_over(segments_along(points[a:b], closed[r]))
        guess = 0
        for i in range(low, high):
            near = nearest(contour, found.places[i, 0], found.places[i, 1], guess)
            guess = near.segment
            found.of_place[i], found.segment[i], found.share[i] = near.distance, a + guess, near.t


def fit_deviation(curves: Curves, layers: Layers) -> pd.DataFrame:
    """Distance between curves and the contours that they were fitted to, one row a layer.

    ``kept_points_mm`` is the greatest distance of a point that the cleaning kept from the curve (rounding, for a fit that
    interpolates), ``points_mm`` of any point of the contour, ``bulge_mm`` of the curve from the contour's segments; ``blocks``
    counts NC blocks. Raises :class:`SettingsError` if the layers have other heights or rings."""
    columns = ("heights", "layer_starts", "closed")
    if not all(np.array_equal(getattr(curves, name), getattr(layers, name)) for name in columns):
        raise SettingsError(
            f"curves of {len(curves)} layers and {curves.closed.size} rings were not fitted to these "
            f"{len(layers)} layers and {layers.closed.size} rings: give the layers of the fit"
        )
    settings = CurveSettings.model_validate(dict(curves.settings))
    kept_mm, points_mm, bulge_mm = np.zeros((3, len(curves)))
    for start in range(0, len(curves), LAYERS_A_STEP):
        of = slice(start, min(start + LAYERS_A_STEP, len(curves)))
        block, contours = curves.block(of.start, of.stop), layers.block(of.start, of.stop)
        found = deviation_of(block, contours)
        near_mm, collinear_mm = settings.near_point_mm, settings.collinear_mm
        kept = clean(contours.points, contours.ring_starts, contours.closed, near_mm, collinear_mm).rows
        layer = np.repeat(block.ring_layer, np.diff(contours.ring_starts))
        np.maximum.at(kept_mm[of], layer[kept], found.of_point[kept])
        np.maximum.at(points_mm[of], layer, found.of_point)
        np.maximum.at(bulge_mm[of], np.repeat(block.ring_layer, np.diff(found.starts)), found.of_place)
    piece_layer = curves.ring_layer[curves.piece_ring]
    return pd.DataFrame(
        {
            "layer": np.arange(len(curves)),
            "height_mm": curves.heights,
            "kept_points_mm": kept_mm,
            "points_mm": points_mm,
            "bulge_mm": bulge_mm,
            "blocks": np.bincount(piece_layer, curves.block_counts(), minlength=len(curves)).astype(np.int64),
        }
    )

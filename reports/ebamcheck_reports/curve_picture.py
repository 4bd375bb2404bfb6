"""Picture of one layer's contours and the curves fitted to them."""

from __future__ import annotations

import itertools
import math

import numpy as np
import shapely

from ebamcheck.curves import Curves
from ebamcheck.kernels import Floats
from ebamcheck.layers.stack import Layers
from ebamcheck_reports.canvas import Box, Canvas, around, outline
from ebamcheck_reports.markup import DOTS, Markup, join, legend

CONTOUR, CURVE, CORNER, JOINT = "#d55e00", "#0072b2", "#000000", "#cc79a7"
WIDTH_PX, INSET_PX = 720.0, 300.0

SAMPLE_TOLERANCE_MM = 1e-3
"""Chord error of the polylines on which the worst place is searched; the figures of the run are exact."""

INSET_DEVIATIONS = 8.0
"""Half the side of the inset over the deviation."""

LEAST_INSET_MM = 0.05

LEGEND = (
    ("contour (input)", CONTOUR, "6 4"),
    ("fitted curve (output)", CURVE, ""),
    ("corner, kept sharp", CORNER, DOTS),
    ("joint of two pieces", JOINT, DOTS),
)


def draw(
    layers: Layers, curves: Curves, layer: int, corner_angle_deg: float, title: str
) -> tuple[Markup, str]:
    """Draw a layer, with the place enlarged at which the curve leaves the contour most.

    Returns
    -------
    The pictures, and a sentence about the place enlarged (empty without one).
    """
    spans = curves.block(layer, layer + 1).bezier_spans()
    sharp, smooth = _joints(curves, layer, corner_angle_deg)
    box = layers.block(layer, layer + 1).bounds()
    pictures = [_canvas(layers, layer, spans.points, sharp, smooth, box, WIDTH_PX).svg(title)]
    sentence = ""
    deviation, x, y = worst_place(layers, curves, layer)
    if deviation > SAMPLE_TOLERANCE_MM:
        near = around(x, y, max(INSET_DEVIATIONS * deviation, LEAST_INSET_MM))
        pictures.append(
            _canvas(layers, layer, spans.points, sharp, smooth, near, INSET_PX).svg(f"{title}, enlarged")
        )
        sentence = f"Enlarged: the place where curve and contour differ most, about {deviation:.2g} mm at ({x:.2f}, {y:.2f}) mm."
    return join(pictures), sentence


def key() -> Markup:
    """Explain the lines."""
    return legend(LEGEND)


def _canvas(
    layers: Layers, layer: int, spans: Floats, sharp: Floats, smooth: Floats, box: Box, width_px: float
) -> Canvas:
    canvas = Canvas(box, width_px)
    zoom = width_px == INSET_PX
    for r in layers.rings_of(layer):
        ring = outline(layers, r)
        if len(ring) > 1:
            canvas.lines(shapely.LineString(ring), stroke=CONTOUR, stroke_width=2.5, stroke_dasharray="6 4")
        if zoom:
            canvas.dots(ring, 5.0, CONTOUR)
    canvas.beziers(spans, stroke=CURVE, stroke_width=1.6)
    canvas.dots(smooth, 5.0, JOINT)
    canvas.dots(sharp, 7.0, CORNER)
    return canvas


def _joints(curves: Curves, layer: int, corner_angle_deg: float) -> tuple[Floats, Floats]:
    """Joints of pieces, (n, 2) each: those at corners (with an angle below the limit), and smooth ones."""
    sharp: list[Floats] = []
    smooth: list[Floats] = []
    for ring in curves.rings_of(layer):
        pieces = list(curves.pieces_of(ring))
        pairs = list(itertools.pairwise(pieces))
        if curves.closed[ring] and pieces:
            pairs.append((pieces[-1], pieces[0]))
        for before, after in pairs:
            end, start = curves.piece(before).control, curves.piece(after).control
            angle = 180.0 - _turn_deg(end[-1] - end[-2], start[1] - start[0])
            (sharp if angle < corner_angle_deg else smooth).append(start[0])
    return np.array(sharp).reshape(-1, 2), np.array(smooth).reshape(-1, 2)


def _turn_deg(a: Floats, b: Floats) -> float:
    return math.degrees(abs(math.atan2(a[0] * b[1] - a[1] * b[0], float(a @ b))))


def worst_place(layers: Layers, curves: Curves, layer: int) -> tuple[float, float, float]:
    """Approximate greatest distance of a layer's curves from its contours, and its place, for drawing."""
    sampled = curves.block(layer, layer + 1).sampled_rings(SAMPLE_TOLERANCE_MM)
    worst = (0.0, math.nan, math.nan)
    for n, r in enumerate(layers.rings_of(layer)):
        ring = outline(layers, r)
        curve = sampled.points[sampled.ring_starts[n] : sampled.ring_starts[n + 1]]
        if len(ring) < 2 or not len(curve):
            continue
        # A curve bulges most between the points of the contour, so the curve's points are measured.
        distance = np.asarray(shapely.distance(shapely.LineString(ring), shapely.points(curve)))
        k = int(np.argmax(distance))
        if distance[k] > worst[0]:
            worst = (float(distance[k]), float(curve[k, 0]), float(curve[k, 1]))
    return worst

"""Figure 7: a layer split at 140 degrees into straight and curved parts, the curved ones fitted by splines."""

from __future__ import annotations

from typing import Any

import numpy as np

from ebamcheck.curves import SPLINE, Curves, fit, fit_deviation
from ebamcheck.layers.stack import Layers
from ebamcheck.showing.colours import COLOURS
from ebamcheck_reports.canvas import Canvas
from ebamcheck_reports.markup import DOTS, Markup, legend
from ebamcheck_reports.paper import published
from ebamcheck_reports.paper.subject import Subject

STRAIGHT, SPLIT = "#1c2126", "#b3261e"
CURVED = tuple(colour for colour in COLOURS if colour != "#000000")
WIDTH_PX = 720.0


def measure(subject: Subject) -> tuple[dict[str, Any], list[Markup]]:
    """Split the layer shown, and the largest one where that is another, and picture both."""
    chosen = {subject.layer: subject.section, subject.largest_layer: subject.largest_section}
    found = [_measured(layer, section) for layer, section in chosen.items()]
    record = {
        "corner_angle_deg": published.CORNER_ANGLE_DEG,
        "layers_of_part": subject.count,
        "layers": [values for values, _ in found],
    }
    return record, [key(), *(picture for _, picture in found)]


def _measured(layer: int, section: Layers) -> tuple[dict[str, Any], Markup]:
    """Fit the exact contours of one layer and count the parts."""
    curves = fit(section, "paper", corner_angle_deg=published.CORNER_ANGLE_DEG)
    curved = int((curves.kind == SPLINE).sum())
    splits = split_places(curves)
    record = {
        "layer": layer + 1,
        "height_mm": float(section.heights[0]),
        "curve_parts": curved,
        "straight_parts": int(curves.kind.size) - curved,
        "splits": len(splits),
        "points": len(section.points),
        "blocks": curves.block_count(),
        "deviation_mm": float(fit_deviation(curves, section)["bulge_mm"].max()),
    }
    return record, _picture(section.bounds(), curves, splits)


def split_places(curves: Curves) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Points at which two parts of a contour meet, (n, 2) mm; a ring of one part has none."""
    places = [
        curves.piece(p).control[0]
        for ring in range(curves.closed.size)
        for p in curves.pieces_of(ring)
        if len(curves.pieces_of(ring)) > 1
    ]
    return np.array(places, np.float64).reshape(-1, 2)


def key() -> Markup:
    """Explain the colours."""
    return legend(
        [
            ("curved parts, one colour after the other", CURVED[0], ""),
            ("straight parts", STRAIGHT, ""),
            ("where two parts meet", SPLIT, DOTS),
        ]
    )


def _picture(
    box: tuple[float, float, float, float],
    curves: Curves,
    splits: np.ndarray[Any, np.dtype[np.float64]],
) -> Markup:
    spans = curves.bezier_spans()
    canvas = Canvas(box, WIDTH_PX)
    rank = np.cumsum(curves.kind == SPLINE) - 1
    for p in range(curves.kind.size):
        curved = curves.kind[p] == SPLINE
        colour = CURVED[int(rank[p]) % len(CURVED)] if curved else STRAIGHT
        canvas.beziers(spans.points[spans.piece == p], stroke=colour, stroke_width=3.0 if curved else 2.0)
    canvas.dots(splits, 9.0, SPLIT)
    return canvas.svg("straight and curved parts of the layer")

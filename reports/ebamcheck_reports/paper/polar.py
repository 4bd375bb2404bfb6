"""Figures 10 and 11: error of a medium tessellation and of the curve fitted to it, against a fine tessellation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
import shapely

from ebamcheck.curves import Curves, contour_error, error_reduction, fit, polar_radius
from ebamcheck.kernels import Floats
from ebamcheck.layers.stack import Layers
from ebamcheck.plugins.registry import models
from ebamcheck.settings.stages import CurveSettings
from ebamcheck.slicers.slicing import slice_part
from ebamcheck_reports.canvas import Canvas
from ebamcheck_reports.charts import Series, line_chart
from ebamcheck_reports.markup import Markup, join, legend
from ebamcheck_reports.paper import published
from ebamcheck_reports.paper.published import Effort, Note
from ebamcheck_reports.sections.fit import rays_rad

FREEFORM = ("ladder", "blade", "impeller")  # Models with curved walls; the first one is drawn
# Tolerances of the sliced and of the reference tessellation; the paper's conclusion says "when the triangle tolerance is one"
# and leaves the reference open
MEDIUM_MM, FINE_MM = 1.0, 0.01

# The paper's fit, which has no limit on how far a curve leaves its chords; and as ebamcheck runs it by default, where a part
# that leaves them farther than ``curves.largest_bulge_mm`` stays a polyline
FITS = (
    ("as written in the paper", CurveSettings(largest_bulge_mm=1e6)),
    ("with ebamcheck's limit", CurveSettings()),
)

KINDS = ("polar", "normal")
FIGURES = ("range", "max", "rms", "mean_abs")
# Blue for the fine contour and red for the medium one, as in the paper; its curve is green here
REFERENCE, POLYLINE, FITTED = "#0072b2", "#d55e00", "#009e73"
ENLARGED_MM = (30.0, 15.0)  # Half the sides of the piece enlarged


def measure(effort: Effort, note: Note) -> tuple[dict[str, Any], list[Markup]]:
    """Errors on each freeform model, and pictures of one layer of the first."""
    rows: list[dict[str, Any]] = []
    pictures: list[Markup] = []
    for name in FREEFORM:
        note(f"error of the fit: {name}")
        model = models([name])[name]
        medium, fine = model.tessellate(MEDIUM_MM), model.tessellate(FINE_MM)
        low, high = model.bounds[:, 2]
        heights = low + (np.arange(effort.polar_layers) + 0.5) / effort.polar_layers * (high - low)
        sliced, reference = slice_part(medium, heights), slice_part(fine, heights)
        before = contour_error(sliced, reference)
        fits = {title: fit(sliced, "paper", settings) for title, settings in FITS}
        rows.append(
            {
                "model": name,
                "facets": len(medium.faces),
                "reference_facets": len(fine.faces),
                "layers": len(heights),
                "polar_rings": int(before["polar_rings"].sum()),
                "polyline": figures(before),
                "fits": {title: _fitted(before, curves, reference) for title, curves in fits.items()},
            }
        )
        if not pictures:
            middle = (len(heights) // 2, len(heights) // 2 + 1)
            curves = fits[FITS[0][0]].block(*middle)
            pictures = _pictures(reference.block(*middle), sliced.block(*middle), curves, name)
    record = {"medium_mm": MEDIUM_MM, "fine_mm": FINE_MM, "models": rows, "paper": published_record()}
    return record, pictures


def published_record() -> dict[str, Any]:
    """The paper's ranges, what they give, and what it claims."""
    polyline, fitted = published.POLYLINE_ERROR, published.FIT_ERROR
    return {
        "polyline_mm": list(polyline),
        "fit_mm": list(fitted),
        "range_mm": [polyline.width_mm, fitted.width_mm],
        "max_mm": [polyline.largest_mm, fitted.largest_mm],
        "reductions": published.published_reductions(),
        "claimed_reduction": published.CLAIMED_REDUCTION,
    }


def figures(errors: pd.DataFrame) -> dict[str, dict[str, float]]:
    """Least, greatest, RMS and mean absolute error of a stack, by kind: ``polar`` and ``normal``."""
    found = {}
    for kind, weight in zip(KINDS, ("polar_rings", "rings"), strict=True):
        table = errors[errors[f"{kind}_rms_mm"].notna()]
        weights = table[weight].to_numpy(float)
        if table.empty:
            found[kind] = dict.fromkeys(("low_mm", "high_mm", "rms_mm", "mean_abs_mm"), float("nan"))
            continue
        found[kind] = {
            "low_mm": float(table[f"{kind}_min_mm"].min()),
            "high_mm": float(table[f"{kind}_max_mm"].max()),
            "rms_mm": float(np.sqrt(np.average(table[f"{kind}_rms_mm"] ** 2, weights=weights))),
            "mean_abs_mm": float(np.average(table[f"{kind}_mean_abs_mm"], weights=weights)),
        }
    return found


def _fitted(before: pd.DataFrame, curves: Curves, reference: Layers) -> dict[str, Any]:
    after = contour_error(curves, reference)
    reductions = error_reduction(before, after)
    return {
        **figures(after),
        "reductions": {kind: {f: float(reductions[f"{kind}_{f}"]) for f in FIGURES} for kind in KINDS},
    }


# -- pictures of one layer -------------------------------------------------------------------------


def _pictures(reference: Layers, sliced: Layers, curves: Curves, name: str) -> list[Markup]:
    """Contours about the place of the greatest polar error, and the polar errors, of the largest outer ring."""
    stacks = (reference, sliced, curves.sample_tolerance(1e-4))
    rings = [stack.ring(int(np.argmax(stack.ring_areas))) for stack in stacks]
    centre = 0.5 * (rings[0].min(axis=0) + rings[0].max(axis=0))
    theta = rays_rad()
    exact, polyline, fitted = (polar_radius(ring, centre, theta) for ring in rings)
    chart = line_chart(
        [
            Series("sliced polyline less fine contour", np.degrees(theta), polyline - exact),
            Series("fitted curve less fine contour", np.degrees(theta), fitted - exact),
        ],
        "direction from the centre of the enveloping rectangle, degrees",
        "polar error, mm",
    )
    worst = int(np.nanargmax(np.abs(polyline - exact))) if np.isfinite(polyline - exact).any() else 0
    place = centre + exact[worst] * np.array([np.cos(theta[worst]), np.sin(theta[worst])])
    return [_contours(rings, place, name), chart]


def _contours(rings: Sequence[Floats], place: Floats, name: str) -> Markup:
    key = (
        ("contour of the fine mesh", REFERENCE, ""),
        ("contour of the medium mesh, its points", POLYLINE, ""),
        ("curve fitted to it", FITTED, "7 4"),
    )
    canvas = Canvas.of(np.stack([place - ENLARGED_MM, place + ENLARGED_MM]), 960.0)
    for ring, (_, colour, dashes), width in zip(rings, key, (5.0, 2.2, 2.2), strict=True):
        closed = shapely.LineString(np.concatenate([ring, ring[:1]]))
        canvas.lines(closed, stroke=colour, stroke_width=width, stroke_dasharray=dashes or None)
    canvas.dots(rings[1], 8.0, POLYLINE)
    return join([canvas.svg(f"contours of {name}, enlarged"), legend(key)])

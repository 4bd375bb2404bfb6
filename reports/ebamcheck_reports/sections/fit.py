"""Fit: contours become curves, and the error of doing so."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from ebamcheck.curves import ARC, LINE, SPLINE, Curves, polar_radius
from ebamcheck.kernels import Floats
from ebamcheck.layers.stack import Layers
from ebamcheck.pipeline.fit import largest_move_mm
from ebamcheck_reports import curve_picture
from ebamcheck_reports.charts import Series, line_chart
from ebamcheck_reports.figures import number, percent
from ebamcheck_reports.markup import (
    Markup,
    element,
    facts,
    figure,
    join,
    paragraph,
    picture,
    section,
    table,
)
from ebamcheck_reports.run_data import RunData, layer_name

RAYS = 1440
"""Directions of the polar chart: four per degree."""

CURVE_TOLERANCE_MM = 1e-5
"""Chord error of the polylines as which curves are measured."""

CORNER_ANGLE_DEG = 140.0
"""Angle of a corner if the settings name none (paper, section 3.2)."""

WHAT = (
    "A contour is a chain of short straight segments, chords of the part's surface. Between its corners it is replaced by a smooth curve "
    "that the control can drive without stopping. Good is a curve that lies no farther from its contour than the mesh bears out, is nearer to the part, "
    "and needs fewer blocks than points."
)


def render(run: RunData) -> Markup:
    """Counts, pictures, deviation over the layers, and the error against a reference."""
    curves, layers = run.curves, run.primary
    if curves is None or layers is None:
        return section("fit", "Fit", WHAT, paragraph("There was no contour to fit.", class_="note bad"))
    return section(
        "fit",
        "Fit",
        WHAT,
        _counts(run, curves),
        _methods(run),
        _deviation(run),
        *_pictures(run, layers, curves),
        element("h3", "Against a reference"),
        *_reference(run, layers, curves),
    )


def _counts(run: RunData, curves: Curves) -> Markup:
    record = run.part_of("fit")
    lines, splines, arcs = (int((curves.kind == kind).sum()) for kind in (LINE, SPLINE, ARC))
    points, blocks = int(record["points"]), int(record["blocks"])
    saved = f" ({percent(1.0 - blocks / points)} fewer)" if 0 < blocks < points else ""
    return facts(
        [
            ("method", record["method"]),
            ("contour points", figure(points)),
            ("NC blocks after fitting", join([figure(blocks), saved])),
            ("pieces", f"{splines} curves, {arcs} arcs, {lines} straight runs"),
            ("farthest contour point from its curve", figure(record["max_points_mm"], "mm")),
            ("farthest bulge of a curve from its contour", figure(record["max_bulge_mm"], "mm")),
            ("limit of both by the settings", figure(largest_move_mm(run.config), "mm")),
        ]
    )


def _methods(run: RunData) -> Markup:
    """Every method beside the chosen one."""
    fits = run.part_of("fit").get("methods", {})
    gains = run.part_of("reference").get("methods", {})
    kinds = [
        (f"{kind}_{what}", f"{kind} {what}, less by")
        for kind in ("polar", "normal")
        for what in ("rms", "max")
    ]
    columns = ("method", "NC blocks", "from its contour", *(title for _, title in kinds if gains))
    rows = [
        (
            name + (" (chosen)" if name == run.part_of("fit")["method"] else ""),
            figure(fit["blocks"]),
            figure(max(number(fit["max_points_mm"]), number(fit["max_bulge_mm"])), "mm"),
            *(figure(gains[name].get(key), text=percent(gains[name].get(key))) for key, _ in kinds if gains),
        )
        for name, fit in fits.items()
    ]
    return table(columns, rows, class_="methods", numbers=columns[1:])


def _deviation(run: RunData) -> Markup:
    fit = run.table("fit.csv")
    series = [
        Series("contour points from the curve", fit["layer"], fit["points_mm"]),
        Series("bulge of the curve", fit["layer"], fit["bulge_mm"]),
    ]
    chart = line_chart(series, "layer", "deviation, mm", from_zero=True)
    return element(
        "figure",
        chart,
        element(
            "figcaption",
            "Deviation of every layer. Beside the limit of the settings, the mesh about each ring says how far its curve may lie from it: "
            "allowed_mm in fit.csv. The gate counts what no evidence speaks for.",
        ),
    )


def _pictures(run: RunData, layers: Layers, curves: Curves) -> list[Markup]:
    fit = run.table("fit.csv")
    worst = int(fit[["points_mm", "bulge_mm"]].max(axis=1).to_numpy().argmax())
    reasons = {run.middle_layer: "middle layer"}
    reasons[worst] = f"{reasons[worst]}, largest deviation" if worst in reasons else "largest deviation"
    parts: list[Markup] = []
    for layer, why in reasons.items():
        if layer is None or not len(layers.rings_of(layer)):
            continue
        name = layer_name(layer, float(layers.heights[layer]))
        angle = run.setting("curves", "corner_angle_deg", CORNER_ANGLE_DEG)
        pictures, enlarged = curve_picture.draw(layers, curves, layer, angle, f"fit of {name}")
        parts.append(picture(element("div", pictures, class_="beside"), f"{name} ({why}). {enlarged}"))
    return [element("div", curve_picture.key(), *parts, class_="together")]


# -- against the finer tessellation ----------------------------------------------------------------


def _reference(run: RunData, layers: Layers, curves: Curves) -> list[Markup]:
    record = run.part_of("reference")
    if not record:
        return [
            paragraph(
                "No reference was given. With a finer tessellation of the same part, ",
                element("code", "--reference FINER.stl"),
                " measures how far contours and curves lie from the true shape.",
            )
        ]
    return [
        paragraph(
            f"Reference: {record['part']['source'].replace(chr(92), '/').rsplit('/', 1)[-1]}, {record['part']['facets']} facets. "
            "Errors are positive where there is metal too much. The polar error is the difference of the radii about the centre of the "
            "contour's enveloping rectangle; it is defined for outer contours that every ray meets once. The normal error is the "
            "distance to the nearest point of the reference and is defined for every contour."
        ),
        *_unmatched(record),
        _errors(record),
        *_polar_chart(run, layers, curves),
        *_error_charts(run),
    ]


def _unmatched(record: Mapping[str, Any]) -> list[Markup]:
    count = int(record["unmatched_rings"])
    if not count:
        return []
    text = f"{count} contours of the part and the reference have no partner: is it the same part in the same place?"
    return [paragraph(text, class_="note warn")]


def _errors(record: Mapping[str, Any]) -> Markup:
    rows = []
    for kind in ("polar", "normal"):
        before, after = record["contour"], record["curve"]
        ends, rms = (f"{kind}_min_mm", f"{kind}_max_mm"), (f"{kind}_rms_mm",)
        rows += [
            (
                f"{kind} error, range (least to greatest)",
                _range(before, ends),
                _range(after, ends),
                f"{kind}_range",
            ),
            (
                f"{kind} error, greatest magnitude",
                _magnitude(before, kind),
                _magnitude(after, kind),
                f"{kind}_max",
            ),
            (f"{kind} error, root mean square", _range(before, rms), _range(after, rms), f"{kind}_rms"),
        ]
    columns = ("error against the reference", "contour", "curve", "reduced by")
    cells = [(name, old, new, _reduction(record, key)) for name, old, new, key in rows]
    return table(columns, cells, class_="reference", numbers=columns[1:])


def _range(errors: Mapping[str, Any], keys: tuple[str, ...]) -> Markup:
    return Markup(" … ".join(figure(errors[k], "mm") for k in keys))


def _magnitude(errors: Mapping[str, Any], kind: str) -> Markup:
    ends = [abs(number(errors[f"{kind}_{end}_mm"])) for end in ("min", "max")]
    return figure(max(ends), "mm")


def _reduction(record: Mapping[str, Any], key: str) -> Markup:
    value = record["reduction"].get(key)
    return figure(value, text=percent(value))


def _polar_chart(run: RunData, layers: Layers, curves: Curves) -> list[Markup]:
    """The chart of the middle layer."""
    truth, layer = run.reference, run.middle_layer
    if truth is None or layer is None or len(truth) != len(layers):
        return []
    theta = rays_rad()
    errors = polar_errors(layers, curves, truth, layer, theta)
    return [] if errors is None else [polar_chart(layers, layer, theta, errors)]


def rays_rad() -> Floats:
    """Directions (n,) in which polar errors are drawn."""
    return np.asarray((np.arange(RAYS) + 0.5) * (2.0 * math.pi / RAYS), np.float64)


def polar_chart(layers: Layers, layer: int, theta_rad: Floats, errors: tuple[Floats, Floats]) -> Markup:
    """Polar error of the largest outer contour of a layer over the angle (paper, Figure 11)."""
    degrees = np.degrees(theta_rad)
    chart = line_chart(
        [Series("contour", degrees, errors[0]), Series("curve", degrees, errors[1])],
        "angle, degrees",
        "polar error, mm",
    )
    caption = (
        f"Polar error of the largest outer contour of {layer_name(layer, float(layers.heights[layer]))} before and after fitting; "
        "nearer to zero is better. Gaps are angles at which a ray meets a contour more than once."
    )
    return element("figure", chart, element("figcaption", caption))


def polar_errors(
    layers: Layers, curves: Curves, truth: Layers, layer: int, theta_rad: Floats
) -> tuple[Floats, Floats] | None:
    """Polar errors of contour and curve of a layer's largest ring against the reference's; None without rings."""
    ours, theirs = _largest(layers, layer), _largest(truth, layer)
    if ours is None or theirs is None:
        return None
    ring = truth.ring(theirs)
    centre = 0.5 * (ring.min(axis=0) + ring.max(axis=0))
    true = polar_radius(ring, centre, theta_rad)
    sampled = curves.block(layer, layer + 1).sampled_rings(CURVE_TOLERANCE_MM)
    place = ours - int(layers.layer_starts[layer])
    curve = sampled.points[sampled.ring_starts[place] : sampled.ring_starts[place + 1]]
    return polar_radius(layers.ring(ours), centre, theta_rad) - true, polar_radius(
        curve, centre, theta_rad
    ) - true


def _largest(layers: Layers, layer: int) -> int | None:
    rings = [r for r in layers.rings_of(layer) if layers.closed[r]]
    return max(rings, key=lambda r: layers.ring_areas[r]) if rings else None


def _error_charts(run: RunData) -> list[Markup]:
    errors = run.table("reference.csv")
    if not len(errors):
        return []
    series = []
    for of in ("contour", "curve"):
        rows = errors[errors["of"] == of]
        series += [
            Series(f"{of}, {end}", rows["layer"], rows[f"normal_{column}_mm"])
            for end, column in (("greatest", "max"), ("least", "min"))
        ]
    caption = "Greatest and least normal error of every layer, before and after fitting."
    return [
        element("figure", line_chart(series, "layer", "normal error, mm"), element("figcaption", caption))
    ]

"""Fit: contours become curves, and the error of doing so; with the picture of a layer's contours and curves."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import shapely

from ebamcheck.curves import ARC, LINE, SPLINE, Curves, polar_radius
from ebamcheck.kernels import Floats
from ebamcheck.layers.stack import Layers
from ebamcheck.pipeline.fit import largest_move_mm
from ebamcheck_reports.canvas import Box, Canvas, around, outline
from ebamcheck_reports.charts import Series, line_chart
from ebamcheck_reports.markup import (
    DOTS,
    Markup,
    element,
    facts,
    figure,
    figure_percent,
    join,
    legend,
    number,
    paragraph,
    percent,
    picture,
    section,
    table,
)
from ebamcheck_reports.run_data import RunData, layer_name

CURVE_TOLERANCE_MM = 1e-5  # Chord error of the polylines as which curves are measured

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
    body = (_counts(run, curves), _methods(run), _deviation(run), *_pictures(run, layers, curves))
    reference = (element("h3", "Against a reference"), *_reference(run, layers, curves))
    return section("fit", "Fit", WHAT, *body, *reference)


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
    fits, gains = run.part_of("fit").get("methods", {}), run.part_of("reference").get("methods", {})
    kinds = [f"{kind} {what}" for kind in ("polar", "normal") for what in ("rms", "max") if gains]
    columns = ("method", "NC blocks", "from its contour", *(f"{kind}, less by" for kind in kinds))
    rows = [
        (
            name + (" (chosen)" if name == run.part_of("fit")["method"] else ""),
            figure(fit["blocks"]),
            figure(max(number(fit["max_points_mm"]), number(fit["max_bulge_mm"])), "mm"),
            *(figure_percent(gains[name].get(kind.replace(" ", "_"))) for kind in kinds),
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
    return picture(
        line_chart(series, "layer", "deviation, mm", from_zero=True),
        "Deviation of every layer. Beside the limit of the settings, the mesh about each ring says how far its curve may lie from it: "
        "allowed_mm in fit.csv. The gate counts what no evidence speaks for.",
    )


def _pictures(run: RunData, layers: Layers, curves: Curves) -> list[Markup]:
    worst = int(run.table("fit.csv")[["points_mm", "bulge_mm"]].max(axis=1).to_numpy().argmax())
    reasons = {run.middle_layer: "middle layer"}
    reasons[worst] = f"{reasons[worst]}, largest deviation" if worst in reasons else "largest deviation"
    angle = run.setting("curves", "corner_angle_deg", 140.0)  # without one, that of the paper (section 3.2)
    parts: list[Markup] = []
    for layer, why in reasons.items():
        if layer is not None and len(layers.rings_of(layer)):
            name = layer_name(layer, float(layers.heights[layer]))
            pictures, enlarged = _drawn(layers, curves, layer, angle, f"fit of {name}")
            parts.append(picture(element("div", pictures, class_="beside"), f"{name} ({why}). {enlarged}"))
    return [element("div", legend(LEGEND), *parts, class_="together")]


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
    source, unmatched = record["part"]["source"].replace("\\", "/"), int(record["unmatched_rings"])
    parts = [
        paragraph(
            f"Reference: {source.rsplit('/', 1)[-1]}, {record['part']['facets']} facets. "
            "Errors are positive where there is metal too much. The polar error is the difference of the radii about the centre of the "
            "contour's enveloping rectangle; it is defined for outer contours that every ray meets once. The normal error is the "
            "distance to the nearest point of the reference and is defined for every contour."
        )
    ]
    if unmatched:
        text = f"{unmatched} contours of the part and the reference have no partner: is it the same part in the same place?"
        parts.append(paragraph(text, class_="note warn"))
    return [*parts, _errors(record), *_polar_chart(run, layers, curves), *_error_charts(run)]


def _errors(record: Mapping[str, Any]) -> Markup:
    rows: list[tuple[Any, ...]] = []
    stages = (record["contour"], record["curve"])
    for kind in ("polar", "normal"):
        ends = [[number(stage[f"{kind}_{end}_mm"]) for end in ("min", "max")] for stage in stages]
        ranges = [Markup(" … ".join(figure(value, "mm") for value in pair)) for pair in ends]
        greatest = [figure(max(map(abs, pair)), "mm") for pair in ends]
        rms = [figure(stage[f"{kind}_rms_mm"], "mm") for stage in stages]
        less = [figure_percent(record["reduction"].get(f"{kind}_{key}")) for key in ("range", "max", "rms")]
        rows += [
            (f"{kind} error, range (least to greatest)", *ranges, less[0]),
            (f"{kind} error, greatest magnitude", *greatest, less[1]),
            (f"{kind} error, root mean square", *rms, less[2]),
        ]
    columns = ("error against the reference", "contour", "curve", "reduced by")
    return table(columns, rows, class_="reference", numbers=columns[1:])


def _polar_chart(run: RunData, layers: Layers, curves: Curves) -> list[Markup]:
    """The chart of the middle layer."""
    truth, layer = run.reference, run.middle_layer
    if truth is None or layer is None or len(truth) != len(layers):
        return []
    errors = polar_errors(layers, curves, truth, layer, rays_rad())
    return [] if errors is None else [polar_chart(layers, layer, errors)]


def rays_rad() -> Floats:
    """Directions (n,) in which polar errors are drawn, four per degree."""
    return np.asarray((np.arange(1440) + 0.5) * (2.0 * math.pi / 1440), np.float64)


def polar_chart(layers: Layers, layer: int, errors: tuple[Floats, Floats]) -> Markup:
    """Polar error of the largest outer contour of a layer over the angle (paper, Figure 11)."""
    series = [Series(of, np.degrees(rays_rad()), error) for of, error in zip(("contour", "curve"), errors, strict=True)]
    caption = (
        f"Polar error of the largest outer contour of {layer_name(layer, float(layers.heights[layer]))} before and after fitting; "
        "nearer to zero is better. Gaps are angles at which a ray meets a contour more than once."
    )
    return picture(line_chart(series, "angle, degrees", "polar error, mm"), caption)


def polar_errors(
    layers: Layers, curves: Curves, truth: Layers, layer: int, theta_rad: Floats
) -> tuple[Floats, Floats] | None:
    """Polar errors of contour and curve of a layer's largest ring against the reference's; None without rings."""
    ours, theirs = _largest(layers, layer), _largest(truth, layer)
    if ours is None or theirs is None:
        return None
    ring = truth.ring(theirs)
    centre = 0.5 * (ring.min(axis=0) + ring.max(axis=0))
    sampled = curves.block(layer, layer + 1).sampled_rings(CURVE_TOLERANCE_MM)
    at = ours - int(layers.layer_starts[layer])
    curve = sampled.points[sampled.ring_starts[at] : sampled.ring_starts[at + 1]]
    true, before, after = (polar_radius(r, centre, theta_rad) for r in (ring, layers.ring(ours), curve))
    return before - true, after - true


def _largest(layers: Layers, layer: int) -> int | None:
    rings = [r for r in layers.rings_of(layer) if layers.closed[r]]
    return max(rings, key=lambda r: layers.ring_areas[r]) if rings else None


def _error_charts(run: RunData) -> list[Markup]:
    errors = run.table("reference.csv")
    if errors.empty:
        return []
    series = [
        Series(f"{of}, {end}", rows["layer"], rows[f"normal_{column}_mm"])
        for of in ("contour", "curve")
        for rows in [errors[errors["of"] == of]]
        for end, column in (("greatest", "max"), ("least", "min"))
    ]
    caption = "Greatest and least normal error of every layer, before and after fitting."
    return [picture(line_chart(series, "layer", "normal error, mm"), caption)]


# -- picture of a layer ----------------------------------------------------------------------------

CONTOUR, CURVE, CORNER, JOINT = "#d55e00", "#0072b2", "#000000", "#cc79a7"
INSET_PX = 300.0
# Chord error of the polylines on which the worst place is searched; the figures of the run are exact
SAMPLE_TOLERANCE_MM = 1e-3

LEGEND = (
    ("contour (input)", CONTOUR, "6 4"),
    ("fitted curve (output)", CURVE, ""),
    ("corner, kept sharp", CORNER, DOTS),
    ("joint of two pieces", JOINT, DOTS),
)


def _drawn(layers: Layers, curves: Curves, layer: int, corner_angle_deg: float, title: str) -> tuple[Markup, str]:
    """Pictures of a layer and of the place at which the curve leaves the contour most, and a sentence about that place."""
    joints = _joints(curves, layer, corner_angle_deg)
    spans = curves.block(layer, layer + 1).bezier_spans().points

    def canvas(box: Box, width_px: float) -> Canvas:
        made = Canvas(box, width_px)
        for ring in (outline(layers, r) for r in layers.rings_of(layer)):
            if len(ring) > 1:
                made.lines(shapely.LineString(ring), stroke=CONTOUR, stroke_width=2.5, stroke_dasharray="6 4")
            if width_px == INSET_PX:
                made.dots(ring, 5.0, CONTOUR)
        made.beziers(spans, stroke=CURVE, stroke_width=1.6)
        made.dots(joints[1], 5.0, JOINT)
        made.dots(joints[0], 7.0, CORNER)
        return made

    whole = canvas(layers.block(layer, layer + 1).bounds(), 720.0).svg(title)
    deviation, x, y = _worst_place(layers, curves, layer)
    if deviation <= SAMPLE_TOLERANCE_MM:
        return whole, ""
    # The deviation takes a sixteenth of the enlarged piece, which has at least 0.1 mm.
    inset = canvas(around(x, y, max(8.0 * deviation, 0.05)), INSET_PX).svg(f"{title}, enlarged")
    told = (
        f"Enlarged: the place where curve and contour differ most, about {deviation:.2g} mm at ({x:.2f}, {y:.2f}) mm."
    )
    return join([whole, inset]), told


def _joints(curves: Curves, layer: int, corner_angle_deg: float) -> tuple[Floats, Floats]:
    """Joints of pieces, (n, 2) each: those at corners (with an angle below the limit), and smooth ones."""
    sharp: list[Floats] = []
    smooth: list[Floats] = []
    for ring in curves.rings_of(layer):
        pieces = [curves.piece(p).control for p in curves.pieces_of(ring)]
        pairs = list(itertools.pairwise(pieces))
        if curves.closed[ring] and pieces:
            pairs.append((pieces[-1], pieces[0]))
        for before, after in pairs:
            a, b = before[-1] - before[-2], after[1] - after[0]
            turn = math.degrees(abs(math.atan2(a[0] * b[1] - a[1] * b[0], float(a @ b))))
            (sharp if 180.0 - turn < corner_angle_deg else smooth).append(after[0])
    return np.array(sharp).reshape(-1, 2), np.array(smooth).reshape(-1, 2)


def _worst_place(layers: Layers, curves: Curves, layer: int) -> tuple[float, float, float]:
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
            worst = (float(distance[k]), *curve[k].tolist())
    return worst

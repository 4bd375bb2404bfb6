"""Agreement: how far apart the methods are, layer by layer, with the likely causes, and chosen layers drawn over each other."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import shapely

from ebamcheck.layers.stack import Layers
from ebamcheck.layers.svg import overlay_svg
from ebamcheck.printable import indexed
from ebamcheck.showing.colours import COLOURS, DASHES
from ebamcheck.showing.markup import inline
from ebamcheck_reports import words
from ebamcheck_reports.canvas import HEIGHT_LIMIT, LEAST_EXTENT_MM, Box, Canvas, around, outlines
from ebamcheck_reports.charts import Series, line_chart
from ebamcheck_reports.markup import (
    Markup,
    counted,
    element,
    figure,
    join,
    mark,
    paragraph,
    picture,
    place,
    section,
    shown,
    table,
)
from ebamcheck_reports.run_data import RunData, layer_name

MOST_FINDINGS = 20

WHAT = (
    "Every pair of methods is compared on every layer. They agree where no part of the area that only one of them has is deeper than "
    "the limit: both promised errors plus a tolerance. Good is agreement of all pairs on all layers."
)


def render(run: RunData) -> Markup:
    """Matrix of pairs, charts over the layers, findings and pictures."""
    if not run.pairs:
        text = f"{counted(len(run.methods), 'method')} came to an end; two are needed to compare anything."
        none = paragraph(text, class_="note bad")
        return section("agreement", "Agreement", WHAT, none, _areas(run), _chosen(run))
    charts = (element("h3", "Over the layers"), _areas(run), _ratios(run))
    findings = (element("h3", "Disagreements"), *_findings(run))
    return section("agreement", "Agreement", WHAT, _counts(run), *_figures(run), *charts, *findings, _chosen(run))


def _counts(run: RunData) -> Markup:
    comparison = run.part_of("comparison")
    verdicts = [
        f"{counted(int(n), 'layer')}: {words.meaning(words.VERDICTS, v)}" for v, n in comparison["verdicts"].items()
    ]
    classes = [f"{n} {words.meaning(words.CLASSES, c)}" for c, n in comparison["classes"].items()]
    return paragraph("; ".join(verdicts), ". Of all, ", ", ".join(classes), ".")


def _figures(run: RunData) -> list[Markup]:
    """Matrix and table of the pairs; left out if every layer is empty, as they would suggest that all is well."""
    if not run.compared:
        text = "There was nothing to compare: that the methods agree on nothing says nothing."
        return [paragraph(text, class_="note bad")]
    known = {frozenset((p["a"], p["b"])): p for p in run.pairs}
    rows = [
        (
            element("th", a, scope="row"),
            *(_matrix_cell(known.get(frozenset((a, b))), a == b) for b in run.backends),
        )
        for a in run.backends
    ]
    return [
        element("h3", "Worst depth of each pair"),
        table(("", *run.backends), rows, class_="matrix"),
        element("h3", "All figures of each pair"),
        _pairs(run),
    ]


def _matrix_cell(pair: Mapping[str, Any] | None, itself: bool) -> Markup:
    if pair is None or itself or not pair["gated"]:
        text = "" if itself else "–" if pair is None else "no layer both can be compared on"
        return element("td", text, class_="void")
    good = pair["agree"] == pair["gated"]
    limit = element("small", f"limit {shown(pair['limit_mm'], 'mm')}")
    told = join([mark(good), shown(pair["max_depth_mm"], "mm"), limit], element("br"))
    return element("td", told, class_="good" if good else "bad")


def _pairs(run: RunData) -> Markup:
    columns = (
        "pair", "layers agreed", "worst depth", "limit", "result", "Hausdorff distance", "95 % of the contour within",
        "area difference", "least overlap (IoU)",
    )  # fmt: skip
    rows = []
    for p in run.pairs:
        apart = f" ({p['layers'] - p['gated']} not compared)" if p["gated"] < p["layers"] else ""
        rows.append(
            (
                f"{p['a']} – {p['b']}",
                f"{p['agree']} of {p['gated']}{apart}",
                figure(p["max_depth_mm"], "mm"),
                figure(p["limit_mm"], "mm"),
                mark(p["agree"] == p["gated"]) if p["gated"] else "–",
                figure(p["max_hausdorff_mm"], "mm"),
                figure(p["max_p95_mm"], "mm"),
                figure(p["max_area_difference_mm2"], "mm²"),
                figure(p["min_iou"], text=f"{p['min_iou']:.6f}" if isinstance(p["min_iou"], float) else ""),
            )
        )
    note = paragraph(
        "Figures are the worst of all layers compared. Only the depth is judged: a sampled method rightly loses the tip of a sharp wedge, "
        "which makes the Hausdorff distance (the farthest that any point of one contour lies from the other) large although next to no area is lost.",
        class_="small",
    )
    return join([table(columns, rows, class_="pairs", numbers=(*columns[2:4], *columns[5:])), note])


def _areas(run: RunData) -> Markup:
    layers, areas = run.layer_table, {name: f"area_mm2_{name}" for name in run.methods}
    series = [Series(name, layers["layer"], layers[c]) for name, c in areas.items() if c in layers]
    if not series:
        return paragraph("There are no layers to draw.")
    caption = "Area of every layer as each method found it; the lines should lie on each other."
    return picture(line_chart(series, "layer", "area, mm²", from_zero=True), caption)


def _ratios(run: RunData) -> Markup:
    pairs = run.pair_table
    # One line per slicer, in its style: eight slicers would give twenty-eight lines of pairs.
    ratio = pairs.assign(ratio=np.where(pairs["gated"], pairs["depth_mm"] / pairs["limit_mm"], np.nan))
    series = []
    for name in run.methods:
        worst = ratio[(ratio["a"] == name) | (ratio["b"] == name)].groupby("layer")["ratio"].max()
        series.append(Series(name, worst.index, worst))
    caption = (
        "Depth of the difference over its limit, of each method against the one that it differs most from: everything must stay "
        "under 1. Gaps are layers that are not compared."
    )
    return picture(line_chart(series, "layer", "depth / limit", 1.0, "limit (1)", from_zero=True), caption)


def _findings(run: RunData) -> list[Markup]:
    found = run.disagreements
    if not found:
        return [paragraph("None.")]
    rows = []
    for f in found[:MOST_FINDINGS]:
        unit = "mm" if f["metric"] == "depth" else ""
        rows.append(
            (
                figure(f["layer"]),
                figure(f["height_mm"], text=f"{f['height_mm']:.3f} mm"),
                f["backend"].replace(",", ", "),
                f["against"],
                words.meaning(words.METRICS, f["metric"]),
                figure(f["value"], unit),
                figure(f["limit"], unit),
                place(f["x_mm"], f["y_mm"]),
                f.get("cause_text") or f["cause"],
                f.get("remedy", ""),
            )
        )
    columns = (
        "layer", "z", "method", "against", "what", "value", "limit", "place (x, y), mm", "likely cause", "what to do",
    )  # fmt: skip
    parts = [table(columns, rows, class_="findings", numbers=("layer", "z", "value", "limit"))]
    if len(found) > MOST_FINDINGS:
        parts.append(paragraph(f"… and {len(found) - MOST_FINDINGS} more, all of them in run.json."))
    causes = sorted({f["cause"] for f in found})
    meant = [element("li", element("b", c), ": ", words.meaning(words.CAUSES, c)) for c in causes]
    return [*parts, element("ul", *meant)]


# -- pictures of chosen layers ---------------------------------------------------------------------

MOST_LAYERS = 8
WIDTH_PX, INSET_PX = 720, 320
# Half the side of the inset over the depth or the limit, whichever is greater, so that both are visible; and at most over the
# size of the layer, so that the inset enlarges at least a little even for a tiny layer
INSET_LIMITS, LARGEST_INSET = 5.0, 0.15
MOST_BYTES = 300_000  # Size of a picture above which it is drawn at half its scale, which needs fewer points


class Place(NamedTuple):
    """Place at which two methods are farthest apart on a layer, in terms of their limit."""

    x_mm: float
    y_mm: float
    depth_mm: float
    limit_mm: float
    pair: str


def _chosen(run: RunData) -> Markup:
    """Overlays of the contours of all methods on chosen layers."""
    if run.part_of("slabs"):
        count = int(run.part_of("slabs")["count"])
        return paragraph(
            f"The part was checked in {count} slabs, and their layers were dropped: there are none to draw."
        )
    worst = worst_places(run)
    frames = [_frame(run, layer, why, worst.get(layer)) for layer, why in _chosen_layers(run, worst).items()]
    drawn = element("div", *frames, class_="frames", data_label="layer")
    return join([element("h3", "Chosen layers"), drawn]) if frames else Markup("")


def _chosen_layers(run: RunData, worst: Mapping[int, Place]) -> dict[int, str]:
    """Layers to draw and why, from the bottom up: first, middle, last, worst and those with findings."""
    filled = run.filled_layers
    if not filled:
        return {}
    chosen = {filled[0]: "first layer"}
    chosen.setdefault(filled[len(filled) // 2], "middle layer")
    chosen.setdefault(filled[-1], "last layer")
    if worst:
        layer = max(worst, key=lambda k: (worst[k].depth_mm / worst[k].limit_mm, -k))
        chosen[layer] = f"{chosen[layer]}, worst agreement" if layer in chosen else "worst agreement"
    for finding in run.disagreements:
        layer = int(finding["layer"]) - 1
        if layer in chosen and "disagreement" not in chosen[layer]:
            chosen[layer] += ", disagreement"
        elif layer not in chosen and len(chosen) < MOST_LAYERS:
            chosen[layer] = "disagreement"
    return dict(sorted(chosen.items()))


def worst_places(run: RunData) -> dict[int, Place]:
    """Worst place of each layer on which a pair was compared."""
    rows = indexed(run.pair_table)
    if not len(rows):
        return {}
    rows = rows[rows["gated"] & (rows["limit_mm"] > 0)]
    ratio = (rows["depth_mm"] / rows["limit_mm"]).fillna(0.0).to_numpy()
    first = rows.iloc[np.lexsort((-ratio, rows["layer"].to_numpy()))].drop_duplicates("layer")
    figures = first[["depth_x_mm", "depth_y_mm", "depth_mm", "limit_mm"]].to_numpy(np.float64).tolist()
    pairs = zip(first["layer"].astype(int).tolist(), figures, first["a"], first["b"], strict=True)
    return {layer: Place(x, y, depth, limit, f"{a} and {b}") for layer, (x, y, depth, limit), a, b in pairs}


def _frame(run: RunData, layer: int, why: str, worst: Place | None) -> Markup:
    """Overlay of several stacks of one layer, and its worst place enlarged."""
    stacks = run.layer(layer)
    name, box = layer_name(layer, float(next(iter(stacks.values())).heights[0])), _box(stacks)
    svg = overlay_svg(stacks, 0, width_px=WIDTH_PX, title=name, box=box)
    if len(svg) > MOST_BYTES:
        svg = overlay_svg(stacks, 0, width_px=WIDTH_PX // 2, title=name, box=box)
    pictures = [inline(svg)]
    caption = f"{name} ({why})."
    if worst is not None and np.isfinite([worst.x_mm, worst.y_mm]).all():
        pictures.append(_inset(stacks, worst, box))
        caption += (
            f" Enlarged: the place where {worst.pair} differ most, ({worst.x_mm:.3f}, {worst.y_mm:.3f}) mm: "
            f"depth {worst.depth_mm:.4g} mm, limit {worst.limit_mm:.4g} mm."
        )
    return picture(element("div", *pictures, class_="beside"), caption, class_="frame", name=name)


def _box(stacks: Mapping[str, Layers]) -> Box:
    """Box of a layer in all stacks, widened so that a narrow one is not drawn taller than the page."""
    bounds = np.array([layers.bounds() for layers in stacks.values()])
    x0, y0 = np.nanmin(bounds[:, :2], axis=0)
    x1, y1 = np.nanmax(bounds[:, 2:], axis=0)
    least = max(LEAST_EXTENT_MM, 0.02 * max(x1 - x0, y1 - y0))
    wider = 0.5 * max(0.0, max(least, (y1 - y0) / HEIGHT_LIMIT) - (x1 - x0))
    taller = 0.5 * max(0.0, least - (y1 - y0))
    return (float(x0 - wider), float(y0 - taller), float(x1 + wider), float(y1 + taller))


def _inset(stacks: Mapping[str, Layers], worst: Place, box: Box) -> Markup:
    """Enlarge the worst place, in the colours and dashes of the whole picture."""
    reach = worst.depth_mm if np.isfinite(worst.depth_mm) else 0.0
    size_mm = max(box[2] - box[0], box[3] - box[1])
    half_mm = min(INSET_LIMITS * max(reach, worst.limit_mm), LARGEST_INSET * size_mm)
    canvas = Canvas(around(worst.x_mm, worst.y_mm, half_mm), INSET_PX)
    for n, layers in enumerate(stacks.values()):
        style = {"stroke": COLOURS[n % len(COLOURS)], "stroke_width": f"{max(1.0, 4.0 - 0.8 * n):g}"}
        for ring in outlines(layers, 0):
            canvas.lines(shapely.LineString(ring), **style, stroke_dasharray=DASHES[n % len(DASHES)] or None)
    canvas.circle(worst.x_mm, worst.y_mm, 9.0, "#b3261e")
    return canvas.svg("worst place enlarged")

"""Agreement: how far apart the methods are, layer by layer, and the likely causes of differences."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ebamcheck_reports import overlays, words
from ebamcheck_reports.charts import Series, line_chart
from ebamcheck_reports.figures import counted, place, shown
from ebamcheck_reports.markup import Markup, element, figure, join, mark, paragraph, section, table
from ebamcheck_reports.run_data import RunData

MOST_FINDINGS = 20

WHAT = (
    "Every pair of methods is compared on every layer. They agree where no part of the area that only one of them has is deeper than "
    "the limit: both promised errors plus a tolerance. Good is agreement of all pairs on all layers."
)


def render(run: RunData) -> Markup:
    """Matrix of pairs, charts over the layers, findings and pictures."""
    if not run.pairs:
        none = paragraph(
            f"{counted(len(run.methods), 'method')} came to an end; two are needed to compare anything.",
            class_="note bad",
        )
        return section("agreement", "Agreement", WHAT, none, _areas(run), overlays.render(run))
    return section(
        "agreement",
        "Agreement",
        WHAT,
        _counts(run),
        *_figures(run),
        element("h3", "Over the layers"),
        _areas(run),
        _ratios(run),
        element("h3", "Disagreements"),
        *_findings(run),
        overlays.render(run),
    )


def _figures(run: RunData) -> list[Markup]:
    """Matrix and table of the pairs; left out if every layer is empty, as they would suggest that all is well."""
    if not run.compared:
        return [
            paragraph(
                "There was nothing to compare: that the methods agree on nothing says nothing.",
                class_="note bad",
            )
        ]
    return [
        element("h3", "Worst depth of each pair"),
        _matrix(run),
        element("h3", "All figures of each pair"),
        _pairs(run),
    ]


def _counts(run: RunData) -> Markup:
    comparison = run.part_of("comparison")
    verdicts = [
        f"{counted(int(n), 'layer')}: {words.meaning(words.VERDICTS, v)}"
        for v, n in comparison["verdicts"].items()
    ]
    classes = [f"{n} {words.meaning(words.CLASSES, c)}" for c, n in comparison["classes"].items()]
    return paragraph("; ".join(verdicts), ". Of all, ", ", ".join(classes), ".")


def _matrix(run: RunData) -> Markup:
    names = list(run.backends)
    known = {frozenset((p["a"], p["b"])): p for p in run.pairs}
    rows = []
    for a in names:
        cells = [element("th", a, scope="row")]
        for b in names:
            pair = known.get(frozenset((a, b)))
            cells.append(
                _matrix_cell(pair) if a != b and pair else element("td", "–" if a != b else "", class_="void")
            )
        rows.append(element("tr", *cells))
    return table(("", *names), rows, class_="matrix")


def _matrix_cell(pair: Mapping[str, Any]) -> Markup:
    if not pair["gated"]:
        return element("td", "no layer both can be compared on", class_="void")
    good = pair["agree"] == pair["gated"]
    return element(
        "td",
        mark(good),
        element("br"),
        shown(pair["max_depth_mm"], "mm"),
        element("br"),
        element("small", f"limit {shown(pair['limit_mm'], 'mm')}"),
        class_="good" if good else "bad",
    )


def _pairs(run: RunData) -> Markup:
    columns = (
        "pair", "layers agreed", "worst depth", "limit", "result", "Hausdorff distance", "95 % of the contour within",
        "area difference", "least overlap (IoU)",
    )  # fmt: skip
    rows = []
    for p in run.pairs:
        good = p["agree"] == p["gated"]
        rows.append(
            (
                f"{p['a']} – {p['b']}",
                f"{p['agree']} of {p['gated']}" + (f" ({p['layers'] - p['gated']} not compared)" if p["gated"] < p["layers"] else ""),
                figure(p["max_depth_mm"], "mm"),
                figure(p["limit_mm"], "mm"),
                mark(good) if p["gated"] else "–",
                figure(p["max_hausdorff_mm"], "mm"),
                figure(p["max_p95_mm"], "mm"),
                figure(p["max_area_difference_mm2"], "mm²"),
                figure(p["min_iou"], text=f"{p['min_iou']:.6f}" if isinstance(p["min_iou"], float) else ""),
            )
        )  # fmt: skip
    note = paragraph(
        "Figures are the worst of all layers compared. Only the depth is judged: a sampled method rightly loses the tip of a sharp wedge, "
        "which makes the Hausdorff distance (the farthest that any point of one contour lies from the other) large although next to no area is lost.",
        class_="small",
    )
    return join([table(columns, rows, class_="pairs", numbers=(*columns[2:4], *columns[5:])), note])


def _areas(run: RunData) -> Markup:
    layers = run.layer_table
    series = [
        Series(name, layers["layer"], layers[f"area_mm2_{name}"])
        for name in run.methods
        if f"area_mm2_{name}" in layers
    ]
    if not series:
        return paragraph("There are no layers to draw.")
    caption = "Area of every layer as each method found it; the lines should lie on each other."
    return element(
        "figure", line_chart(series, "layer", "area, mm²", from_zero=True), element("figcaption", caption)
    )


def _ratios(run: RunData) -> Markup:
    table_ = run.pair_table
    # One line per slicer, in its style: eight slicers would give twenty-eight lines of pairs.
    ratio = table_.assign(ratio=np.where(table_["gated"], table_["depth_mm"] / table_["limit_mm"], np.nan))
    series = []
    for name in run.methods:
        worst = ratio[(ratio["a"] == name) | (ratio["b"] == name)].groupby("layer")["ratio"].max()
        series.append(Series(name, worst.index, worst))
    caption = (
        "Depth of the difference over its limit, of each method against the one that it differs most from: everything must stay "
        "under 1. Gaps are layers that are not compared."
    )
    chart = line_chart(series, "layer", "depth / limit", limit=1.0, limit_name="limit (1)", from_zero=True)
    return element("figure", chart, element("figcaption", caption))


def _findings(run: RunData) -> list[Markup]:
    found = run.disagreements
    if not found:
        return [paragraph("None.")]
    rows = [
        (
            figure(f["layer"]),
            figure(f["height_mm"], text=f"{f['height_mm']:.3f} mm"),
            f["backend"].replace(",", ", "),
            f["against"],
            words.meaning(words.METRICS, f["metric"]),
            figure(f["value"], "mm" if f["metric"] == "depth" else ""),
            figure(f["limit"], "mm" if f["metric"] == "depth" else ""),
            place(f["x_mm"], f["y_mm"]),
            f.get("cause_text") or f["cause"],
            f.get("remedy", ""),
        )
        for f in found[:MOST_FINDINGS]
    ]
    columns = (
        "layer",
        "z",
        "method",
        "against",
        "what",
        "value",
        "limit",
        "place (x, y), mm",
        "likely cause",
        "what to do",
    )
    parts = [table(columns, rows, class_="findings", numbers=("layer", "z", "value", "limit"))]
    if len(found) > MOST_FINDINGS:
        parts.append(paragraph(f"… and {len(found) - MOST_FINDINGS} more, all of them in run.json."))
    causes = sorted({f["cause"] for f in found})
    meant = [element("li", element("b", c), ": ", words.meaning(words.CAUSES, c)) for c in causes]
    return [*parts, element("ul", *meant)]

"""Report section on partition and order: how beads fill each layer, in which order, how warm it gets, and pictures of islands."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import shapely

from ebamcheck.kernels import Floats
from ebamcheck.layers.stack import Layers
from ebamcheck.printable import numbered
from ebamcheck.scan import ScanPlan
from ebamcheck.showing.colours import ramp
from ebamcheck_reports.canvas import Canvas, outline
from ebamcheck_reports.charts import Series, line_chart
from ebamcheck_reports.markup import (
    Markup,
    element,
    facts,
    figure,
    figure_duration,
    figure_percent,
    figures_of,
    join,
    legend,
    number,
    paragraph,
    percent,
    picture,
    section,
)
from ebamcheck_reports.run_data import BEAD_WIDTH_MM, RunData, layer_name

# Temperature of the chamber, solidus and boiling point if the settings name none
AMBIENT_K, SOLIDUS_K, BOILING_K = 293.15, 1877.0, 3533.0

WHAT = (
    "Each section is divided into islands (hexagons, or whole walls where it is thin), which are filled with parallel beads one after the "
    "other so that heat spreads. Good is a section that the beads cover, with few starts of the wire and short jumps."
)


def render(run: RunData) -> Markup:
    """Render metrics, pictures of layers, coverage, times and heat."""
    plan = run.plan
    if plan is None:
        none = paragraph("There was no contour to fill.", class_="note bad")
        return section("scan", "Partition and order", WHAT, none)
    pictures = element("div", legend(LEGEND), *_pictures(run, plan), class_="together")
    body = (_metrics(run, plan), pictures, _coverage(run, plan), _times(run), *_heat(run, plan))
    return section("scan", "Partition and order", WHAT, *body)


def _metrics(run: RunData, plan: ScanPlan) -> Markup:
    record, metrics = run.part_of("scan"), plan.metrics
    solid = metrics[metrics["area_mm2"] > 0]
    covered = solid["covered_fraction"]
    kinds = {str(k): int((plan.island_kind == k).sum()) for k in np.unique(plan.island_kind)}
    mean = float(np.average(covered, weights=solid["area_mm2"])) if len(solid) else float("nan")
    islands = (figure(record["islands"]), " (", ", ".join(f"{n} {k}" for k, n in kinds.items()), ")")
    lengths = (
        ("hatch lines", "hatch_mm", "mm"),
        ("contours", "contour_mm", "mm"),
        ("turns between lines", "turn_mm", "mm"),
        ("beads of thin walls", "wall_mm", "mm"),
        ("beads over gaps", "gap_mm", "mm"),
        ("moves with the beam off", "travel_mm", "mm"),
        ("starts of the wire", "starts", ""),
    )
    return facts(
        [
            ("order of islands", f"{record['order']} (seed {record['seed']})"),
            ("islands", join(islands)),
            ("side of the hexagons", _sides(metrics["side_mm"].dropna())),
            ("covered by beads, all layers", figure_percent(mean)),
            ("covered by beads, least layer", figure_percent(covered.min())),
            *figures_of(record, (given for given in lengths if given[1] in record)),
            ("time of beads, moves and waits", figure_duration(record["time_s"])),
            ("least time between neighbours", _least(metrics["interval_min_s"])),
        ]
    )


def _sides(sides: pd.Series[float]) -> Markup | str:
    if sides.empty:
        return "no hexagons"
    low, high = sides.min(), sides.max()
    return figure(low, "mm") if low == high else join([figure(low), " to ", figure(high, "mm")])


def _least(column: pd.Series[float]) -> Markup | str:
    known = column.to_numpy(np.float64)
    known = known[np.isfinite(known)]
    return figure_duration(known.min()) if known.size else "no neighbours"


def _pictures(run: RunData, plan: ScanPlan) -> list[Markup]:
    chosen: dict[int, str] = {}
    if run.middle_layer is not None:
        chosen[run.middle_layer] = "middle layer"
    solid = np.flatnonzero(plan.metrics["area_mm2"].to_numpy() > 0)
    if solid.size:
        worst = int(solid[plan.metrics["covered_fraction"].to_numpy()[solid].argmin()])
        chosen[worst] = f"{chosen[worst]}, least covered" if worst in chosen else "least covered layer"
        if len(chosen) < 2:
            busiest = int(plan.metrics["islands"].to_numpy().argmax())
            chosen.setdefault(busiest, "layer of the most islands")
    bead_mm, made = run.setting("process", "bead_width_mm", BEAD_WIDTH_MM), []
    for layer, why in chosen.items():
        name, found = layer_name(layer, float(plan.heights[layer])), plan.metrics.iloc[layer]
        caption = (
            f"{name} ({why}): {int(found['islands'])} islands, {percent(found['covered_fraction'])} covered, "
            f"{int(found['starts'])} starts of the wire. Numbers and colours give the order."
        )
        made.append(picture(draw(plan, run.primary, layer, bead_mm, f"partition of {name}"), caption))
    return made


# -- over the layers -------------------------------------------------------------------------------


def _coverage(run: RunData, plan: ScanPlan) -> Markup:
    metrics, limit = numbered(plan.metrics), run.gate_limit("coverage")
    solid = np.where(metrics["area_mm2"] > 0, 100.0 * metrics["covered_fraction"], np.nan)
    series = [Series("covered", metrics["layer"], solid)]
    limit = None if limit is None else 100.0 * limit
    chart = line_chart(series, "layer", "covered, %", limit=limit, limit_name="least")
    return picture(chart, "Share of each section that the beads cover; it must stay over the limit.")


def _times(run: RunData) -> Markup:
    program, metrics = run.table("program.csv"), run.table("scan.csv")
    whole = [name for name in ("deposit_s", "travel_s", "pause_s") if name in program.columns]
    if {"deposit_s", "travel_s"} <= set(whole):
        series = [
            Series("whole layer", program["layer"], program[whole].sum(axis=1)),
            Series("beam on", program["layer"], program["deposit_s"]),
        ]
    else:
        series = [Series("hatching and jumps", metrics["layer"], metrics["time_s"])]
    caption = "Time of each layer at constant feed; ramps of the axes come on top."
    return picture(line_chart(series, "layer", "time, s", from_zero=True), caption)


def _heat(run: RunData, plan: ScanPlan) -> list[Markup]:
    """Temperatures of the heat model, waits (dwell) and power of each layer, and their cost, if these were planned."""
    metrics = numbered(plan.metrics)
    if "entry_max_k" not in metrics or metrics["entry_max_k"].isna().all():
        return []
    solidus = run.setting("material", "solidus_k", SOLIDUS_K)
    boiling = run.setting("material", "boiling_k", BOILING_K)
    limit = run.gate_limit("heat")
    entry = metrics["entry_max_k"] + run.setting("process", "ambient_temperature_k", AMBIENT_K)
    lines = {
        "warmest bead when it is entered": entry,
        "surface when the layer begins": metrics["enter_k"],
        "surface when it is done": metrics["leave_k"],
    }
    series = [Series(n, metrics["layer"], np.minimum(k, boiling)) for n, k in lines.items() if k.notna().any()]
    given = (solidus, "solidus") if limit is None else (limit, "limit of entry")
    chart = line_chart(series, "layer", "temperature, K", *given)
    over = int((np.maximum(entry, metrics["leave_k"].fillna(0.0)) >= boiling).sum())
    caption = (
        "Temperatures by the heat model: the balance of the whole part, and what differs across each section. A bead may be "
        "entered up to the limit; the surface gets warmer while a layer is laid."
    )
    if over:
        caption += f" {over} layers are over the model's range and drawn at the boiling point: metal would boil."
    return [*_build_times(run), picture(chart, caption), *_measures(plan, metrics)]


def _build_times(run: RunData) -> list[Markup]:
    """Build time as programmed, beside the times without waits and with waits alone at full power."""
    times = run.part_of("heat").get("build_s", {})
    named = {
        "without_measures": "build time without waits and at any power: too hot where the gate would shut",
        "dwell": "build time with waits at full power",
        "programmed": "build time as programmed, with power and waits",
    }
    known = [name for name in named if np.isfinite(number(times.get(name)))]
    return [facts((named[name], figure_duration(number(times[name]))) for name in known)] if known else []


def _measures(plan: ScanPlan, metrics: pd.DataFrame) -> list[Markup]:
    """Waits and power over the layers."""
    if "wait_s" not in metrics or metrics["wait_s"].isna().all():
        return []
    within = np.zeros(len(metrics))
    if len(plan.island_wait_s):
        within += np.bincount(plan.island_layer, plan.island_wait_s, minlength=len(metrics))
    if len(plan.inner_wait_s):
        island = plan.further_beads()
        within += np.bincount(plan.island_layer[island], plan.inner_wait_s[island], minlength=len(metrics))
    waits = [
        Series("before the layer", metrics["layer"], metrics["wait_s"]),
        Series("before islands and beads of it", metrics["layer"], within),
    ]
    power = [Series("power", metrics["layer"], 100.0 * metrics["power_share"])]
    return [
        picture(
            line_chart(waits, "layer", "wait, s", from_zero=True),
            "Waits that keep the entry of each bead under the limit.",
        ),
        picture(
            line_chart(power, "layer", "of full power, %", from_zero=True),
            "Power: full on the cold base, less as the part gets warm.",
        ),
    ]


# -- picture of a layer ----------------------------------------------------------------------------

# Most islands that get numbers, and most that get arrows between them: more would cover the picture
MOST_NUMBERS, MOST_ARROWS = 150, 600
BEAD, LINE, WAY, THIN, SECTION = "#0072b2", "#555555", "#d81b60", "#d55e00", "#000000"
LEGEND = (
    ("first island", ramp(0.0), ""),
    ("last island", ramp(1.0), ""),
    ("way from island to island", WAY, ""),
    ("hatch line (one bead)", LINE, ""),
    ("contour of the part", SECTION, ""),
    ("contour bead: centre line, and its width lightly", BEAD, ""),
    ("border of a thin wall", THIN, "5 3"),
)


def draw(plan: ScanPlan, section: Layers | None, layer: int, bead_width_mm: float, title: str) -> Markup:
    """Draw a layer: islands coloured by rank, hatch lines, contour beads, the way between islands, and the section to fill."""
    islands, region = plan.islands_of(layer), plan.contours[layer]
    outlines = [] if section is None else [outline(section, r) for r in section.rings_of(layer)]
    canvas = Canvas.of(_corners([region, *plan.islands[islands]], bead_width_mm, outlines), 880.0)
    bead: dict[str, Any] = {
        "stroke_width": f"{bead_width_mm * canvas.px_per_mm:.1f}",
        "stroke_opacity": 0.18,
        "stroke_linejoin": "round",
    }
    canvas.lines(region.boundary, stroke=BEAD, **bead)
    for rank, island in enumerate(islands.tolist()):
        border: dict[str, Any] = {"stroke": "#fff", "stroke_width": 1.0, "stroke_dasharray": None}
        if plan.island_kind[island] == "thin wall":
            border = {"stroke": THIN, "stroke_width": 1.8, "stroke_dasharray": "5 3"}
        colour = ramp(rank / max(len(islands) - 1, 1))
        canvas.lines(plan.islands[island], fill=colour, fill_opacity=0.55, **border)
    starts, ends = (plan.vectors_of(layer)[[f"x{k}", f"y{k}"]].to_numpy() for k in range(2))
    canvas.segments(starts, ends, stroke=LINE, stroke_width=0.7)
    canvas.lines(region.boundary, stroke=BEAD, stroke_width=1.6)
    for points in outlines:
        canvas.lines(shapely.LineString(points), stroke=SECTION, stroke_width=1.0)
    centres = plan.island_centroid[islands]
    if len(islands) <= MOST_ARROWS:
        canvas.arrows(centres, WAY)
    if len(islands) <= MOST_NUMBERS:
        for rank, (x, y) in enumerate(centres.tolist()):
            canvas.label(x, y, str(rank + 1))
    return canvas.svg(title)


def _corners(shapes: list[Any], bead_width_mm: float, outlines: list[Floats]) -> Floats:
    """Points whose bounding box holds all beads and the section."""
    pad = 0.5 * bead_width_mm
    bounds = [np.add(shapely.bounds(s), (-pad, -pad, pad, pad)).reshape(2, 2) for s in shapes if not s.is_empty]
    return np.concatenate([*bounds, *outlines] or [np.array([[-0.5, -0.5], [0.5, 0.5]])])

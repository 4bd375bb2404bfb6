"""Partition and order: how the section is filled, and in which order."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ebamcheck.printable import numbered
from ebamcheck.scan import ScanPlan
from ebamcheck_reports import scan_picture
from ebamcheck_reports.charts import Series, line_chart
from ebamcheck_reports.figures import duration, number, percent
from ebamcheck_reports.markup import Markup, element, facts, figure, join, paragraph, picture, section
from ebamcheck_reports.run_data import RunData, layer_name

BEAD_WIDTH_MM = 6.0
"""Width at which beads are drawn if the settings name none."""

AMBIENT_K, SOLIDUS_K, BOILING_K = 293.15, 1877.0, 3533.0
"""Temperature of the chamber, solidus and boiling point if the settings name none."""

WHAT = (
    "Each section is divided into islands (hexagons, or whole walls where it is thin), which are filled with parallel beads one after the "
    "other so that heat spreads. Good is a section that the beads cover, with few starts of the wire and short jumps."
)


def render(run: RunData) -> Markup:
    """Metrics, pictures of layers, and the time of each."""
    plan = run.plan
    if plan is None:
        return section(
            "scan", "Partition and order", WHAT, paragraph("There was no contour to fill.", class_="note bad")
        )
    return section(
        "scan", "Partition and order", WHAT, _metrics(run, plan), element("div", scan_picture.key(), *_pictures(run, plan), class_="together"), _coverage(run, plan), _times(run), *_heat(run, plan)
    )  # fmt: skip


def _metrics(run: RunData, plan: ScanPlan) -> Markup:
    record, metrics = run.part_of("scan"), plan.metrics
    solid = metrics[metrics["area_mm2"] > 0]
    covered = solid["covered_fraction"]
    kinds = {str(k): int((plan.island_kind == k).sum()) for k in np.unique(plan.island_kind)}
    mean = float(np.average(covered, weights=solid["area_mm2"])) if len(solid) else float("nan")
    sides = metrics["side_mm"].dropna()
    return facts(
        [
            ("order of islands", f"{record['order']} (seed {record['seed']})"),
            (
                "islands",
                join([figure(record["islands"]), " (", ", ".join(f"{n} {k}" for k, n in kinds.items()), ")"]),
            ),
            ("side of the hexagons", _extent(sides.min(), sides.max()) if len(sides) else "no hexagons"),
            ("covered by beads, all layers", figure(mean, text=percent(mean))),
            ("covered by beads, least layer", figure(covered.min(), text=percent(covered.min()))),
            ("hatch lines", figure(record["hatch_mm"], "mm")),
            *_further_lengths(record),
            ("moves with the beam off", figure(record["travel_mm"], "mm")),
            ("starts of the wire", figure(record["starts"])),
            ("time of beads, moves and waits", figure(record["time_s"], text=duration(record["time_s"]))),
            ("least time between neighbours", _least(metrics["interval_min_s"])),
        ]
    )


def _further_lengths(record: Mapping[str, Any]) -> list[tuple[str, Markup]]:
    """Lengths of the other beads; runs of earlier versions have none of them."""
    names = {
        "contour_mm": "contours",
        "turn_mm": "turns between lines",
        "wall_mm": "beads of thin walls",
        "gap_mm": "beads over gaps",
    }
    return [(text, figure(record[name], "mm")) for name, text in names.items() if name in record]


def _extent(low: float, high: float) -> Markup:
    return figure(low, "mm") if low == high else join([figure(low), " to ", figure(high, "mm")])


def _least(column: object) -> Markup:
    known = np.asarray(column, np.float64)
    known = known[np.isfinite(known)]
    return figure(known.min(), text=duration(known.min())) if known.size else join(["no neighbours"])


def _pictures(run: RunData, plan: ScanPlan) -> list[Markup]:
    chosen: dict[int, str] = {}
    if run.middle_layer is not None:
        chosen[run.middle_layer] = "middle layer"
    solid = np.flatnonzero(plan.metrics["area_mm2"].to_numpy() > 0)
    if solid.size:
        worst = int(solid[plan.metrics["covered_fraction"].to_numpy()[solid].argmin()])
        chosen[worst] = f"{chosen[worst]}, least covered" if worst in chosen else "least covered layer"
        busiest = int(plan.metrics["islands"].to_numpy().argmax())
        if len(chosen) < 2:
            chosen.setdefault(busiest, "layer of the most islands")
    return [_picture(run, plan, layer, why) for layer, why in chosen.items()]


def _picture(run: RunData, plan: ScanPlan, layer: int, why: str) -> Markup:
    name = layer_name(layer, float(plan.heights[layer]))
    row = plan.metrics.iloc[layer]
    svg = scan_picture.draw(
        plan,
        run.primary,
        layer,
        run.setting("process", "bead_width_mm", BEAD_WIDTH_MM),
        f"partition of {name}",
    )
    caption = (
        f"{name} ({why}): {int(row['islands'])} islands, {percent(row['covered_fraction'])} covered, "
        f"{int(row['starts'])} starts of the wire. Numbers and colours give the order."
    )
    return picture(svg, caption)


def _coverage(run: RunData, plan: ScanPlan) -> Markup:
    metrics = numbered(plan.metrics)
    solid = np.where(metrics["area_mm2"] > 0, 100.0 * metrics["covered_fraction"], np.nan)
    limit = run.gate_limit("coverage")
    chart = line_chart(
        [Series("covered", metrics["layer"], solid)],
        "layer",
        "covered, %",
        limit=None if limit is None else 100.0 * limit,
        limit_name="least",
    )
    return element(
        "figure",
        chart,
        element("figcaption", "Share of each section that the beads cover; it must stay over the limit."),
    )


def _heat(run: RunData, plan: ScanPlan) -> list[Markup]:
    """Temperatures of the heat model, waits (dwell) and power of each layer, and their cost, if these were planned."""
    metrics = numbered(plan.metrics)
    if "entry_max_k" not in metrics or metrics["entry_max_k"].isna().all():
        return []
    ambient = run.setting("process", "ambient_temperature_k", AMBIENT_K)
    solidus = run.setting("material", "solidus_k", SOLIDUS_K)
    boiling = run.setting("material", "boiling_k", BOILING_K)
    limit = run.gate_limit("heat")
    entry = metrics["entry_max_k"] + ambient
    lines = {
        "warmest bead when it is entered": entry,
        "surface when the layer begins": metrics["enter_k"],
        "surface when it is done": metrics["leave_k"],
    }
    chart = line_chart(
        [
            Series(name, metrics["layer"], np.minimum(k, boiling))
            for name, k in lines.items()
            if k.notna().any()
        ],
        "layer",
        "temperature, K",
        limit=solidus if limit is None else limit,
        limit_name="solidus" if limit is None else "limit of entry",
    )
    over = int((np.maximum(entry, metrics["leave_k"].fillna(0.0)) >= boiling).sum())
    caption = (
        "Temperatures by the heat model: the balance of the whole part, and what differs across each section. A bead may be "
        "entered up to the limit; the surface gets warmer while a layer is laid."
    )
    if over:
        caption += (
            f" {over} layers are over the model's range and drawn at the boiling point: metal would boil."
        )
    figures = [element("figure", chart, element("figcaption", caption))]
    return [*_build_times(run), *figures, *_measures(plan)]


def _build_times(run: RunData) -> list[Markup]:
    """Time of the program beside that without measures and with waits alone."""
    times = run.part_of("heat").get("build_s", {})
    named = {
        "without_measures": "build time without waits and at any power: too hot where the gate would shut",
        "dwell": "build time with waits at full power",
        "programmed": "build time as programmed, with power and waits",
    }
    rows = [
        (text, figure(number(times[name]), text=duration(number(times[name]))))
        for name, text in named.items()
        if name in times and np.isfinite(number(times[name]))
    ]
    return [facts(rows)] if rows else []


def _measures(plan: ScanPlan) -> list[Markup]:
    """Waits and power over the layers."""
    metrics = numbered(plan.metrics)
    if "wait_s" not in metrics or metrics["wait_s"].isna().all():
        return []
    within = np.zeros(len(metrics))
    if len(plan.island_wait_s):
        within += np.bincount(plan.island_layer, plan.island_wait_s, minlength=len(metrics))
    if len(plan.inner_wait_s):
        island = plan.further_beads()
        within += np.bincount(plan.island_layer[island], plan.inner_wait_s[island], minlength=len(metrics))
    waits = line_chart(
        [
            Series("before the layer", metrics["layer"], metrics["wait_s"]),
            Series("before islands and beads of it", metrics["layer"], within),
        ],
        "layer",
        "wait, s",
        from_zero=True,
    )
    power = line_chart(
        [Series("power", metrics["layer"], 100.0 * metrics["power_share"])],
        "layer",
        "of full power, %",
        from_zero=True,
    )
    return [
        element(
            "figure", waits, element("figcaption", "Waits that keep the entry of each bead under the limit.")
        ),
        element(
            "figure",
            power,
            element("figcaption", "Power: full on the cold base, less as the part gets warm."),
        ),
    ]


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
    return element(
        "figure", line_chart(series, "layer", "time, s", from_zero=True), element("figcaption", caption)
    )

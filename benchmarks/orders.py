"""Scan orders on layers of the reference models: ``python -m benchmarks.orders``; tables in reports/scan.

What `thermal` has over `farthest` and `raster` on layers of a cooled base: by the linear model (finer than the one that plans), by
the nonlinear referee of :mod:`benchmarks.referee`, and with ``--thesis VERSION`` by the heat code 3DThesis on the path that a
simulator gets. ``--builds`` compares the build times of whole parts instead.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from shapely.geometry.base import BaseGeometry

from benchmarks.figures import machine, machine_text, markdown
from benchmarks.referee import referee_of, second_opinion
from ebamcheck.accuracy.heat_judge import LayerCase, judge_layer
from ebamcheck.geometry.regions import layer_section
from ebamcheck.plugins.registry import models
from ebamcheck.scan.plan.comparing import OrderComparison
from ebamcheck.scan.plan.whole_part import scan_part
from ebamcheck.settings.config import Config

BUILD_SIZE = ("bulkhead", "nozzle")
"""Models of the size that wire machines build; medians are also given without them."""

MODELS = (
    *BUILD_SIZE,
    *("ladder", "torus", "prism", "helical-channel", "blade", "impeller", "two-spheres", "case-cura-1473"),
)
"""Models whose layers are large enough for a partition at the default bead."""

SHARES = (0.07, 0.31, 0.53, 0.77, 0.93)
"""Heights of the layers, as shares of the model's height: none of them at a step."""

LEAST_ISLANDS = 12  # layers of fewer islands leave an order no choice
ORDERS = ("thermal", "farthest", "raster")
SEEDS = 20  # of an order that is drawn
OUTPUT = Path("reports/scan")

PART, LAYERS, SIDE_MM = "bulkhead", 100, 9.5
"""A reference model, its layers, and the side of hexagons of which about 300 lie in a layer."""

BUILD_LAYERS = 24  # lowest layers of each part of which the build time is compared
BUILD_ORDERS = (
    ("thermal", "thermal", {}),
    ("thermal without moves", "thermal", {"annealing_steps": 0}),
    *((name, name, {}) for name in ("raster", "stride", "nearest", "farthest", "least-heat")),
)


class Ratio(NamedTuple):
    """A greatest figure of `thermal` over that of another order, with a target where there is one."""

    what: str
    figure: str
    other: str
    most: float | None = None


RATIOS = (
    Ratio("greatest entry rise, by the model", "entry_max_k", "farthest", 0.45),
    Ratio("greatest entry rise, by the model", "entry_max_k", "raster", 0.2),
    Ratio("the same by the referee", "referee_max_k", "farthest", 0.5),
    Ratio("the same by the referee", "referee_max_k", "raster", 0.25),
    Ratio("hottest spot at entry, by the model", "entry_point_max_k", "farthest", 0.5),
    Ratio("hottest spot at entry, by the model", "entry_point_max_k", "raster"),
    Ratio("the same by the referee", "referee_point_max_k", "farthest", 0.5),
    Ratio("the same by the referee", "referee_point_max_k", "raster"),
    Ratio("greatest entry rise, by 3DThesis", "thesis_max_k", "farthest", 0.5),
    Ratio("greatest entry rise, by 3DThesis", "thesis_max_k", "raster", 0.25),
    Ratio("place of entry, by 3DThesis", "thesis_spot_max_k", "farthest", 0.5),
    Ratio("place of entry, by 3DThesis", "thesis_spot_max_k", "raster"),
    Ratio("jump travel", "travel_mm", "farthest", 0.5),
    Ratio("jump travel", "travel_mm", "raster"),
    Ratio("layer time", "time_s", "farthest"),
    Ratio("layer time", "time_s", "raster", 1.1),
)


def layers(names: tuple[str, ...]) -> Iterator[tuple[str, float, BaseGeometry]]:
    """Layers of the models: name, height over the lowest point, section."""
    for name, model in models(names).items():
        low, high = model.bounds[:, 2]
        for share in SHARES:
            z = float(low + share * (high - low))
            yield name, z - float(low), layer_section(model.section(z))


def compared(names: tuple[str, ...], orders: tuple[str, ...], config: Config, thesis: bool) -> pd.DataFrame:
    """Compare orders on all layers that are large enough: one row a layer, order and seed."""
    rows = []
    for name, height_mm, section in layers(names):
        comparison = OrderComparison.of(section, config, int(height_mm / config.layer_height_mm), height_mm)
        if len(comparison.islands) < LEAST_ISLANDS:
            continue
        judge = referee_of(comparison.laid, config)
        place = {"model": name, "height_mm": height_mm, "islands": len(comparison.islands)}
        for order in orders:
            for result in comparison.results(order, SEEDS):
                row = {**place, "order": order, **result.figures(), **second_opinion(judge, result, config)}
                if thesis:
                    case = LayerCase.of(result.plan, 0, section, config, height_mm=height_mm)
                    row |= judge_layer(case, config).figures()
                rows.append(row)
        print(f"{name}, {height_mm:.0f} mm: {len(comparison.islands)} islands", file=sys.stderr, flush=True)
    return pd.DataFrame(rows)


def ratio_rows(plans: pd.DataFrame) -> list[list[str]]:
    """Rows of the table: medians over the layers with the tenth and ninetieth percentile, beside the targets."""
    by_layer = plans.groupby(["model", "height_mm", "order"], sort=False).mean(numeric_only=True)
    wide = by_layer.reset_index().pivot_table(index=["model", "height_mm"], columns="order")
    rows = []
    for ratio in RATIOS:
        if ratio.figure not in plans or ratio.other not in set(plans["order"]):
            continue
        values = wide[(ratio.figure, "thermal")] / wide[(ratio.figure, ratio.other)]
        low, middle, high = np.nanquantile(values.to_numpy(), [0.1, 0.5, 0.9])
        limit = "-" if ratio.most is None else f"at most {ratio.most:g}"
        verdict = "-" if ratio.most is None else "met" if middle <= ratio.most else "missed"
        what = f"{ratio.what}: thermal over {ratio.other}"
        rows.append([what, f"{middle:.2f}", f"{low:.2f} to {high:.2f}", limit, verdict])
    return rows


def orders_text(plans: pd.DataFrame, command: str) -> str:
    """The report: ratios on all layers, and without the models of build size."""
    columns = ["what", "median", "10 % to 90 %", "target", ""]
    small = plans[~plans["model"].isin(BUILD_SIZE)]
    count = len(plans[["model", "height_mm"]].drop_duplicates())
    lines = ["# Scan orders by heat", "", f"By `{command}` on {machine_text(machine())}", ""]
    lines.append(
        f"Medians over {count} layers of {plans['model'].nunique()} models on a cooled base; temperatures are rises over the "
        "chamber. The referee is nonlinear (finite differences, latent heat, evaporation) and shares nothing with the model; "
        "3DThesis heats a half space that begins cold."
    )
    lines += ["", markdown(columns, ratio_rows(plans))]
    if len(small) and len(small) < len(plans):
        lines += ["", f"Without {' and '.join(BUILD_SIZE)}:", "", markdown(columns, ratio_rows(small))]
    return "\n".join(lines) + "\n"


def planned_layers() -> dict[str, Any]:
    """Order and heat of all layers of a part: seconds and islands of each, from below."""
    model = models((PART,))[PART]
    low, high = model.bounds[:, 2]
    height_mm = (high - low) / LAYERS
    heights = height_mm * (np.arange(LAYERS) + 0.5)
    config = Config().changed(scan={"hexagon_side_mm": SIDE_MM}, layers={"layer_height_mm": float(height_mm)})
    sections = [layer_section(model.section(float(low + z))) for z in heights.tolist()]
    seconds, islands, used_s, began = [], [], time.process_time(), time.perf_counter()
    for layer in scan_part(sections, heights, config, "thermal", config.scan.seed):
        seconds.append(time.perf_counter() - began)
        islands.append(int(layer["islands"]))
        began += seconds[-1]
    used_s = time.process_time() - used_s
    return {"status": "done", "why": "", "layer_s": seconds, "islands": islands, "processor_s": used_s}


def build_table(names: tuple[str, ...]) -> pd.DataFrame:
    """Build time of the lowest layers of parts by several orders, and by `thermal` without its moves; travel, processor time."""
    rows = []
    for name, model in models(names).items():
        low, high = model.bounds[:, 2]
        step_mm = Config().layer_height_mm
        heights = np.arange(0.5 * step_mm, high - low, step_mm)[:BUILD_LAYERS]
        sections = [layer_section(model.section(float(low + z))) for z in heights.tolist()]
        for what, order, scan in BUILD_ORDERS:
            began = time.process_time()
            found = pd.DataFrame(scan_part(sections, heights, Config().changed(scan=scan), order, 0))
            rows.append({
                "part": name, "order": what, "build, s": found["time_s"].sum() + found["wait_s"].sum(),
                "hottest entry, K": found["entry_max_k"].mean(), "travel, m": 1e-3 * found["travel_mm"].sum(),
                "processor, s": time.process_time() - began,
            })  # fmt: skip
    return pd.DataFrame(rows).round(1)


def main() -> None:
    """Compare, print, and write the table and all figures."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.orders", description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=OUTPUT)
    parser.add_argument("--models", default=",".join(MODELS))
    parser.add_argument("--orders", default=",".join(ORDERS))
    parser.add_argument("--thesis", help="version of 3DThesis, which does not tell it")
    parser.add_argument("--render", action="store_true", help="make the table again from the figures in the folder")
    parser.add_argument("--builds", action="store_true", help="print the build times of whole parts instead")
    options = parser.parse_args()
    names = tuple(options.models.split(","))
    if options.builds:
        table = build_table(names)
        print(markdown(list(table.columns), table.itertuples(index=False)))
        return
    options.output.mkdir(parents=True, exist_ok=True)
    file = options.output / "orders.csv"
    if not options.render:
        orders = tuple(options.orders.split(","))
        compared(names, orders, Config(), bool(options.thesis)).round(4).to_csv(file, index=False)
    command = "python -m benchmarks.orders" + (f' --thesis "{options.thesis}"' if options.thesis else "")
    text = orders_text(pd.read_csv(file), command)
    (options.output / "orders.md").write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()

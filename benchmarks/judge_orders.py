"""Scan orders judged by 3DThesis: ``python -m benchmarks.judge_orders --thesis VERSION``; tables in reports/scan.

What `thermal` has over `farthest` and `raster` on layers of :mod:`benchmarks.scan_orders`, by the heat code 3DThesis on
the path that a simulator gets, and by our own model driven at the same times.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import shapely

from benchmarks.machine import machine
from benchmarks.scan_orders import (
    BUILD_SIZE,
    DEFAULT_OUTPUT,
    LEAST_ISLANDS,
    MODELS,
    Ratio,
    layers,
    markdown,
)
from ebamcheck.accuracy.heat_judge import LayerCase, judge_layer
from ebamcheck.scan.plan.comparing import OrderComparison
from ebamcheck.settings.config import Config

ORDERS = ("thermal", "farthest", "raster")

TABLE, SAME_BODY = "judged.csv", "judged-same-body.csv"

BODY_PLACES = 16
"""Places an island on the plates, where every beam has some hundred images: on the smallest
plate the sum of all rises differs by 1.4 % from that over 64."""

PLATES = ((90.0, 60.0, 12.0), (150.0, 80.0, 12.0), (150.0, 80.0, 60.0))
"""Sides and heights, mm, of plates on which the body of 3DThesis is that of our model: mirrors on all sides but the top."""


RATIOS = (
    Ratio("island mean at entry, 3DThesis", "thesis_max_k", "farthest", 0.5),
    Ratio("island mean at entry, 3DThesis", "thesis_max_k", "raster", 0.25),
    Ratio("place of entry, 3DThesis", "thesis_spot_max_k", "farthest", 0.5),
    Ratio("place of entry, 3DThesis", "thesis_spot_max_k", "raster"),
    Ratio("hottest place of the island at entry, 3DThesis", "thesis_hottest_max_k", "farthest"),
    Ratio("hottest place of the island at entry, 3DThesis", "thesis_hottest_max_k", "raster"),
    Ratio("island mean at entry, our model", "model_max_k", "farthest", 0.45),
    Ratio("island mean at entry, our model", "model_max_k", "raster", 0.2),
)

AGREEMENT = {
    "kendall_tau": "Kendall's tau of the islands of a plan, our model against 3DThesis",
    "spearman": "Spearman's correlation of the same",
    "thesis_over_model": "all rises of a plan, 3DThesis over our model",
}


TEXT = """# Scan orders judged by 3DThesis

By `python -m benchmarks.judge_orders --thesis "{thesis}"` on {cores} cores of {cpu}; 3DThesis (github.com/ORNL-MDF/3DThesis) {thesis}, on the processor.

Medians over {count} layers of {models} models of the greatest rise of a layer: the mean of an island when the beam enters it, the place where it enters, and the hottest place of that island at that time.

3DThesis heats a half space that begins cold: no sides of the part, no base, no radiation. Both models get the islands' beads at the same times, and the constant material of our linear model; what is over boiling is linear heat beyond its range, good for a ratio alone.

{ratios}
## Our model against 3DThesis on the same body

Plates on an insulated base that do not radiate, with mirrors for their sides and base in 3DThesis: rises of the islands at entry, 3DThesis over our model. Our islands are heated evenly, those of 3DThesis bead by bead: where the beam enters beside what it has just laid, as `raster` does, 3DThesis finds more.

{bodies}
## Greatest rises by 3DThesis, K

{layers}"""
"""Text of the report."""


def judged(names: tuple[str, ...], config: Config) -> pd.DataFrame:
    """Judge the orders on all layers that are large enough: one row a layer and order."""
    rows: list[dict[str, Any]] = []
    for name, height_mm, section in layers(names):
        began = time.perf_counter()
        layer = int(height_mm / config.layer_height_mm)
        comparison = OrderComparison.of(section, config, layer, height_mm)
        if len(comparison.islands) < LEAST_ISLANDS:
            continue
        for order in ORDERS:
            plan = comparison.result(order, config.scan.seed).plan
            case = LayerCase.of(plan, 0, section, config, height_mm=height_mm)
            figures = judge_layer(case, config).figures()
            rows.append({"model": name, "height_mm": height_mm, "order": order, **figures})
        took = time.perf_counter() - began
        print(
            f"{name}, {height_mm:.0f} mm: {len(comparison.islands)} islands, {took:.0f} s",
            file=sys.stderr,
            flush=True,
        )
    return pd.DataFrame(rows)


def same_body(config: Config) -> pd.DataFrame:
    """Judge the orders on plates on an insulated base that do not radiate: one row a plate and order."""
    plain = config.changed(process={"base": "insulated"}, material={"emissivity": 0.0})
    rows: list[dict[str, Any]] = []
    for wide, deep, height_mm in PLATES:
        section = shapely.box(0.0, 0.0, wide, deep)
        comparison = OrderComparison.of(section, plain, 0, height_mm)
        for order in ORDERS:
            plan = comparison.result(order, plain.scan.seed).plan
            case = LayerCase.of(plan, 0, section, plain, height_mm=height_mm, body="box", places=BODY_PLACES)
            judged = judge_layer(case, plain)
            share = (judged.table["thesis_k"] / judged.table["model_k"])[1:]
            low, middle, high = share.quantile([0.1, 0.5, 0.9])
            place = {"plate, mm": f"{wide:g} x {deep:g} x {height_mm:g}", "order": order}
            spread = {"low": low, "median": middle, "high": high}
            rows.append({**place, **judged.figures(), **spread})
            print(f"plate {place}", file=sys.stderr, flush=True)
    return pd.DataFrame(rows)


def body_table(table: pd.DataFrame) -> pd.DataFrame:
    """How the two models agree on the same body."""
    return pd.DataFrame(
        {
            "plate, mm": table["plate, mm"],
            "order": table["order"],
            "islands": table["islands"].astype(int),
            "all rises": table["thesis_over_model"].map("{:.2f}".format),
            "median island": table["median"].map("{:.2f}".format),
            "10 % to 90 %": [
                f"{low:.2f} to {high:.2f}" for low, high in zip(table["low"], table["high"], strict=True)
            ],
            "Kendall's tau": table["kendall_tau"].map("{:.2f}".format),
        }
    )


def ratio_rows(table: pd.DataFrame, suffix: str) -> list[dict[str, str]]:
    """Rows of the ratios: medians over the layers, with the tenth and ninetieth percentile."""
    wide = table.pivot_table(index=["model", "height_mm"], columns="order")
    return [
        spread_row(
            f"{ratio.what}: thermal over {ratio.other}{suffix}",
            (wide[(ratio.figure, "thermal")] / wide[(ratio.figure, ratio.other)]).to_numpy(),
            ratio.most,
        )
        for ratio in RATIOS
    ]


def spread_row(what: str, values: np.ndarray, most: float | None = None) -> dict[str, str]:
    """Median and spread, beside a target where there is one."""
    low, middle, high = np.nanquantile(values, [0.1, 0.5, 0.9])
    return {
        "what": what,
        "median": f"{middle:.2f}",
        "10 % to 90 %": f"{low:.2f} to {high:.2f}",
        "target": "-" if most is None else f"<= {most:g}",
        "result": "reported" if most is None else "met" if middle <= most else "missed",
    }


def layer_table(table: pd.DataFrame, config: Config) -> pd.DataFrame:
    """Greatest rises of every layer by 3DThesis; over boiling, where its linear heat ends, only that they are over it."""
    most_k = config.material.boiling_k - config.process.ambient_temperature_k

    def told(value: float) -> str:
        return f"> {most_k:.0f}" if value > most_k else f"{value:.0f}"

    rows = []
    for (model, height_mm), some in table.groupby(["model", "height_mm"], sort=False):
        by_order = some.set_index("order")
        row = {"model": model, "height, mm": f"{height_mm:.0f}", "islands": int(some["islands"].max())}
        for figure, what in (("thesis_max_k", "mean"), ("thesis_spot_max_k", "place")):
            row |= {f"{what}, {order}": told(float(by_order[figure][order])) for order in ORDERS}
        rows.append(row)
    return pd.DataFrame(rows)


def report(table: pd.DataFrame, bodies: pd.DataFrame, thesis: str, config: Config) -> str:
    """Write the report."""
    groups = {"": table, f" (without {' and '.join(BUILD_SIZE)})": table[~table["model"].isin(BUILD_SIZE)]}
    rows = [row for suffix, some in groups.items() if len(some) for row in ratio_rows(some, suffix)]
    rows += [spread_row(what, table[name].to_numpy()) for name, what in AGREEMENT.items()]
    here, count = machine(), len(table) // len(ORDERS)
    return TEXT.format(
        thesis=thesis,
        **here,
        count=count,
        models=table["model"].nunique(),
        ratios=markdown(pd.DataFrame(rows)),
        bodies=markdown(body_table(bodies)),
        layers=markdown(layer_table(table, config)),
    )


def main() -> None:
    """Judge, print, and write the report and all figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=DEFAULT_OUTPUT)
    parser.add_argument("--models", default=",".join(MODELS))
    parser.add_argument("--thesis", required=True, help="Version of 3DThesis, which does not tell it.")
    parser.add_argument(
        "--render", action="store_true", help="Make the report again from the figures in the folder."
    )
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    config, files = Config(), [options.output / name for name in (TABLE, SAME_BODY)]
    if not options.render:
        judged(tuple(options.models.split(",")), config).round(4).to_csv(files[0], index=False)
        same_body(config).round(4).to_csv(files[1], index=False)
    table, bodies = (pd.read_csv(file) for file in files)
    text = report(table, bodies, options.thesis, config)
    (options.output / "judged.md").write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()

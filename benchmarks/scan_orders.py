"""Scan orders on layers of the reference models: ``python -m benchmarks.scan_orders [--csv FILE] [--scale 2.5 --side 10]``.

Medians over the layers of what `thermal` has over `farthest` and `raster`, for a cooled and an insulated base.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
import pandas as pd
import shapely
from shapely import affinity

from ebamcheck import compare_orders
from ebamcheck.config import Config
from ebamcheck.model import models
from ebamcheck.scan.comparing import COMPARED

MODELS = ("ladder", "torus", "prism", "helical-channel", "blade", "impeller", "two-spheres", "case-cura-1473")
"""Models whose layers are large enough for a partition at the default bead."""

SHARES = (0.07, 0.31, 0.53, 0.77, 0.93)
"""Heights of the layers, as shares of the model's height: none of them at a step."""

LEAST_ISLANDS = 12
"""Layers of fewer islands leave an order no choice."""

SEEDS = 5
"""Seeds of the order `random`."""

RATIOS = {
    "entry max / farthest": ("entry_max_k", "farthest", 0.5),
    "entry max / raster": ("entry_max_k", "raster", 0.2),
    "travel / farthest": ("travel_mm", "farthest", 0.5),
    "layer time / raster": ("time_s", "raster", 1.1),
}
"""Figures of `thermal` over those of another order, and the target."""


def compared(names: tuple[str, ...], orders: tuple[str, ...], profile: Config, scale: float) -> pd.DataFrame:
    """Compare orders on all layers that are large enough; one row a layer and order."""
    tables = []
    for name, model in models(names).items():
        low, high = model.bounds[:, 2]
        for share in SHARES:
            section = shapely.union_all(model.section(float(low + share * (high - low))))
            larger = affinity.scale(section, scale, scale, origin=(0, 0))
            height_mm = float(scale * share * (high - low))
            table = compare_orders(larger, profile, orders, seeds=SEEDS, height_mm=height_mm)
            tables.append(table.assign(model=name, height_mm=height_mm))
    table = pd.concat(tables, ignore_index=True)
    return table[table["islands"] >= LEAST_ISLANDS]


def ratios(table: pd.DataFrame) -> pd.DataFrame:
    """Ratios of :data:`RATIOS` by layer."""
    wide = table.pivot_table(index=["model", "height_mm"], columns="order")
    return pd.DataFrame(
        {
            name: wide[(figure, "thermal")] / wide[(figure, other)]
            for name, (figure, other, _) in RATIOS.items()
        }
    )


def report(base: str, table: pd.DataFrame) -> None:
    """Print medians of the figures and of the ratios."""
    figures = ["entry_max_k", "entry_sd_k", "excess_uniformity", "interval_p10_s", "travel_mm", "time_s"]
    found = ratios(table)
    islands = table["islands"].median()
    print(
        f"\n{base} base: medians of {len(found)} layers of {table['model'].nunique()} models, {islands:.0f} islands"
    )
    print(table.groupby("order", sort=False)[figures].median().round(2).to_string())
    for name, (_, _, target) in RATIOS.items():
        low, middle, high = np.quantile(found[name], [0.1, 0.5, 0.9])
        verdict = "met" if middle <= target else "missed"
        print(f"{name}: {middle:.2f} (10 % {low:.2f}, 90 % {high:.2f}), target {target:g}: {verdict}")


def main() -> None:
    """Compare, print, and write all figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--csv", type=Path, help="file for all figures")
    parser.add_argument("--scale", type=float, default=1.0, help="enlarge the models")
    parser.add_argument("--side", type=float, help="side of the hexagons, mm; default: planned")
    parser.add_argument("--models", default=",".join(MODELS))
    parser.add_argument("--orders", default=",".join(COMPARED))
    parser.add_argument("--bases", default="cooled,insulated")
    options = parser.parse_args()
    began = time.perf_counter()
    tables = []
    for base in options.bases.split(","):
        profile = Config().changed(process={"base": base}, scan={"hexagon_side_mm": options.side})
        table = compared(
            tuple(options.models.split(",")), tuple(options.orders.split(",")), profile, options.scale
        )
        report(base, table)
        tables.append(table.assign(base=base))
    if options.csv:
        pd.concat(tables).to_csv(options.csv, index=False)
    print(f"\n{time.perf_counter() - began:.0f} s")


if __name__ == "__main__":
    main()

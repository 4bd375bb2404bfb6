"""Scan orders on layers of the reference models: ``python -m benchmarks.scan_orders [--csv FILE]``.

Medians over the layers of what `thermal` has over `farthest` and `raster`, for a cooled and an insulated base.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
import pandas as pd

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

BASES = ("cooled", "insulated")

RATIOS = {
    "entry max / farthest": ("entry_max_k", "farthest", 0.5),
    "entry max / raster": ("entry_max_k", "raster", 0.2),
    "travel / farthest": ("travel_mm", "farthest", 0.5),
    "layer time / raster": ("time_s", "raster", 1.1),
}
"""Figures of `thermal` over those of another order, and the target."""


def layers(base: str, orders: tuple[str, ...]) -> pd.DataFrame:
    """Compare orders on all layers; one row a layer and order."""
    profile = Config().changed(process={"base": base})
    tables = []
    for name, model in models(MODELS).items():
        low, high = model.bounds[:, 2]
        for share in SHARES:
            height_mm = float(share * (high - low))
            table = compare_orders(
                model.section(float(low) + height_mm), profile, orders, seeds=5, height_mm=height_mm
            )
            # Wire starts and islands do not depend on the order, times of neighbours do.
            tables.append(table.assign(base=base, model=name, height_mm=height_mm))
    return pd.concat(tables, ignore_index=True)


def large_enough(base: str) -> list[tuple[str, float]]:
    """Layers of at least so many islands."""
    from ebamcheck import plan_scan

    profile = Config().changed(process={"base": base})
    found = []
    for name, model in models(MODELS).items():
        low, high = model.bounds[:, 2]
        for share in SHARES:
            height_mm = float(share * (high - low))
            if len(plan_scan(model.section(float(low) + height_mm), profile).islands) >= LEAST_ISLANDS:
                found.append((name, height_mm))
    return found


def ratios(table: pd.DataFrame) -> pd.DataFrame:
    """Ratios of :data:`RATIOS` by layer."""
    wide = table.pivot_table(index=["base", "model", "height_mm"], columns="order")
    return pd.DataFrame(
        {
            name: wide[(figure, "thermal")] / wide[(figure, other)]
            for name, (figure, other, _) in RATIOS.items()
        }
    )


def main() -> None:
    """Print the medians."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--csv", type=Path, help="file for all figures")
    options = parser.parse_args()
    began = time.perf_counter()
    chosen = large_enough("cooled")
    table = pd.concat([layers(base, COMPARED) for base in BASES])
    keys = pd.MultiIndex.from_arrays([table["model"], table["height_mm"]])
    table = table[keys.isin(chosen)]
    if options.csv:
        table.to_csv(options.csv, index=False)
    print(
        f"{len(chosen)} layers of {len({m for m, _ in chosen})} models, {time.perf_counter() - began:.0f} s\n"
    )
    figures = ["entry_max_k", "entry_sd_k", "excess_uniformity", "interval_p10_s", "travel_mm", "time_s"]
    for base, part in table.groupby("base"):
        print(f"{base} base, medians\n{part.groupby('order', sort=False)[figures].median().round(2)}\n")
    found = ratios(table)
    for base, part in found.groupby(level="base"):
        for name, (_, _, target) in RATIOS.items():
            low, middle, high = np.quantile(part[name], [0.1, 0.5, 0.9])
            verdict = "met" if middle <= target else "missed"
            print(
                f"{base}: {name} {middle:.2f} (10 % {low:.2f}, 90 % {high:.2f}), target {target:g}: {verdict}"
            )


if __name__ == "__main__":
    main()

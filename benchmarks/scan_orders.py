"""Scan orders on layers of the reference models: ``python -m benchmarks.scan_orders``; tables in reports/scan.

Medians over the layers of what `thermal` has over `farthest` and `raster`, for a cooled and an insulated base, by the
linear model (finer than the one that plans) and by the nonlinear referee, and how far the two agree in rank.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.stats import kendalltau
from shapely.geometry.base import BaseGeometry

from benchmarks.machine import machine
from benchmarks.referee import referee_of, second_opinion
from ebamcheck.geometry.regions import layer_section
from ebamcheck.plugins.registry import models
from ebamcheck.scan.plan.comparing import RANDOM, OrderComparison, compared_orders
from ebamcheck.settings.config import Config

BUILD_SIZE = ("bulkhead", "nozzle")
"""Models of the size that wire machines build; medians are also given without them."""

MODELS = (
    *BUILD_SIZE,
    "ladder",
    "torus",
    "prism",
    "helical-channel",
    "blade",
    "impeller",
    "two-spheres",
    "case-cura-1473",
)
"""Models whose layers are large enough for a partition at the default bead."""

SHARES = (0.07, 0.31, 0.53, 0.77, 0.93)
"""Heights of the layers, as shares of the model's height: none of them at a step."""

LEAST_ISLANDS, MANY_ISLANDS = 12, 40
"""Layers of fewer islands leave an order no choice; the more there are, the more it can do."""

SEEDS = 20
"""Seeds of the order `random`."""

BASES = ("cooled", "insulated")

DEFAULT_OUTPUT = Path("reports/scan")

FIGURES = (
    "entry_max_k",
    "entry_sd_k",
    "entry_point_max_k",
    "touching",
    "excess_uniformity",
    "interval_p10_s",
    "travel_mm",
    "time_s",
    "referee_max_k",
    "referee_point_max_k",
)


class Ratio(NamedTuple):
    """A greatest figure of `thermal` over that of another order; a target where the issue of orders sets one."""

    what: str
    figure: str
    other: str
    most: float | None = None


RATIOS = (
    Ratio("entry temperature rise, greatest", "entry_max_k", "farthest", 0.45),
    Ratio("entry temperature rise, greatest", "entry_max_k", "raster", 0.2),
    Ratio("the same by the nonlinear referee", "referee_max_k", "farthest", 0.5),
    Ratio("the same by the nonlinear referee", "referee_max_k", "raster", 0.25),
    Ratio("hottest spot at entry", "entry_point_max_k", "farthest", 0.5),
    Ratio("hottest spot at entry", "entry_point_max_k", "raster"),
    Ratio("hottest spot at entry by the nonlinear referee", "referee_point_max_k", "farthest", 0.5),
    Ratio("hottest spot at entry by the nonlinear referee", "referee_point_max_k", "raster"),
    Ratio("jump travel", "travel_mm", "farthest", 0.5),
    Ratio("jump travel", "travel_mm", "raster"),
    Ratio("layer time", "time_s", "farthest"),
    Ratio("layer time", "time_s", "raster", 1.1),
)

MOST_TOUCHING = 0.01
"""Share of the islands of all layers that may follow one that they touch, while another is left."""

RANKED_ORDERS = 5
"""Orders from which on their ranks are worth a correlation."""

LEAST_TAU = 0.9
"""Rank agreement of the linear model and the referee over a cooled base."""


def compared(
    names: tuple[str, ...], orders: tuple[str, ...], config: Config
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Compare orders on all layers that are large enough.

    Returns one row a layer, order and seed; and one row a layer with the agreement in rank.
    """
    plans, ranks = [], []
    for name, height_mm, section in layers(names):
        layer = int(height_mm / config.layer_height_mm)
        comparison = OrderComparison.of(section, config, layer, height_mm)
        if len(comparison.islands) < LEAST_ISLANDS:
            continue
        judge = referee_of(comparison.laid, config)
        rows, by_island = [], []
        for order in orders:
            for result in comparison.results(order, SEEDS):
                by_referee = second_opinion(judge, result, config)
                by_island.append(by_referee.pop("referee_tau"))
                rows.append({"order": order, **result.figures(), **by_referee})
        table = pd.DataFrame(rows)
        place: dict[str, Any] = {"model": name, "height_mm": height_mm, "islands": len(comparison.islands)}
        plans.append(table.assign(**place))
        ranks.append({**place, **agreement_of_plans(table), "tau_of_islands": float(np.median(by_island))})
        print(f"{name}, {height_mm:.0f} mm: {len(comparison.islands)} islands", file=sys.stderr, flush=True)
    return pd.concat(plans, ignore_index=True), pd.DataFrame(ranks)


def layers(names: tuple[str, ...]) -> Iterator[tuple[str, float, BaseGeometry]]:
    """Layers of the models: name, height over the lowest point, section."""
    for name, model in models(names).items():
        low, high = model.bounds[:, 2]
        for share in SHARES:
            z = float(low + share * (high - low))
            yield name, z - float(low), layer_section(model.section(z))


def agreement_of_plans(table: pd.DataFrame) -> dict[str, float]:
    """Kendall's tau of all plans of a layer by their greatest entry temperature, and of the orders by their means."""
    figures = ["entry_max_k", "referee_max_k"]
    orders = table.groupby("order")[figures].mean()
    return {
        name: float(kendalltau(*(rows[figure] for figure in figures)).statistic)
        for name, rows in (("tau_of_plans", table), ("tau_of_orders", orders))
    }


def by_layer(plans: pd.DataFrame) -> pd.DataFrame:
    """Figures of each layer and order, those of `random` as means over its seeds."""
    return plans.groupby(["model", "height_mm", "order"], sort=False).mean(numeric_only=True).reset_index()


def groups(plans: pd.DataFrame) -> dict[str, pd.DataFrame]:
    """Plans of all layers, of those of many islands, and of all but the large models, by what to say of them."""
    found = {
        "": plans,
        f" (layers of {MANY_ISLANDS} islands or more)": plans[plans["islands"] >= MANY_ISLANDS],
        f" (without {' and '.join(BUILD_SIZE)})": plans[~plans["model"].isin(BUILD_SIZE)],
    }
    return {suffix: some for suffix, some in found.items() if len(some)}


def ratio_rows(base: str, plans: pd.DataFrame, suffix: str) -> list[dict[str, Any]]:
    """Rows of the table of targets: medians over the layers, with the tenth and ninetieth percentile."""
    wide = by_layer(plans).pivot_table(index=["model", "height_mm"], columns="order")
    rows = []
    for ratio in RATIOS:
        values = wide[(ratio.figure, "thermal")] / wide[(ratio.figure, ratio.other)]
        what = f"{ratio.what}: thermal over {ratio.other}{suffix}"
        rows.append(target_row(base, what, values.to_numpy(), ratio.most, at_most=True))
    thermal = plans[plans["order"] == "thermal"]
    share = float((thermal["touching"] * thermal["islands"]).sum() / thermal["islands"].sum())
    what = f"thermal: islands of all layers that follow one they touch, though another is left{suffix}"
    rows.append(target_row(base, what, np.array([share]), MOST_TOUCHING, at_most=True))
    return rows


def tau_rows(base: str, ranks: pd.DataFrame) -> list[dict[str, Any]]:
    """Rows of the agreement in rank."""
    return [
        target_row(
            base, f"Kendall's tau, linear against nonlinear, of {what}", ranks[column].to_numpy(), LEAST_TAU
        )
        for what, column in (
            ("the plans of a layer by their greatest entry temperature", "tau_of_plans"),
            ("the orders of a layer by the same, each over its seeds", "tau_of_orders"),
            ("the islands of a plan by their entry temperature", "tau_of_islands"),
        )
    ]


def target_row(
    base: str, what: str, values: np.ndarray, limit: float | None, at_most: bool = False
) -> dict[str, Any]:
    """Median and spread beside a target, which is one for the cooled base only."""
    low, middle, high = np.quantile(values, [0.1, 0.5, 0.9])
    if base != "cooled":
        limit = None
    met = limit is not None and (middle <= limit if at_most else middle >= limit)
    verdict = "reported" if limit is None else "met" if met else "missed"
    sign = "<=" if at_most else ">="
    return {
        "base": base,
        "what": what,
        "median": f"{middle:.3f}" if middle < 0.05 else f"{middle:.2f}",
        "10 % to 90 %": f"{low:.2f} to {high:.2f}",
        "target": "-" if limit is None else f"{sign} {limit:g}",
        "result": verdict,
    }


def markdown(table: pd.DataFrame) -> str:
    """Write a table as Markdown."""
    lines = ["| " + " | ".join(table.columns) + " |", "|" + "---|" * len(table.columns)]
    lines += ["| " + " | ".join(str(value) for value in row) + " |" for row in table.itertuples(index=False)]
    return "\n".join(lines) + "\n"


def figures_table(plans: pd.DataFrame) -> pd.DataFrame:
    """Medians over the layers of the figures of every order."""
    medians = by_layer(plans).groupby("order", sort=False)[list(FIGURES)].median()
    digits = {name: 2 if name in ("excess_uniformity", "touching") else 0 for name in FIGURES}
    texts = {name: medians[name].map(f"{{:.{digits[name]}f}}".format) for name in FIGURES}
    return pd.DataFrame(texts).reset_index()


def main() -> None:
    """Compare, print, and write tables and all figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=DEFAULT_OUTPUT)
    parser.add_argument("--models", default=",".join(MODELS))
    parser.add_argument(
        "--orders", default=",".join(compared_orders()), help=f"`{RANDOM}` is tried with {SEEDS} seeds"
    )
    parser.add_argument(
        "--render", action="store_true", help="Make the tables again from the figures in the folder."
    )
    parser.add_argument("--bases", nargs="+", choices=BASES, default=BASES, help="only these bases")
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    rows, tables = [], []
    for base in options.bases:
        files = [options.output / f"{base}-{what}.csv" for what in ("plans", "ranks")]
        if not options.render:
            config = Config().changed(process={"base": base})
            found = compared(tuple(options.models.split(",")), tuple(options.orders.split(",")), config)
            for table, file in zip(found, files, strict=True):
                table.round(4).to_csv(file, index=False)
        plans, ranks = (pd.read_csv(file) for file in files)
        for suffix, some in groups(plans).items():
            rows += ratio_rows(base, some, suffix)
        if plans["order"].nunique() >= RANKED_ORDERS:
            rows += tau_rows(base, ranks)
        count, islands = len(ranks), ranks["islands"].median()
        title = f"## {base} base: medians of {count} layers of {ranks['model'].nunique()} models, {islands:.0f} islands"
        tables.append(f"{title}\n\n{markdown(figures_table(plans))}")
    here, ran = machine(), ",".join(plans["order"].unique())
    if list(options.bases) != list(BASES):
        ran += f" --bases {' '.join(options.bases)}"
    what = (
        "Temperatures are rises over the chamber, K: `entry` of whole islands when the beam enters them, `entry_point` under "
        "the beam there (hottest spot at entry); `referee` by the nonlinear referee. `touching` is the share of islands "
        "that follow one they touch, though another is left.\n"
    )
    text = "\n".join(
        [
            "# Scan orders by heat\n",
            f"By `python -m benchmarks.scan_orders --orders {ran}` on {here['cores']} cores of {here['cpu']}.\n",
            what,
            markdown(pd.DataFrame(rows)),
            *tables,
        ]
    )
    (options.output / "orders.md").write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()

"""Orders side by side on one layer: how hot, how far, how long."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd
from shapely.geometry.base import BaseGeometry

from ebamcheck.errors import SettingsError
from ebamcheck.geometry.regions import layer_section
from ebamcheck.heat.island_heat import IslandHeat, island_heat
from ebamcheck.kernels import Bools, Floats, Ints
from ebamcheck.plugins import registry
from ebamcheck.scan.order.entries import (
    entry_temperatures,
    modes_at_entries,
    nearest_options,
    rises_at_entries,
)
from ebamcheck.scan.order.orders import LayerIslands, needs_heat
from ebamcheck.scan.order.search import touching, touching_successors
from ebamcheck.scan.plan.columns import ScanPlan
from ebamcheck.scan.plan.laying import LaidLayer, lay_islands
from ebamcheck.scan.plan.stacking import simulate_order, stack_plans
from ebamcheck.scan.plan.whole_part import OrderedLayer
from ebamcheck.settings.config import Config

RANDOM = "random"
SEEDS = 20  # seeds over which the figures of `random` are averaged

# Columns of a comparison and what they are
FIGURES = {
    "order": "name of the order",
    "seeds": "plans that were averaged",
    "islands": "islands of the layer",
    "entry_max_k": "greatest mean temperature rise of an island when the beam enters it",
    "entry_sd_k": "standard deviation of it over the islands",
    "entry_point_max_k": "greatest temperature rise under the beam, where it enters an island",
    "touching": "share of islands that touch the one before them, though another was left that does not",
    "excess_uniformity": "spread of the temperature without the island's own heat, over the mean; mean of all islands",
    "interval_p10_s": "time between the ends of neighbouring islands, shortest tenth",
    "interval_min_s": "the same, least",
    "travel_mm": "jumps between islands",
    "starts": "wire starts",
    "time_s": "time of the layer without contour beads",
}


@dataclass(frozen=True, eq=False)
class OrderResult:
    """One order simulated on a layer of I islands."""

    plan: ScanPlan
    rank: Ints  # (I,) place in the order
    start_s: Floats
    end_s: Floats
    entry_k: Floats  # (I,) rise of the whole island when the beam enters
    point_k: Floats  # (I,) the same under the beam
    excess: Floats  # (I,) excess uniformity
    touching: Bools  # (I,) whether it touches the one before, though another was left that does not
    travel_mm: float  # jumps between islands

    def figures(self) -> dict[str, float]:
        """Figures as :data:`FIGURES` names them."""
        row = self.plan.metrics.iloc[0]
        of_plan = ("islands", "interval_p10_s", "interval_min_s", "starts", "time_s")
        figures = dict.fromkeys([name for name in FIGURES if name not in ("order", "seeds")], math.nan)
        figures |= {name: float(row[name]) for name in of_plan} | {"travel_mm": self.travel_mm}
        if len(self.entry_k):
            figures |= {"entry_max_k": float(self.entry_k.max()), "entry_sd_k": float(self.entry_k.std())}
            figures |= {
                "entry_point_max_k": float(self.point_k.max()),
                "touching": float(self.touching.mean()),
            }
            figures["excess_uniformity"] = float(self.excess.mean())
        return figures


def compared_orders() -> tuple[str, ...]:
    """Names of the orders that are compared unless others are named: each that is installed once, by its fullest name."""
    installed = registry.load_plugins(registry.ORDERS)
    return tuple({id(order): name for name, order in installed.items()}.values())


def compare_orders(
    polygons: BaseGeometry | Iterable[BaseGeometry],
    config: Config | None = None,
    orders: Sequence[str] | None = None,
    seeds: int = SEEDS,
    layer: int = 0,
    height_mm: float = 0.0,
) -> pd.DataFrame:
    """Plan a layer in several orders and simulate each on the heat model.

    The simulation resolves waves as short as an island, of which a plan knows only those that last.

    Parameters
    ----------
    polygons, config, layer, height_mm
        As for :func:`ebamcheck.plan_scan`; the height is that over the base plate.
    orders, seeds
        Names, all of the house if None, and seeds over which `random` is averaged; others take that of the settings.

    Returns
    -------
    DataFrame
        One row an order, columns as in :data:`FIGURES`; temperatures are NaN for a layer without islands.

    Raises
    ------
    SettingsError, GeometryError
        If an order is unknown, or there is no seed; if a coordinate is not finite.

    Examples
    --------
    >>> import shapely
    >>> table = compare_orders(shapely.box(0, 0, 80, 60), orders=["raster", "thermal"]).set_index("order")
    >>> bool(table["entry_max_k"]["thermal"] < table["entry_max_k"]["raster"])
    True
    """
    config = config or Config()
    compared = OrderComparison.of(polygons, config, layer, height_mm)
    names = compared_orders() if orders is None else orders
    rows = [figures_of(name, compared.results(name, seeds)) for name in names]
    return pd.DataFrame(rows, columns=list(FIGURES))


def figures_of(name: str, results: Iterable[OrderResult]) -> dict[str, Any]:
    """One row of a comparison: the means over plans of one order."""
    table = pd.DataFrame([result.figures() for result in results])
    return {"order": name, "seeds": len(table), **table.mean()}


@dataclass(frozen=True, eq=False)
class OrderComparison:
    """A layer on which orders are compared: islands and heat models are set up once."""

    laid: LaidLayer
    islands: LayerIslands
    heat: IslandHeat | None
    config: Config

    @classmethod
    def of(
        cls, polygons: BaseGeometry | Iterable[BaseGeometry], config: Config, layer: int, height_mm: float
    ) -> OrderComparison:
        """Divide a layer into islands and set up its heat model."""
        section = layer_section(polygons)
        laid = lay_islands(section, config, layer, height_mm)
        islands = laid.choices(config, config.scan.seed)
        heat = None
        if len(islands):
            schedule = islands.known_schedule
            times = schedule.beam_s, schedule.time_s
            modes = island_heat(section, laid.islands, *times, config, height_mm, fine=True)
            heat = islands.with_fresh_heat(modes)
        return cls(laid, islands, heat, config)

    @cached_property
    def planning_heat(self) -> IslandHeat:
        """Heat model that orders plan by, on a cold part; `heat`, on which they are simulated, is finer."""
        return self.islands.cold_heat()

    def results(self, name: str, seeds: int) -> Iterator[OrderResult]:
        """Plan one order and simulate it, one after the other: `random` for several seeds, others for that of the settings."""
        tried = range(seeds) if name == RANDOM else (self.config.scan.seed,)
        if not len(tried):
            raise SettingsError(f"seeds {seeds}: give at least 1 for the order {RANDOM!r}")
        return (self.result(name, seed) for seed in tried)

    def result(self, name: str, seed: int) -> OrderResult:
        """Plan one order and simulate it."""
        islands = self.islands if seed == self.islands.seed else self.laid.choices(self.config, seed)
        known = self.planning_heat if needs_heat(name) and len(islands) > 1 else None
        ordered = OrderedLayer.of(name, self.laid, islands, known)
        order, options = ordered.order, ordered.options
        plan = stack_plans([ordered], self.config, name, seed)
        simulated = simulate_order(plan, self.config)
        rank = np.argsort(order)
        if self.heat is None:
            nothing, none = np.zeros(0), np.zeros(0, np.bool_)
            return OrderResult(plan, rank, nothing, nothing, nothing, nothing, nothing, none, 0.0)
        # An island without lines is passed in no time.
        end_s = simulated["end_s"].ffill().fillna(0.0)
        start_s = simulated["start_s"].fillna(end_s)
        by_island = np.argsort(simulated["island"].to_numpy())
        begins, ends = start_s.to_numpy()[by_island], end_s.to_numpy()[by_island]
        entry_k, excess = entry_temperatures(self.heat, islands.area_mm2, order, begins, ends)
        schedule = islands.known_schedule
        if (options < 0).any():
            options = nearest_options(order, schedule.entry, schedule.leave)
        modes = modes_at_entries(self.heat, schedule)
        points_k = rises_at_entries(self.heat, modes, order, begins, ends, options)[np.arange(len(order)), options]
        hot = touching_successors(touching(islands.neighbours, len(order)), order)[rank]
        travel_mm = float(simulated["travel_mm"].sum())
        return OrderResult(plan, rank, begins, ends, entry_k, points_k, excess, hot, travel_mm)

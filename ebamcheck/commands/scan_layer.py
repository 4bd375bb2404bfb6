"""``ebamcheck scan PART --height Z``: one layer in one or several scan orders."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import shapely
import typer

from ebamcheck.atomic_file import made_folder, replacing
from ebamcheck.commands.options import print_json
from ebamcheck.commands.progress import watched
from ebamcheck.commands.scan_pictures import order_pictures
from ebamcheck.drawing.tables import text_table
from ebamcheck.errors import ExitCode, interruptible
from ebamcheck.json_values import plain
from ebamcheck.layers.heights import heights_within
from ebamcheck.layers.stack import from_polygons
from ebamcheck.mesh.part import Part
from ebamcheck.numeric.rings import Floats
from ebamcheck.pipeline.stages import bead_paths
from ebamcheck.program import write_program
from ebamcheck.scan import ScanPlan
from ebamcheck.scan.plan.comparing import RANDOM, OrderComparison, OrderResult, figures_of
from ebamcheck.settings.config import Config
from ebamcheck.slicers.slicing import slice_part

TABLE = "orders.json"

LEAST_HEIGHT_MM = 1e-3
"""A layer at the very bottom of a part is exported so high over the plate."""

HEADINGS = {
    "order": "order",
    "entry_max_k": "entry max, K",
    "entry_sd_k": "sd, K",
    "excess_uniformity": "excess R",
    "interval_p10_s": "interval p10, s",
    "interval_min_s": "min, s",
    "travel_mm": "travel, mm",
    "starts": "starts",
    "time_s": "time, s",
}
"""Figures of the printed table, and their headings."""


@dataclass
class _Compared:
    """What is known of the orders so far: their figures, and the plan of the first seed of each, which is drawn."""

    rows: list[dict[str, Any]] = field(default_factory=list)
    shown: dict[str, OrderResult] = field(default_factory=dict)

    def records(self) -> list[dict[str, Any]]:
        """Rows with None for what is not a number."""
        found: list[dict[str, Any]] = json.loads(pd.DataFrame(self.rows).to_json(orient="records"))
        return found

    def travel_and_entry(self) -> dict[str, tuple[float, float]]:
        """Travel and greatest entry temperature of each order, as the table has them."""
        return {row["order"]: (row["travel_mm"], row["entry_max_k"]) for row in self.rows}


def scan_layer(
    part: Part,
    config: Config,
    height_mm: float,
    orders: tuple[str, ...],
    seeds: int,
    simulators: tuple[str, ...],
    output: Path | None,
    as_json: bool,
) -> ExitCode:
    """Plan one layer of a placed part in several orders; an interrupt keeps the orders that are done."""
    cut = heights_within(part, [height_mm], "--height")
    if output is not None:
        made_folder(output)
    layers = slice_part(part, cut)
    over_plate_mm = height_mm - float(part.bounds[0][2])
    number = max(0, round(over_plate_mm / config.layer_height_mm - 0.5))
    layer = OrderComparison.of(layers.polygons(0), config, number, max(over_plate_mm, 0.0))
    done, interrupted = _Compared(), False
    try:
        with interruptible():
            for _ in _compare(layer, orders, seeds, done):
                if output is not None:
                    _write(output, _table(done))
    except KeyboardInterrupt:
        interrupted = True
    if output is not None and done.shown:
        _write(output, _table(done))
        what = f"{part.name}, z = {height_mm:g} mm"
        _write(output, order_pictures(layer, done.shown, done.travel_and_entry(), what))
        _export(output, simulators, done.shown, height_mm, over_plate_mm, config)
    if interrupted:
        kept = f", kept in {output}" if output is not None and done.rows else ""
        raise KeyboardInterrupt(f"{len(done.rows)} of {len(orders)} orders are done{kept}")
    if as_json:
        print_json(done.records())
    else:
        rows = [[_cell(row[name]) for name in HEADINGS] for row in done.records()]
        count, base = len(layer.laid.islands), config.process.base
        low, high = part.bounds[:, 2].tolist()
        beside = "" if count else f" (the part reaches from {low:g} to {high:g} mm)"
        typer.echo(f"{count} islands at z = {height_mm:g} mm{beside}, {base} base\n")
        typer.echo(text_table(list(HEADINGS.values()), rows))
    return ExitCode.PASS


def _compare(layer: OrderComparison, orders: tuple[str, ...], seeds: int, done: _Compared) -> Iterator[None]:
    """Plan and simulate one order after the other, with a bar that moves with each plan."""
    with watched() as observer:
        observer.stage("orders", sum(seeds if name == RANDOM else 1 for name in orders))
        for name in orders:
            results = []
            for result in layer.results(name, seeds):
                results.append(result)
                observer.advance(1)
            done.shown[name] = results[0]
            done.rows.append(figures_of(name, results))
            yield


def _export(
    folder: Path,
    simulators: tuple[str, ...],
    shown: dict[str, OrderResult],
    height_mm: float,
    over_plate_mm: float,
    config: Config,
) -> None:
    """Write the path of each order for each simulator, as paths/ORDER/SIMULATOR, at the height over the plate."""
    step_mm = 0.5 * max(over_plate_mm, LEAST_HEIGHT_MM)
    heights = np.array([height_mm - step_mm, height_mm])
    for name, result in shown.items() if simulators else ():
        plan = _over_nothing(result.plan, heights)
        beads = bead_paths(from_polygons(heights, [[], []]), plan, config)
        for simulator in simulators:
            program = config.changed(machine={"control": simulator})
            write_program(beads, plan, program, folder / "paths" / name / simulator)


def _over_nothing(plan: ScanPlan, heights: Floats) -> ScanPlan:
    """Plan of one layer with an empty one below it.

    Posts count Z from the first layer of a stack, which is as high as its step to the second: so the second of two
    lies at twice that step, and the layer alone would lie at one layer height, wherever it was cut.
    """
    return replace(
        plan,
        heights=heights,
        contours=np.array([shapely.Polygon(), *plan.contours], object),
        island_layer=plan.island_layer + 1,
        metrics=pd.concat([plan.metrics] * 2, ignore_index=True).assign(wait_s=0.0),
        sections=None if plan.sections is None else np.array([shapely.Polygon(), *plan.sections], object),
    )


def _table(done: _Compared) -> dict[str, str]:
    return {TABLE: json.dumps(plain(done.records()), indent=2, sort_keys=True) + "\n"}


def _write(folder: Path, files: dict[str, str]) -> None:
    """Write files by name into a folder that is there."""
    for name, text in files.items():
        with replacing(folder / name) as temporary:
            temporary.write_text(text, encoding="utf-8")


def _cell(value: Any) -> str:
    if value is None:
        return "-"
    return value if isinstance(value, str) else f"{value:.2f}" if abs(value) < 10 else f"{value:.0f}"

"""``ebamcheck scan``: one layer of a part in several scan orders, or all layers in one, on the heat model."""

from __future__ import annotations

import csv
import json
import os
from collections.abc import Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pandas as pd
import shapely
import typer
from typer import Option

from ebamcheck.atomic_file import made_folder, replacing
from ebamcheck.commands import options
from ebamcheck.commands.summaries import watched
from ebamcheck.errors import ExitCode, SettingsError, interruptible
from ebamcheck.heat import ContourModes
from ebamcheck.json_values import plain
from ebamcheck.kernels import Floats
from ebamcheck.layers.heights import cut_heights, heights_within
from ebamcheck.layers.stack import from_polygons
from ebamcheck.mesh.part import Part
from ebamcheck.nc.control import simulators
from ebamcheck.pipeline.stages import bead_paths
from ebamcheck.program import write_program
from ebamcheck.scan.order.entries import entered
from ebamcheck.scan.plan.comparing import (
    RANDOM,
    SEEDS,
    OrderComparison,
    OrderResult,
    compared_orders,
    figures_of,
)
from ebamcheck.scan.plan.whole_part import WHOLE_PART, scan_part
from ebamcheck.settings.config import Config
from ebamcheck.settings.process_window import checked_window
from ebamcheck.settings.stages import order_names
from ebamcheck.showing import pictures
from ebamcheck.showing.short_text import text_table
from ebamcheck.slicers.slicing import slice_part

BUILT = "built_s"  # column: time from the start of the build to the end of a layer, with the waits between
# Figures of the printed table of orders, and their headings
HEADINGS = {
    "order": "order", "entry_max_k": "entry max, K", "entry_sd_k": "sd, K", "excess_uniformity": "excess R",
    "interval_p10_s": "interval p10, s", "interval_min_s": "min, s", "travel_mm": "travel, mm", "starts": "starts",
    "time_s": "time, s",
}  # fmt: skip


@options.explained(
    all_layers=Option("--all", help="All layers from below, with the heat of those under them."),
    pause=Option(help="With --all: wait between two layers, s; default: process.layer_pause_s.", min=0.0),
    orders=f"{', '.join(order_names())}, or all; comma-separated. Default: scan.order.",
    output="Folder for orders.json and pictures.",
    export="Also write the path of each order for heat simulators, by the names of their controls, or for all.",
)
def scan_command(
    part: Path,
    height: Annotated[float | None, Option(help="Absolute height z of the layer, mm.")] = None,
    all_layers: bool = False,
    pause: float | None = None,
    layer_height: float | None = None,
    orders: str = "",
    output: Path | None = None,
    export: str = "",
    seeds: Annotated[int, Option(help=f"Seeds over which `{RANDOM}` is averaged.")] = SEEDS,
    config_file: Path | None = None,
    units: str = "",
    direction: str = "",
    yes: bool = False,
    as_json: bool = False,
) -> ExitCode:
    """Plan one layer in one or several scan orders, or all layers in one; say how hot, how far and how long.

    Example: ebamcheck scan blade.stl --height 12 --orders all -o orders
    """
    config = options.settings_of(config_file, units, direction, layer_height)
    checked_window(config)
    wanted = compared_orders() if orders == "all" else options.names(orders) or (config.scan.order,)
    for name in wanted:  # an unknown one is refused before anything is computed
        config.changed(scan={"order": name})
    exported = simulators() if export == "all" else options.names(export)
    if unknown := set(exported) - set(simulators()):
        raise SettingsError(f"--export {sorted(unknown)[0]!r}: choose from {', '.join(simulators())}, or all")
    if exported and output is None:
        raise SettingsError("--export: give the folder with -o")
    if seeds < 1:
        raise SettingsError(f"--seeds {seeds}: give at least 1")
    if all_layers == (height is not None):
        raise SettingsError("scan: give either --height Z for one layer, or --all")
    if pause is not None and not all_layers:
        raise SettingsError("--pause: the wait between layers belongs to --all")
    placed = options.loaded(part, config)
    if height is None:
        if len(wanted) != 1:
            raise SettingsError(f"--all plans in one order, not {len(wanted)}: give one with --orders")
        if pause is not None:
            config = config.changed(process={"layer_pause_s": pause})
        return scan_all(placed, config, wanted[0], output, as_json, yes)
    return scan_layer(placed, config, height, wanted, seeds, exported, output, as_json)


def scan_all(part: Part, config: Config, order: str, output: Path | None, as_json: bool, yes: bool) -> ExitCode:
    """Order all layers of a placed part; rows are written as they are done, so that an interrupt keeps them."""
    layers = slice_part(part, options.within_work(part, cut_heights(part, config), config, yes))
    sections = [layers.section(k) for k in range(len(layers))]
    heights_mm = np.asarray(layers.heights) - float(part.bounds[0][2])
    found = scan_part(sections, heights_mm, config, order, config.scan.seed)
    rows: list[dict[str, Any]] = []
    built_s = 0.0
    file = os.devnull if output is None else made_folder(output) / "layers.csv"
    opening = open(file, "w", newline="", encoding="utf-8", buffering=1)  # noqa: SIM115
    with closing(found), opening as opened, watched() as observer:
        table = csv.DictWriter(opened, [*WHOLE_PART, BUILT])
        table.writeheader()
        observer.stage("order and heat", len(sections))
        try:
            with interruptible():
                for row in found:
                    row["layer"] += 1
                    built_s += float(np.nansum([row["wait_s"], row["time_s"]]))
                    row[BUILT] = built_s
                    table.writerow(row)
                    rows.append(row)
                    observer.advance(1)
        except KeyboardInterrupt:
            # It may come between the line of a layer and the count of it.
            done = len(rows) if output is None else Path(file).read_bytes().count(b"\n") - 1
            kept = f", kept in {file}" if output is not None and done else ""
            raise KeyboardInterrupt(f"{done} of {len(sections)} layers are done{kept}") from None
    if as_json:
        options.print_json([{k: None if v != v else v for k, v in row.items()} for row in rows])
        return ExitCode.PASS
    typer.echo(f"{len(rows)} layers in the order {order}, {config.process.base} base\n")

    def figure(value: float) -> str:
        return "-" if value != value else f"{value:.6g}" if isinstance(value, int) else f"{value:.1f}"

    shown = [*(name for name in WHOLE_PART if name != "stored_j"), BUILT]
    typer.echo(text_table(shown, [[figure(row[name]) for name in shown] for row in rows]))
    return ExitCode.PASS


@dataclass
class _Compared:
    """What is known of the orders so far: their figures, and the plan of the first seed of each, which is drawn."""

    rows: list[dict[str, Any]] = field(default_factory=list)
    shown: dict[str, OrderResult] = field(default_factory=dict)

    def records(self) -> list[dict[str, Any]]:
        """Rows with None for what is not a number."""
        found: list[dict[str, Any]] = json.loads(pd.DataFrame(self.rows).to_json(orient="records"))
        return found

    def write(self, folder: Path) -> None:
        """Write the table into a folder that is there."""
        _write(folder, {"orders.json": json.dumps(plain(self.records()), indent=2, sort_keys=True) + "\n"})


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
                    done.write(output)
    except KeyboardInterrupt:
        interrupted = True
    if output is not None and done.shown:
        done.write(output)
        figures = {row["order"]: (row["travel_mm"], row["entry_max_k"]) for row in done.rows}
        _write(output, order_pictures(layer, done.shown, figures, f"{part.name}, z = {height_mm:g} mm"))
        _export(output, simulators, done.shown, height_mm, over_plate_mm, config)
    if interrupted:
        kept = f", kept in {output}" if output is not None and done.rows else ""
        raise KeyboardInterrupt(f"{len(done.rows)} of {len(orders)} orders are done{kept}")
    if as_json:
        options.print_json(done.records())
    else:

        def cell(value: Any) -> str:
            if value is None or isinstance(value, str):
                return value or "-"
            return f"{value:.2f}" if abs(value) < 10 else f"{value:.0f}"

        rows = [[cell(row[name]) for name in HEADINGS] for row in done.records()]
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
    """Write the path of each order for each simulator, as paths/ORDER/SIMULATOR, at the height over the plate.

    A stack's first layer is as high as its step to the second: so the layer is the second of two, at twice that step, the lower one
    empty."""
    step_mm = 0.5 * max(over_plate_mm, 1e-3)
    heights = np.array([height_mm - step_mm, height_mm])
    for name, result in shown.items() if simulators else ():
        plan, none = result.plan, shapely.Polygon()
        two: dict[str, Any] = {"heights": heights, "contours": np.array([none, *plan.contours], object)}
        two["metrics"] = pd.concat([plan.metrics] * 2, ignore_index=True).assign(wait_s=0.0)
        if plan.sections is not None:
            two["sections"] = np.array([none, *plan.sections], object)
        plan = replace(plan, island_layer=plan.island_layer + 1, **two)
        beads = bead_paths(from_polygons(heights, [[], []]), plan, config)
        for simulator in simulators:
            program = config.changed(machine={"control": simulator})
            write_program(beads, plan, program, folder / "paths" / name / simulator)


def _write(folder: Path, files: dict[str, str]) -> None:
    for name, text in files.items():
        with replacing(folder / name) as temporary:
            temporary.write_text(text, encoding="utf-8")


def order_pictures(
    compared: OrderComparison,
    results: Mapping[str, OrderResult],
    figures: Mapping[str, tuple[float, float]],
    what: str,
) -> dict[str, str]:
    """Texts by file name: two maps an order, and its last temperatures, all in one frame and on one scale.

    It ends at the hottest entry, or what most of a finished layer is under, and at boiling at last; `figures` are travel and
    hottest entry."""
    islands, section = compared.laid.islands, compared.laid.regions.section
    plans = {name: result.plan for name, result in results.items()}
    scenes = {n: pictures.Scene.of(section, plan.contours[0], plan.vectors_of(0)) for n, plan in plans.items()}
    files = {}
    for name, result in results.items():
        rank, title = result.rank.astype(np.float64), f"{what}: rank, {name}"
        files[f"{name}-rank.svg"] = pictures.islands_svg(islands, rank, title, scene=scenes[name])
    heat = compared.heat
    if heat is None or not isinstance(plane := heat.model.plane, ContourModes):
        return files
    at_end = {}
    for name, result in results.items():
        _, state = entered(heat, np.argsort(result.rank), result.start_s, result.end_s)
        # Temperature rise in the cells of the section when an order is done, (M,).
        at_end[name] = np.asarray(plane.values @ (state @ heat.modes.in_layer), np.float64)  # noqa: PD011
    hottest = max(float(result.entry_k.max()) for result in results.values())
    # The colours tell nine of ten cells apart: the last islands are far hotter.
    warmest = max(float(np.quantile(last_k, 0.9)) for last_k in at_end.values())
    config = compared.config
    ambient_k = config.process.ambient_temperature_k
    solidus, boiling = (k - ambient_k for k in (config.material.solidus_k, config.material.boiling_k))
    scale = pictures.TemperatureScale.of(max(hottest, warmest), solidus, boiling)
    for name, result in results.items():
        title, scene = f"{what}: entry temperature rise, {name}", scenes[name]
        entry = pictures.islands_svg(islands, result.entry_k, title, " K", scene=scene, temperatures=scale)
        title = f"{what}: temperature rise when the layer is done, {name}"
        rises = partial(_rises, plane, at_end[name])
        field = pictures.field_svg(rises, section, title, " K", scale.greatest, scene, scale)
        files |= {f"{name}-entry.svg": entry, f"{name}-field.svg": field}
    files["pareto.svg"] = pictures.pareto_svg(figures, f"{what}: {len(islands)} islands")
    return files


def _rises(plane: ContourModes, of_cells: Floats, points: Floats) -> Floats:
    """Rises at points (n, 2) between those in the cells of the section."""
    return plane.grid.interpolation(points) @ of_cells

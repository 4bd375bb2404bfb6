"""``ebamcheck scan``: one layer of a part in several scan orders, on the heat model."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pandas as pd
import typer

from ebamcheck.atomic_file import replacing
from ebamcheck.config import Config
from ebamcheck.errors import ExitCode, SettingsError
from ebamcheck.layers import Layers
from ebamcheck.options import (
    ConfigOption,
    DirectionOption,
    JsonOption,
    LayerHeightOption,
    PartArgument,
    UnitsOption,
    loaded,
    names,
    print_json,
    settings_of,
)
from ebamcheck.pipeline.programming import bead_paths
from ebamcheck.program import write_program
from ebamcheck.scan.comparing import COMPARED, RANDOM, SEEDS, OrderComparison, OrderResult, figures_of
from ebamcheck.settings.scan import SCAN_ORDERS
from ebamcheck.slicing import slice_part
from ebamcheck.stages.scan_part_command import scan_all
from ebamcheck.stages.scan_pictures import order_pictures
from ebamcheck.store import plain
from ebamcheck.tables import text_table

ALL = "all"

SIMULATORS = ("3dthesis", "adamantine", "additivefoam")
"""Posts of heat simulators, which take the path of a layer."""

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


def scan_command(
    part: PartArgument,
    height: Annotated[float | None, typer.Option(help="Absolute height z of the layer, mm.")] = None,
    all_layers: Annotated[
        bool, typer.Option("--all", help="All layers from below, with the heat of those under them.")
    ] = False,
    pause: Annotated[float, typer.Option(help="With --all: time between two layers, s.", min=0.0)] = 0.0,
    layer_height: LayerHeightOption = None,
    orders: Annotated[
        str, typer.Option(help=f"{', '.join(SCAN_ORDERS)}, or all; comma-separated. Default: scan.order.")
    ] = "",
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Folder for orders.json and pictures.")
    ] = None,
    export: Annotated[
        str,
        typer.Option(
            help=f"Also write the path of each order for simulators: {', '.join(SIMULATORS)}, or all."
        ),
    ] = "",
    seeds: Annotated[int, typer.Option(help=f"Seeds over which `{RANDOM}` is averaged.")] = SEEDS,
    config: ConfigOption = None,
    units: UnitsOption = "",
    direction: DirectionOption = "",
    as_json: JsonOption = False,
) -> ExitCode:
    """Plan one layer in one or several scan orders, or all layers in one; say how hot, how far and how long."""
    settings = settings_of(config, units, direction, layer_height)
    wanted = COMPARED if orders == ALL else names(orders) or (settings.scan.order,)
    for name in wanted:
        settings.changed(scan={"order": name})  # an unknown name is refused before anything is computed
    simulators = SIMULATORS if export == ALL else names(export)
    if unknown := set(simulators) - set(SIMULATORS):
        raise SettingsError(f"--export {sorted(unknown)[0]!r}: choose from {', '.join(SIMULATORS)}, or all")
    if simulators and output is None:
        raise SettingsError("--export: give the folder with -o")
    if seeds < 1:
        raise SettingsError(f"--seeds {seeds}: give at least 1")
    if all_layers == (height is not None):
        raise SettingsError("scan: give either --height Z for one layer, or --all")
    placed = loaded(part, settings)
    if height is None:
        if len(wanted) != 1:
            raise SettingsError(f"--all plans in one order, not {len(wanted)}: give one with --orders")
        return scan_all(placed, settings, wanted[0], pause, output, as_json)
    layers = slice_part(placed, np.array([height]))
    low = float(placed.bounds[0][2])
    number = max(0, round((height - low) / settings.layer_height_mm - 0.5))
    compared = OrderComparison.of(layers.polygons(0), settings, number, max(height - low, 0.0))
    table, shown = _compared(compared, wanted, seeds)
    if output is not None:
        _export(output, simulators, shown, layers, settings)
        _write(output, table, shown, compared, f"{part.name}, z = {height:g} mm")
    if as_json:
        print_json(_records(table))
    else:
        rows = [[_cell(row[name]) for name in HEADINGS] for row in _records(table)]
        typer.echo(
            f"{len(compared.laid.islands)} islands at z = {height:g} mm, {settings.process.base} base\n"
        )
        typer.echo(text_table(list(HEADINGS.values()), rows))
    return ExitCode.PASS


def _compared(
    compared: OrderComparison, wanted: tuple[str, ...], seeds: int
) -> tuple[pd.DataFrame, dict[str, OrderResult]]:
    """Figures of all orders, and the plan of the first seed of each, which is drawn."""
    shown = {}
    rows = []
    for name in wanted:
        results = compared.results(name, seeds)
        shown[name] = results[0]
        rows.append(figures_of(name, results))
    return pd.DataFrame(rows), shown


def _export(
    folder: Path, simulators: tuple[str, ...], shown: dict[str, OrderResult], layers: Layers, settings: Config
) -> None:
    """Write the path of each order for each simulator, as paths/ORDER/SIMULATOR."""
    for name, result in shown.items() if simulators else ():
        beads = bead_paths(layers, result.plan, settings)
        for simulator in simulators:
            program = settings.changed(machine={"control": simulator})
            write_program(beads, result.plan, program, folder / "paths" / name / simulator)


def _records(table: pd.DataFrame) -> list[dict[str, Any]]:
    """Rows with None for what is not a number."""
    records: list[dict[str, Any]] = json.loads(table.to_json(orient="records"))
    return records


def _cell(value: Any) -> str:
    if value is None:
        return "-"
    return value if isinstance(value, str) else f"{value:.2f}" if abs(value) < 10 else f"{value:.0f}"


def _write(
    folder: Path, table: pd.DataFrame, shown: dict[str, OrderResult], compared: OrderComparison, what: str
) -> None:
    """Write the table and the pictures."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise SettingsError(f"{folder}: cannot be made: {error.strerror}") from None
    files = {"orders.json": json.dumps(plain(_records(table)), indent=2, sort_keys=True) + "\n"}
    files |= order_pictures(compared, shown, what)
    for file, text in files.items():
        with replacing(folder / file) as temporary:
            temporary.write_text(text, encoding="utf-8")

"""``ebamcheck scan``: one layer of a part in several scan orders, or all layers in one, on the heat model."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ebamcheck.commands.options import (
    ConfigOption,
    DirectionOption,
    JsonOption,
    LayerHeightOption,
    PartArgument,
    UnitsOption,
    YesOption,
    loaded,
    names,
    settings_of,
)
from ebamcheck.commands.scan_layer import scan_layer
from ebamcheck.commands.scan_part import scan_all
from ebamcheck.errors import ExitCode, SettingsError
from ebamcheck.nc.control import simulators
from ebamcheck.scan.plan.comparing import RANDOM, SEEDS, compared_orders
from ebamcheck.settings.config import Config
from ebamcheck.settings.process_window import checked_window
from ebamcheck.settings.stages import order_names

ALL = "all"


def scan_command(
    part: PartArgument,
    height: Annotated[float | None, typer.Option(help="Absolute height z of the layer, mm.")] = None,
    all_layers: Annotated[
        bool, typer.Option("--all", help="All layers from below, with the heat of those under them.")
    ] = False,
    pause: Annotated[
        float | None,
        typer.Option(help="With --all: wait between two layers, s; default: process.layer_pause_s.", min=0.0),
    ] = None,
    layer_height: LayerHeightOption = None,
    orders: Annotated[
        str, typer.Option(help=f"{', '.join(order_names())}, or all; comma-separated. Default: scan.order.")
    ] = "",
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Folder for orders.json and pictures.")
    ] = None,
    export: Annotated[
        str,
        typer.Option(
            help="Also write the path of each order for heat simulators, by the names of their controls, or for all."
        ),
    ] = "",
    seeds: Annotated[int, typer.Option(help=f"Seeds over which `{RANDOM}` is averaged.")] = SEEDS,
    config_file: ConfigOption = None,
    units: UnitsOption = "",
    direction: DirectionOption = "",
    yes: YesOption = False,
    as_json: JsonOption = False,
) -> ExitCode:
    """Plan one layer in one or several scan orders, or all layers in one; say how hot, how far and how long.

    Example: ebamcheck scan blade.stl --height 12 --orders all -o orders
    """
    config = settings_of(config_file, units, direction, layer_height)
    checked_window(config)
    wanted = _orders(orders, config)
    exported = _exported(export, output)
    if seeds < 1:
        raise SettingsError(f"--seeds {seeds}: give at least 1")
    if all_layers == (height is not None):
        raise SettingsError("scan: give either --height Z for one layer, or --all")
    if pause is not None and not all_layers:
        raise SettingsError("--pause: the wait between layers belongs to --all")
    placed = loaded(part, config)
    if height is None:
        if len(wanted) != 1:
            raise SettingsError(f"--all plans in one order, not {len(wanted)}: give one with --orders")
        if pause is not None:
            config = config.changed(process={"layer_pause_s": pause})
        return scan_all(placed, config, wanted[0], output, as_json, yes)
    return scan_layer(placed, config, height, wanted, seeds, exported, output, as_json)


def _orders(orders: str, config: Config) -> tuple[str, ...]:
    """Orders that are asked for; an unknown name is refused before anything is computed."""
    wanted = compared_orders() if orders == ALL else names(orders) or (config.scan.order,)
    for name in wanted:
        config.changed(scan={"order": name})
    return wanted


def _exported(export: str, output: Path | None) -> tuple[str, ...]:
    """Simulators that the paths are written for."""
    known = simulators()
    exported = known if export == ALL else names(export)
    if unknown := set(exported) - set(known):
        raise SettingsError(f"--export {sorted(unknown)[0]!r}: choose from {', '.join(known)}, or all")
    if exported and output is None:
        raise SettingsError("--export: give the folder with -o")
    return exported

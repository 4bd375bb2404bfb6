"""``ebamcheck relayer RUN --layer K --measured-z Z``: one layer of a finished run made again at the height that was measured."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer

from ebamcheck.commands.options import JsonOption, numbers, print_json
from ebamcheck.errors import ExitCode, SettingsError
from ebamcheck.live.heat_so_far import heat_under
from ebamcheck.live.loading import FinishedRun, finished_run
from ebamcheck.live.making import LayerMaker
from ebamcheck.live.relaying import Relayered, relayer


def relayer_command(
    run: Annotated[Path, typer.Argument(help="A finished run folder.")],
    layer: Annotated[int, typer.Option(help="Layer that comes next, counted from 0.")],
    measured_z: Annotated[
        float, typer.Option(help="Height of what stands, over the base plate, mm: the layer is laid on it.")
    ],
    direction: Annotated[
        str,
        typer.Option(help="Slicing direction in the file's coordinates, as X,Y,Z; default: that of the run."),
    ] = "",
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Folder of the new layers; default: RUN.live.")
    ] = None,
    part: Annotated[Path | None, typer.Option(help="The part, if it is not where it was.")] = None,
    annealing: Annotated[
        int,
        typer.Option(
            min=0, help="Moves by which the order of islands is improved; each thousand takes time."
        ),
    ] = 0,
    as_json: JsonOption = False,
) -> ExitCode:
    """Slice a layer at its measured height, plan, write and verify it, and put it under a new name beside the old one.

    Example: ebamcheck relayer blade.run --layer 12 --measured-z 20.4
    """
    if not math.isfinite(measured_z) or measured_z < 0.0:
        raise SettingsError(f"--measured-z {measured_z}: give a height over the base plate in mm")
    turned = None
    if direction:
        turned = numbers(direction, "--direction")
        if len(turned) != 3:
            raise SettingsError(f"--direction {direction!r}: give three numbers")
    found = finished_run(run, part, turned)
    layers = len(found.thickness_mm)
    if not 0 <= layer < layers:
        raise SettingsError(f"--layer {layer}: the run has the layers 0 to {layers - 1}")
    heat = heat_under(found.plan, layer, found.thickness_mm, found.busy_s(), found.config)
    folder = output or run.with_name(f"{run.resolve().name.removesuffix('.run')}.live")
    with LayerMaker(found.part, found.config, found.primary, annealing) as maker:
        # Along another direction other layers would have been laid than those that the run knows.
        metal = None if turned else found.metal_under(layer)
        done = relayer(maker, heat, layer, measured_z, folder, metal)
    if as_json:
        print_json({**done.certificate, "place": done.place, "said": done.said, "seconds": done.made.seconds})
    else:
        _tell(done, found, layer)
    return ExitCode.PASS if done.place is not None else ExitCode.OUT_OF_TOLERANCE


def _tell(done: Relayered, found: FinishedRun, layer: int) -> None:
    """Print what came of it."""
    wanted = done.made.wanted
    for text in done.said:
        typer.echo(f"note: {text}")
    old = found.program_of(layer)
    was = f" in place of {old['name']}" if old else ""
    if done.place is None:
        stays = f", {old['name']}" if old else ""
        typer.echo(f"layer {layer}: {done.made.why}; the old layer stays{stays}")
        return
    seconds = sum(done.made.seconds.values())
    typer.echo(
        f"layer {layer}: Z {wanted.base_mm:.3f} to {wanted.top_mm:.3f} mm, cut at {done.made.cut_mm:.3f} mm, "
        f"{done.made.islands} islands, {len(done.made.gates)} gates open, {seconds:.2f} s"
    )
    typer.echo(f"{done.place}: {done.certificate['called']}{was}; wait {done.made.wait_s:g} s before it")

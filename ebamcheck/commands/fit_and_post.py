"""``ebamcheck fit`` and ``ebamcheck post``: single stages of the job, for those who want no more."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Argument, Option

from ebamcheck import curves as fits
from ebamcheck.commands import options
from ebamcheck.controls.thesis import SCRIPT, case_post
from ebamcheck.curves import METHODS, Curves, fit_for_program
from ebamcheck.errors import ExitCode, InputError, SettingsError
from ebamcheck.layers.heights import cut_heights
from ebamcheck.layers.stack import Layers
from ebamcheck.mesh.inspection import inspect
from ebamcheck.mesh.part_source import read_reference
from ebamcheck.nc.control import control as control_named
from ebamcheck.pipeline.stages import bead_paths, plan_program, smooth_layers
from ebamcheck.preflight.report import chosen_height
from ebamcheck.printable import index_of_number
from ebamcheck.program import write_program
from ebamcheck.record.run_folder import MANIFEST
from ebamcheck.settings.process_window import checked_window
from ebamcheck.showing.short_text import counted, text_table
from ebamcheck.slicers.slicing import slice_part
from ebamcheck.writing.posts import begin_at_layer, check_entry


@options.explained(
    method=f"{', '.join(METHODS)}, or all; default: curves.method of the settings.",
    output="FILE.parquet for the curves of one method.",
    reference="A finer mesh of the same part: errors are measured against it.",
    part=Argument(help="Mesh file: .stl, .obj, .ply or .3mf."),
)
def fit_command(
    part: Path,
    method: str = "",
    output: Path | None = None,
    tolerance: Annotated[float | None, Option(help="Tolerance of `bounded`, mm.")] = None,
    reference: Path | None = None,
    layer_height: float | None = None,
    config_file: Path | None = None,
    units: str = "",
    direction: str = "",
    yes: bool = False,
    as_json: bool = False,
) -> ExitCode:
    """Slice a part, fit curves to its contours and say how near they are and how many blocks they take.

    Example: ebamcheck fit blade.stl --method all --reference blade-fine.stl
    """
    config = options.settings_of(config_file, units, direction, layer_height)
    if tolerance is not None:
        config = config.changed(curves={"tolerance_mm": tolerance})
    methods = tuple(METHODS) if method == "all" else (method or config.curves.method,)
    if output is not None and (len(methods) > 1 or output.suffix.lower() != ".parquet"):
        raise SettingsError(f"{output}: give FILE.parquet and one method")
    placed = options.loaded(part, config)
    layers = slice_part(placed, options.within_work(placed, cut_heights(placed, config), config, yes))
    truth = slice_part(read_reference(reference, part, config.part), layers.heights) if reference else None
    rows = []
    for name in methods:
        curves = fits.fit(layers, name, config.curves, part=placed)
        if output is not None:
            curves.to_parquet(output)
        rows.append(_row(name, curves, layers, truth))
    if as_json:
        options.print_json(rows)
    else:
        typer.echo(f"{len(layers)} layers, {len(layers.points)} contour points\n")
        typer.echo(text_table(list(rows[0]), [list(row.values()) for row in rows]))
    return ExitCode.PASS


def _row(name: str, curves: Curves, layers: Layers, truth: Layers | None) -> dict[str, Any]:
    deviation = fits.fit_deviation(curves, layers)
    row: dict[str, Any] = {
        "method": name,
        "blocks": curves.block_count(),
        "points a block": len(layers.points) / max(curves.block_count(), 1),
        "from contour, mm": float(deviation[["points_mm", "bulge_mm"]].to_numpy().max(initial=0.0)),
    }
    if truth is not None:
        gain = fits.error_reduction(fits.contour_error(layers, truth), fits.contour_error(curves, truth))
        for kind in ("polar", "normal"):
            for figure in ("rms", "max"):
                less = float(gain[f"{kind}_{figure}"])
                row[f"{kind} {figure} less by"] = "-" if math.isnan(less) else f"{100.0 * less:.1f} %"
    return row


@options.explained(
    layer="Case of one layer, counted from 1, for a heat simulator.",
    from_layer=Option(min=1, help="Leave out the layers before this one, counted from 1: to go on after a break."),
)
def post_command(
    source: Annotated[Path, Argument(help="A finished run folder, or a part to slice, fit and plan.")],
    output: Annotated[Path, Option("-o", "--output", help="Folder for the program; replaced whole.")],
    control: Annotated[str, Option(help="Post-processor; default: machine.control of the settings.")] = "",
    layer: int | None = None,
    from_layer: int = 1,
    layer_height: float | None = None,
    config_file: Path | None = None,
    units: str = "",
    direction: str = "",
    yes: bool = False,
) -> ExitCode:
    """Write a program for a control or a whole case for a heat simulator; `ebamcheck verify` checks it, `run` validates it.

    Example: ebamcheck post blade.run --control linuxcnc -o blade.ngc
    """
    if control:
        # What cannot be written is refused before anything is sliced.
        control_named(control)
        if layer is not None:
            case_post(control)
    of_run = (source / MANIFEST).is_file()
    if of_run:
        config, beads, plan, sha256 = options.stack_of_run(source, config_file)
    elif source.is_dir():
        raise InputError(f"{source}: is no finished run folder: it has no {MANIFEST}")
    else:
        config = options.settings_of(config_file, units, direction, layer_height)
    checked_window(config)
    check_entry(from_layer, config)
    if not of_run:
        placed = options.loaded(source, config)
        config = chosen_height(placed, inspect(placed).passed, config).config
        layers = slice_part(placed, options.within_work(placed, cut_heights(placed, config), config, yes))
        smooth = smooth_layers(fit_for_program(layers, config.curves, placed))
        plan = plan_program(smooth, config)
        beads, sha256 = bead_paths(smooth, plan, config), placed.source_sha256
    if control:
        config = config.changed(machine={"control": control})
    is_read = control_named(config.machine.control).is_read
    if from_layer > 1 and not is_read:
        raise SettingsError(f"--from-layer: {config.machine.control} is no control but a heat simulator")
    header = {"PART SHA-256": sha256}
    if layer is None:
        files = write_program(beads, plan, config, output, header=header)
        if from_layer > 1:
            files = begin_at_layer(files, from_layer)
    else:
        post = case_post(config.machine.control)
        files = post(beads, plan, config, output, header=header, layer=index_of_number(layer, len(plan)))
    blocks = sum(files.blocks.values())
    counts = f"{counted(len(files.names), 'file')}, {counted(blocks, 'block')}"
    typer.echo(f"{files.main}: {counts} for {config.machine.control}")
    said = "check it with `ebamcheck verify`, or let `ebamcheck run` make and validate one"
    if not is_read:
        said = f"a simulator's case is not read back; {files.folder / SCRIPT} runs it"
    elif from_layer > 1 and of_run and not control and not config_file:
        said = f"`ebamcheck verify {output} --whole {source}` checks the run and that this program is its end"
    elif from_layer > 1:
        said = (
            "write the whole program, too (without --from-layer), and check that and this one as its end with "
            f"`ebamcheck verify {output} --whole WHOLE --part PART`"
        )
    typer.echo(f"NOT VALIDATED: {said}")
    return ExitCode.PASS

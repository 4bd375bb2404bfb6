"""``ebamcheck select``: which slicers suit this machine, by accuracy and speed on a part."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from ebamcheck.accuracy.selection import (
    REPEATS,
    RULES,
    Choice,
    Trial,
    Workpiece,
    choose,
    try_backends,
    workpiece_of_model,
    workpiece_of_part,
    write_choice,
)
from ebamcheck.drawing.tables import text_table
from ebamcheck.errors import BackendMissing, ExitCode, SettingsError
from ebamcheck.json_values import plain
from ebamcheck.mesh.part_source import read_part
from ebamcheck.plugins.model import models
from ebamcheck.settings.config import Config, load_config
from ebamcheck.settings.stages import machine_name

DEFAULT_CONFIG = Path("ebamcheck.toml")

DEFAULT_MODEL = "ladder"

COARSE_MM = 0.4
"""Tolerance of a model's mesh: of the ladder's sizes a coarse one, a tenth of a second to slice."""

TOLERANCE_MM = 0.1
"""Default of the error that a slicer may have: half of what the fitted curves may leave their contours by."""


def select(
    part: Annotated[Path | None, typer.Option(help="Mesh file of a part like yours.")] = None,
    model: Annotated[
        str, typer.Option(help="Reference model instead of a part; default: the ladder, a coarse size.")
    ] = "",
    tolerance_mm: Annotated[
        float, typer.Option(help="Error that a slicer may have, by its bound and as measured, mm.")
    ] = TOLERANCE_MM,
    layer_height: Annotated[
        float | None, typer.Option(help="Layer height, mm; default: that of one bead of the process.")
    ] = None,
    repeats: Annotated[int, typer.Option(min=1, help="Timed runs of each backend.")] = REPEATS,
    write: Annotated[bool, typer.Option("--write", help="Write the choice into the settings file.")] = False,
    config_file: Annotated[
        Path | None,
        typer.Option("-c", "--config", help="Settings (TOML); default: ./ebamcheck.toml."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")] = False,
) -> ExitCode:
    """Try every slicer on this machine and choose by accuracy, then speed; exit code 1 where none is fit.

    Example: ebamcheck select --part blade.stl --tolerance-mm 0.05 --write
    """
    if part is not None and model:
        raise SettingsError("give --part or --model, not both")
    if not 0.0 < tolerance_mm < float("inf"):
        raise SettingsError(f"--tolerance-mm {tolerance_mm}: give a positive number of millimetres")
    path = config_file or DEFAULT_CONFIG
    config = load_config(path if config_file or path.is_file() else None)
    if layer_height is not None:
        config = config.changed(layers={"layer_height_mm": layer_height, "heights_mm": ()})
    workpiece = _workpiece(part, model, config)
    trials = try_backends(workpiece, config, repeats, lambda text: typer.echo(f"ebamcheck: {text}", err=True))
    if not any(trial.available for trial in trials):
        raise BackendMissing("no backend is available: see `ebamcheck backends` for the reasons")
    choice = choose(trials, tolerance_mm)
    circumstances = {
        "part": workpiece.title,
        "part_sha256": workpiece.part.sha256,
        "layers": len(workpiece.timed),
        "layer_height_mm": config.layer_height_mm,
        "tolerance_mm": tolerance_mm,
    }
    if as_json:
        record = _record(trials, choice, circumstances)
        typer.echo(json.dumps(plain(record), indent=2, sort_keys=True, allow_nan=False, ensure_ascii=False))
    else:
        typer.echo(_table(workpiece, trials, choice, tolerance_mm))
    if not choice.primary:
        return ExitCode.OUT_OF_TOLERANCE
    if write:
        write_choice(path, machine_name(), choice, trials, circumstances)
        typer.echo(f"ebamcheck: {path}: wrote the section of machine {machine_name()!r}", err=True)
    return ExitCode.PASS


def _workpiece(part: Path | None, model: str, config: Config) -> Workpiece:
    if part is not None:
        placed, _ = read_part(part, config.part.model_copy(update={"fix_orientation": False}))
        return workpiece_of_part(placed, config.layer_height_mm)
    name = model or DEFAULT_MODEL
    return workpiece_of_model(models([name])[name], COARSE_MM, config.layer_height_mm)


def _record(trials: list[Trial], choice: Choice, circumstances: dict[str, Any]) -> dict[str, Any]:
    return {
        "machine": machine_name(),
        "primary": choice.primary,
        "required": list(choice.required),
        **circumstances,
        "backends": {t.name: {**vars(t), "reason": choice.reasons[t.name]} for t in trials},
    }


def _table(workpiece: Workpiece, trials: list[Trial], choice: Choice, tolerance_mm: float) -> str:
    columns = ["slicer", "available", "bound mm", "measured mm", "seconds", "device", "reason"]
    rows = [
        [t.name, t.available, t.bound_mm, t.measured_mm, t.seconds, t.device, choice.reasons[t.name]]
        for t in trials
    ]
    chosen = (
        f"primary: {choice.primary}; required: {', '.join(choice.required)}"
        if choice.primary
        else f"no slicer is accurate to {tolerance_mm:g} mm"
    )
    alone = (
        ""
        if choice.witness or not choice.primary
        else "\nthere is no second slicer of that accuracy: a run needs two that agree"
    )
    head = f"machine {machine_name()}: {workpiece.title}, {len(workpiece.timed)} layers"
    return f"{head}\n{text_table(columns, rows)}\n\n{RULES}\n\n{chosen}{alone}"

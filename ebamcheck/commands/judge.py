"""``ebamcheck judge RUN --layer K``: the islands of one layer of a run by 3DThesis, beside our own model."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import pandas as pd
import typer
from typer import Argument, Option

from ebamcheck.accuracy.heat_judge import BEADS, BODIES, THESIS, JudgedLayer, LayerCase, judge_layer
from ebamcheck.atomic_file import made_folder, replacing
from ebamcheck.commands.options import ConfigOption, JsonOption, print_json, stack_of_run
from ebamcheck.commands.progress import watched
from ebamcheck.errors import ExitCode
from ebamcheck.layer_numbers import index_of_number
from ebamcheck.record.run_folder import RunFolder
from ebamcheck.settings.config import Config
from ebamcheck.showing.short_text import text_table

TABLE, CASE = "judged.csv", "case"

# Columns of the printed table, and their headings
SHOWN = {
    "rank": "rank",
    "island": "island",
    "entered_s": "entered, s",
    "model_k": "model, K",
    "thesis_k": "3DThesis, K",
    "thesis_spot_k": "at the entry, K",
    "thesis_hottest_k": "hottest, K",
}

FIGURES = {
    "kendall_tau": "Kendall's tau of the islands",
    "spearman": "Spearman's rank correlation",
    "thesis_over_model": "3DThesis over model, all rises",
}


def judge_command(
    run: Annotated[Path, Argument(help="A finished run folder.")],
    layer: Annotated[int, Option(help="Layer, counted from 1.")],
    output: Annotated[
        Path | None, Option("-o", "--output", help=f"Folder for {CASE}/ and {TABLE}; default: RUN.judge.")
    ] = None,
    beads: Annotated[
        str, Option(help=f"Beads that heat in 3DThesis: {', '.join(BEADS)}; our model counts islands.")
    ] = BEADS[0],
    body: Annotated[
        str, Option(help=f"What 3DThesis heats: {', '.join(BODIES)} around the section.")
    ] = BODIES[0],
    config_file: ConfigOption = None,
    as_json: JsonOption = False,
) -> ExitCode:
    """Let 3DThesis say how warm the islands of a layer are when the beam enters them, beside our model.

    Example: ebamcheck judge blade.run --layer 4
    """
    config, curves, plan, _ = stack_of_run(run, config_file)
    index = index_of_number(layer, len(plan))
    folder = made_folder(output or run.with_name(f"{run.resolve().name.removesuffix('.run')}.judge"))
    layers = RunFolder(run).read_layers(str(RunFolder(run).manifest()["primary"]))
    section = layers.section(index)
    case = LayerCase.of(plan, index, section, config, curves=curves, beads=beads, body=body)
    case.write(folder / CASE, config)
    THESIS.path()
    with watched() as observer:
        observer.stage("3DThesis", len(case.islands))
        judged = judge_layer(case, config, observer.advance)
    with replacing(folder / TABLE) as temporary:
        judged.table.round(4).to_csv(temporary, index=False)
    if as_json:
        print_json(
            {**judged.figures(), "layer": layer, "beads": beads, "body": body, "table": str(folder / TABLE)}
        )
    else:
        _tell(judged, layer, body, config, folder)
    return ExitCode.PASS


def _tell(judged: JudgedLayer, layer: int, body: str, config: Config, folder: Path) -> None:
    most_k = config.material.boiling_k - config.process.ambient_temperature_k
    typer.echo(f"layer {layer}: rise of its {len(judged.table)} islands when the beam enters them\n")
    rows = [[_cell(name, row[name], most_k) for name in SHOWN] for _, row in judged.table.iterrows()]
    typer.echo(text_table(list(SHOWN.values()), rows) + "\n")
    figures = judged.figures()
    lines = [[what, f"{figures[name]:.2f}"] for name, what in FIGURES.items()]
    for what, name in (("model", "model"), ("3DThesis", "thesis"), ("3DThesis at the entry", "thesis_spot")):
        lines.append(
            [f"greatest rise, {what}", _cell(f"{name}_max_k", figures[f"{name}_max_k"], most_k) + " K"]
        )
    typer.echo(text_table(["", ""], lines).strip("\n"))
    typer.echo(f"\nBoth are linear and begin cold; 3DThesis heats a {body}. {folder / CASE} is its case.")


def _cell(name: str, value: float, most_k: float) -> str:
    """Write a number; over boiling, where both models end, only that it is over it."""
    if not name.endswith("_k"):
        return f"{value:.1f}" if name.endswith("_s") else f"{value:.0f}"
    if pd.isna(value):
        return "-"
    return f"> {most_k:.0f}" if value > most_k else f"{value:.0f}"

"""``ebamcheck regress``, ``select`` and ``conform``: how far slicers are from the truth, which suit this machine, what the kit
finds; and ``judge``, the heat model beside 3DThesis."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import pandas as pd
import typer
from typer import Argument, Option

from ebamcheck.accuracy import regression, selection
from ebamcheck.accuracy.baselines import strict_json
from ebamcheck.accuracy.heat_judge import BEADS, BODIES, THESIS, JudgedLayer, LayerCase, judge_layer
from ebamcheck.accuracy.measurement import Tolerances, read_tolerances
from ebamcheck.atomic_file import made_folder, replacing
from ebamcheck.commands import options
from ebamcheck.commands.summaries import watched
from ebamcheck.errors import BackendMissing, ExitCode, SettingsError
from ebamcheck.mesh.part_source import read_part
from ebamcheck.plugins import registry
from ebamcheck.plugins.registry import models
from ebamcheck.printable import index_of_number
from ebamcheck.record.run_folder import RunFolder
from ebamcheck.settings.checking import checked
from ebamcheck.settings.config import Config, load_config
from ebamcheck.settings.stages import machine_name
from ebamcheck.showing.short_text import text_table
from ebamcheck.slicers.isolation import Limits
from ebamcheck.testing.conformance import conform, conform_control, markdown_table


@options.explained(
    baselines="Folder of the baselines; default: reports/baselines of the checkout.",
    update_baseline=Option(metavar="failed|all", help="Show the differences, then accept them."),
    tolerances="Tolerance of each metric (TOML); default: the shipped ones.",
    history="SQLite file of the history; default: OUTPUT/history.sqlite.",
    output="Folder for results, report and history.",
    config_file="Settings (TOML), table [regression] and [slicing.settings.NAME]; default: ./ebamcheck.toml.",
)
def regress(
    models: Annotated[str, Option(help="Models, comma-separated, or all; default: those of every day.")] = "",
    backends: Annotated[str, Option(help="Backends, comma-separated; default: all available.")] = "",
    baselines: Path | None = None,
    update_baseline: str = "",
    tolerances: Path | None = None,
    history: Path | None = None,
    output: Path = Path("regress"),
    config_file: Path | None = None,
    as_json: bool = False,
) -> ExitCode:
    """Measure the slicers on models with known sections; exit code 1 where one got worse than its baseline.

    Writes results.json, junit.xml and regress.html, the same bytes for the same figures; timings.json holds all
    timings, history.sqlite the results over time.

    Example: ebamcheck regress --models cube,sphere --backends planecut -o regress
    """
    path = config_file or (options.DEFAULT_CONFIG if options.DEFAULT_CONFIG.is_file() else None)
    config = load_config(path)
    settings = config.regression
    own = {name: values for name, values in config.slicing.settings.items() if values}
    if update_baseline not in ("", "failed", "all"):
        raise SettingsError(f"--update-baseline {update_baseline!r}: give failed or all")
    if update_baseline and own:
        what = "under which no baseline is made: leave it out, or put it into the matrix as a variant"
        raise SettingsError(f"--update-baseline: {path} has slicing.settings.{next(iter(own))}, {what}")
    table = checked(Tolerances, settings.tolerances, f"{path}: regression.tolerances")
    table = read_tolerances(tolerances) if tolerances else table
    limits = Limits(config.slicing.time_limit_s, config.slicing.memory_limit_mb)
    folder = regression.default_baselines(baselines, settings.baselines)
    chosen = options.names(models), options.names(backends)
    found = regression.run_regression(folder, *chosen, table, limits=limits, note=_note, settings=own)
    history = history or (Path(settings.history) if settings.history else output / regression.HISTORY)
    made_folder(output)
    regression.record(history, found)
    for name, values in (("results.json", found.record()), ("timings.json", found.timings)):
        with replacing(output / name) as temporary:
            temporary.write_text(strict_json(values) + "\n", encoding="utf-8")
    regression.write_junit(found, output)
    regression.write_page(found, history, output)
    said = strict_json(found.record()) if as_json else "\n".join(summary(found, advise=not update_baseline))
    typer.echo(said)
    if not update_baseline:
        return found.exit_code
    changed = regression.updated(found, "all" if update_baseline == "all" else "failed")
    if not as_json:
        typer.echo(f"\nbaselines written: {', '.join(map(str, changed)) or 'none, nothing changed'}")
    return regression.accepted(found).exit_code


def _note(text: str) -> None:
    typer.echo(f"ebamcheck: {text}", err=True)


def summary(found: regression.Regression, advise: bool = True) -> list[str]:
    """What a report came to, for the terminal: differences first, then the counts, then what can be done if that is wanted."""
    lines = [line for d in found.differences if d.verdict != "same" for line in d.lines()]
    verdicts = [d.verdict for d in found.differences]
    counts = [f"{verdicts.count(v)} {v}" for v in dict.fromkeys(sorted(verdicts))]
    lines.append(f"{len(verdicts)} entries: {', '.join(counts) or 'none'}; baselines: {found.baselines}")
    if not advise:
        return lines
    if any(d.fails for d in found.differences):
        lines.append("accept what got worse, is new or vanished with --update-baseline=failed")
    elif not found.compared:
        lines.append("nothing was compared: make the baselines with --update-baseline=all")
    return lines


TOLERANCE_MM = (
    0.1  # default of the error that a slicer may have: half of what the fitted curves may leave their contours by
)


@options.explained(
    model="Reference model instead of a part; default: the ladder, a coarse size.",
    tolerance_mm="Error that a slicer may have, by its bound and as measured, mm.",
)
def select(
    part: Annotated[Path | None, Option(help="Mesh file of a part like yours.")] = None,
    model: str = "",
    tolerance_mm: float = TOLERANCE_MM,
    layer_height: float | None = None,
    repeats: Annotated[int, Option(min=1, help="Timed runs of each backend.")] = selection.REPEATS,
    write: Annotated[bool, Option("--write", help="Write the choice into the settings file.")] = False,
    config_file: Path | None = None,
    as_json: bool = False,
) -> ExitCode:
    """Try every slicer on this machine and choose by accuracy, then speed; exit code 1 where none is fit.

    Example: ebamcheck select --part blade.stl --tolerance-mm 0.05 --write
    """
    if part is not None and model:
        raise SettingsError("give --part or --model, not both")
    if not 0.0 < tolerance_mm < float("inf"):
        raise SettingsError(f"--tolerance-mm {tolerance_mm}: give a positive number of millimetres")
    path = config_file or options.DEFAULT_CONFIG
    config = load_config(path if config_file or path.is_file() else None)
    if layer_height is not None:
        config = config.changed(layers={"layer_height_mm": layer_height, "heights_mm": ()})
    if part is not None:
        placed, _ = read_part(part, config.part.model_copy(update={"fix_orientation": False}))
        workpiece = selection.workpiece_of_part(placed, config.layer_height_mm)
    else:
        name = model or "ladder"
        # Of the ladder a coarse size: a tenth of a second to slice.
        workpiece = selection.workpiece_of_model(models([name])[name], 0.4, config.layer_height_mm)
    trials = selection.try_backends(workpiece, config, repeats, _note)
    if not any(trial.available for trial in trials):
        raise BackendMissing("no backend is available: see `ebamcheck backends` for the reasons")
    choice = selection.choose(trials, tolerance_mm)
    circumstances = {
        "part": workpiece.title,
        "part_sha256": workpiece.part.sha256,
        "layers": len(workpiece.timed),
        "layer_height_mm": config.layer_height_mm,
        "tolerance_mm": tolerance_mm,
    }
    if as_json:
        chosen = {"machine": machine_name(), "primary": choice.primary, "required": list(choice.required)}
        told = {t.name: {**vars(t), "reason": choice.reasons[t.name]} for t in trials}
        options.print_json({**chosen, **circumstances, "backends": told})
    else:
        typer.echo(_table(workpiece, trials, choice, tolerance_mm))
    if not choice.primary:
        return ExitCode.OUT_OF_TOLERANCE
    if write:
        selection.write_choice(path, machine_name(), choice, trials, circumstances)
        _note(f"{path}: wrote the section of machine {machine_name()!r}")
    return ExitCode.PASS


def _table(
    workpiece: selection.Workpiece,
    trials: list[selection.Trial],
    choice: selection.Choice,
    tolerance_mm: float,
) -> str:
    columns = ["slicer", "available", "bound mm", "measured mm", "seconds", "device", "reason"]
    fields = ("name", "available", "bound_mm", "measured_mm", "seconds", "device")
    rows = [[*(getattr(t, field) for field in fields), choice.reasons[t.name]] for t in trials]
    chosen = f"no slicer is accurate to {tolerance_mm:g} mm"
    if choice.primary:
        chosen = f"primary: {choice.primary}; required: {', '.join(choice.required)}"
        if not choice.witness:
            chosen += "\nthere is no second slicer of that accuracy: a run needs two that agree"
    head = f"machine {machine_name()}: {workpiece.title}, {len(workpiece.timed)} layers"
    return f"{head}\n{text_table(columns, rows)}\n\n{selection.RULES}\n\n{chosen}"


@options.explained(
    names=Argument(metavar="NAME", help="Backends, or controls; default: all that this machine can run."),
    controls="Test controls: write, read back, plant faults.",
    models="Reference models, as a,b; default: all installed; none for none.",
    setting=Option("--set", help="A setting of the backend, or of the machine, as NAME=VALUE; repeatable."),
    markdown="Print one table of checks and backends for a document.",
)
def conform_command(
    names: list[str] | None = None,
    controls: bool = False,
    models: str | None = None,
    setting: list[str] | None = None,
    as_json: bool = False,
    markdown: bool = False,
) -> ExitCode:
    """Test backends against the protocol, the laws of sections and the reference models; or controls by what they write.

    Exit code 1 if a check is broken, 4 if a backend is not available.

    Example: ebamcheck conform planecut --models cube,sphere
    """
    values = options.assignments(setting or ())
    if controls:
        found = [conform_control(name, values) for name in names or registry.names(registry.CONTROLS)]
    else:
        wanted = list(names or [name for name in registry.house_slicers() if registry.probe(name).available])
        chosen = None if models is None else [m for m in models.split(",") if m and m != "none"]
        found = [conform(name, chosen, values) for name in wanted]
    if as_json:
        typer.echo(json.dumps([c.to_json() for c in found], indent=2, allow_nan=True))
    elif markdown:
        typer.echo(markdown_table(found))
    else:
        typer.echo("\n\n".join(c.table() for c in found))
    return ExitCode.PASS if all(c.passed for c in found) else ExitCode.OUT_OF_TOLERANCE


TABLE, CASE = "judged.csv", "case"
# Columns of the printed table, and their headings
SHOWN = {
    "rank": "rank", "island": "island", "entered_s": "entered, s", "model_k": "model, K",
    "thesis_k": "3DThesis, K", "thesis_spot_k": "at the entry, K", "thesis_hottest_k": "hottest, K",
}  # fmt: skip

FIGURES = {
    "kendall_tau": "Kendall's tau of the islands",
    "spearman": "Spearman's rank correlation",
    "thesis_over_model": "3DThesis over model, all rises",
}


@options.explained(
    output=f"Folder for {CASE}/ and {TABLE}; default: RUN.judge.",
    beads=f"Beads that heat in 3DThesis: {', '.join(BEADS)}; our model counts islands.",
    body=f"What 3DThesis heats: {', '.join(BODIES)} around the section.",
)
def judge_command(
    run: Path,
    layer: Annotated[int, Option(help="Layer, counted from 1.")],
    output: Path | None = None,
    beads: str = BEADS[0],
    body: str = BODIES[0],
    config_file: Path | None = None,
    as_json: bool = False,
) -> ExitCode:
    """Let 3DThesis say how warm the islands of a layer are when the beam enters them, beside our model.

    Example: ebamcheck judge blade.run --layer 4
    """
    config, curves, plan, _ = options.stack_of_run(run, config_file)
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
        of_case = {"layer": layer, "beads": beads, "body": body, "table": str(folder / TABLE)}
        options.print_json({**judged.figures(), **of_case})
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
        rise = _cell("max_k", figures[f"{name}_max_k"], most_k)
        lines.append([f"greatest rise, {what}", f"{rise} K"])
    typer.echo(text_table(["", ""], lines).strip("\n"))
    typer.echo(f"\nBoth are linear and begin cold; 3DThesis heats a {body}. {folder / CASE} is its case.")


def _cell(name: str, value: float, most_k: float) -> str:
    """Write a number; over boiling, where both models end, only that it is over it."""
    if not name.endswith("_k"):
        return f"{value:.1f}" if name.endswith("_s") else f"{value:.0f}"
    if pd.isna(value):
        return "-"
    return f"> {most_k:.0f}" if value > most_k else f"{value:.0f}"

"""``ebamcheck regress``: how far every slicer is from the truth, held against the baselines."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import typer

from ebamcheck.accuracy.baselines import UpdateMode, strict_json
from ebamcheck.accuracy.matrix import Tolerances, read_tolerances
from ebamcheck.accuracy.regression import (
    Regression,
    accepted,
    default_baselines,
    run_regression,
    updated,
)
from ebamcheck.accuracy.report import HISTORY, record, write_junit, write_page
from ebamcheck.atomic_file import made_folder, replacing
from ebamcheck.errors import ExitCode, SettingsError
from ebamcheck.settings.checking import checked
from ebamcheck.settings.config import load_config
from ebamcheck.slicers.isolation import Limits

RESULTS, TIMINGS = "results.json", "timings.json"

DEFAULT_CONFIG = Path("ebamcheck.toml")


def regress(
    models: Annotated[
        str, typer.Option(help="Models, comma-separated, or all; default: those of every day.")
    ] = "",
    backends: Annotated[str, typer.Option(help="Backends, comma-separated; default: all available.")] = "",
    baselines: Annotated[
        Path | None, typer.Option(help="Folder of the baselines; default: reports/baselines of the checkout.")
    ] = None,
    update_baseline: Annotated[
        str, typer.Option(metavar="failed|all", help="Show the differences, then accept them.")
    ] = "",
    tolerances: Annotated[
        Path | None, typer.Option(help="Tolerance of each metric (TOML); default: the shipped ones.")
    ] = None,
    history: Annotated[
        Path | None, typer.Option(help="SQLite file of the history; default: OUTPUT/history.sqlite.")
    ] = None,
    output: Annotated[
        Path, typer.Option("-o", "--output", help="Folder for results, report and history.")
    ] = Path("regress"),
    config_file: Annotated[
        Path | None,
        typer.Option(
            "-c",
            "--config",
            help="Settings (TOML), table [regression] and [slicing.settings.NAME]; default: ./ebamcheck.toml.",
        ),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of text.")] = False,
) -> ExitCode:
    """Measure the slicers on models with known sections; exit code 1 where one got worse than its baseline.

    Writes results.json, junit.xml and regress.html, the same bytes for the same figures; timings.json holds all
    timings, history.sqlite the results over time.

    Example: ebamcheck regress --models cube,sphere --backends planecut -o regress
    """
    path = config_file or (DEFAULT_CONFIG if DEFAULT_CONFIG.is_file() else None)
    config = load_config(path)
    settings = config.regression
    own = {name: values for name, values in config.slicing.settings.items() if values}
    _check_update(update_baseline, own, path)
    table = (
        checked(Tolerances, settings.tolerances, f"{path}: regression.tolerances")
        if tolerances is None
        else read_tolerances(tolerances)
    )
    found = run_regression(
        default_baselines(baselines, settings.baselines),
        _names(models),
        _names(backends),
        table,
        limits=Limits(config.slicing.time_limit_s, config.slicing.memory_limit_mb),
        note=lambda text: typer.echo(f"ebamcheck: {text}", err=True),
        settings=own,
    )
    _write(found, output, history or (Path(settings.history) if settings.history else output / HISTORY))
    typer.echo(
        strict_json(found.record()) if as_json else "\n".join(summary(found, advise=not update_baseline))
    )
    if not update_baseline:
        return found.exit_code
    mode: UpdateMode = "all" if update_baseline == "all" else "failed"
    changed = updated(found, mode)
    if not as_json:
        typer.echo(f"\nbaselines written: {', '.join(map(str, changed)) or 'none, nothing changed'}")
    return accepted(found).exit_code


def _check_update(update_baseline: str, own: Mapping[str, object], path: Path | None) -> None:
    """Refuse an unknown mode, and baselines under slicers' settings (by name) of one's own."""
    if update_baseline not in ("", "failed", "all"):
        raise SettingsError(f"--update-baseline {update_baseline!r}: give failed or all")
    if update_baseline and own:
        raise SettingsError(
            f"--update-baseline: {path} has slicing.settings.{next(iter(own))}, under which no baseline is made: leave it "
            "out, or put it into the matrix as a variant"
        )


def summary(found: Regression, advise: bool = True) -> list[str]:
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


def _write(found: Regression, output: Path, history: Path) -> None:
    """Write all files of the report."""
    made_folder(output)
    record(history, found)
    for name, values in ((RESULTS, found.record()), (TIMINGS, found.timings)):
        with replacing(output / name) as temporary:
            temporary.write_text(strict_json(values) + "\n", encoding="utf-8")
    write_junit(found, output)
    write_page(found, history, output)


def _names(text: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in text.split(",") if name.strip())

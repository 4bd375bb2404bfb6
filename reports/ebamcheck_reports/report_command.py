"""``ebamcheck report``: the page of a finished run made again, from its record, without running anything again."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ebamcheck.atomic_file import replacing
from ebamcheck.errors import ExitCode, InputError, SettingsError
from ebamcheck.pipeline.run_folder import MANIFEST, RunFolder


def report(
    run: Annotated[Path, typer.Argument(help="A finished run folder.")],
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="FILE.html; default: NAME.html for the run NAME.run."),
    ] = None,
) -> ExitCode:
    """Render the report of a finished run anew, as this version draws it; the run itself stays as it is.

    Example: ebamcheck report blade.run -o blade.html
    """
    from ebamcheck_reports.html import document
    from ebamcheck_reports.run_data import RunData

    if not (run / MANIFEST).is_file():
        raise InputError(f"{run}: is no finished run folder: it has no {MANIFEST}")
    target = output or Path(f"{run.resolve().name.removesuffix('.run')}.html")
    if target.suffix.lower() != ".html":
        raise SettingsError(f"{target}: give FILE.html")
    if run.resolve() in target.resolve().parents:
        raise SettingsError(
            f"{target}: lies in the run, whose certificate names every file by its hash: give another place with -o"
        )
    text = document(RunData(RunFolder(run)))
    with replacing(target) as temporary:
        temporary.write_text(text, encoding="utf-8")
    typer.echo(f"report: {target}")
    return ExitCode.PASS

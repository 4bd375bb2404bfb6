"""``ebamcheck report``: the page of a finished run made again, from its record, without running anything again."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ebamcheck.atomic_file import replacing
from ebamcheck.errors import ExitCode, InputError, SettingsError
from ebamcheck.record.run_folder import MANIFEST, RunFolder


def report(
    run: Annotated[Path, typer.Argument(help="A finished run folder, or the folder of a live build.")],
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="FILE.html; default: NAME.html for the run NAME.run."),
    ] = None,
) -> ExitCode:
    """Render the report of a finished run or a live build anew.

    It looks as this version draws it; the run itself stays as it is.

    Example: ebamcheck report blade.run -o blade.html
    """
    from ebamcheck.live.verifying import is_build
    from ebamcheck_reports import build_page, html
    from ebamcheck_reports.run_data import RunData

    build = is_build(run)
    if not build and not (run / MANIFEST).is_file():
        raise InputError(f"{run}: is no finished run folder: it has no {MANIFEST}")
    name = run.resolve().name
    target = output or Path(f"{name if build else name.removesuffix('.run')}.html")
    if target.suffix.lower() != ".html":
        raise SettingsError(f"{target}: give FILE.html")
    if not build and run.resolve() in target.resolve().parents:
        raise SettingsError(
            f"{target}: lies in the run, whose certificate names every file by its hash: give another place with -o"
        )
    text = build_page.document(run) if build else html.document(RunData(RunFolder(run)))
    with replacing(target) as temporary:
        temporary.write_text(text, encoding="utf-8")
    typer.echo(f"report: {target}")
    return ExitCode.PASS

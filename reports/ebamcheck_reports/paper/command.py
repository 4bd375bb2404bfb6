"""The command ``ebamcheck paper``; it imports when it runs, because every command of ebamcheck loads this module."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from ebamcheck.errors import ExitCode


def paper(
    output: Annotated[
        Path, typer.Option("-o", "--output", help="Folder for paper.html and paper.json.")
    ] = Path("paper"),
    bunny: Annotated[
        Path | None,
        typer.Option(
            help="Mesh to show Figures 3 to 8 on (the Stanford bunny is not shipped); default: a blade."
        ),
    ] = None,
    units: Annotated[
        str, typer.Option(help="Unit of that file: mm, cm, m, um, in, ft. Never guessed.")
    ] = "mm",
    full: Annotated[
        bool, typer.Option("--full", help="All eleven sizes and all 4488 layers: some ten minutes, 7 GB.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print paper.json instead of a table.")] = False,
) -> ExitCode:
    """Make the paper's figures and numbers again, beside its own values, and say what cannot be compared.

    Example: ebamcheck paper -o paper --json
    """
    from ebamcheck.atomic_file import made_folder
    from ebamcheck_reports.paper.effort import FULL, QUICK
    from ebamcheck_reports.paper.job import reproduce
    from ebamcheck_reports.paper.page import as_text, write

    folder = made_folder(output)
    found = reproduce(
        FULL if full else QUICK, bunny, units, note=lambda text: typer.echo(f"ebamcheck: {text}", err=True)
    )
    write(found, folder)
    typer.echo(as_text(found.record, ensure_ascii=True) if as_json else summary(found.record, folder))
    return ExitCode.PASS


def summary(record: Mapping[str, Any], folder: Path) -> str:
    """The table at the top of the page, for the terminal."""
    blocks = [
        f"{row['figure']}\n  the paper    {row['paper']}\n  ours         {row['ours']}\n  comparable   {row['comparable']}: {row['why']}"
        for row in record["comparison"]
    ]
    return "\n\n".join([*blocks, f"page: {folder / 'paper.html'}"])

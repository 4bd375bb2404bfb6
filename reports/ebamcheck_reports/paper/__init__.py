"""``ebamcheck paper``: the paper's figures and numbers, reproduced on stand-in parts and compared with its own.

The paper: "Slicing Algorithm and Partition Scanning Strategy for 3D Printing Based on GPU Parallel Computing". The command
imports when it runs, because every command of ebamcheck loads this module.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ebamcheck.errors import ExitCode


def paper(
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder for paper.html and paper.json.")] = Path(
        "paper"
    ),
    bunny: Annotated[
        Path | None,
        typer.Option(help="Mesh to show Figures 3 to 8 on (the Stanford bunny is not shipped); default: a blade."),
    ] = None,
    units: Annotated[str, typer.Option(help="Unit of that file: mm, cm, m, um, in, ft. Never guessed.")] = "mm",
    full: Annotated[
        bool, typer.Option("--full", help="All eleven sizes and all 4488 layers: some ten minutes, 7 GB.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print paper.json instead of a table.")] = False,
) -> ExitCode:
    """Make the paper's figures and numbers again, beside its own values, and say what cannot be compared.

    Example: ebamcheck paper -o paper --json
    """
    from ebamcheck.atomic_file import made_folder
    from ebamcheck_reports.paper import page, published

    folder = made_folder(output)
    effort = published.FULL if full else published.QUICK
    found = page.reproduce(effort, bunny, units, note=lambda text: typer.echo(f"ebamcheck: {text}", err=True))
    page.write(found, folder)
    blocks = [
        f"{row['figure']}\n  the paper    {row['paper']}\n  ours         {row['ours']}\n  comparable   {row['comparable']}: {row['why']}"
        for row in found.record["comparison"]
    ]
    told = "\n\n".join([*blocks, f"page: {folder / page.PAGE}"])
    typer.echo(page.as_text(found.record, ensure_ascii=True) if as_json else told)
    return ExitCode.PASS

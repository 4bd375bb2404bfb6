"""``ebamcheck view``: one page that scrubs through a finished run."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ebamcheck.atomic_file import replacing
from ebamcheck.errors import ExitCode, InputError, SettingsError
from ebamcheck.record.run_folder import MANIFEST, RunFolder


def view(
    run: Annotated[Path, typer.Argument(help="A finished run folder.")],
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="FILE.html; default: NAME-viewer.html for the run NAME.run."),
    ] = None,
) -> ExitCode:
    """Write one page that scrubs through every layer, slicer, bead and NC block of a run; it opens from disk, without a network.

    Example: ebamcheck view blade.run -o blade-viewer.html
    """
    from ebamcheck_viewer.contents import of_run
    from ebamcheck_viewer.page import document

    if not (run / MANIFEST).is_file():
        raise InputError(f"{run}: is no finished run folder: it has no {MANIFEST}")
    target = output or Path(f"{run.resolve().name.removesuffix('.run')}-viewer.html")
    if target.suffix.lower() != ".html":
        raise SettingsError(f"{target}: give FILE.html")
    if run.resolve() in target.resolve().parents:
        raise SettingsError(
            f"{target}: lies in the run, whose certificate names every file by its hash: give another place with -o"
        )
    text = document(of_run(RunFolder(run)))
    with replacing(target) as temporary:
        temporary.write_text(text, encoding="utf-8")
    typer.echo(f"viewer: {target} ({len(text) / 1e6:.1f} MB)")
    return ExitCode.PASS

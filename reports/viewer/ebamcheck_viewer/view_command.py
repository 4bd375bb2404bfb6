"""``ebamcheck view``: one page that scrubs through a finished run, a program or files of layers."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ebamcheck.atomic_file import replacing
from ebamcheck.commands.options import DEFAULT_CONFIG
from ebamcheck.errors import ExitCode, SettingsError
from ebamcheck.record.run_folder import MANIFEST, RunFolder

if TYPE_CHECKING:
    from ebamcheck_viewer.contents import Contents


def view(
    files: Annotated[
        list[Path],
        typer.Argument(help="A finished run folder; or a program, layer files of several slicers, or both."),
    ],
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="FILE.html; default: NAME-viewer.html for the first of the files."),
    ] = None,
    config_file: Annotated[
        Path | None,
        typer.Option(
            "-c",
            "--config",
            help="Settings (TOML) of a program's machine; default: ./ebamcheck.toml where there is one.",
        ),
    ] = None,
) -> ExitCode:
    """Write a page that scrubs through a build, bead by bead.

    It shows layers, slicers, beads and NC blocks, opens from disk, and needs no network.

    Example: ebamcheck view blade.run -o blade-viewer.html
    """
    from ebamcheck_viewer.contents import of_run
    from ebamcheck_viewer.page import document

    first = files[0].resolve()
    target = output or Path(f"{first.name.removesuffix('.run') if first.is_dir() else first.stem}-viewer.html")
    if target.suffix.lower() != ".html":
        raise SettingsError(f"{target}: give FILE.html")
    is_run = len(files) == 1 and (first / MANIFEST).is_file()
    if is_run and first in target.resolve().parents:
        told = "lies in the run, whose certificate names every file by its hash"
        raise SettingsError(f"{target}: {told}: give another place with -o")
    text = document(of_run(RunFolder(first)) if is_run else _of_files(files, config_file))
    with replacing(target) as temporary:
        temporary.write_text(text, encoding="utf-8")
    typer.echo(f"viewer: {target} ({len(text) / 1e6:.1f} MB)")
    return ExitCode.PASS


def _of_files(files: list[Path], config_file: Path | None) -> Contents:
    """Contents of files, told apart by their suffixes: layers, else a program."""
    from ebamcheck.layers.files import FORMATS, read_layers
    from ebamcheck.nc.reader import read_program
    from ebamcheck.settings.config import load_config
    from ebamcheck_viewer.contents import of_files

    config = load_config(config_file or (DEFAULT_CONFIG if DEFAULT_CONFIG.is_file() else None))
    layers = [file for file in files if file.suffix.lower() in FORMATS]
    programs = [file for file in files if file not in layers]
    if len(programs) > 1:
        raise SettingsError(f"{programs[1]}: a page shows one program; {programs[0]} is another")
    names = [file.stem if sum(one.stem == file.stem for one in layers) == 1 else file.name for file in layers]
    stacks = {name: read_layers(file) for name, file in zip(names, layers, strict=True)}
    return of_files(stacks, read_program(programs[0], config) if programs else None, config)

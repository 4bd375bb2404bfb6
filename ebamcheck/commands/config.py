"""``ebamcheck config``: the settings in force, as a text, a new file, or new keys of an old one."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ebamcheck.commands.options import ConfigOption, print_json, settings_of
from ebamcheck.errors import ExitCode, SettingsError


def config_command(
    config_file: ConfigOption = None,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="Write them into a new FILE; one that is there stays."),
    ] = None,
    merge: Annotated[
        Path | None,
        typer.Option(help="Add the keys that FILE lacks, with their explanations; keep what is set in it."),
    ] = None,
    schema: Annotated[bool, typer.Option("--schema", help="Print the JSON schema instead.")] = False,
) -> ExitCode:
    """Print all settings in force, with their explanations, as TOML."""
    from ebamcheck.settings.checking import as_toml
    from ebamcheck.settings.config import Config

    if sum((output is not None, merge is not None, schema)) > 1 or (
        merge is not None and config_file is not None
    ):
        raise SettingsError("give one of --output, --merge and --schema; --merge goes without --config")
    if merge is not None:
        return _merged(merge)
    if schema:
        from ebamcheck.settings.checking import explained_schema

        print_json(explained_schema(Config))
        return ExitCode.PASS
    config = settings_of(config_file, "", "", None)
    if output is None:
        typer.echo(as_toml(config), nl=False)
        return ExitCode.PASS
    from ebamcheck.settings.files import write_new

    write_new(output, config)
    typer.echo(f"{output}: all settings, with their explanations")
    return ExitCode.PASS


def _merged(path: Path) -> ExitCode:
    """Add new keys to a file, and say which; exit code 2 where it holds keys that no command takes."""
    from ebamcheck.settings.files import merge

    made = merge(path)
    for key in made.added:
        typer.echo(f"added {key}")
    typer.echo(
        f"{path}: {len(made.added) or 'no'} new key{'' if len(made.added) == 1 else 's'}; what was set is kept"
    )
    for text in made.unknown:
        typer.echo(
            f"ebamcheck: {path}: {text}; it stays in the file, but no command accepts the file until you remove it",
            err=True,
        )
    return ExitCode.USAGE if made.unknown else ExitCode.PASS

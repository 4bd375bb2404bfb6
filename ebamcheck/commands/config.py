"""``ebamcheck config`` and ``backends``: the settings in force, and the slicers that are installed."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Annotated

import typer
from typer import Option

from ebamcheck.commands.options import explained, print_json, settings_of
from ebamcheck.errors import ExitCode, SettingsError


@explained()
def backends(as_json: bool = False) -> ExitCode:
    """List the slicers: availability, versions, device, rules and error bound; and what is wrong with a plugin."""
    from ebamcheck.commands.summaries import backend_record, backends_text
    from ebamcheck.plugins import registry

    with warnings.catch_warnings():
        # What is wrong with a plugin stands in the list.
        warnings.simplefilter("ignore", registry.BrokenPluginWarning)
        registry.forget(kept=True)
        records = [backend_record(name) for name in registry.slicers()]
        left_out = registry.broken_plugins()
    if as_json:
        print_json([*records, *({**vars(plugin), "available": False, "broken": True} for plugin in left_out)])
        return ExitCode.PASS
    print(backends_text(records, left_out))
    return ExitCode.PASS


@explained(
    output="Write them into a new FILE; one that is there stays.",
    merge="Add the keys that FILE lacks, with their explanations; keep what is set in it.",
)
def config_command(
    config_file: Path | None = None,
    output: Path | None = None,
    merge: Path | None = None,
    schema: Annotated[bool, Option("--schema", help="Print the JSON schema instead.")] = False,
) -> ExitCode:
    """Print all settings in force, with their explanations, as TOML."""
    from ebamcheck.settings.checking import as_toml
    from ebamcheck.settings.config import Config
    from ebamcheck.settings.files import write_new

    given = (output is not None, merge is not None, schema)
    if sum(given) > 1 or (merge is not None and config_file is not None):
        raise SettingsError("give one of --output, --merge and --schema; --merge goes without --config")
    if merge is not None:
        return _merged(merge)
    if schema:
        print_json(Config.model_json_schema())
        return ExitCode.PASS
    config = settings_of(config_file, "", "", None)
    if output is None:
        typer.echo(as_toml(config), nl=False)
        return ExitCode.PASS
    write_new(output, config)
    typer.echo(f"{output}: all settings, with their explanations")
    return ExitCode.PASS


def _merged(path: Path) -> ExitCode:
    """Add new keys to a file, and say which; exit code 2 where it holds keys that no command takes."""
    from ebamcheck.settings.files import merge

    made = merge(path)
    for key in made.added:
        typer.echo(f"added {key}")
    new = f"{len(made.added) or 'no'} new key{'' if len(made.added) == 1 else 's'}"
    typer.echo(f"{path}: {new}; what was set is kept")
    for text in made.unknown:
        stays = "it stays in the file, but no command accepts the file until you remove it"
        typer.echo(f"ebamcheck: {path}: {text}; {stays}", err=True)
    return ExitCode.USAGE if made.unknown else ExitCode.PASS

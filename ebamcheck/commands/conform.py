"""``ebamcheck conform``: the conformance kit for slicers and controls."""

from __future__ import annotations

import json
from typing import Annotated

import typer

from ebamcheck.commands.options import assignments
from ebamcheck.errors import ExitCode
from ebamcheck.plugins import registry
from ebamcheck.testing.conformance import conform, conform_control, markdown_table

# Annotations of a command are read when it is registered, so their names must exist at run time.


def conform_command(
    names: Annotated[
        list[str] | None,
        typer.Argument(metavar="NAME", help="Backends, or controls; default: all that this machine can run."),
    ] = None,
    controls: Annotated[
        bool, typer.Option("--controls", help="Test controls: write, read back, plant faults.")
    ] = False,
    models: Annotated[
        str | None, typer.Option(help="Reference models, as a,b; default: all installed; none for none.")
    ] = None,
    setting: Annotated[
        list[str] | None,
        typer.Option("--set", help="A setting of the backend, or of the machine, as NAME=VALUE; repeatable."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")] = False,
    markdown: Annotated[
        bool, typer.Option("--markdown", help="Print one table of checks and backends for a document.")
    ] = False,
) -> ExitCode:
    """Test backends against the protocol, the laws of sections and the reference models; or controls by what they write.

    Exit code 1 if a check is broken, 4 if a backend is not available.

    Example: ebamcheck conform planecut --models cube,sphere
    """
    values = assignments(setting or ())
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

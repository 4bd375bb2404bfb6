"""``ebamcheck warm``: compiles all kernels, so that no later command has to wait for them."""

from __future__ import annotations

import typer

from ebamcheck.errors import ExitCode


def warm_command() -> ExitCode:
    """Compile the kernels once, so that no later command has to wait for it."""
    from ebamcheck.commands.warm import warm_kernels

    typer.echo(
        "compiling the kernels where they are not yet, on all cores: a minute or two on two of them the first time"
    )
    seconds = warm_kernels()
    typer.echo(f"kernels are compiled ({seconds:.1f} s)")
    return ExitCode.PASS

"""The group of all commands: their order in the help, those that plugins add, and how they end (one line and an exit code)."""

from __future__ import annotations

import ast
import contextlib
import errno
import functools
import importlib.util
import os
import shlex
import sys
import traceback
from collections.abc import Callable
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup

from ebamcheck.commands.warm import tell_if_cold, warm_kernels
from ebamcheck.errors import EbamcheckError, ExitCode, behind, interruptible
from ebamcheck.installed import entry_points, is_house, sorted_out
from ebamcheck.printable import printable

COMMANDS = "ebamcheck.commands"  # entry point group of commands that plugin packages add
# Commands that begin with all kernels compiled, beside those that show progress; and those that compile a few as they go
MOST_KERNELS = ("verify", "live_command", "relayer_command", "post_command", "fit_command", "regress", "select", "paper")  # fmt: skip
FEW_KERNELS = ["slice_command", "inspect", "compare", "polar", "preflight_command"]

# Commands in the order of the help; the first five, in this order, are the way from a part to a proven program.
GROUPS = {
    "Start here": ("config", "preflight", "run", "view", "verify"),
    "Make": ("slice", "fit", "scan", "post", "warm"),
    "Look": ("inspect", "compare", "polar", "report", "backends"),
    "Prove": ("check", "judge", "key", "sign"),
    "Test slicers": ("conform", "regress", "select", "paper"),
    "Machines": ("machine", "live", "relayer"),
}


class CommandGroup(TyperGroup):
    """The house's commands, and those of installed plugin packages, each loaded when it is first asked for."""

    _is_listing = False

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """List all commands by group; those of the house with what their sources say, for which none is loaded."""
        self._is_listing = True
        try:
            commands = {name: self.get_command(ctx, name) for name in self.list_commands(ctx)}
        finally:
            self._is_listing = False
        grouped = {name for names in GROUPS.values() for name in names}
        longest = max(map(len, commands))
        for title, names in {**GROUPS, "Plug-ins": commands.keys() - grouped}.items():
            rows = [
                (name.ljust(longest), command.get_short_help_str(formatter.width - longest - 6))
                for name, command in commands.items()
                if name in names and command is not None
            ]
            if rows:
                with formatter.section(title):
                    formatter.write_dl(rows)

    def list_commands(self, ctx: Any) -> list[str]:
        """Names of all commands: by group, then those of other packages."""
        known = {*super().list_commands(ctx), *_plugins()}
        grouped = [name for names in GROUPS.values() for name in names if name in known]
        return [*grouped, *sorted(known.difference(grouped))]

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Find the command; where a file stands in its place, the message says what to do with one."""
        if args and self.get_command(ctx, args[0]) is None and Path(args[0]).exists():
            how = f"to make a program of a part, `ebamcheck run {shlex.join(args)}`"
            ctx.fail(f"{args[0]!r} is no command: {how}")
        return super().resolve_command(ctx, args)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return a command; None where there is none of that name or its plugin is broken."""
        if (own := super().get_command(ctx, cmd_name)) is not None or cmd_name not in _plugins():
            return own
        point = _plugins()[cmd_name]
        if self._is_listing and is_house(point):
            return TyperCommand(cmd_name, help=_told_in_source(point))
        try:
            if is_house(point):
                function = point.load()
            else:
                # A stranger's command is loaded here only after it has loaded in another process.
                from ebamcheck.plugins import registry

                function = registry.load(point)
        except Exception as error:
            typer.echo(f"ebamcheck: warning: command {cmd_name!r} was left out: {error}", err=True)
            return None
        app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)
        app.command(cmd_name)(guarded(function))
        return typer.main.get_command(app)


@functools.cache
def _plugins() -> dict[str, EntryPoint]:
    return sorted_out(entry_points(group=COMMANDS))[0]


def _told_in_source(point: EntryPoint) -> str:
    """Docstring of a function of the house that an entry point names; only the topmost package is imported for it."""
    module, _, name = point.value.partition(":")
    top, *within = module.split(".")
    spec = importlib.util.find_spec(top)
    assert spec is not None
    assert spec.origin is not None
    return _docstring(Path(spec.origin).parent.joinpath(*within), name)


def _docstring(module: Path, name: str) -> str:
    """Docstring of a function of a module, or of one beside it from which a package takes it."""
    file = module / "__init__.py" if module.is_dir() else module.with_suffix(".py")
    for node in ast.parse(file.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.FunctionDef) and node.name == name:
            return ast.get_docstring(node) or ""
        if isinstance(node, ast.ImportFrom) and node.module and name in (one.name for one in node.names):
            return _docstring(module / node.module.rpartition(".")[2], name)
    return ""


def guarded(function: Callable[..., Any]) -> Callable[..., None]:
    """Turn what a command raises into one line, and what it returns into the exit code of the process."""

    @functools.wraps(function)
    def run(*args: Any, **kwargs: Any) -> None:
        raise typer.Exit(int(_run_guarded(function, *args, **kwargs)))

    return run


def _run_guarded(function: Callable[..., Any], *args: Any, **kwargs: Any) -> ExitCode:
    try:
        with interruptible():
            if function.__name__ in MOST_KERNELS:
                warm_kernels()
            elif function.__name__ in FEW_KERNELS:
                tell_if_cold()
            code = ExitCode(function(*args, **kwargs) or ExitCode.PASS)
        sys.stdout.flush()
    except KeyboardInterrupt as interrupt:
        code = ExitCode.INTERRUPTED
        kept = "what was finished is kept for --resume" if function.__name__ in ("run", "check") else str(interrupt)
        tell(f"interrupted; {kept}" if kept else "interrupted", ended=True)
    except (typer.Exit, typer.Abort):
        raise
    except Exception as error:
        return ended_by(error)
    return code


def ended_by(error: BaseException) -> ExitCode:
    """Tell in one line what has ended a command; returns the exit code.

    A full disk and too little memory have codes of their own, whatever was made of them on the way up.
    """
    code, message = _ending(error)
    if code is ExitCode.NOBODY_READS:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return code
    with contextlib.suppress(OSError):  # Standard error may be on the full disk.
        tell(message, ended=True)
    if code is ExitCode.DISK_FULL and sys.stdout is not None:
        # What is left in the buffer of the output would be tried once more when Python ends.
        with contextlib.suppress(OSError):
            sys.stdout.flush()
        if not isinstance(error, EbamcheckError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return code


def _ending(error: BaseException) -> tuple[ExitCode, str]:
    chain = list(behind(error))
    numbers = {one.errno for one in chain if isinstance(one, OSError)}
    told = f"error: {_said(error)}"
    if any(map(_of_memory, chain)) or errno.ENOMEM in numbers:
        what = f"error: too little memory: {_said(error)}: end other programs, or use a larger machine"
        return ExitCode.MEMORY_FULL, what
    if numbers & {errno.ENOSPC, errno.EDQUOT}:
        return ExitCode.DISK_FULL, f"{told}: make room, and run it again"
    if isinstance(error, EbamcheckError):
        return error.exit_code, told
    if errno.EPIPE in numbers:
        # The reader of our output has gone; there is nobody left to tell.
        return ExitCode.NOBODY_READS, ""
    if isinstance(error, OSError):
        # What the system refuses (a folder without permission) is for the user to mend.
        return ExitCode.USAGE, told
    what = f"internal error: {type(error).__name__}: {error} (run again with --debug for a traceback)"
    return ExitCode.INTERNAL, what


def _of_memory(error: BaseException) -> bool:
    """Whether Python, numpy, Arrow, the loader of libraries or a start of threads has run out of memory."""
    said = str(error)
    return (
        isinstance(error, MemoryError)
        or (isinstance(error, RuntimeError) and "can't start new thread" in said)
        or (isinstance(error, ImportError) and ("failed to map segment" in said or "allocate" in said))
    )


def _said(error: BaseException) -> str:
    if isinstance(error, EbamcheckError) or not isinstance(error, OSError):
        return str(error) or type(error).__name__
    return f"{error.filename or 'output'}: {error.strerror or error}"


def tell(message: str, ended: bool = False) -> None:
    """Print a message as one line on standard error; if a command has `ended`, after the traceback that the user asks for."""
    if ended and os.environ.get("EBAMCHECK_DEBUG"):
        traceback.print_exc()
    typer.echo(f"ebamcheck: {printable(' '.join(message.split()))}", err=True)

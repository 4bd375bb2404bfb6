"""The command line. Every command is a thin skin over the Python interface."""

from __future__ import annotations

import atexit
import gc
import io
import logging
import os
import signal
import sys
import warnings
from collections.abc import Callable
from typing import Annotated, Any, TextIO, cast

import typer
from typer import Option

from ebamcheck import __version__
from ebamcheck.commands.command_group import CommandGroup, ended_by, guarded, tell
from ebamcheck.commands.config import backends, config_command
from ebamcheck.commands.run import check, run, verify
from ebamcheck.commands.slice import compare, inspect, slice_command
from ebamcheck.commands.warm import warm_command
from ebamcheck.errors import ExitCode
from ebamcheck.printable import PrintableStream, printable

app = typer.Typer(
    name="ebamcheck",
    cls=CommandGroup,
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    epilog="Examples: ebamcheck run blade.stl -o blade.run; ebamcheck --install-completion",
    help="Slice a part with independent slicers, prove that they agree, and write a validated NC program.\n\n"
    "Exit codes: 0 pass, 1 out of tolerance, 2 usage, configuration or unreadable input, 3 internal error, "
    "4 a required backend is missing, 5 nothing compared, 6 disk full, 7 too little memory, 130 interrupted, "
    "141 nobody reads the output.",
)


class _PrintableFormatter(logging.Formatter):
    """Log messages quote names from files."""

    def formatMessage(self, record: logging.LogRecord) -> str:  # noqa: N802
        return printable(super().formatMessage(record))


def _show_version(asked: bool) -> None:
    if asked:
        print(f"ebamcheck {__version__}")
        raise typer.Exit(0)


@app.callback()
def _global(
    debug: Annotated[bool, Option("--debug", help="Show tracebacks and debug messages.")] = False,
    version: Annotated[
        bool, Option("--version", help="Print the version and leave.", is_eager=True, callback=_show_version)
    ] = False,
) -> None:
    if debug:
        os.environ["EBAMCHECK_DEBUG"] = "1"
    logging.basicConfig(level=logging.DEBUG if debug else logging.WARNING, force=True)
    for noisy in ("numba", "trimesh", "matplotlib", "PIL"):
        logging.getLogger(noisy).setLevel(logging.WARNING)
    for handler in logging.getLogger().handlers:
        handler.setFormatter(_PrintableFormatter("ebamcheck: %(levelname)s: %(message)s"))
    logging.captureWarnings(capture=True)
    warnings.formatwarning = lambda message, *_args, **_kwargs: str(message)


# Name and function of each command, and its example
COMMANDS: tuple[tuple[str, Callable[..., Any], str], ...] = (
    ("run", run, "Example: ebamcheck run blade.stl -c ebamcheck.toml -o blade.run --reference blade-fine.stl"),
    ("check", check, "Example: ebamcheck check blade.stl --layer-height 0.2 --witnesses all -o blade.run"),
    ("inspect", inspect, "Example: ebamcheck inspect part.stl --regions --picture regions.svg"),
    ("slice", slice_command, "Example: ebamcheck slice part.stl --backend planecut --layer-height 0.2 -o part.parquet"),
    ("compare", compare, "Example: ebamcheck compare a.parquet b.parquet --tolerance 0.01"),
    ("backends", backends, "Example: ebamcheck backends --json"),
    ("warm", warm_command, "Example: ebamcheck warm"),
    ("verify", verify, "Examples: ebamcheck verify blade.run --trusted keys/; ebamcheck verify blade.run/program/MAIN.MPF --part blade.stl"),
    ("config", config_command, "Examples: ebamcheck config -o ebamcheck.toml; ebamcheck config --merge ebamcheck.toml"),
)  # fmt: skip

for _name, _function, _example in COMMANDS:
    app.command(_name, epilog=_example)(guarded(_function))


def main() -> None:
    """Entry point of the program; ``--debug`` may stand anywhere."""
    # Imports make hundreds of thousands of objects, and none that die: a slice of a small part is over before the first look.
    gc.set_threshold(300_000)
    # Else Python looks through all objects once more when it ends: the time of a whole slice of a small part.
    atexit.register(gc.freeze)
    if "--debug" in sys.argv:
        sys.argv.remove("--debug")
        sys.argv.insert(1, "--debug")
    _open_streams()
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            # A name that the terminal's encoding cannot show is no reason to fail.
            stream.reconfigure(errors="backslashreplace")
    sys.stdout = cast(TextIO, PrintableStream(sys.stdout))
    # End on SIGTERM as on Ctrl-C: workers are ended and temporary files go.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        sys.exit(app(standalone_mode=False))
    except (typer.Abort, KeyboardInterrupt):
        sys.exit(ExitCode.INTERRUPTED)
    except SystemExit as end:
        # Thus the parser ends where nobody reads its help.
        sys.exit(ended_by(end.__context__) if isinstance(end.__context__, BrokenPipeError) else end.code)
    except Exception as error:
        if not hasattr(error, "format_message"):
            sys.exit(ended_by(error))
        # Wrong usage, told by the parser of the command line.
        if len(sys.argv) == 1:
            print(error.format_message(), file=sys.stderr)
        else:
            context = getattr(error, "ctx", None)
            path = context.command_path if context is not None else "ebamcheck"
            tell(f"error: {error.format_message()} (see `{path} --help`)")
        sys.exit(ExitCode.USAGE)


def _open_streams() -> None:
    """Let streams that are closed lead nowhere: else the next file that is opened would take the place of one."""
    while True:
        descriptor = os.open(os.devnull, os.O_RDWR)
        if descriptor > 2:  # that of standard error
            os.close(descriptor)
            break
    sys.stdout = sys.stdout or open(os.devnull, "w")  # noqa: SIM115
    sys.stderr = sys.stderr or open(os.devnull, "w")  # noqa: SIM115

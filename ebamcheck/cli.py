"""The command line. Every command is a thin skin over the Python interface."""

from __future__ import annotations

import functools
import io
import json
import logging
import os
import signal
import sys
import traceback
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer

from ebamcheck import __version__
from ebamcheck.errors import EbamcheckError, ExitCode, InputError, NothingCompared, SettingsError

if TYPE_CHECKING:
    from ebamcheck.config import Config
    from ebamcheck.part import Part

app = typer.Typer(
    name="ebamcheck",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    help="Slice a part with independent slicers, prove that they agree, and write a validated NC program.\n\n"
    "Exit codes: 0 pass, 1 out of tolerance, 2 usage, configuration or unreadable input, 3 internal error, "
    "4 a required backend is missing, 5 nothing compared, 130 interrupted.",
)

SLICE_SUFFIXES = (".parquet", ".cli", ".svg")
"""Formats that `ebamcheck slice` writes; looked at before the work, not after it."""

_Command = TypeVar("_Command", bound=Callable[..., Any])

ConfigOption = Annotated[
    Path | None,
    typer.Option("-c", "--config", help="Settings (TOML); default: ./ebamcheck.toml where there is one."),
]
UnitsOption = Annotated[
    str, typer.Option(help="Unit of the part's file: mm, cm, m, um, in, ft. Never guessed.")
]
DirectionOption = Annotated[str, typer.Option(help="Slicing direction in the file's coordinates, as X,Y,Z.")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")]
PartArgument = Annotated[Path, typer.Argument(help="Mesh file: .stl, .obj, .ply or .3mf.")]
LayerHeightOption = Annotated[
    float | None, typer.Option(help="Layer height, mm; default: that of one bead of the process.")
]


def command(name: str | None = None, **options: Any) -> Callable[[_Command], _Command]:
    """Register a command whose errors become one line and an exit code."""

    def register(function: _Command) -> _Command:
        @app.command(name, **options)
        @functools.wraps(function)
        def guarded(*args: Any, **kwargs: Any) -> None:
            raise typer.Exit(int(_run_guarded(function, *args, **kwargs)))

        return function

    return register


def _run_guarded(function: Callable[..., Any], *args: Any, **kwargs: Any) -> ExitCode:
    """Run a command; turn what it raises into a message and an exit code."""
    debug = bool(os.environ.get("EBAMCHECK_DEBUG"))
    try:
        code = ExitCode(function(*args, **kwargs) or ExitCode.PASS)
        sys.stdout.flush()
    except EbamcheckError as error:
        code = error.exit_code
        _tell(f"error: {error}", debug)
    except KeyboardInterrupt:
        code = ExitCode.INTERRUPTED
        kept = "; what was finished is kept for --resume" if function.__name__ == "run" else ""
        _tell(f"interrupted{kept}", debug)
    except BrokenPipeError:
        # The reader of our output has gone; there is nobody left to tell.
        code = ExitCode.PASS
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except OSError as error:
        # What the system refuses (a full disk, a folder without permission) is for the user to mend.
        code = ExitCode.USAGE
        where = f"{error.filename}: " if error.filename else ""
        _tell(f"error: {where}{error.strerror or error}", debug)
    except (typer.Exit, typer.Abort):
        raise
    except Exception as error:
        code = ExitCode.INTERNAL
        _tell(
            f"internal error: {type(error).__name__}: {error} (run again with --debug for a traceback)", debug
        )
    return code


def _tell(message: str, debug: bool = False) -> None:
    """Print a message as one line on standard error, after the traceback where one is wanted."""
    if debug:
        traceback.print_exc()
    print(f"ebamcheck: {' '.join(message.split())}", file=sys.stderr)


def _show_version(asked: bool) -> None:
    if asked:
        print(f"ebamcheck {__version__}")
        raise typer.Exit(0)


@app.callback()
def _global(
    debug: Annotated[bool, typer.Option("--debug", help="Show tracebacks and debug messages.")] = False,
    version: Annotated[
        bool,
        typer.Option("--version", help="Print the version and leave.", is_eager=True, callback=_show_version),
    ] = False,
) -> None:
    if debug:
        os.environ["EBAMCHECK_DEBUG"] = "1"
    logging.basicConfig(
        level=logging.DEBUG if debug else logging.WARNING,
        format="ebamcheck: %(levelname)s: %(message)s",
        force=True,
    )
    for noisy in ("numba", "trimesh", "matplotlib", "PIL"):
        logging.getLogger(noisy).setLevel(logging.WARNING)
    logging.captureWarnings(capture=True)
    warnings.formatwarning = lambda message, *_args, **_kwargs: str(message)


# -- commands ------------------------------------------------------------------------------------------


@command(
    epilog="Example: ebamcheck run blade.stl -c ebamcheck.toml -o blade.run --reference blade-fine.stl",
)
def run(
    part: PartArgument,
    config: ConfigOption = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Run folder; default: NAME.run.")
    ] = None,
    layer_height: LayerHeightOption = None,
    backends: Annotated[
        str, typer.Option(help="Backends to run, comma-separated; default: all available.")
    ] = "",
    reference: Annotated[Path | None, typer.Option(help="A finer tessellation of the same part.")] = None,
    units: UnitsOption = "",
    direction: DirectionOption = "",
    fix_orientation: Annotated[
        bool, typer.Option("--fix-orientation", help="Turn flipped facets and inside-out bodies over.")
    ] = False,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on with a killed run of the same input.")
    ] = False,
    as_json: JsonOption = False,
) -> ExitCode:
    """Slice, cross-check, fit, partition, order, write the NC program, verify it and report."""
    from ebamcheck.machines import for_this_machine
    from ebamcheck.pipeline import run_job
    from ebamcheck.progress import watched
    from ebamcheck.summaries import run_summary

    settings = for_this_machine(_settings(config, units, direction, layer_height))
    if backends:
        settings = settings.changed(slicing={"backends": _names(backends)})
    if fix_orientation:
        settings = settings.changed(part={"fix_orientation": True})
    target = output or Path(f"{part.stem}.run")
    with watched() as observer:
        result = run_job(part, target, settings, reference, resume, observer)
    if as_json:
        _print_json(result.manifest)
    else:
        print(run_summary(result.manifest))
        report = result.folder.path / "report.html"
        print(f"\nrun folder: {result.folder.path}" + (f"\nreport:     {report}" if report.is_file() else ""))
    return result.exit_code


@command(epilog="Example: ebamcheck inspect part.stl --json")
def inspect(part: PartArgument, units: UnitsOption = "mm", as_json: JsonOption = False) -> ExitCode:
    """Count the defects of a part and judge whether it can be sliced; exit code 1 where it should not."""
    from ebamcheck.inspection import inspect as inspect_part
    from ebamcheck.mesh_files import load

    found = inspect_part(load(part, units))
    if as_json:
        _print_json(found.as_dict())
    else:
        figures = found.as_dict()
        for key in ("name", "verdict", "why", "notes", "passed"):
            figures.pop(key)
        figures["size_mm"] = " x ".join(f"{s:.6g}" for s in found.size_mm)
        figures["lower_mm"] = ", ".join(f"{s:.6g}" for s in found.lower_mm)
        for key, value in figures.items():
            print(
                f"{key.replace('_', ' '):20} {value:.9g}"
                if isinstance(value, float)
                else f"{key.replace('_', ' '):20} {value}"
            )
        print(f"{'verdict':20} {found.verdict}: {found.why}")
    return ExitCode.PASS if found.passed else ExitCode.OUT_OF_TOLERANCE


@command(
    name="slice",
    epilog="Example: ebamcheck slice part.stl --backend planecut --layer-height 0.2 -o part.parquet",
)
def slice_command(
    part: PartArgument,
    output: Annotated[
        Path, typer.Option("-o", "--output", help="FILE.parquet, .cli (Common Layer Interface) or .svg.")
    ],
    backend: Annotated[
        str, typer.Option(help="Backend; default: the available exact one of the highest priority.")
    ] = "",
    layer_height: LayerHeightOption = None,
    heights: Annotated[
        str, typer.Option(help="Listed heights, mm, comma-separated, instead of uniform layers.")
    ] = "",
    setting: Annotated[
        list[str] | None, typer.Option("--set", help="Backend setting NAME=VALUE; repeatable.")
    ] = None,
    config: ConfigOption = None,
    units: UnitsOption = "",
    direction: DirectionOption = "",
) -> ExitCode:
    """Slice a part with one backend and write its layers."""
    from ebamcheck import registry
    from ebamcheck.heights import layer_heights
    from ebamcheck.isolate import Limits
    from ebamcheck.layer_files import write_layers
    from ebamcheck.slicing import slice_part

    if output.suffix.lower() not in SLICE_SUFFIXES:
        raise SettingsError(
            f"{output}: unknown slice format {output.suffix!r}: use {', '.join(SLICE_SUFFIXES)}"
        )
    settings = _settings(config, units, direction, layer_height)
    name = backend or settings.slicing.primary or registry.default_backend()
    values = {**settings.slicing.settings.get(name, {}), **_pairs(setting or [])}
    registry.slicer_settings(name, values)
    placed = _load(part, settings)
    wanted = _numbers(heights, "--heights") if heights else layer_heights(placed, settings.layer_height_mm)
    limits = Limits(settings.slicing.time_limit_s, settings.slicing.memory_limit_mb)
    layers = slice_part(placed, wanted, name, isolate=True, limits=limits, **values)
    write_layers(layers, output)
    print(
        f"{len(layers)} layers, {int(layers.ring_counts().sum())} rings, {int(layers.open_counts().sum())} open paths, "
        f"{len(layers.points)} points: {output}"
    )
    return ExitCode.PASS


@command(epilog="Example: ebamcheck compare a.parquet b.parquet --tolerance 0.01")
def compare(
    a: Annotated[Path, typer.Argument(help="Layers of one slicer (.parquet or .cli).")],
    b: Annotated[Path, typer.Argument(help="Layers of another, at the same heights.")],
    tolerance: Annotated[float, typer.Option(help="Depth of the symmetric difference allowed, mm.")] = 0.001,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="Write the table as CSV.")] = None,
    any_part: Annotated[
        bool, typer.Option("--any-part", help="Compare slices of different parts, too.")
    ] = False,
    as_json: JsonOption = False,
) -> ExitCode:
    """Compare two slice files layer by layer; exit code 1 where they differ by more than the tolerance."""
    from ebamcheck.atomic_file import replacing
    from ebamcheck.comparison import compare as compare_layers
    from ebamcheck.layer_files import read_layers
    from ebamcheck.tables import text_table

    if not tolerance >= 0.0:
        raise SettingsError(f"--tolerance {tolerance}: give 0 or a positive number of millimetres")
    one, other = read_layers(a), read_layers(b)
    if one.part and other.part and one.part != other.part and not any_part:
        raise SettingsError(f"{a} and {b} are of different parts: give slices of one part, or --any-part")
    table = compare_layers(one, other, tolerance_mm=tolerance, check_part=False)
    if not len(table):
        raise NothingCompared(f"{a} and {b} hold no layers: nothing was compared")
    if output is not None:
        with replacing(output) as temporary:
            table.to_csv(temporary, index=False)
    shown = [
        "layer",
        "height_mm",
        "area_difference_mm2",
        "symmetric_difference_mm2",
        "iou",
        "hausdorff_mm",
        "depth_mm",
        "agrees",
    ]
    if as_json:
        _print_json(table.to_dict(orient="records"))
    else:
        rows = table[~table["agrees"]] if not table["agrees"].all() else table.nlargest(10, "depth_mm")
        print(text_table(shown, rows[shown].head(20).itertuples(index=False)))
        print(f"\n{int(table['agrees'].sum())} of {len(table)} layers agree within {tolerance:g} mm")
    return ExitCode.PASS if table["agrees"].all() else ExitCode.OUT_OF_TOLERANCE


@command(epilog="Example: ebamcheck backends --json")
def backends(as_json: JsonOption = False) -> ExitCode:
    """List the slicers: availability, versions, device, rules and error bound."""
    from ebamcheck import registry
    from ebamcheck.summaries import backend_record, backends_text

    records = [backend_record(name) for name in registry.slicers()]
    if as_json:
        _print_json(records)
        return ExitCode.PASS
    print(backends_text(records))
    return ExitCode.PASS


@command()
def warm() -> ExitCode:
    """Compile the kernels once, so that no later command has to wait for it."""
    from ebamcheck.warm import warm_kernels

    print("compiling the kernels where they are not yet: a minute or two the first time", flush=True)
    seconds = warm_kernels()
    print(f"kernels are compiled ({seconds:.1f} s)")
    return ExitCode.PASS


@command(
    epilog="Examples: ebamcheck verify blade.run; ebamcheck verify blade.run/program/MAIN.MPF --part blade.stl",
)
def verify(
    target: Annotated[Path, typer.Argument(help="A run folder, or a program (with --part).")],
    part: Annotated[Path | None, typer.Option(help="The part that the program should make.")] = None,
    config: ConfigOption = None,
    layer_height: LayerHeightOption = None,
    units: UnitsOption = "",
    as_json: JsonOption = False,
) -> ExitCode:
    """Check a finished run, or a program against a part, from the program's text."""
    from ebamcheck.pipeline.verify import verify_against_part, verify_run
    from ebamcheck.store import MANIFEST
    from ebamcheck.tables import text_table

    if (target / MANIFEST).is_file():
        checks = verify_run(target, part)
    elif not target.exists():
        raise InputError(f"{target}: there is no such run folder or program")
    elif part is None:
        raise SettingsError(f"{target}: is no run folder: to verify a program, name its part with --part")
    else:
        checks = verify_against_part(target, part, _settings(config, units, "", layer_height))
    if as_json:
        _print_json([vars(check) for check in checks])
    else:
        rows = [
            ["pass" if c.passed else "FAIL", c.name, c.value, c.limit, c.unit, c.where, c.text]
            for c in checks
        ]
        print(text_table(["", "check", "value", "limit", "unit", "where", ""], rows))
        failed = sum(not c.passed for c in checks)
        print(f"\n{len(checks) - failed} of {len(checks)} checks passed")
    return ExitCode.PASS if all(c.passed for c in checks) else ExitCode.OUT_OF_TOLERANCE


@command(name="config", epilog="Example: ebamcheck config > ebamcheck.toml")
def config_command(
    config: ConfigOption = None,
    schema: Annotated[bool, typer.Option("--schema", help="Print the JSON schema instead.")] = False,
) -> ExitCode:
    """Print all settings in force, with their explanations, as TOML."""
    from ebamcheck.config import Config
    from ebamcheck.config_text import as_toml

    if schema:
        _print_json(Config.model_json_schema())
    else:
        print(as_toml(_settings(config, "", "", None)), end="")
    return ExitCode.PASS


# -- what the commands share ---------------------------------------------------------------------------


def _settings(config: Path | None, units: str, direction: str, layer_height: float | None) -> Config:
    """Settings of the file, with what the command line says on top."""
    from ebamcheck.config import load_config

    default = Path("ebamcheck.toml")
    settings = load_config(config or (default if default.is_file() else None))
    if units:
        settings = settings.changed(part={"units": units})
    if direction:
        settings = settings.changed(part={"direction": _numbers(direction, "--direction")})
    if layer_height is not None:
        settings = settings.changed(layers={"layer_height_mm": layer_height, "heights_mm": ()})
    return settings


def _load(path: Path, settings: Config) -> Part:
    from ebamcheck.mesh_files import load

    return load(path, settings.part.units).along(settings.part.direction)


def _names(text: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in text.split(",") if name.strip())


def _numbers(text: str, option: str) -> tuple[float, ...]:
    try:
        return tuple(float(number) for number in text.split(","))
    except ValueError:
        raise SettingsError(f"{option} {text!r}: give numbers, separated by commas") from None


def _pairs(assignments: list[str]) -> dict[str, Any]:
    """Settings given as NAME=VALUE; values are JSON where they can be, else text."""
    values: dict[str, Any] = {}
    for assignment in assignments:
        name, equals, value = assignment.partition("=")
        if not equals:
            raise SettingsError(f"--set {assignment!r}: write it as NAME=VALUE")
        try:
            values[name.strip()] = json.loads(value)
        except json.JSONDecodeError:
            values[name.strip()] = value
    return values


def _print_json(value: Any) -> None:
    from ebamcheck.store import plain

    # ASCII alone, so that it is valid JSON under every encoding of the terminal.
    print(json.dumps(plain(value), indent=2, sort_keys=True, allow_nan=False))


def _add_plugin_commands() -> None:
    """Add the commands of installed wings (entry point group ``ebamcheck.commands``)."""
    from importlib.metadata import entry_points

    for point in entry_points(group="ebamcheck.commands"):
        try:
            command(point.name)(point.load())
        except Exception as error:
            print(f"ebamcheck: warning: command {point.name!r} was left out: {error}", file=sys.stderr)


def main() -> None:
    """Entry point of the program; ``--debug`` may stand anywhere."""
    if "--debug" in sys.argv:
        sys.argv.remove("--debug")
        sys.argv.insert(1, "--debug")
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            # A name that the terminal's encoding cannot show is no reason to fail.
            stream.reconfigure(errors="backslashreplace")
    signal.signal(signal.SIGTERM, _terminate)
    _add_plugin_commands()
    try:
        sys.exit(app(standalone_mode=False))
    except (typer.Abort, KeyboardInterrupt):
        sys.exit(ExitCode.INTERRUPTED)
    except Exception as error:
        # Wrong usage, told by the parser of the command line.
        if not hasattr(error, "format_message"):
            raise
        if len(sys.argv) == 1:
            print(error.format_message(), file=sys.stderr)
        else:
            _tell(f"error: {error.format_message()} (see `{_command_path(error)} --help`)")
        sys.exit(ExitCode.USAGE)


def _command_path(error: Exception) -> str:
    context = getattr(error, "ctx", None)
    return context.command_path if context is not None else "ebamcheck"


def _terminate(*_: object) -> None:
    """End on SIGTERM as on Ctrl-C: workers are ended and temporary files go."""
    raise KeyboardInterrupt

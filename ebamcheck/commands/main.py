"""The command line. Every command is a thin skin over the Python interface."""

from __future__ import annotations

import io
import logging
import os
import signal
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer

from ebamcheck import __version__
from ebamcheck.commands.command_group import CommandGroup, guarded, tell
from ebamcheck.commands.config import config_command
from ebamcheck.commands.inspect import inspect
from ebamcheck.commands.options import (
    DEFAULT_CONFIG,
    BackendsOption,
    ConfigOption,
    DirectionOption,
    FixOption,
    ForceOption,
    JobPart,
    JsonOption,
    LayerHeightOption,
    PartArgument,
    PlaceOption,
    PlateOption,
    ResumeOption,
    RotateOption,
    RunFolderOption,
    UnitsOption,
    WitnessesOption,
    YesOption,
    assignments,
    begun,
    job_settings,
    loaded,
    numbers,
    part_or_plate,
    placed_settings,
    print_json,
    settings_of,
    within_work,
)
from ebamcheck.commands.warm_command import warm_command
from ebamcheck.errors import ExitCode, NothingCompared, SettingsError

if TYPE_CHECKING:
    from ebamcheck.pipeline import RunResult

app = typer.Typer(
    name="ebamcheck",
    cls=CommandGroup,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    epilog="Examples: ebamcheck run blade.stl -o blade.run; ebamcheck --install-completion",
    help="Slice a part with independent slicers, prove that they agree, and write a validated NC program.\n\n"
    "Exit codes: 0 pass, 1 out of tolerance, 2 usage, configuration or unreadable input, 3 internal error, "
    "4 a required backend is missing, 5 nothing compared, 130 interrupted.",
)

SLICE_SUFFIXES = (".parquet", ".cli", ".svg")
"""Formats that `ebamcheck slice` writes; looked at before the work, not after it."""

_Command = TypeVar("_Command", bound=Callable[..., Any])


def command(
    name: str | None = None, compiles: bool = False, **options: Any
) -> Callable[[_Command], _Command]:
    """Register a command whose errors become one line and an exit code; `compiles` has it tell of kernels."""

    def register(function: _Command) -> _Command:
        app.command(name, **options)(guarded(function, compiles))
        return function

    return register


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
    part: JobPart = None,
    plate: PlateOption = None,
    config: ConfigOption = None,
    output: RunFolderOption = None,
    layer_height: LayerHeightOption = None,
    backends: BackendsOption = "",
    witnesses: WitnessesOption = "",
    reference: Annotated[Path | None, typer.Option(help="A finer tessellation of the same part.")] = None,
    units: UnitsOption = "",
    direction: DirectionOption = "",
    place: PlaceOption = "",
    rotate: RotateOption = None,
    fix_orientation: FixOption = False,
    from_layer: Annotated[
        int,
        typer.Option(min=1, help="Write a program that begins at this layer, too: to go on after a break."),
    ] = 1,
    yes: YesOption = False,
    resume: ResumeOption = False,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> ExitCode:
    """Look at the part, slice, cross-check, fit, partition, order, write the NC program, verify it and report."""
    settings = job_settings(config, units, direction, layer_height, backends, witnesses, fix_orientation)
    settings, source = placed_settings(settings, place, rotate), part_or_plate(part, plate)
    part_ready = begun(source, settings, "run", yes)
    from ebamcheck.commands.progress import watched
    from ebamcheck.pipeline import run_job

    target = output or Path(f"{source.stem}.run")
    with watched() as observer:
        result = run_job(
            source,
            target,
            settings,
            reference,
            resume,
            observer,
            part_ready,
            force=force,
            from_layer=from_layer,
        )
    return _told(result, as_json)


@command(epilog="Example: ebamcheck check blade.stl --layer-height 0.2 --witnesses all -o blade.run")
def check(
    part: JobPart = None,
    plate: PlateOption = None,
    config: ConfigOption = None,
    output: RunFolderOption = None,
    layer_height: LayerHeightOption = None,
    backends: BackendsOption = "",
    witnesses: WitnessesOption = "",
    units: UnitsOption = "",
    direction: DirectionOption = "",
    place: PlaceOption = "",
    rotate: RotateOption = None,
    fix_orientation: FixOption = False,
    yes: YesOption = False,
    resume: ResumeOption = False,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> ExitCode:
    """Slice with every backend and compare all pairs on every layer; as `run`, without a program."""
    settings = job_settings(config, units, direction, layer_height, backends, witnesses, fix_orientation)
    settings, source = placed_settings(settings, place, rotate), part_or_plate(part, plate)
    part_ready = begun(source, settings, "check", yes)
    from ebamcheck.commands.progress import watched
    from ebamcheck.pipeline import check_job

    with watched() as observer:
        folder = output or Path(f"{source.stem}.run")
        result = check_job(source, folder, settings, resume, observer, part_ready, force=force)
    return _told(result, as_json)


def _told(result: RunResult, as_json: bool) -> ExitCode:
    """Tell what a job came to."""
    from ebamcheck.commands.summaries import run_summary

    if as_json:
        print_json(result.manifest)
    else:
        print(run_summary(result.manifest))
        report = result.folder.path / "report.html"
        print(f"\nrun folder: {result.folder.path}" + (f"\nreport:     {report}" if report.is_file() else ""))
    return result.exit_code


command(compiles=True, epilog="Example: ebamcheck inspect part.stl --regions --picture regions.svg")(inspect)


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
    yes: YesOption = False,
) -> ExitCode:
    """Slice a part with one backend and write its layers."""
    from ebamcheck.slicers.worker_pool import Crew

    if output.suffix.lower() not in SLICE_SUFFIXES:
        raise SettingsError(
            f"{output}: unknown slice format {output.suffix!r}: use {', '.join(SLICE_SUFFIXES)}"
        )
    # The worker's interpreter comes up while this one does, and while the part is read.
    with Crew(ahead=1) as crew:
        from ebamcheck.commands.progress import announced
        from ebamcheck.layers.cuts import heights_within
        from ebamcheck.layers.heights import layer_heights
        from ebamcheck.plugins import registry
        from ebamcheck.slicers.isolation import Limits
        from ebamcheck.slicers.slicing import slice_to_file

        settings = settings_of(config, units, direction, layer_height)
        name = backend or settings.slicing.primary or registry.default_backend()
        values = {**settings.slicing.settings.get(name, {}), **assignments(setting or [])}
        registry.slicer_settings(name, values)
        with announced():
            placed = loaded(part, settings)
            wanted = (
                heights_within(placed, numbers(heights, "--heights"), "--heights")
                if heights
                else layer_heights(placed, settings.layer_height_mm)
            )
            within_work(placed, wanted, settings, yes)
            limits = Limits(settings.slicing.time_limit_s, settings.slicing.memory_limit_mb)
            points = settings.slicing.block_points
            made = slice_to_file(placed, wanted, output, name, limits, points, crew, **values)
    print(
        f"{len(wanted)} layers, {made.rings} rings, {made.open_paths} open paths, {made.points} points: {output}"
    )
    return ExitCode.PASS


@command(compiles=True, epilog="Example: ebamcheck compare a.parquet b.parquet --tolerance 0.01")
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
    from ebamcheck.drawing.tables import text_table
    from ebamcheck.layers.files import read_layers

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
        print_json(table.to_dict(orient="records"))
    else:
        rows = table[~table["agrees"]] if not table["agrees"].all() else table.nlargest(10, "depth_mm")
        print(text_table(shown, rows[shown].head(20).itertuples(index=False)))
        print(f"\n{int(table['agrees'].sum())} of {len(table)} layers agree within {tolerance:g} mm")
    return ExitCode.PASS if table["agrees"].all() else ExitCode.OUT_OF_TOLERANCE


@command(epilog="Example: ebamcheck backends --json")
def backends(as_json: JsonOption = False) -> ExitCode:
    """List the slicers: availability, versions, device, rules and error bound; and what is wrong with a plugin."""
    from ebamcheck.commands.summaries import backend_record, backends_text, broken_record
    from ebamcheck.plugins import registry

    with warnings.catch_warnings():
        # What is wrong with a plugin stands in the list.
        warnings.simplefilter("ignore", registry.BrokenPluginWarning)
        registry.forget(kept=True)
        records = [backend_record(name) for name in registry.slicers()]
        left_out = registry.broken_plugins()
    if as_json:
        print_json([*records, *(broken_record(plugin) for plugin in left_out)])
        return ExitCode.PASS
    print(backends_text(records, left_out))
    return ExitCode.PASS


command(name="warm", compiles=True, epilog="Example: ebamcheck warm")(warm_command)


@command(
    compiles=True,
    epilog="Examples: ebamcheck verify blade.run --trusted keys/; "
    "ebamcheck verify blade.run/program/MAIN.MPF --part blade.stl",
)
def verify(
    target: Annotated[Path, typer.Argument(help="A run folder, or a program (with --part).")],
    part: Annotated[
        Path | None,
        typer.Option(help="The part that the program should make; of a run: if it is not where it was."),
    ] = None,
    quick: Annotated[
        bool,
        typer.Option("--quick", help="Of a run: believe its recorded layers and gates, slice nothing anew."),
    ] = False,
    trusted: Annotated[
        list[Path] | None,
        typer.Option(help="Public key, or a folder of them; one must have signed. May be given again."),
    ] = None,
    config: ConfigOption = None,
    layer_height: LayerHeightOption = None,
    units: UnitsOption = "",
    as_json: JsonOption = False,
) -> ExitCode:
    """Work every gate of a finished run out again, or check a program against a part, from the program's text."""
    from ebamcheck.drawing.tables import text_table
    from ebamcheck.pipeline import verify as verification
    from ebamcheck.pipeline.certificate import find_record
    from ebamcheck.pipeline.run_folder import MANIFEST

    # A run has its own settings: a file that lies about does not matter to it, nor to a program in it.
    own = (target / MANIFEST).is_file()
    if not own and target.exists() and not (config or units or layer_height):
        own = find_record(target) is not None
    default = not (config or units or layer_height or DEFAULT_CONFIG.is_file())
    settings = None if own or default else settings_of(config, units, "", layer_height)
    checks = verification.verify(target, part, settings, quick=quick, trusted=trusted or ())
    if as_json:
        print_json([vars(check) for check in checks])
    else:
        rows = [
            ["pass" if c.passed else "FAIL", c.name, c.value, c.limit, c.unit, c.where, c.text]
            for c in checks
        ]
        print(text_table(["", "check", "value", "limit", "unit", "where", ""], rows))
        failed = sum(not c.passed for c in checks)
        print(f"\n{len(checks) - failed} of {len(checks)} checks passed")
    return ExitCode.PASS if all(c.passed for c in checks) else ExitCode.OUT_OF_TOLERANCE


command(
    name="config",
    epilog="Examples: ebamcheck config -o ebamcheck.toml; ebamcheck config --merge ebamcheck.toml",
)(config_command)


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
            tell(f"error: {error.format_message()} (see `{_command_path(error)} --help`)")
        sys.exit(ExitCode.USAGE)


def _command_path(error: Exception) -> str:
    context = getattr(error, "ctx", None)
    return context.command_path if context is not None else "ebamcheck"


def _terminate(*_: object) -> None:
    """End on SIGTERM as on Ctrl-C: workers are ended and temporary files go."""
    raise KeyboardInterrupt

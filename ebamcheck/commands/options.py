"""Options that several commands share, and how their values are read."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar, get_origin, get_type_hints

import typer
from typer import Argument, Option

from ebamcheck.errors import InputError, SettingsError
from ebamcheck.printable import printable

if TYPE_CHECKING:
    from ebamcheck.curves import Curves
    from ebamcheck.kernels import Floats
    from ebamcheck.mesh.part import Part
    from ebamcheck.preflight.report import Ready
    from ebamcheck.scan import ScanPlan
    from ebamcheck.settings.config import Config

Command = TypeVar("Command", bound=Callable[..., Any])
# Settings that are taken where none are named, if there are some in the working folder
DEFAULT_CONFIG = Path("ebamcheck.toml")
# Options and arguments that mean the same in every command, by the names of their parameters
KNOWN: dict[str, Any] = {
    "part": Argument(help="Mesh file: .stl, .obj, .ply or .3mf; or plate.toml."),
    "run": Argument(help="A finished run folder."),
    "plate": "In place of a part: plate.toml, with several parts or copies on one plate.",
    "config_file": "Settings (TOML); default: ./ebamcheck.toml where there is one.",
    "output": "Run folder; default: NAME.run.",
    "layer_height": "Layer height, mm; default: that of one bead of the process.",
    "units": "Unit of the part's file: mm, cm, m, um, in (inch, inches), ft. Default: that of the file where it has one, else mm.",
    "direction": "Slicing direction in the file's coordinates, as X,Y,Z.",
    "place": "Where the middle of the part's box comes to lie, as X,Y; and its lowest point, as X,Y,Z.",
    "rotate": "Turn about the vertical, degrees, counter-clockwise from above.",
    "backends": "Backends to run, comma-separated; default: all of the house that are available.",
    "witnesses": "Outside programs that slice, too, comma-separated; `all`: those installed here.",
    "fix_orientation": "Turn flipped facets and inside-out bodies over.",
    "yes": "Run the job even where it is more work than the settings allow (work.*).",
    "resume": "Go on with a killed job of the same input.",
    "force": "Run even where OUTPUT holds a finished run; that one is moved to a name with its date.",
    "as_json": Option("--json", help="Print JSON instead of a table."),
}


def explained(**given: Any) -> Callable[[Command], Command]:
    """Make options of the parameters of a command that are none yet, each with its help or as given, else as known; a bool is a
    flag."""
    short = {"output": ("-o", "--output"), "config_file": ("-c", "--config")}

    def made(function: Command) -> Command:
        hints = get_type_hints(function, include_extras=True)
        for name in hints.keys() - {"return"}:
            if get_origin(hints[name]) is Annotated:
                continue
            said = given.get(name) or KNOWN[name]
            flag = ("--" + name.replace("_", "-"),) if hints[name] is bool else ()
            option = Option(*short.get(name, flag), help=said) if isinstance(said, str) else said
            hints[name] = Annotated[hints[name], option]
        function.__annotations__ = hints
        return function

    return made


def job_settings(
    config_file: Path | None,
    units: str,
    direction: str,
    layer_height: float | None,
    backends: str,
    witnesses: str,
    fix_orientation: bool,
) -> Config:
    """Settings of a job on this machine, with what the command line says on top."""
    from ebamcheck.settings.stages import for_this_machine

    config = for_this_machine(settings_of(config_file, units, direction, layer_height))
    if backends:
        config = config.changed(slicing={"backends": names(backends)})
    if witnesses:
        config = config.changed(slicing={"witnesses": names(witnesses)})
    return config.changed(part={"fix_orientation": True}) if fix_orientation else config


def settings_of(config_file: Path | None, units: str, direction: str, layer_height: float | None) -> Config:
    """Settings of the file, with what the command line says on top."""
    from ebamcheck.settings.config import load_config

    config = load_config(config_file or (DEFAULT_CONFIG if DEFAULT_CONFIG.is_file() else None))
    if units:
        config = config.changed(part={"units": units})
    if direction:
        config = config.changed(part={"direction": numbers(direction, "--direction")})
    if layer_height is not None:
        config = config.changed(layers={"layer_height_mm": layer_height, "heights_mm": ()})
    return config


def placed_settings(config: Config, place: str, rotate: float | None) -> Config:
    """Settings with the place and the turn of the command line on top."""
    if place:
        config = config.changed(part={"place_at_mm": numbers(place, "--place")})
    return config if rotate is None else config.changed(part={"rotate_deg": rotate})


def part_or_plate(part: Path | None, plate: Path | None) -> Path:
    """File of what is to be built; raises :class:`SettingsError` unless exactly one is given."""
    if (part is None) == (plate is None):
        raise SettingsError("give either the file of a part, or --plate with that of a plate")
    if plate is not None and plate.suffix.lower() != ".toml":
        what = "a plate is a list of parts in TOML: give a file such as plate.toml"
        raise SettingsError(f"--plate {plate}: {what}")
    found = part or plate
    assert found is not None
    return found


def loaded(path: Path, config: Config) -> Part:
    """Part of a file, or of a plate, as the settings read, turn and place it; facets stay as they are."""
    from ebamcheck.mesh.part_source import read_part

    return read_part(path, config.part.model_copy(update={"fix_orientation": False}))[0]


def begun(source: Path, config: Config, job: str, yes: bool) -> Ready:
    """Part of a job that may begin; what the preflight warns of is told before anything else is loaded."""
    from ebamcheck.preflight.report import ready
    from ebamcheck.settings.process_window import checked_window

    if job == "run":
        checked_window(config)
    found = ready(source, config, job, yes)
    found.preflight.stop(job)
    for check in found.preflight.checks:
        if check.level != "pass":
            said = ": ".join(filter(None, (check.level, check.name, check.text, check.remedy)))
            typer.echo(printable(f"ebamcheck: preflight: {said}"), err=True)
    return found


def within_work(part: Part, heights: Floats, config: Config, yes: bool) -> Floats:
    """Heights, once slicing at them is no more work than the settings allow; else :class:`SettingsError`."""
    from ebamcheck.preflight.workload import refuse_work

    refuse_work(part, heights, config, yes)
    return heights


def names(text: str) -> tuple[str, ...]:
    """Names of a list with commas."""
    return tuple(name.strip() for name in text.split(",") if name.strip())


def numbers(text: str, option: str) -> tuple[float, ...]:
    """Numbers of a list with commas; raises :class:`SettingsError` that names the option."""
    try:
        return tuple(float(number) for number in text.split(","))
    except ValueError:
        raise SettingsError(f"{option} {text!r}: give numbers, separated by commas") from None


def assignments(texts: Iterable[str]) -> dict[str, Any]:
    """Settings given as NAME=VALUE; values are JSON where they can be, else text.

    >>> assignments(["pixel_mm=0.1", "mode=literal"])
    {'pixel_mm': 0.1, 'mode': 'literal'}
    """
    values: dict[str, Any] = {}
    for text in texts:
        name, equals, value = text.partition("=")
        if not (name.strip() and equals):
            raise SettingsError(f"--set {text!r}: write it as NAME=VALUE")
        try:
            values[name.strip()] = json.loads(value)
        except ValueError:
            values[name.strip()] = value
    return values


def print_json(value: Any) -> None:
    """Print a value as JSON with sorted keys."""
    from ebamcheck.json_values import plain

    # ASCII alone, so that it is valid JSON under every encoding of the terminal.
    typer.echo(json.dumps(plain(value), indent=2, sort_keys=True, allow_nan=False))


def stack_of_run(folder: Path, config_file: Path | None) -> tuple[Config, Curves, ScanPlan, str]:
    """Settings, paths of the contour beads, scan plan and part's hash of a finished run; other settings only where a file names
    them."""
    from ebamcheck.curves import Curves
    from ebamcheck.record.run_folder import MANIFEST, RunFolder
    from ebamcheck.scan import ScanPlan
    from ebamcheck.settings.config import validated

    manifest = RunFolder(folder).manifest()
    if config_file is not None:
        config = settings_of(config_file, "", "", None)
    else:
        config = validated(manifest["settings"], MANIFEST)
    beads, plan = folder / "beads.parquet", folder / "scan.parquet"
    if not beads.is_file() or not plan.is_file():
        raise InputError(f"{folder}: has no bead paths: make it with `ebamcheck run`, not `check`")
    sha256 = str(manifest["part"]["sha256"])
    return config, Curves.from_parquet(beads), ScanPlan.from_parquet(plan), sha256

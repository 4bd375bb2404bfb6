"""Options that commands share, and what their texts mean."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ebamcheck.errors import SettingsError

if TYPE_CHECKING:
    from ebamcheck.mesh.part import Part
    from ebamcheck.settings.config import Config

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

RunFolderOption = Annotated[
    Path | None, typer.Option("-o", "--output", help="Run folder; default: NAME.run.")
]
BackendsOption = Annotated[
    str, typer.Option(help="Backends to run, comma-separated; default: all of the house that are available.")
]
WitnessesOption = Annotated[
    str, typer.Option(help="Outside programs that slice, too, comma-separated; `all`: those installed here.")
]
FixOption = Annotated[
    bool, typer.Option("--fix-orientation", help="Turn flipped facets and inside-out bodies over.")
]
ResumeOption = Annotated[bool, typer.Option("--resume", help="Go on with a killed job of the same input.")]


def job_settings(
    config: Path | None,
    units: str,
    direction: str,
    layer_height: float | None,
    backends: str,
    witnesses: str,
    fix_orientation: bool,
) -> Config:
    """Settings of a job on this machine, with what the command line says on top."""
    from ebamcheck.settings.machines import for_this_machine

    settings = for_this_machine(settings_of(config, units, direction, layer_height))
    if backends:
        settings = settings.changed(slicing={"backends": names(backends)})
    if witnesses:
        settings = settings.changed(slicing={"witnesses": names(witnesses)})
    return settings.changed(part={"fix_orientation": True}) if fix_orientation else settings


def settings_of(config: Path | None, units: str, direction: str, layer_height: float | None) -> Config:
    """Settings of the file, with what the command line says on top."""
    from ebamcheck.settings.config import load_config

    default = Path("ebamcheck.toml")
    settings = load_config(config or (default if default.is_file() else None))
    if units:
        settings = settings.changed(part={"units": units})
    if direction:
        settings = settings.changed(part={"direction": numbers(direction, "--direction")})
    if layer_height is not None:
        settings = settings.changed(layers={"layer_height_mm": layer_height, "heights_mm": ()})
    return settings


def loaded(path: Path, settings: Config) -> Part:
    """Part of a file in the unit and along the direction of the settings."""
    from ebamcheck.mesh.files import load

    return load(path, settings.part.units).along(settings.part.direction)


def names(text: str) -> tuple[str, ...]:
    """Names of a list with commas."""
    return tuple(name.strip() for name in text.split(",") if name.strip())


def numbers(text: str, option: str) -> tuple[float, ...]:
    """Numbers of a list with commas; raises :class:`SettingsError` that names the option."""
    try:
        return tuple(float(number) for number in text.split(","))
    except ValueError:
        raise SettingsError(f"{option} {text!r}: give numbers, separated by commas") from None


def assignments(assignments: list[str]) -> dict[str, Any]:
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


def print_json(value: Any) -> None:
    """Print a value as JSON with sorted keys."""
    from ebamcheck.pipeline.run_folder import plain

    # ASCII alone, so that it is valid JSON under every encoding of the terminal.
    typer.echo(json.dumps(plain(value), indent=2, sort_keys=True, allow_nan=False))

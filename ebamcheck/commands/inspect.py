"""``ebamcheck inspect PART``: the defects of a part, and the surfaces that the curves see."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ebamcheck.commands.options import (
    ConfigOption,
    JsonOption,
    PartArgument,
    UnitsOption,
    print_json,
    settings_of,
)
from ebamcheck.errors import ExitCode, SettingsError

if TYPE_CHECKING:
    from ebamcheck.curves.regions.surfaces import Surface


def inspect(
    part: PartArgument,
    units: UnitsOption = "",
    regions: Annotated[
        bool,
        typer.Option("--regions", help="List the surfaces that the curves see: planes, cylinders, freeform."),
    ] = False,
    picture: Annotated[
        Path | None, typer.Option(help="Draw the surfaces into FILE.svg; with --regions.")
    ] = None,
    config_file: ConfigOption = None,
    as_json: JsonOption = False,
) -> ExitCode:
    """Count the defects of a part and judge whether it can be sliced; exit code 1 where it should not."""
    from ebamcheck.mesh.inspection import inspect as inspect_part
    from ebamcheck.mesh.part_source import read_part
    from ebamcheck.settings.base import unit_named
    from ebamcheck.settings.checking import checked
    from ebamcheck.settings.stages import PartSettings

    if picture is not None and (not regions or picture.suffix.lower() != ".svg"):
        raise SettingsError(f"--picture {picture}: it draws regions as SVG; give --regions and FILE.svg")
    loaded_part, _ = read_part(
        part, checked(PartSettings, {"units": unit_named(units)} if units else {}, "--units")
    )
    found = inspect_part(loaded_part)
    listed: list[Surface] = []
    if regions:
        from ebamcheck.curves.regions.surfaces import surfaces
        from ebamcheck.drawing.regions import regions_svg

        listed = surfaces(loaded_part, settings_of(config_file, "", "", None).curves)
        if picture is not None:
            picture.write_text(regions_svg(loaded_part, listed), encoding="utf-8")
    if as_json:
        figures = found.as_dict()
        print_json({**figures, "regions": [s.as_dict() for s in listed]} if regions else figures)
    else:
        figures = found.as_dict()
        for key in ("name", "verdict", "why", "notes", "passed", "relations", "union_known", "units_from"):
            figures.pop(key)
        figures["size_mm"] = " x ".join(f"{s:.6g}" for s in found.size_mm)
        figures["units"] = f"{found.units} ({found.units_from})"
        figures["lower_mm"] = ", ".join(f"{s:.6g}" for s in found.lower_mm)
        for key, value in figures.items():
            typer.echo(
                f"{key.replace('_', ' '):20} {value:.9g}"
                if isinstance(value, float)
                else f"{key.replace('_', ' '):20} {value}"
            )
        for relation in found.relations:
            typer.echo(f"{'warning' if relation.lost else 'bodies':20} {relation.text}")
        if not found.union_known:
            typer.echo(f"{'warning':20} the volume is the sum of all bodies, which may overlap")
        for note in found.notes:
            typer.echo(f"{'note':20} {note}")
        typer.echo(f"{'verdict':20} {found.verdict}: {found.why}")
        if regions:
            from ebamcheck.curves.regions.surfaces import table

            typer.echo(f"\n{table(listed)}")
    return ExitCode.PASS if found.passed else ExitCode.OUT_OF_TOLERANCE

"""``ebamcheck slice``, ``compare`` and ``inspect``: one backend, two files of layers, and the defects of a part."""

from __future__ import annotations

import logging
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Argument, Option

from ebamcheck.atomic_file import made_folder
from ebamcheck.commands import options
from ebamcheck.errors import ExitCode, NothingCompared, SettingsError
from ebamcheck.showing.short_text import counted

if TYPE_CHECKING:
    from ebamcheck.surface.surfaces import Surface

_log = logging.getLogger(__name__)


@options.explained(
    output="FILE.parquet, .cli (Common Layer Interface), .svg, .dxf, .vtp, .3mf or .csv.",
    backend="Backend; default: the available exact one of the highest priority.",
    heights="Listed heights, mm, comma-separated, instead of uniform layers.",
    setting=Option("--set", help="Backend setting NAME=VALUE; repeatable."),
)
def slice_command(
    part: Path,
    output: Path,
    backend: str = "",
    layer_height: float | None = None,
    heights: str = "",
    setting: list[str] | None = None,
    config_file: Path | None = None,
    units: str = "",
    direction: str = "",
    yes: bool = False,
) -> ExitCode:
    """Slice a part with one backend and write its layers."""
    from ebamcheck.layers.files import format_of
    from ebamcheck.plugins import registry

    # A wrong name of the file is told before the work, not after it.
    format_of(output)
    made_folder(output.parent)

    config = options.settings_of(config_file, units, direction, layer_height)
    name = backend or config.slicing.primary or registry.default_backend()
    values = {**config.slicing.settings.get(name, {}), **options.assignments(setting or [])}
    registry.slicer_settings(name, values)
    with ExitStack() as opened:
        from ebamcheck.slicers.cutting import may_run_here

        pool = None
        if not may_run_here(name):
            from ebamcheck.slicers.isolation import WorkerPool

            # The worker's interpreter comes up while the part is read.
            pool = opened.enter_context(WorkerPool([name]))
        from ebamcheck.layers.heights import heights_within, layer_heights
        from ebamcheck.slicers.outcome import Limits
        from ebamcheck.slicers.slicing import slice_to_file

        placed = options.loaded(part, config)
        if heights:
            wanted = heights_within(placed, options.numbers(heights, "--heights"), "--heights")
        else:
            wanted = layer_heights(placed, config.layer_height_mm)
        options.within_work(placed, wanted, config, yes)
        slicing = config.slicing
        limits = Limits(slicing.time_limit_s, slicing.memory_limit_mb)
        made = slice_to_file(placed, wanted, output, name, limits, slicing.block_points, pool, **values)
    if made.open_paths or not made.rings:
        what = "has open paths" if made.open_paths else "has no contour on any layer"
        _log.warning("%s %s: `ebamcheck inspect` tells whether its mesh is open or inside out", part, what)
    counts = {"layer": len(wanted), "ring": made.rings, "open path": made.open_paths, "point": made.points}
    print(f"{', '.join(counted(number, one) for one, number in counts.items())}: {output}")
    return ExitCode.PASS


@options.explained(
    a=Argument(help="Layers of one slicer (.parquet, .cli, .svg, .dxf, .vtp, .3mf or .csv)."),
)
def compare(
    a: Path,
    b: Annotated[Path, Argument(help="Layers of another, at the same heights.")],
    tolerance: Annotated[float, Option(help="Depth of the symmetric difference allowed, mm.")] = 0.001,
    output: Annotated[Path | None, Option("-o", "--output", help="Write the table as CSV.")] = None,
    any_part: Annotated[bool, Option("--any-part", help="Compare slices of different parts, too.")] = False,
    as_json: bool = False,
) -> ExitCode:
    """Compare two slice files layer by layer; exit code 1 where they differ by more than the tolerance."""
    import numpy as np

    from ebamcheck.atomic_file import replacing
    from ebamcheck.comparison import compare as compare_layers
    from ebamcheck.comparison.pairwise import check_comparable
    from ebamcheck.layers.files import read_layers
    from ebamcheck.printable import numbered
    from ebamcheck.showing.short_text import text_table

    if not tolerance >= 0.0:
        raise SettingsError(f"--tolerance {tolerance}: give 0 or a positive number of millimetres")
    one, other = read_layers(a), read_layers(b)
    # Formats with 32-bit numbers may round heights by so much, over a metre.
    if len(one) == len(other) and np.allclose(one.heights, other.heights, rtol=0.0, atol=1e-4):
        other = replace(other, heights=one.heights)
    if one.part and other.part and one.part != other.part and not any_part:
        raise SettingsError(f"{a} and {b} are of different parts: give slices of one part, or --any-part")
    check_comparable({str(a): one, str(b): other}, check_part=False)
    table = numbered(compare_layers(one, other, tolerance_mm=tolerance, check_part=False))
    if not len(table):
        raise NothingCompared(f"{a} and {b} hold no layers: nothing was compared")
    if output is not None:
        with replacing(output) as temporary:
            table.to_csv(temporary, index=False)
    areas = ("area_difference_mm2", "symmetric_difference_mm2")
    shown = ["layer", "height_mm", *areas, "iou", "hausdorff_mm", "depth_mm", "agrees"]
    if as_json:
        options.print_json(table.to_dict(orient="records"))
    else:
        rows = table[~table["agrees"]] if not table["agrees"].all() else table.nlargest(10, "depth_mm")
        print(text_table(shown, rows[shown].head(20).itertuples(index=False)))
        print(f"\n{int(table['agrees'].sum())} of {len(table)} layers agree within {tolerance:g} mm")
    return ExitCode.PASS if table["agrees"].all() else ExitCode.OUT_OF_TOLERANCE


@options.explained(
    regions="List the surfaces that the curves see: planes, cylinders, freeform.",
)
def inspect(
    part: Path,
    units: str = "",
    regions: bool = False,
    picture: Annotated[Path | None, Option(help="Draw the surfaces into FILE.svg; with --regions.")] = None,
    config_file: Path | None = None,
    as_json: bool = False,
) -> ExitCode:
    """Count the defects of a part and judge whether it can be sliced; exit code 1 where it should not."""
    from ebamcheck.mesh.inspection import inspect as inspect_part
    from ebamcheck.mesh.part_source import read_part
    from ebamcheck.settings.base import unit_named
    from ebamcheck.settings.checking import checked
    from ebamcheck.settings.stages import PartSettings

    if picture is not None and (not regions or picture.suffix.lower() != ".svg"):
        raise SettingsError(f"--picture {picture}: it draws regions as SVG; give --regions and FILE.svg")
    given = {"units": unit_named(units)} if units else {}
    loaded_part, _ = read_part(part, checked(PartSettings, given, "--units"))
    found = inspect_part(loaded_part)
    listed: list[Surface] = []
    if regions:
        from ebamcheck.showing.pictures import regions_svg
        from ebamcheck.surface.surfaces import surfaces, table

        listed = surfaces(loaded_part, options.settings_of(config_file, "", "", None).curves)
        if picture is not None:
            kinds = [(surface.kind, surface.facets) for surface in listed]
            drawn = regions_svg(loaded_part.triangles, kinds, f"Regions of {loaded_part.name}")
            picture.write_text(drawn, encoding="utf-8")
    figures = found.as_dict()
    if as_json:
        options.print_json({**figures, "regions": [s.as_dict() for s in listed]} if regions else figures)
    else:
        for key in ("name", "verdict", "why", "notes", "passed", "relations", "union_known", "units_from"):
            figures.pop(key)
        figures["size_mm"] = " x ".join(f"{s:.6g}" for s in found.size_mm)
        figures["units"] = f"{found.units} ({found.units_from})"
        figures["lower_mm"] = ", ".join(f"{s:.6g}" for s in found.lower_mm)
        for key, value in figures.items():
            typer.echo(f"{key.replace('_', ' '):20} {f'{value:.9g}' if isinstance(value, float) else value}")
        for relation in found.relations:
            typer.echo(f"{'warning' if relation.lost else 'bodies':20} {relation.text}")
        if not found.union_known:
            typer.echo(f"{'warning':20} the volume is the sum of all bodies, which may overlap")
        for note in found.notes:
            typer.echo(f"{'note':20} {note}")
        typer.echo(f"{'verdict':20} {found.verdict}: {found.why}")
        if regions:
            typer.echo(f"\n{table(listed)}")
    return ExitCode.PASS if found.passed else ExitCode.OUT_OF_TOLERANCE

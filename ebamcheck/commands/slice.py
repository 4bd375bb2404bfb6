"""``ebamcheck slice``: one backend, one file of layers."""

from __future__ import annotations

import logging
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import typer

from ebamcheck.atomic_file import made_folder
from ebamcheck.commands.options import (
    ConfigOption,
    DirectionOption,
    LayerHeightOption,
    PartArgument,
    UnitsOption,
    YesOption,
    assignments,
    loaded,
    numbers,
    settings_of,
    within_work,
)
from ebamcheck.errors import ExitCode
from ebamcheck.showing.short_text import counted

_log = logging.getLogger(__name__)


def slice_command(
    part: PartArgument,
    output: Annotated[
        Path,
        typer.Option(
            "-o",
            "--output",
            help="FILE.parquet, .cli (Common Layer Interface), .svg, .dxf, .vtp, .3mf or .csv.",
        ),
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
    config_file: ConfigOption = None,
    units: UnitsOption = "",
    direction: DirectionOption = "",
    yes: YesOption = False,
) -> ExitCode:
    """Slice a part with one backend and write its layers."""
    from ebamcheck.layers.files import format_of
    from ebamcheck.plugins import registry

    # A wrong name of the file is told before the work, not after it.
    format_of(output)
    made_folder(output.parent)

    config = settings_of(config_file, units, direction, layer_height)
    name = backend or config.slicing.primary or registry.default_backend()
    values = {**config.slicing.settings.get(name, {}), **assignments(setting or [])}
    registry.slicer_settings(name, values)
    from ebamcheck.numeric.compiling_beside import SLICING, compiled_beside

    own = registry.points(registry.BACKENDS)[name].module
    with compiled_beside(modules=(*SLICING, own)), ExitStack() as opened:
        from ebamcheck.slicers.cutting import may_run_here

        pool = None
        if not may_run_here(name):
            from ebamcheck.slicers.worker_pool import WorkerPool

            # The worker's interpreter comes up while the part is read.
            pool = opened.enter_context(WorkerPool([name]))
        from ebamcheck.commands.progress import announced
        from ebamcheck.layers.heights import heights_within, layer_heights
        from ebamcheck.slicers.outcome import Limits
        from ebamcheck.slicers.slicing import slice_to_file

        with announced():
            placed = loaded(part, config)
            wanted = (
                heights_within(placed, numbers(heights, "--heights"), "--heights")
                if heights
                else layer_heights(placed, config.layer_height_mm)
            )
            within_work(placed, wanted, config, yes)
            limits = Limits(config.slicing.time_limit_s, config.slicing.memory_limit_mb)
            points = config.slicing.block_points
            made = slice_to_file(placed, wanted, output, name, limits, points, pool, **values)
    if made.open_paths or not made.rings:
        what = "has open paths" if made.open_paths else "has no contour on any layer"
        _log.warning("%s %s: `ebamcheck inspect` tells whether its mesh is open or inside out", part, what)
    counts = [
        counted(number, one)
        for number, one in (
            (len(wanted), "layer"),
            (made.rings, "ring"),
            (made.open_paths, "open path"),
            (made.points, "point"),
        )
    ]
    print(f"{', '.join(counts)}: {output}")
    return ExitCode.PASS

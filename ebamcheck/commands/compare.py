"""``ebamcheck compare``: two files of layers, layer by layer."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from ebamcheck.commands.options import (
    JsonOption,
    print_json,
)
from ebamcheck.errors import ExitCode, NothingCompared, SettingsError

HEIGHT_ROUNDING_MM = 1e-4
"""What formats with 32-bit numbers may round heights by, over a metre; a tenth of the default tolerance on a slope of 45 degrees."""


def compare(
    a: Annotated[
        Path, typer.Argument(help="Layers of one slicer (.parquet, .cli, .svg, .dxf, .vtp, .3mf or .csv).")
    ],
    b: Annotated[Path, typer.Argument(help="Layers of another, at the same heights.")],
    tolerance: Annotated[float, typer.Option(help="Depth of the symmetric difference allowed, mm.")] = 0.001,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="Write the table as CSV.")] = None,
    any_part: Annotated[
        bool, typer.Option("--any-part", help="Compare slices of different parts, too.")
    ] = False,
    as_json: JsonOption = False,
) -> ExitCode:
    """Compare two slice files layer by layer; exit code 1 where they differ by more than the tolerance."""
    import numpy as np

    from ebamcheck.atomic_file import replacing
    from ebamcheck.comparison import compare as compare_layers
    from ebamcheck.comparison.pairwise import check_comparable
    from ebamcheck.drawing.tables import text_table
    from ebamcheck.layer_numbers import numbered
    from ebamcheck.layers.files import read_layers

    if not tolerance >= 0.0:
        raise SettingsError(f"--tolerance {tolerance}: give 0 or a positive number of millimetres")
    one, other = read_layers(a), read_layers(b)
    if len(one) == len(other) and np.allclose(one.heights, other.heights, rtol=0.0, atol=HEIGHT_ROUNDING_MM):
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

"""``ebamcheck polar``: the polar error of one layer of a run, before and after fitting (paper, Figure 11)."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from ebamcheck.atomic_file import replacing
from ebamcheck.commands.options import print_json
from ebamcheck.errors import ExitCode, InputError, SettingsError
from ebamcheck.printable import index_of_number
from ebamcheck.record.run_folder import MANIFEST, RunFolder
from ebamcheck.showing.short_text import text_table


def polar(
    run: Annotated[Path, typer.Argument(help="A run folder that was made with --reference.")],
    layer: Annotated[int | None, typer.Option(help="Layer, counted from 1; default: the middle one.")] = None,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="FILE.html for the chart.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")] = False,
) -> ExitCode:
    """Say how far the largest contour of a layer is from the part, before and after fitting, and draw it.

    Example: ebamcheck polar blade.run --layer 4 -o polar.html
    """
    from ebamcheck_reports.markup import page
    from ebamcheck_reports.run_data import RunData, layer_name
    from ebamcheck_reports.sections.fit import polar_chart, polar_errors, rays_rad

    if not (run / MANIFEST).is_file():
        raise InputError(f"{run}: is no finished run folder: it has no {MANIFEST}")
    if output is not None and output.suffix.lower() != ".html":
        raise SettingsError(f"{output}: give FILE.html")
    data = RunData(RunFolder(run))
    layers, curves, truth = data.primary, data.curves, data.reference
    if layers is None or curves is None or truth is None:
        raise InputError(f"{run}: has no reference to measure against: make it with `ebamcheck run --reference FINE`")
    chosen = data.middle_layer if layer is None else index_of_number(layer, len(layers))
    if chosen is None:
        raise InputError(f"{run}: no layer of it has a contour")
    errors = polar_errors(layers, curves, truth, chosen, rays_rad())
    if errors is None:
        raise SettingsError(f"--layer {chosen + 1}: there is no closed contour on that layer; choose another")
    rows = [_figures(of, error) for of, error in zip(("contour", "curve"), errors, strict=True)]
    name = layer_name(chosen, float(layers.heights[chosen]))
    if output is not None:
        text = page(f"{run.name}: {name}", polar_chart(layers, chosen, errors))
        with replacing(output) as temporary:
            temporary.write_text(text, encoding="utf-8")
    if as_json:
        print_json(rows)
    else:
        typer.echo(f"{name}: polar error of the largest contour\n")
        typer.echo(text_table(list(rows[0]), [list(row.values()) for row in rows]))
    return ExitCode.PASS


def _figures(of: str, error: np.ndarray[tuple[int], np.dtype[np.float64]]) -> dict[str, str | float]:
    """Figures of the paper's section 5.2; rays that meet a contour more than once have no radius."""
    known = error[np.isfinite(error)]
    if not known.size:
        return {"of": of, "rays": 0}
    return {
        "of": of,
        "rays": int(known.size),
        "least, mm": float(known.min()),
        "greatest, mm": float(known.max()),
        "range, mm": float(np.ptp(known)),
        "RMS, mm": float(np.sqrt((known**2).mean())),
        "mean abs., mm": float(np.abs(known).mean()),
    }

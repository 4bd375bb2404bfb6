"""``ebamcheck scan PART --all``: order and heat of all layers, each beginning with what those below have left."""

from __future__ import annotations

import csv
import os
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import typer

from ebamcheck.atomic_file import made_folder
from ebamcheck.commands.options import print_json, within_work
from ebamcheck.commands.progress import watched
from ebamcheck.drawing.tables import text_table
from ebamcheck.errors import ExitCode, interruptible
from ebamcheck.layers.heights import cut_heights
from ebamcheck.layers.stack import Layers
from ebamcheck.mesh.part import Part
from ebamcheck.scan.plan.whole_part import WHOLE_PART, scan_part
from ebamcheck.settings.config import Config
from ebamcheck.slicers.slicing import slice_part

TABLE = "layers.csv"

BUILT = "built_s"
"""Column: time from the start of the build to the end of a layer, with the waits between layers."""


def scan_all(
    part: Part, config: Config, order: str, output: Path | None, as_json: bool, yes: bool
) -> ExitCode:
    """Order all layers of a placed part; rows are written as they are done, so that an interrupt keeps them."""
    layers = slice_part(part, within_work(part, cut_heights(part, config), config, yes))
    rows = _rows(layers, float(part.bounds[0][2]), config, order, output)
    if as_json:
        print_json([{k: None if v != v else v for k, v in row.items()} for row in rows])
        return ExitCode.PASS
    typer.echo(f"{len(rows)} layers in the order {order}, {config.process.base} base\n")
    shown = [*(name for name in WHOLE_PART if name != "stored_j"), BUILT]
    typer.echo(text_table(shown, [[_cell(row[name]) for name in shown] for row in rows]))
    return ExitCode.PASS


def _rows(
    layers: Layers, low_mm: float, config: Config, order: str, output: Path | None
) -> list[dict[str, Any]]:
    """Rows of all layers; also line by line into the table of the output folder."""
    sections = [layers.section(k) for k in range(len(layers))]
    found = scan_part(sections, np.asarray(layers.heights) - low_mm, config, order, config.scan.seed)
    rows: list[dict[str, Any]] = []
    built_s = 0.0
    with closing(found), _table(output) as table, watched() as observer:
        observer.stage("order and heat", len(sections))
        try:
            with interruptible():
                for row in found:
                    row["layer"] += 1
                    built_s += float(np.nansum([row["wait_s"], row["time_s"]]))
                    row[BUILT] = built_s
                    table.writerow(row)
                    rows.append(row)
                    observer.advance(1)
        except KeyboardInterrupt:
            done = len(rows) if output is None else _written(output / TABLE)
            kept = f", kept in {output / TABLE}" if output is not None and done else ""
            raise KeyboardInterrupt(f"{done} of {len(sections)} layers are done{kept}") from None
    return rows


@contextmanager
def _table(output: Path | None) -> Iterator[csv.DictWriter[str]]:
    """Table of the layers in the output folder, a line as soon as it is written; without a folder it is lost."""
    file = os.devnull if output is None else made_folder(output) / TABLE
    with open(file, "w", newline="", encoding="utf-8", buffering=1) as opened:
        writer = csv.DictWriter(opened, [*WHOLE_PART, BUILT])
        writer.writeheader()
        yield writer


def _written(table: Path) -> int:
    """Layers in a table: an interrupt may come between the line of a layer and the count of it."""
    return table.read_bytes().count(b"\n") - 1


def _cell(value: float) -> str:
    return "-" if value != value else f"{value:.6g}" if isinstance(value, int) else f"{value:.1f}"

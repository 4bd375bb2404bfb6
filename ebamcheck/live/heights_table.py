"""Planned, measured and corrected heights of a build, their cusps and deviations: a table that grows with it, and a plot.

Both follow from the journal alone and are written between the layers, after the answer: nobody waits for them.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from ebamcheck.atomic_file import replacing
from ebamcheck.kernels import Floats
from ebamcheck.showing.markup import Markup, element, svg_file, text

TABLE, PLOT = "heights.csv", "heights.svg"

PLOT_EVERY = 20  # the plot is drawn anew after so many layers, and when a server ends or the part is built


@dataclass(frozen=True)
class LaidHeight:
    """One layer that was laid and measured, with heights over the base plate."""

    layer: int  # from 1
    planned_top_mm: float  # when the build began; NaN where it was not planned then
    base_mm: float
    corrected_top_mm: float  # from what it was laid on
    measured_top_mm: float
    deviation_mm: float  # of the measured top over the corrected one
    thickness_mm: float  # as corrected
    grown_mm: float
    cusp_mm: float


def laid_height(
    layer: int, planned_tops_mm: Floats, base_mm: float, top_mm: float, measured_mm: float, cusp_mm: float
) -> LaidHeight:
    """Put together the row of the layer of that index."""
    planned = float(planned_tops_mm[layer]) if layer < len(planned_tops_mm) else float("nan")
    return LaidHeight(
        layer + 1, planned, base_mm, top_mm, measured_mm, measured_mm - top_mm, top_mm - base_mm, measured_mm - base_mm, cusp_mm
    )  # fmt: skip


class HeightsTable:
    """The table of a build in its folder; rows that are added wait until somebody has time to write them."""

    def __init__(self, folder: Path) -> None:
        self._folder, self._waiting, self._written = folder, list[LaidHeight](), 0
        self.add = self._waiting.append

    def write(self, ended: bool = False) -> None:
        """Write the rows that wait, and now and then the plot, a table of before anew; a full disk costs the table, and not the
        build."""
        if self._waiting or (ended and self._written):
            with suppress(OSError):
                self._write(ended)

    def _write(self, ended: bool) -> None:
        names = [field.name for field in fields(LaidHeight)]
        with (self._folder / TABLE).open("a" if self._written else "w", newline="") as file:
            writer = csv.DictWriter(file, names)
            if not self._written:
                writer.writeheader()
            writer.writerows({k: f"{v:.7g}" for k, v in asdict(row).items()} for row in self._waiting)
        before, self._written = self._written, self._written + len(self._waiting)
        self._waiting.clear()
        if ended or self._written // PLOT_EVERY > before // PLOT_EVERY:
            with replacing(self._folder / PLOT) as temporary:
                temporary.write_text(heights_plot(read_heights(self._folder / TABLE)), encoding="utf-8")


def read_heights(path: Path) -> dict[str, Floats]:
    """Columns of a table of heights."""
    with path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    return {field.name: np.array([float(row[field.name]) for row in rows]) for field in fields(LaidHeight)}


WIDTH_PX, PANEL_PX, LEFT_PX, TOP_PX, GAP_PX, RIGHT_PX = 900.0, 170.0, 70.0, 46.0, 58.0, 20.0
# Title of each panel, and its lines: name, column, and the column that is taken off it
PANELS = (
    ("height over the plan of the beginning, mm", (("corrected", "corrected_top_mm", "planned_top_mm"), ("measured", "measured_top_mm", "planned_top_mm"))),
    ("height of the layer, mm", (("corrected", "thickness_mm", ""), ("as grown", "grown_mm", ""))),
    ("cusp and deviation, mm", (("cusp", "cusp_mm", ""), ("deviation", "deviation_mm", ""))),
)  # fmt: skip
LINES = (("#1f77b4", None), ("#d62728", "5 3"))  # colour and dashes of the lines of a panel


def heights_plot(table: dict[str, Floats]) -> str:
    """Draw a table of heights over the layers, one panel under the other; the text of an SVG file."""
    title = f"Heights of {len(table['layer'])} layers: planned, measured, corrected"
    parts = [text(LEFT_PX, 20, title, 14)]
    for k, (name, lines) in enumerate(PANELS):
        columns = {line: table[column] - (table[less] if less else 0.0) for line, column, less in lines}
        parts += _panel(TOP_PX + k * (PANEL_PX + GAP_PX), name, table["layer"], columns)
    return svg_file(WIDTH_PX, TOP_PX + len(PANELS) * (PANEL_PX + GAP_PX), parts, title)


def ticks(low: float, most: float) -> list[float]:
    """Round numbers from `low` to `most`, about five.

    >>> ticks(-0.06, 0.84)
    [0.0, 0.2, 0.4, 0.6, 0.8]
    >>> ticks(1.0, 175.0)
    [50.0, 100.0, 150.0]
    """
    wide = (most - low) / 4.0
    unit = 10.0 ** math.floor(math.log10(wide))
    step = unit * next(factor for factor in (1.0, 2.0, 5.0, 10.0) if factor * unit >= 0.8 * wide)
    first, last = math.ceil(low / step - 1e-9), math.floor(most / step + 1e-9)
    return [round(k * step, 9) + 0.0 for k in range(first, last + 1)]


def _panel(top_px: float, title: str, layer: Floats, columns: dict[str, Floats]) -> Iterator[Markup]:
    values = np.concatenate([column[np.isfinite(column)] for column in columns.values()])
    low, most = (float(values.min()), float(values.max())) if values.size else (0.0, 1.0)
    low, most = (low, most) if most > low else (low - 0.5, low + 0.5)
    wide, last = WIDTH_PX - LEFT_PX - RIGHT_PX, max(float(layer[-1]) if layer.size else 2.0, 2.0)

    def x(value: Any) -> Any:
        return LEFT_PX + wide * (value - 1.0) / (last - 1.0)

    def y(value: Any) -> Any:
        return top_px + PANEL_PX * (most - value) / (most - low)

    yield element("rect", x=LEFT_PX, y=top_px, width=wide, height=PANEL_PX, fill="none", stroke="#777")
    yield text(LEFT_PX, top_px - 6, title, 12)
    for value in ticks(low, most):
        yield text(LEFT_PX - 6, y(value) + 4, f"{value:g}", 12, text_anchor="end")
    for value in sorted({1.0, *(t for t in ticks(1.0, last) if t >= 1.0)}):
        yield text(x(value), top_px + PANEL_PX + 16, f"{value:g}", 12, text_anchor="middle")
    if low < 0.0 < most:
        yield element("path", d=f"M{LEFT_PX:g} {y(0.0):.1f}h{wide:g}", stroke="#bbb")
    for k, (name, column) in enumerate(columns.items()):
        known, at_px = np.isfinite(column), WIDTH_PX - RIGHT_PX - 190.0 + 100.0 * k
        places = zip(x(layer[known]).tolist(), y(column[known]).tolist(), strict=True)
        drawn = {"stroke": LINES[k][0], "stroke_dasharray": LINES[k][1], "fill": "none"}
        yield element("polyline", points=" ".join(f"{a:.1f},{b:.1f}" for a, b in places), **drawn)
        yield element("path", d=f"M{at_px:g} {top_px - 10:g}h20", **drawn)
        yield text(at_px + 24, top_px - 6, name, 12)

"""Planned, measured and corrected heights of a build, their cusps and deviations: a table that grows with it, and a plot.

Both follow from the journal alone and are written between the layers, after the answer: nobody waits for them.
"""

from __future__ import annotations

import csv
import math
from contextlib import suppress
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import numpy as np

from ebamcheck.atomic_file import replacing
from ebamcheck.kernels import Floats

TABLE, PLOT = "heights.csv", "heights.svg"

PLOT_EVERY = 20  # the plot is drawn anew after so many layers, and when a server ends or the part is built


@dataclass(frozen=True)
class LaidHeight:
    """One layer that was laid and measured, from 1, with heights over the base plate.

    Its top as planned when the build began, NaN where it was not planned then; as corrected from what it was laid on; as measured, and how
    far that is over the corrected one; its height as corrected and as grown, and its cusp.
    """

    layer: int
    planned_top_mm: float
    base_mm: float
    corrected_top_mm: float
    measured_top_mm: float
    deviation_mm: float
    thickness_mm: float
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
    """The table of a build in its folder; rows wait until somebody has time to write them."""

    def __init__(self, folder: Path) -> None:
        self._folder, self._waiting, self._written = folder, list[LaidHeight](), 0

    def add(self, row: LaidHeight) -> None:
        """Add a row, to be written later."""
        self._waiting.append(row)

    def write(self, ended: bool = False) -> None:
        """Write the rows that wait, and now and then the plot; a table of before is begun anew.

        A full disk costs the table, and not the build.
        """
        with suppress(OSError):
            self._write(ended)

    def _write(self, ended: bool) -> None:
        if not self._waiting and not (ended and self._written):
            return
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


# -- plot ----------------------------------------------------------------------------------------------

WIDTH_PX, PANEL_PX, LEFT_PX, TOP_PX, GAP_PX, RIGHT_PX = 900.0, 170.0, 70.0, 46.0, 58.0, 20.0

# Title of each panel, and its lines: name, column, and the column that is taken off it
PANELS = (
    ("height over the plan of the beginning, mm", (("corrected", "corrected_top_mm", "planned_top_mm"), ("measured", "measured_top_mm", "planned_top_mm"))),
    ("height of the layer, mm", (("corrected", "thickness_mm", ""), ("as grown", "grown_mm", ""))),
    ("cusp and deviation, mm", (("cusp", "cusp_mm", ""), ("deviation", "deviation_mm", ""))),
)  # fmt: skip

LINES = (("#1f77b4", ""), ("#d62728", "5 3"))  # colour and dashes of the lines of a panel


def heights_plot(table: dict[str, Floats]) -> str:
    """Draw a table of heights over the layers, one panel under the other; the text of an SVG file."""
    high = TOP_PX + len(PANELS) * (PANEL_PX + GAP_PX)
    count = len(table["layer"])
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH_PX:g} {high:g}" font-family="sans-serif" font-size="12">',
        f'<rect width="{WIDTH_PX:g}" height="{high:g}" fill="white"/>',
        f'<text x="{LEFT_PX:g}" y="20" font-size="14">Heights of {count} layers: planned, measured, corrected</text>',
    ]
    for k, (title, lines) in enumerate(PANELS):
        columns = [table[column] - table[less] if less else table[column] for _, column, less in lines]
        parts += _panel(
            TOP_PX + k * (PANEL_PX + GAP_PX), title, [name for name, *_ in lines], table["layer"], columns
        )
    return "\n".join([*parts, "</svg>", ""])


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


def _panel(top_px: float, title: str, names: list[str], layer: Floats, columns: list[Floats]) -> list[str]:
    values = np.concatenate([column[np.isfinite(column)] for column in columns] or [np.zeros(1)])
    low, most = (float(values.min()), float(values.max())) if values.size else (0.0, 1.0)
    low, most = (low, most) if most > low else (low - 0.5, low + 0.5)
    wide, last = WIDTH_PX - LEFT_PX - RIGHT_PX, max(float(layer[-1]) if layer.size else 2.0, 2.0)

    def x(value: float) -> float:
        return LEFT_PX + wide * (value - 1.0) / (last - 1.0)

    def y(value: float) -> float:
        return top_px + PANEL_PX * (most - value) / (most - low)

    parts = [
        f'<rect x="{LEFT_PX:g}" y="{top_px:g}" width="{wide:g}" height="{PANEL_PX:g}" fill="none" stroke="#777"/>',
        f'<text x="{LEFT_PX:g}" y="{top_px - 6:g}">{title}</text>',
    ]
    parts += [
        f'<text x="{LEFT_PX - 6:g}" y="{y(value) + 4:.1f}" text-anchor="end">{value:g}</text>'
        for value in ticks(low, most)
    ]
    parts += [
        f'<text x="{x(value):.1f}" y="{top_px + PANEL_PX + 16:g}" text-anchor="middle">{value:g}</text>'
        for value in sorted({1.0, *(t for t in ticks(1.0, last) if t >= 1.0)})
    ]
    if low < 0.0 < most:
        parts.append(f'<path d="M{LEFT_PX:g} {y(0.0):.1f}h{wide:g}" stroke="#bbb"/>')
    for k, (name, column) in enumerate(zip(names, columns, strict=True)):
        colour, dashes = LINES[k]
        known = np.isfinite(column)
        places = " ".join(
            f"{x(a):.1f},{y(b):.1f}"
            for a, b in zip(layer[known].tolist(), column[known].tolist(), strict=True)
        )
        at_px = WIDTH_PX - RIGHT_PX - 190.0 + 100.0 * k
        parts += [
            f'<polyline points="{places}" fill="none" stroke="{colour}" stroke-dasharray="{dashes}"/>',
            f'<path d="M{at_px:g} {top_px - 10:g}h20" stroke="{colour}" stroke-dasharray="{dashes}"/>',
            f'<text x="{at_px + 24:g}" y="{top_px - 6:g}">{name}</text>',
        ]  # fmt: skip
    return parts

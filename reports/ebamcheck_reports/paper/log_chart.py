"""Charts with two logarithmic axes as inline SVG."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ebamcheck.showing.colours import COLOURS, DASHES
from ebamcheck_reports.charts import BOTTOM_PX, LEFT_PX, RIGHT_PX, TOP_PX, WIDTH_PX, Series
from ebamcheck_reports.markup import DOTS, Markup, element, join, legend

HEIGHT_PX = 420.0
LONE = "#b3261e"
LONE_PX = 14.0
MINOR = (2, 5)
"""Ticks between powers of ten."""


@dataclass(frozen=True)
class _LogAxis:
    """A stretch of a logarithmic axis, in powers of ten, and the pixels of its ends."""

    low: float
    high: float
    start_px: float
    end_px: float

    def px(self, value: float) -> float:
        share = (math.log10(value) - self.low) / (self.high - self.low)
        return self.start_px + share * (self.end_px - self.start_px)

    def ticks(self) -> list[float]:
        powers = range(math.floor(self.low), math.ceil(self.high) + 1)
        values = [m * 10.0**p for p in powers for m in (1, *MINOR)]
        return [v for v in values if self.low - 1e-9 <= math.log10(v) <= self.high + 1e-9]


def log_chart(series: Sequence[Series], alone: Series, x_label: str, y_label: str) -> Markup:
    """Draw series over two logarithmic axes, and one value apart from them as a large dot.

    Values that are not positive, or no numbers, are left out.
    """
    lines = [(s.name, _drawable(s)) for s in series]
    lone = _drawable(alone)
    everything = np.concatenate([*(places for _, places in lines), lone])
    if not len(everything):
        return element("p", "There is nothing to draw.", class_="none")
    low, high = np.log10(everything.min(axis=0)) - 0.12, np.log10(everything.max(axis=0)) + 0.12
    x_axis = _LogAxis(float(low[0]), float(high[0]), LEFT_PX, WIDTH_PX - RIGHT_PX)
    y_axis = _LogAxis(float(low[1]), float(high[1]), HEIGHT_PX - BOTTOM_PX, TOP_PX)
    body = [_grid(x_axis, y_axis), _names(x_label, y_label)]
    body += [_line(places, x_axis, y_axis, n) for n, (_, places) in enumerate(lines)]
    body += [_dot(x_axis.px(x), y_axis.px(y)) for x, y in lone.tolist()]
    svg = element(
        "svg", element("title", f"{y_label} over {x_label}"), *body,
        viewBox=f"0 0 {WIDTH_PX:g} {HEIGHT_PX:g}", class_="chart", role="img",
    )  # fmt: skip
    keys = [(name, COLOURS[n % len(COLOURS)], DASHES[n % len(DASHES)]) for n, (name, _) in enumerate(lines)]
    return join([svg, legend([*keys, (alone.name, LONE, DOTS)])])


def _drawable(series: Series) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    places = np.column_stack([np.asarray(series.x, np.float64), np.asarray(series.y, np.float64)])
    return places[(np.isfinite(places) & (places > 0.0)).all(axis=1)]


def _grid(x_axis: _LogAxis, y_axis: _LogAxis) -> Markup:
    right, bottom = x_axis.end_px, y_axis.start_px
    across = "".join(f"M{LEFT_PX:g},{y_axis.px(t):.1f}H{right:g}" for t in y_axis.ticks())
    up = "".join(f"M{x_axis.px(t):.1f},{bottom:g}V{TOP_PX:g}" for t in x_axis.ticks())
    labels = [
        element("text", f"{t:,.10g}", x=f"{x_axis.px(t):.1f}", y=f"{bottom + 19:g}", text_anchor="middle")
        for t in x_axis.ticks()
    ]
    labels += [
        element("text", f"{t:g}", x=f"{LEFT_PX - 8:g}", y=f"{y_axis.px(t) + 4:.1f}", text_anchor="end")
        for t in y_axis.ticks()
    ]
    return join(
        [
            element("path", d=across + up, stroke="#e3e3e3", fill="none"),
            element("path", d=f"M{LEFT_PX:g},{TOP_PX:g}V{bottom:g}H{right:g}", stroke="#777", fill="none"),
            *labels,
        ]
    )


def _names(x_label: str, y_label: str) -> Markup:
    middle_x, middle_y = 0.5 * (LEFT_PX + WIDTH_PX - RIGHT_PX), 0.5 * (TOP_PX + HEIGHT_PX - BOTTOM_PX)
    return join(
        [
            element("text", x_label, x=f"{middle_x:g}", y=f"{HEIGHT_PX - 6:g}", text_anchor="middle"),
            element(
                "text", y_label, x=14, y=f"{middle_y:g}", text_anchor="middle",
                transform=f"rotate(-90 14 {middle_y:g})",
            ),
        ]
    )  # fmt: skip


def _line(
    places: np.ndarray[tuple[int, int], np.dtype[np.float64]], x_axis: _LogAxis, y_axis: _LogAxis, rank: int
) -> Markup:
    if not len(places):
        return Markup("")
    at = [(x_axis.px(x), y_axis.px(y)) for x, y in places.tolist()]
    colour, dashes = COLOURS[rank % len(COLOURS)], DASHES[rank % len(DASHES)]
    way = "M" + "L".join(f"{x:.1f},{y:.1f}" for x, y in at)
    dots = "".join(f"M{x:.1f},{y:.1f}h0" for x, y in at)
    return join(
        [
            element(
                "path", d=way, fill="none", stroke=colour, stroke_width=2, stroke_dasharray=dashes or None
            ),
            element("path", d=dots, stroke=colour, stroke_width=7, stroke_linecap="round"),
        ]
    )


def _dot(x: float, y: float) -> Markup:
    return element(
        "path", d=f"M{x:.1f},{y:.1f}h0", stroke=LONE, stroke_width=f"{LONE_PX:g}", stroke_linecap="round"
    )

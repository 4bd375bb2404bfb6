"""Charts as inline SVG, small however long their series are: lines over a common axis, and with two logarithmic axes."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ebamcheck.kernels import Floats
from ebamcheck.showing.colours import COLOURS, DASHES
from ebamcheck_reports.markup import DOTS, Markup, element, join, legend

WIDTH_PX, HEIGHT_PX, LOG_HEIGHT_PX = 960.0, 280.0, 420.0
# Room for names and figures, which are twice as large in print and on phones
LEFT_PX, RIGHT_PX, TOP_PX, BOTTOM_PX = 100.0, 16.0, 14.0, 56.0
# Most points of a drawn series, about one per pixel, and of one whose points are marked by dots
MOST_POINTS, FEW_POINTS = 700, 60
RED = "#b3261e"
NOTHING = element("p", "There is nothing to draw.", class_="none")


@dataclass(frozen=True)
class Series:
    """One line of a chart; NaN leaves a gap."""

    name: str
    x: ArrayLike
    y: ArrayLike


@dataclass(frozen=True)
class _Axis:
    """Ends of an axis as they are drawn (in powers of ten if it is logarithmic), its ticks, and the pixels of its ends."""

    low: float
    high: float
    ticks: tuple[float, ...]
    start_px: float
    end_px: float
    scaled: Callable[[Floats | float], Floats | float] = np.asarray

    def px(self, value: Floats | float) -> Floats:
        """Where values lie on the picture; those beyond the ends at the ends."""
        share = np.clip((self.scaled(value) - self.low) / (self.high - self.low), 0.0, 1.0)
        return np.asarray(self.start_px + share * (self.end_px - self.start_px))


# -- linear axes -----------------------------------------------------------------------------------


def line_chart(
    series: Sequence[Series],
    x_label: str,
    y_label: str,
    limit: float | None = None,
    limit_name: str = "limit",
    from_zero: bool = False,
) -> Markup:
    """Draw series over a common axis, each with its own colour and dashes, and a limit across, with a legend below.

    The greatest of the finite values sets the scale, infinite ones are drawn at its top.
    """
    columns = [(np.asarray(s.x, np.float64), np.asarray(s.y, np.float64)) for s in series]
    xs, ys = (np.concatenate([np.zeros(0), *(pair[k] for pair in columns)]) for k in range(2))
    ys = ys[np.isfinite(ys)]
    if not ys.size:
        return NOTHING
    extra = [v for v in (limit, 0.0 if from_zero else None) if v is not None]
    x_axis = _linear(xs.min(), xs.max(), LEFT_PX, WIDTH_PX - RIGHT_PX, tight=True)
    y_axis = _linear(min([ys.min(), *extra]), max([ys.max(), *extra]), HEIGHT_PX - BOTTOM_PX, TOP_PX)
    body = [_grid(x_axis, y_axis), _names(x_label, y_label, HEIGHT_PX, 20)]
    keys = _keys(series)
    if limit is not None:
        across = f"M{LEFT_PX:g},{float(y_axis.px(limit)):.1f}H{WIDTH_PX - RIGHT_PX:g}"
        body.append(element("path", d=across, stroke=RED, stroke_width=1.5, stroke_dasharray="2 3"))
        keys.append((limit_name, RED, "2 3"))
    body += [_line(*thinned(x, y), x_axis, y_axis, n) for n, (x, y) in enumerate(columns)]
    return join([_svg(x_label, y_label, HEIGHT_PX, body), legend(keys)])


def thinned(x: Floats, y: Floats, most: int = MOST_POINTS) -> tuple[Floats, Floats]:
    """Keep the least and greatest value of each stretch of a long series, in their order.

    >>> x, y = thinned(np.arange(10000.0), np.where(np.arange(10000) == 4321, 5.0, 0.0))
    >>> len(x) <= 700, y.max()
    (True, np.float64(5.0))
    """
    if len(x) <= most:
        return x, y
    edges = np.linspace(0, len(x), most // 2 + 1).astype(int)
    filled = np.isfinite(y)
    low, high = np.where(filled, y, np.inf), np.where(filled | np.isposinf(y), y, -np.inf)
    kept = []
    for a, b in itertools.pairwise(edges):
        kept += sorted({a + int(low[a:b].argmin()), a + int(high[a:b].argmax())})
    return x[kept], y[kept]


def _linear(low: float, high: float, start_px: float, end_px: float, tight: bool = False) -> _Axis:
    """Axis of about five steps that ends at ticks, or, if it is tight, where its data end."""
    ends = (low, high)
    if high <= low:
        pad = 0.5 * abs(low) or 0.5
        low, high = low - pad, high + pad
    step = (high - low) / 5
    power = 10.0 ** math.floor(math.log10(step))
    step = next(s * power for s in (1.0, 2.0, 2.5, 5.0, 10.0) if s * power >= step * (1 - 1e-9))
    first, last = math.floor(low / step + 1e-9), math.ceil(high / step - 1e-9)
    ticks = tuple(k * step for k in range(first, last + 1))
    if tight and ends == (low, high):
        return _Axis(low, high, tuple(t for t in ticks if low <= t <= high), start_px, end_px)
    return _Axis(ticks[0], ticks[-1], ticks, start_px, end_px)


def _grid(x_axis: _Axis, y_axis: _Axis) -> Markup:
    bottom, right = HEIGHT_PX - BOTTOM_PX, WIDTH_PX - RIGHT_PX
    rows = [(t, float(y_axis.px(t))) for t in y_axis.ticks]
    columns = [(t, float(x_axis.px(t))) for t in x_axis.ticks]
    across = "".join(f"M{LEFT_PX:g},{y:.1f}H{right:g}" for _, y in rows)
    up = "".join(f"M{x:.1f},{bottom:g}v5" for _, x in columns)
    return join(
        [
            element("path", d=across, stroke="#e3e3e3", fill="none"),
            element("path", d=f"M{LEFT_PX:g},{bottom:g}H{right:g}{up}", stroke="#777", fill="none"),
            *(_row_label(f"{t:.6g}", y) for t, y in rows),
            *(_column_label(f"{t:.6g}", x, bottom + 22) for t, x in columns),
        ]
    )


def _line(x: Floats, y: Floats, x_axis: _Axis, y_axis: _Axis, rank: int) -> Markup:
    data, dots, joined = [], [], False
    for a, b, drawn in zip(x_axis.px(x).tolist(), y_axis.px(y).tolist(), ~np.isnan(y), strict=True):
        if drawn:
            data.append(f"{'L' if joined else 'M'}{a:.1f},{b:.1f}")
            dots.append(f"M{a:.1f},{b:.1f}h0")
        joined = drawn
    # Later lines are thinner, so that none hides another.
    width = max(1.2, 3.0 - 0.4 * rank)
    colour, dashes = COLOURS[rank % len(COLOURS)], DASHES[rank % len(DASHES)]
    line = element(
        "path", d="".join(data) or "M0,0", fill="none", stroke=colour, stroke_width=f"{width:g}",
        stroke_dasharray=dashes or None, stroke_linejoin="round",
    )  # fmt: skip
    return join([line, _dots(dots, colour, width + 2)]) if 0 < len(dots) <= FEW_POINTS else line


# -- logarithmic axes ------------------------------------------------------------------------------


def log_chart(series: Sequence[Series], alone: Series, x_label: str, y_label: str) -> Markup:
    """Draw series over two logarithmic axes, and one value apart from them as a large dot.

    Values that are not positive, or no numbers, are left out.
    """
    lines, lone = [_drawable(s) for s in series], _drawable(alone)
    everything = np.concatenate([*lines, lone])
    if not len(everything):
        return NOTHING
    bottom = LOG_HEIGHT_PX - BOTTOM_PX
    x_axis = _logarithmic(everything[:, 0], LEFT_PX, WIDTH_PX - RIGHT_PX)
    y_axis = _logarithmic(everything[:, 1], bottom, TOP_PX)
    rows = [(t, float(y_axis.px(t))) for t in y_axis.ticks]
    columns = [(t, float(x_axis.px(t))) for t in x_axis.ticks]
    across = "".join(f"M{LEFT_PX:g},{y:.1f}H{WIDTH_PX - RIGHT_PX:g}" for _, y in rows)
    up = "".join(f"M{x:.1f},{bottom:g}V{TOP_PX:g}" for _, x in columns)
    frame = f"M{LEFT_PX:g},{TOP_PX:g}V{bottom:g}H{WIDTH_PX - RIGHT_PX:g}"
    body = [
        element("path", d=across + up, stroke="#e3e3e3", fill="none"),
        element("path", d=frame, stroke="#777", fill="none"),
        *(_column_label(f"{t:,.10g}", x, bottom + 19) for t, x in columns),
        *(_row_label(f"{t:g}", y) for t, y in rows),
        _names(x_label, y_label, LOG_HEIGHT_PX, 14),
    ]
    for n, places in enumerate([*lines, lone]):
        at = [f"{x:.1f},{y:.1f}" for x, y in zip(x_axis.px(places[:, 0]), y_axis.px(places[:, 1]), strict=True)]
        colour, dashes = COLOURS[n % len(COLOURS)], DASHES[n % len(DASHES)]
        dots = [f"M{words}h0" for words in at]
        if n == len(lines):
            body += [_dots([dot], RED, 14.0) for dot in dots]
        elif at:
            line = {"stroke": colour, "stroke_width": 2, "stroke_dasharray": dashes or None}
            body += [element("path", d="M" + "L".join(at), fill="none", **line), _dots(dots, colour, 7)]
    keys = [*_keys(series), (alone.name, RED, DOTS)]
    return join([_svg(x_label, y_label, LOG_HEIGHT_PX, body), legend(keys)])


def _drawable(series: Series) -> Floats:
    places = np.column_stack([np.asarray(series.x, np.float64), np.asarray(series.y, np.float64)])
    return np.asarray(places[(np.isfinite(places) & (places > 0.0)).all(axis=1)])


def _logarithmic(values: Floats, start_px: float, end_px: float) -> _Axis:
    """Axis with some room beside the values and ticks at 1, 2 and 5 times the powers of ten."""
    low, high = float(np.log10(values.min())) - 0.12, float(np.log10(values.max())) + 0.12
    values_ = [m * 10.0**p for p in range(math.floor(low), math.ceil(high) + 1) for m in (1, 2, 5)]
    ticks = tuple(v for v in values_ if low - 1e-9 <= math.log10(v) <= high + 1e-9)
    return _Axis(low, high, ticks, start_px, end_px, np.log10)


# -- pieces of both --------------------------------------------------------------------------------


def _svg(x_label: str, y_label: str, height_px: float, body: Sequence[Markup]) -> Markup:
    title, box = element("title", f"{y_label} over {x_label}"), f"0 0 {WIDTH_PX:g} {height_px:g}"
    return element("svg", title, *body, viewBox=box, class_="chart", role="img")


def _keys(series: Sequence[Series]) -> list[tuple[str, str, str]]:
    return [(s.name, COLOURS[n % len(COLOURS)], DASHES[n % len(DASHES)]) for n, s in enumerate(series)]


def _dots(data: Sequence[str], colour: str, width_px: float) -> Markup:
    return element("path", d="".join(data), stroke=colour, stroke_width=f"{width_px:g}", stroke_linecap="round")


def _row_label(words: str, y_px: float) -> Markup:
    return element("text", words, x=f"{LEFT_PX - 8:g}", y=f"{y_px + 4:.1f}", text_anchor="end")


def _column_label(words: str, x_px: float, y_px: float) -> Markup:
    return element("text", words, x=f"{x_px:.1f}", y=f"{y_px:g}", text_anchor="middle")


def _names(x_label: str, y_label: str, height_px: float, left_px: int) -> Markup:
    x, y = 0.5 * (LEFT_PX + WIDTH_PX - RIGHT_PX), 0.5 * (TOP_PX + height_px - BOTTOM_PX)
    turn = f"rotate(-90 {left_px} {y:g})"
    return join(
        [
            element("text", x_label, x=f"{x:g}", y=f"{height_px - 6:g}", text_anchor="middle"),
            element("text", y_label, x=left_px, y=f"{y:g}", text_anchor="middle", transform=turn),
        ]
    )

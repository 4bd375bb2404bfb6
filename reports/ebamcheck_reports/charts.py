"""Line charts as inline SVG, small however long their series are."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ebamcheck.kernels import Floats
from ebamcheck.showing.colours import COLOURS, DASHES
from ebamcheck_reports.markup import Markup, element, join, legend

WIDTH_PX, HEIGHT_PX = 960.0, 280.0
LEFT_PX, RIGHT_PX, TOP_PX, BOTTOM_PX = 100.0, 16.0, 14.0, 56.0
"""Room for names and figures, which are twice as large in print and on phones."""

MOST_POINTS = 700
"""Most points of a drawn series, about one per pixel; of a longer one, the least and greatest of each stretch are kept."""

FEW_POINTS = 60
"""Most points of a series that are marked by dots."""

TICKS = 5
LIMIT = "#b3261e"


@dataclass(frozen=True)
class Series:
    """One line of a chart; NaN leaves a gap."""

    name: str
    x: ArrayLike
    y: ArrayLike


def line_chart(
    series: Sequence[Series],
    x_label: str,
    y_label: str,
    limit: float | None = None,
    limit_name: str = "limit",
    from_zero: bool = False,
) -> Markup:
    """Draw series over a common axis, each with its own colour and dashes, with a legend below.

    Parameters
    ----------
    series
        Lines; the greatest of the finite values sets the scale, infinite ones are drawn at its top.
    x_label, y_label
        Names of the axes with units.
    limit
        Value at which a line is drawn across.
    limit_name
        What that line is called.
    from_zero
        Start the vertical axis at zero.
    """
    columns = [(np.asarray(s.x, np.float64), np.asarray(s.y, np.float64)) for s in series]
    xs = np.concatenate([x for x, _ in columns]) if columns else np.zeros(0)
    ys = np.concatenate([y for _, y in columns]) if columns else np.zeros(0)
    ys = ys[np.isfinite(ys)]
    if not ys.size:
        return element("p", "There is nothing to draw.", class_="none")
    extra = [v for v in (limit, 0.0 if from_zero else None) if v is not None]
    x_axis = _tight(_axis(xs.min(), xs.max()), xs.min(), xs.max())
    y_axis = _axis(min([ys.min(), *extra]), max([ys.max(), *extra]))
    body = [_grid(x_axis, y_axis), _names(x_label, y_label)]
    if limit is not None:
        body.append(_limit(y_axis, limit))
    for n, (x, y) in enumerate(columns):
        body.append(_line(x, y, x_axis, y_axis, n))
    svg = element(
        "svg", element("title", f"{y_label} over {x_label}"), *body,
        viewBox=f"0 0 {WIDTH_PX:g} {HEIGHT_PX:g}", class_="chart", role="img",
    )  # fmt: skip
    keys = [(s.name, COLOURS[n % len(COLOURS)], DASHES[n % len(DASHES)]) for n, s in enumerate(series)]
    if limit is not None:
        keys.append((limit_name, LIMIT, "2 3"))
    return join([svg, legend(keys)])


def thinned(x: Floats, y: Floats, most: int = MOST_POINTS) -> tuple[Floats, Floats]:
    """Keep the least and greatest value of each stretch of a long series, in their order.

    Examples
    --------
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


@dataclass(frozen=True)
class _Axis:
    low: float
    high: float
    ticks: tuple[float, ...]


def _axis(low: float, high: float) -> _Axis:
    """Round the ends of an axis to its ticks."""
    if high <= low:
        pad = 0.5 * abs(low) or 0.5
        low, high = low - pad, high + pad
    step = (high - low) / TICKS
    power = 10.0 ** math.floor(math.log10(step))
    step = next(s * power for s in (1.0, 2.0, 2.5, 5.0, 10.0) if s * power >= step * (1 - 1e-9))
    first, last = math.floor(low / step + 1e-9), math.ceil(high / step - 1e-9)
    ticks = tuple(k * step for k in range(first, last + 1))
    return _Axis(ticks[0], ticks[-1], ticks)


def _tight(axis: _Axis, low: float, high: float) -> _Axis:
    """End an axis where its data end, with the ticks between."""
    if high <= low:
        return axis
    return _Axis(low, high, tuple(t for t in axis.ticks if low <= t <= high))


def _x(axis: _Axis, value: Floats | float) -> Floats:
    at = (np.asarray(value) - axis.low) / (axis.high - axis.low)
    return np.asarray(LEFT_PX + at * (WIDTH_PX - LEFT_PX - RIGHT_PX))


def _y(axis: _Axis, value: Floats | float) -> Floats:
    at = np.clip((np.asarray(value) - axis.low) / (axis.high - axis.low), 0.0, 1.0)
    return np.asarray(HEIGHT_PX - BOTTOM_PX - at * (HEIGHT_PX - TOP_PX - BOTTOM_PX))


def _grid(x_axis: _Axis, y_axis: _Axis) -> Markup:
    bottom, right = HEIGHT_PX - BOTTOM_PX, WIDTH_PX - RIGHT_PX
    across = "".join(f"M{LEFT_PX:g},{float(_y(y_axis, t)):.1f}H{right:g}" for t in y_axis.ticks)
    up = "".join(f"M{float(_x(x_axis, t)):.1f},{bottom:g}v5" for t in x_axis.ticks)
    parts = [
        element("path", d=across, stroke="#e3e3e3", fill="none"),
        element("path", d=f"M{LEFT_PX:g},{bottom:g}H{right:g}{up}", stroke="#777", fill="none"),
    ]
    parts += [
        element(
            "text", f"{t:.6g}", x=f"{LEFT_PX - 8:g}", y=f"{float(_y(y_axis, t)) + 4:.1f}", text_anchor="end"
        )
        for t in y_axis.ticks
    ]
    parts += [
        element(
            "text", f"{t:.6g}", x=f"{float(_x(x_axis, t)):.1f}", y=f"{bottom + 22:g}", text_anchor="middle"
        )
        for t in x_axis.ticks
    ]
    return join(parts)


def _names(x_label: str, y_label: str) -> Markup:
    middle_x, middle_y = 0.5 * (LEFT_PX + WIDTH_PX - RIGHT_PX), 0.5 * (TOP_PX + HEIGHT_PX - BOTTOM_PX)
    return join(
        [
            element("text", x_label, x=f"{middle_x:g}", y=f"{HEIGHT_PX - 6:g}", text_anchor="middle"),
            element(
                "text",
                y_label,
                x=20,
                y=f"{middle_y:g}",
                text_anchor="middle",
                transform=f"rotate(-90 20 {middle_y:g})",
            ),
        ]
    )


def _limit(axis: _Axis, value: float) -> Markup:
    y = float(_y(axis, value))
    return element(
        "path",
        d=f"M{LEFT_PX:g},{y:.1f}H{WIDTH_PX - RIGHT_PX:g}",
        stroke=LIMIT,
        stroke_width=1.5,
        stroke_dasharray="2 3",
    )


def _line(x: Floats, y: Floats, x_axis: _Axis, y_axis: _Axis, rank: int) -> Markup:
    x, y = thinned(x, y)
    colour, dashes = COLOURS[rank % len(COLOURS)], DASHES[rank % len(DASHES)]
    known = ~np.isnan(y)
    across, up = _x(x_axis, x), _y(y_axis, y)
    data, dots, joined = [], [], False
    for a, b, drawn in zip(across.tolist(), up.tolist(), known.tolist(), strict=True):
        if drawn:
            data.append(f"{'L' if joined else 'M'}{a:.1f},{b:.1f}")
            dots.append(f"M{a:.1f},{b:.1f}h0")
        joined = drawn
    # Later lines are thinner, so that none hides another.
    width = max(1.2, 3.0 - 0.4 * rank)
    line = element(
        "path", d="".join(data) or "M0,0", fill="none", stroke=colour, stroke_width=f"{width:g}",
        stroke_dasharray=dashes or None, stroke_linejoin="round",
    )  # fmt: skip
    if len(dots) > FEW_POINTS or not dots:
        return line
    return join(
        [
            line,
            element(
                "path", d="".join(dots), stroke=colour, stroke_width=f"{width + 2:g}", stroke_linecap="round"
            ),
        ]
    )

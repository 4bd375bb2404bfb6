"""Time over facets, both logarithmic, as a self-contained SVG; what is estimated or cut short looks so."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from benchmarks.figures import cell_times, find, is_scaled, quantity
from ebamcheck.showing.colours import COLOURS, DASHES
from ebamcheck_reports.markup import Markup, element, join
from ebamcheck_reports.paper import published

Raw = Mapping[str, Any]
Kind = Literal["measured", "scaled", "over"]

WIDTH_PX, HEIGHT_PX = 1080.0, 620.0
LEFT_PX, RIGHT_PX, TOP_PX, BOTTOM_PX = 78.0, 300.0, 64.0, 54.0
LABEL_STEP_PX = 17.0
DOT_PX = 4.0
GREY, FRAME, LONE = "#e4e4e4", "#777777", "#b3261e"
HALO = {"paint_order": "stroke", "stroke": "white", "stroke_width": "4"}
"""Keeps words readable where lines pass under them."""
PADDING = 0.12
"""Room at the ends of the axes, in powers of ten."""


@dataclass(frozen=True)
class Point:
    """One figure: seconds at a number of facets, with the least and the greatest."""

    facets: float
    seconds: float
    least: float
    greatest: float
    kind: Kind = "measured"


@dataclass(frozen=True)
class Line:
    """The figures of a method, from small to large."""

    name: str
    points: tuple[Point, ...]


@dataclass(frozen=True)
class _Axis:
    low: float
    high: float
    start_px: float
    end_px: float

    def px(self, value: float) -> float:
        share = (math.log10(value) - self.low) / (self.high - self.low)
        return self.start_px + share * (self.end_px - self.start_px)

    def ticks(self, steps: Sequence[int] = (1, 2, 5)) -> list[float]:
        values = [m * 10.0**p for p in range(math.floor(self.low), math.ceil(self.high) + 1) for m in steps]
        return [v for v in values if self.low <= math.log10(v) <= self.high]


def lines_of(raw: Raw, series: str) -> list[Line]:
    """Lines of all methods of a series that have a figure, or ran over the limit."""
    found = []
    for name in raw["methods"]:
        points = [
            point
            for key, part in raw["parts"].items()
            if part["series"] == series and (point := _point(part["facets"], find(raw["cells"], key, name)))
        ]
        if points:
            found.append(Line(name, tuple(points)))
    return found


def time_chart(lines: Sequence[Line], title: str, subtitle: str) -> str:
    """Draw lines and the paper's own figure; the text of an SVG file."""
    paper = Point(published.FACETS, published.SLICING_S, published.SLICING_S, published.SLICING_S)
    points = [*(p for line in lines for p in line.points), paper]
    x_axis = _axis([p.facets for p in points], LEFT_PX, WIDTH_PX - RIGHT_PX)
    y_axis = _axis([v for p in points for v in (p.least, p.greatest)], HEIGHT_PX - BOTTOM_PX, TOP_PX)
    ends = [(y_axis.px(line.points[-1].seconds), n) for n, line in enumerate(lines)]
    paper_px = y_axis.px(paper.seconds)
    places = dict(zip([n for _, n in [*sorted(ends)]], _apart([y for y, _ in sorted(ends)]), strict=True))
    body = [_grid(x_axis, y_axis), *_titles(title, subtitle)]
    for n, line in enumerate(lines):
        body += _drawn(line, x_axis, y_axis, n)
        body += _label(line, x_axis, y_axis, n, places[n])
    body += _paper(x_axis.px(paper.facets), paper_px)
    svg = element(
        "svg", element("title", f"{title}: time over facets"), element("rect", width="100%", height="100%", fill="white"),
        *body, xmlns="http://www.w3.org/2000/svg", viewBox=f"0 0 {WIDTH_PX:g} {HEIGHT_PX:g}",
        font_family="system-ui, sans-serif", font_size="13",
    )  # fmt: skip
    return f"{svg}\n"


def _point(facets: int, cell: Raw | None) -> Point | None:
    times = cell_times(cell)
    if cell is not None and times is not None:
        kind: Kind = "scaled" if is_scaled(cell) else "measured"
        return Point(facets, times.median, times.least, times.greatest, kind)
    if cell is not None and cell["status"] == "over" and not cell["why"].startswith("not tried"):
        return Point(facets, cell["limit_s"], cell["limit_s"], cell["limit_s"], "over")
    return None


def _axis(values: Sequence[float], start_px: float, end_px: float) -> _Axis:
    return _Axis(math.log10(min(values)) - PADDING, math.log10(max(values)) + PADDING, start_px, end_px)


def _apart(wanted_px: Sequence[float]) -> list[float]:
    """Places of labels as near to those wanted (rising) as their height allows, within the chart."""
    places = list(wanted_px)
    for n in range(1, len(places)):
        places[n] = max(places[n], places[n - 1] + LABEL_STEP_PX)
    bottom = HEIGHT_PX - BOTTOM_PX
    for n in range(len(places) - 1, -1, -1):
        places[n] = min(places[n], bottom)
        bottom = places[n] - LABEL_STEP_PX
    return places


def _grid(x_axis: _Axis, y_axis: _Axis) -> Markup:
    right, bottom = x_axis.end_px, y_axis.start_px
    lines = "".join(f"M{LEFT_PX:g},{y_axis.px(t):.1f}H{right:g}" for t in y_axis.ticks((1, 3)))
    lines += "".join(f"M{x_axis.px(t):.1f},{bottom:g}V{TOP_PX:g}" for t in x_axis.ticks())
    words = [_text(x_axis.px(t), bottom + 19.0, f"{t:,.0f}", text_anchor="middle") for t in x_axis.ticks()]
    words += [
        _text(LEFT_PX - 8.0, y_axis.px(t) + 4.0, _tick(t), text_anchor="end") for t in y_axis.ticks((1, 3))
    ]
    words.append(_text(0.5 * (LEFT_PX + right), bottom + 42.0, "facets", text_anchor="middle"))
    return join(
        [
            element("path", d=lines, stroke=GREY, fill="none"),
            element("path", d=f"M{LEFT_PX:g},{TOP_PX:g}V{bottom:g}H{right:g}", stroke=FRAME, fill="none"),
            *words,
        ]
    )


def _tick(value_s: float) -> str:
    """Write a round time without needless digits."""
    return f"{1e3 * value_s:g} ms" if value_s < 1.0 else f"{value_s:g} s"


def _titles(title: str, subtitle: str) -> list[Markup]:
    return [
        _text(LEFT_PX, 24.0, title, font_size="17", font_weight="600"),
        _text(
            LEFT_PX,
            44.0,
            f"{subtitle} Hollow: scaled from some layers. Arrow: ended at the limit.",
            fill="#555555",
        ),
    ]


def _drawn(line: Line, x_axis: _Axis, y_axis: _Axis, rank: int) -> list[Markup]:
    """The line with its spreads and dots."""
    colour, dashes = _style(rank)
    at = [(x_axis.px(p.facets), y_axis.px(p.seconds)) for p in line.points]
    bars = "".join(
        f"M{x:.1f},{y_axis.px(p.least):.1f}V{y_axis.px(p.greatest):.1f}"
        for (x, _), p in zip(at, line.points, strict=True)
    )
    way = "M" + "L".join(f"{x:.1f},{y:.1f}" for x, y in at)
    return [
        element("path", d=way, fill="none", stroke=colour, stroke_width=1.8, stroke_dasharray=dashes or None),
        element("path", d=bars, fill="none", stroke=colour, stroke_width=1),
        *(_dot(x, y, p.kind, colour) for (x, y), p in zip(at, line.points, strict=True)),
    ]  # fmt: skip


def _style(rank: int) -> tuple[str, str]:
    """Colour and dashes of a line; where the colours begin again, the dashes do not."""
    return COLOURS[rank % len(COLOURS)], DASHES[(rank + rank // len(COLOURS)) % len(DASHES)]


def _dot(x: float, y: float, kind: Kind, colour: str) -> Markup:
    if kind == "over":
        return element(
            "path", d=f"M{x:.1f},{y:.1f}v-16m-4,6l4,-6l4,6", fill="none", stroke=colour, stroke_width=1.8
        )
    fill = colour if kind == "measured" else "white"
    return element(
        "circle", cx=f"{x:.1f}", cy=f"{y:.1f}", r=f"{DOT_PX:g}", fill=fill, stroke=colour, stroke_width=1.8
    )


def _label(line: Line, x_axis: _Axis, y_axis: _Axis, rank: int, place_px: float) -> list[Markup]:
    """Name and last figure of a line at its end, joined to it."""
    last = line.points[-1]
    sign = {"measured": "", "scaled": "~", "over": "> "}[last.kind]
    colour, _ = _style(rank)
    x, y, right = x_axis.px(last.facets), y_axis.px(last.seconds), x_axis.end_px
    lead = f"M{x + 6.0:.1f},{y:.1f}L{right + 10.0:.1f},{place_px:.1f}"
    return [
        element("path", d=lead, fill="none", stroke=colour, stroke_width=0.6),
        _text(right + 14.0, place_px + 4.0, f"{line.name}: {sign}{quantity(last.seconds, 's')}", fill=colour),
    ]


def _paper(x: float, y: float) -> list[Markup]:
    """The paper's figure, with what differs."""
    star = "".join(
        f"{'M' if k == 0 else 'L'}{x + r * math.sin(k * math.pi / 5.0):.1f},{y - r * math.cos(k * math.pi / 5.0):.1f}"
        for k, r in enumerate([9.0, 4.0] * 5)
    )
    words = f"paper: {published.SLICING_S:g} s, {published.FACETS:,} facets, {published.LAYERS} layers"
    differs = f"another part, {published.DEVICE.partition(',')[0]}"
    return [
        element("path", d=f"{star}Z", fill=LONE),
        _text(x - 14.0, y - 4.0, words, fill=LONE, text_anchor="end", **HALO),
        _text(x - 14.0, y + 12.0, differs, fill=LONE, text_anchor="end", **HALO),
    ]


def _text(x: float, y: float, words: str, **attributes: str) -> Markup:
    return element("text", words, x=f"{x:.1f}", y=f"{y:.1f}", **attributes)

"""``regress.html``: one file that shows what changed, how accurate every slicer is, and how that went over time.

It needs no scripts and no network, and it holds no time and no date: the same result gives the same bytes.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape
from itertools import groupby
from pathlib import Path

from ebamcheck.atomic_file import replacing
from ebamcheck.layers.svg import COLOURS, DASHES
from ebamcheck.regression.difference import Difference
from ebamcheck.regression.history import Trend, trends
from ebamcheck.regression.job import Regression
from ebamcheck.regression.measurement import MEASURED
from ebamcheck.regression.metrics import METRICS, WHOLE

PAGE = "regress.html"

TREND_METRICS = ("depth_max_mm", "area_error_mean_mm2")
"""Metrics whose trends are drawn: one of shape, one of size."""

WIDTH_PX, HEIGHT_PX = 640, 150
LEFT_PX, RIGHT_PX, TOP_PX, BOTTOM_PX = 74, 14, 12, 26

STYLE = """
body{font:15px/1.5 system-ui,sans-serif;max-width:72em;margin:2em auto;padding:0 1em;color:#1a1a1a;background:#fff}
table{border-collapse:collapse;font-variant-numeric:tabular-nums}th,td{padding:.2em .6em;border-bottom:1px solid #ddd}
th{text-align:left}td.n{text-align:right}pre{background:#f5f5f5;padding:.8em;overflow-x:auto}
.scroll{overflow-x:auto}.bad{color:#b3261e;font-weight:600}.good{color:#1a7f37}.key{margin-right:1.2em}
svg{max-width:100%;height:auto}text{font:11px system-ui,sans-serif;fill:#444}
"""


def write_page(regression: Regression, history: Path, folder: Path) -> Path:
    """Write the page, whole or not at all."""
    path = folder / PAGE
    with replacing(path) as temporary:
        temporary.write_text(document(regression, history), encoding="utf-8")
    return path


def document(regression: Regression, history: Path) -> str:
    """Build the page."""
    failing = [d for d in regression.differences if d.fails]
    verdict = (
        f'<span class="bad">{len(failing)} of {len(regression.differences)} entries failed</span>'
        if failing
        else f'<span class="good">no entry got worse</span>, {regression.compared} were compared'
    )
    intro = (
        f"<p>{verdict}. Every entry is one slicer under one choice of settings on one model whose sections are "
        "known exactly.</p>"
    )
    body = [
        "<h1>Accuracy against the baselines</h1>",
        intro,
        *_changes(regression.differences),
        "<h2>Accuracy now</h2>",
        _figures(regression),
        "<h2>What the figures mean</h2>",
        _glossary(),
        "<h2>Trend</h2>",
        "<p>One point a distinct result of the history; a result seen again adds none.</p>",
        *(_trends(history, metric) for metric in TREND_METRICS),
    ]
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>ebamcheck: accuracy against the baselines</title><style>{STYLE}</style></head>\n<body>\n"
        + "\n".join(body)
        + "\n</body></html>\n"
    )


def _changes(differences: Sequence[Difference]) -> Iterable[str]:
    told = [d for d in differences if d.verdict != "same"]
    if told:
        yield "<h2>What changed</h2>"
    for difference in told:
        yield f"<pre>{escape(chr(10).join(difference.lines()))}</pre>"


def _figures(regression: Regression) -> str:
    names = [metric.name for metric in METRICS] + list(WHOLE)
    verdicts = {d.key: d for d in regression.differences}
    rows = []
    for key, entry in regression.entries.items():
        verdict = verdicts[key]
        mark = f'<td class="{"bad" if verdict.fails else "good"}">{escape(verdict.verdict)}</td>'
        if entry.measured.status == MEASURED:
            cells = "".join(f'<td class="n">{entry.measured.metrics[name]:.4g}</td>' for name in names)
        else:
            cells = (
                f'<td colspan="{len(names)}">{escape(f"{entry.measured.status}: {entry.measured.why}")}</td>'
            )
        rows.append(f"<tr><td>{escape(entry.title)}</td>{mark}{cells}</tr>")
    head = "".join(f"<th>{escape(name.replace('_', ' '))}</th>" for name in ("entry", "verdict", *names))
    table = f"<table><thead><tr>{head}</tr></thead><tbody>{''.join(rows)}</tbody></table>"
    return f'<div class="scroll">{table}</div>'


def _glossary() -> str:
    meanings = {**{metric.name: metric.what for metric in METRICS}, **WHOLE}
    rows = "".join(f"<tr><td>{name}</td><td>{escape(what)}</td></tr>" for name, what in meanings.items())
    return f"<table><tbody>{rows}</tbody></table>"


def _trends(history: Path, metric: str) -> str:
    """One small chart a model: all its entries over the results."""
    parts = [f"<h3>{escape(metric.replace('_', ' '))}</h3>"]
    for model, found in groupby(trends(history, metric), key=lambda trend: trend.key.model):
        parts.append(_chart(model, list(found), metric))
    return "\n".join(parts)


def _chart(model: str, lines: Sequence[Trend], metric: str) -> str:
    last = max(max(line.results) for line in lines)
    most = max(max(line.values) for line in lines) or 1.0
    drawn = "".join(_line(line, k, last, most) for k, line in enumerate(lines))
    bottom, right = HEIGHT_PX - BOTTOM_PX, WIDTH_PX - RIGHT_PX
    axes = (
        f'<path d="M{LEFT_PX},{TOP_PX}V{bottom}H{right}" stroke="#777" fill="none"/>'
        f'<text x="{LEFT_PX - 6}" y="{TOP_PX + 8}" text-anchor="end">{most:.4g}</text>'
        f'<text x="{LEFT_PX - 6}" y="{bottom}" text-anchor="end">0</text>'
        f'<text x="{LEFT_PX}" y="{HEIGHT_PX - 8}">1</text>'
        f'<text x="{right}" y="{HEIGHT_PX - 8}" text-anchor="end">result {last}</text>'
    )
    svg = (
        f'<svg viewBox="0 0 {WIDTH_PX} {HEIGHT_PX}" role="img"><title>{escape(f"{metric} of {model}")}</title>'
        f"{axes}{drawn}</svg>"
    )
    keys = "".join(_legend(line, k) for k, line in enumerate(lines))
    return f"<h4>{escape(model)}</h4>{svg}<div>{keys}</div>"


def _line(line: Trend, rank: int, last: int, most: float) -> str:
    span = max(last - 1, 1)
    points = [
        (
            LEFT_PX + (result - 1) / span * (WIDTH_PX - LEFT_PX - RIGHT_PX),
            HEIGHT_PX - BOTTOM_PX - value / most * (HEIGHT_PX - TOP_PX - BOTTOM_PX),
        )
        for result, value in zip(line.results, line.values, strict=True)
    ]
    path = "M" + "L".join(f"{x:.1f},{y:.1f}" for x, y in points)
    dots = "".join(f"M{x:.1f},{y:.1f}h0" for x, y in points)
    colour, dashes = COLOURS[rank % len(COLOURS)], DASHES[rank % len(DASHES)]
    return (
        f'<path d="{path}" fill="none" stroke="{colour}" stroke-width="1.6" stroke-dasharray="{dashes}"/>'
        f'<path d="{dots}" stroke="{colour}" stroke-width="5" stroke-linecap="round"/>'
    )


def _legend(line: Trend, rank: int) -> str:
    colour = COLOURS[rank % len(COLOURS)]
    return f'<span class="key" style="color:{colour}">&#9632; {escape(line.key.backend)} {line.key.settings_hash}</span>'

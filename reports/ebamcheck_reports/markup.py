"""Pieces of a report page: numbers for readers, tables, lists of facts, pictures with captions, and the page itself."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from importlib.resources import files
from typing import Any

from ebamcheck.showing.markup import Markup, clean, escaped
from ebamcheck.showing.markup import element as plain_element
from ebamcheck.showing.markup import join as plain_join
from ebamcheck.showing.short_text import counted

__all__ = ["Markup", "clean", "counted"]

UNDEFINED = "not defined"

# -- numbers as text -------------------------------------------------------------------------------


def number(value: Any) -> float:
    """Turn a number of ``run.json`` into a float: ``"NaN"``, ``"Infinity"`` and null as well.

    >>> number("-Infinity"), number(3)
    (-inf, 3.0)
    """
    try:
        return math.nan if value is None else float(value)
    except (TypeError, ValueError):
        return math.nan


def shown(value: Any, unit: str = "") -> str:
    """Write a number with few digits and its unit; the exact value stands in the markup and in ``run.json``.

    >>> shown(0.410115922, "mm"), shown(13084.0), shown("NaN", "mm"), shown("Infinity", "mm")
    ('0.4101 mm', '13084', 'not defined', 'infinite')
    """
    x = number(value)
    if math.isnan(x):
        return UNDEFINED
    if math.isinf(x):
        return "infinite" if x > 0 else "minus infinite"
    if x == 1.0 and unit in ("faults", "layers", "characters"):
        return f"1 {unit[:-1]}"
    if x == int(x) and abs(x) < 1e9:
        text = str(int(x))
    else:
        text = f"{x:.1f}" if 1000.0 <= abs(x) < 1e9 else f"{x:.4g}"
    return f"{text} {unit}".strip()


def percent(value: Any) -> str:
    """Write a fraction of 1 as per cent.

    >>> percent(0.95227), percent("NaN")
    ('95.23 %', 'not defined')
    """
    x = number(value)
    return f"{100.0 * x:.2f} %" if math.isfinite(x) else UNDEFINED


def duration(seconds: Any) -> str:
    """Write a duration in a readable unit.

    >>> duration(0.1032), duration(75.2), duration(4057.8)
    ('0.103 s', '1 min 15 s', '1 h 7 min 38 s')
    """
    x = number(seconds)
    if not math.isfinite(x):
        return UNDEFINED
    if x < 60.0:
        return f"{x:.3g} s"
    whole = round(x)
    hours, minutes, rest = whole // 3600, whole % 3600 // 60, whole % 60
    return f"{hours} h {minutes} min {rest} s" if hours else f"{minutes} min {rest} s"


def place(x_mm: Any, y_mm: Any) -> str:
    """Write a place on a layer."""
    x, y = number(x_mm), number(y_mm)
    return f"({x:.3f}, {y:.3f})" if math.isfinite(x) and math.isfinite(y) else "no place"


# -- elements --------------------------------------------------------------------------------------


def markup(value: Any) -> Markup:
    """Escape a text, or write a number with its exact value beside it; markup stays as it is, and None becomes empty.

    >>> markup("<a&b>"), markup(True)
    (Markup('&lt;a&amp;b&gt;'), Markup('yes'))
    """
    if isinstance(value, bool):
        return Markup("yes" if value else "no")
    return figure(value) if isinstance(value, float) else escaped(value)


def join(parts: Iterable[Any], between: str = "") -> Markup:
    """Markup of several items, joined."""
    return plain_join((markup(part) for part in parts), between)


def element(tag: str, *children: Any, **attributes: Any) -> Markup:
    """One element as :func:`ebamcheck.showing.markup.element` builds it, whose numbers are figures."""
    return plain_element(tag, *(markup(child) for child in children), **attributes)


def figure(value: Any, unit: str = "", text: str = "") -> Markup:
    """Write a number with few digits and its exact value in the markup; `text` replaces the digits."""
    return element("data", text or shown(value, unit), value=repr(number(value)))


def figure_percent(value: Any) -> Markup:
    """Figure of a fraction of 1, written as per cent."""
    return figure(value, text=percent(value))


def figure_duration(seconds: Any) -> Markup:
    """Figure of a duration."""
    return figure(seconds, text=duration(seconds))


def figures_of(record: Mapping[str, Any], names: Iterable[tuple[str, str, str]]) -> list[tuple[str, Markup]]:
    """Facts of a record, each by its name in words, its key and its unit."""
    return [(name, figure(record[key], unit)) for name, key, unit in names]


def table(
    columns: Sequence[str],
    rows: Iterable[Sequence[Any]],
    class_: str | None = None,
    numbers: Sequence[str] = (),
) -> Markup:
    """Build a table whose columns in `numbers` have their heads to the right; a row that is an element stays as it is."""
    heads = (element("th", c, scope="col", class_="number" if c in numbers else None) for c in columns)
    body = [given if isinstance(given, Markup) else row(given) for given in rows]
    whole = element("table", element("thead", element("tr", *heads)), element("tbody", *body), class_=class_)
    return element("div", whole, class_="scroll")


def row(cells: Iterable[Any], **attributes: Any) -> Markup:
    """One row of a table."""
    return element("tr", *(cell(value) for value in cells), **attributes)


def cell(value: Any) -> Markup:
    """One cell of a table, numbers to the right; a cell that is an element already stays as it is."""
    if isinstance(value, Markup) and value.startswith(("<td", "<th")):
        return value
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    is_figure = isinstance(value, Markup) and value.startswith("<data")
    return element("td", value, class_="number" if is_number or is_figure else None)


def facts(pairs: Iterable[tuple[str, Any]]) -> Markup:
    """Build a list of names and values; code (a hash) takes a whole row."""
    rows = []
    for name, value in pairs:
        is_code = isinstance(value, Markup) and value.startswith("<code")
        pair = (element("dt", name), element("dd", value))
        rows.append(element("div", *pair, class_="wide" if is_code else None))
    return element("dl", *rows)


def paragraph(*children: Any, class_: str | None = None) -> Markup:
    """Build a paragraph."""
    return element("p", *children, class_=class_)


def mark(passed: bool) -> Markup:
    """Say pass or fail by sign, word and colour."""
    return element("span", "✔ pass" if passed else "✘ FAIL", class_="pass" if passed else "fail")


def section(anchor: str, title: str, what: str, *children: Any) -> Markup:
    """One section: what is checked and what good looks like comes first."""
    return element("section", element("h2", title), paragraph(what, class_="what"), *children, id=anchor)


def picture(svg: Markup, caption: Any, class_: str | None = None, name: str | None = None) -> Markup:
    """Build a figure with its caption."""
    return element("figure", svg, element("figcaption", caption), class_=class_, data_name=name)


def collapsed(title: str, *children: Any) -> Markup:
    """Build a block that opens on a click, without scripts."""
    return element("details", element("summary", title), *children)


DOTS = "dots"  # In place of dashes, for a legend entry of dots


def legend(entries: Iterable[tuple[str, str, str]]) -> Markup:
    """Explain lines: name, colour, dashes."""
    items = [element("span", _sample(colour, dashes), " ", name, class_="key") for name, colour, dashes in entries]
    return element("div", *items, class_="legend")


def _sample(colour: str, dashes: str) -> Markup:
    if dashes == DOTS:
        path = element("path", d="M7,5h0M21,5h0", stroke=colour, stroke_width=7, stroke_linecap="round")
    else:
        path = element("path", d="M0,5h28", stroke=colour, stroke_width=3, stroke_dasharray=dashes or None)
    return element("svg", path, width=28, height=10)


# -- the page --------------------------------------------------------------------------------------


def header(title: str, said: str, chapters: Iterable[tuple[str, str]]) -> Markup:
    """Head of a page: its title, a paragraph, and links to the sections (anchor, title)."""
    links = [element("a", name, href=f"#{anchor}") for anchor, name in chapters]
    return element("header", element("h1", title), paragraph(said), element("nav", *links))


def page(title: str, *body: Markup, style: str | Markup = "") -> str:
    """Build a self-contained page in the style of the reports; `style` comes after theirs."""
    css = Markup(files("ebamcheck_reports").joinpath("report.css").read_text(encoding="utf-8"))
    head = element(
        "head",
        element("meta", charset="utf-8"),
        element("meta", name="viewport", content="width=device-width, initial-scale=1"),
        element("title", title),
        element("style", css, Markup(style)),
    )
    return f"<!DOCTYPE html>\n{element('html', head, element('body', *body), lang='en')}\n"

"""Pieces of a report page: figures, tables, lists of facts, pictures with their captions."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from ebamcheck.showing.markup import Markup, clean, escaped
from ebamcheck.showing.markup import element as plain_element
from ebamcheck.showing.markup import join as plain_join
from ebamcheck_reports.figures import number, shown

__all__ = ["Markup", "clean"]


def markup(value: Any) -> Markup:
    """Escape a text, or write a number with its exact value beside it; markup stays as it is, and None becomes empty.

    Examples
    --------
    >>> markup("<a&b>")
    Markup('&lt;a&amp;b&gt;')
    >>> markup(True)
    Markup('yes')
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


def table(
    columns: Sequence[str],
    rows: Iterable[Sequence[Any]],
    class_: str | None = None,
    numbers: Sequence[str] = (),
) -> Markup:
    """Build a table; a row that is an element already stays as it is.

    Numbers are set to the right, and so are the heads of the columns named in `numbers`.
    """
    heads = (element("th", c, scope="col", class_="number" if c in numbers else None) for c in columns)
    body = [
        row if isinstance(row, Markup) else element("tr", *(cell(value) for value in row)) for row in rows
    ]
    whole = element("table", element("thead", element("tr", *heads)), element("tbody", *body), class_=class_)
    return element("div", whole, class_="scroll")


def cell(value: Any) -> Markup:
    """One cell of a table."""
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


DOTS = "dots"
"""In place of dashes, for a legend entry of dots."""


def legend(entries: Iterable[tuple[str, str, str]]) -> Markup:
    """Explain lines: name, colour, dashes."""
    items = [
        element("span", _sample(colour, dashes), " ", name, class_="key") for name, colour, dashes in entries
    ]
    return element("div", *items, class_="legend")


def _sample(colour: str, dashes: str) -> Markup:
    if dashes == DOTS:
        path = element("path", d="M7,5h0M21,5h0", stroke=colour, stroke_width=7, stroke_linecap="round")
    else:
        path = element("path", d="M0,5h28", stroke=colour, stroke_width=3, stroke_dasharray=dashes or None)
    return element("svg", path, width=28, height=10)


def collapsed(title: str, *children: Any) -> Markup:
    """Build a block that opens on a click, without scripts."""
    return element("details", element("summary", title), *children)

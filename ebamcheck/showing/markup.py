"""SVG and HTML elements in which every text is escaped unless it is markup already; what comes out is HTML and XML at once."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any

from markupsafe import Markup, escape

__all__ = ["FONT", "NAMESPACE", "Markup", "clean", "element", "escaped", "inline", "join", "svg_file", "text"]
_NOT_IN_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
EMPTY_ELEMENTS = frozenset({"meta", "br", "input", "hr", "path", "rect", "circle", "line", "image", "polygon", "polyline"})  # fmt: skip
NAMESPACE = "http://www.w3.org/2000/svg"
FONT = "Helvetica, Arial, sans-serif"


def clean(text: str) -> str:
    """Text without the characters that XML cannot hold (control characters, halves of surrogates).

    >>> clean("a\\x00b")
    'a\ufffdb'
    """
    return _NOT_IN_XML.sub("\ufffd", text)


def escaped(value: Any) -> Markup:
    """Escape a text; markup stays as it is, and nothing is nothing.

    >>> escaped("<a&b>")
    Markup('&lt;a&amp;b&gt;')
    """
    if isinstance(value, Markup):
        return value
    return Markup("") if value is None else escape(clean(str(value)))


def join(parts: Iterable[Any], between: str = "") -> Markup:
    """Markup of several things one after the other."""
    return Markup(escaped(between).join(escaped(part) for part in parts))


def element(tag: str, *children: Any, **attributes: Any) -> Markup:
    """One element; an underscore at the end of an attribute goes, others become hyphens, and None leaves it out.

    >>> element("td", "a < b", class_="num", stroke_width=None)
    Markup('<td class="num">a &lt; b</td>')
    """
    named = {name.rstrip("_").replace("_", "-"): value for name, value in attributes.items()}
    given = "".join(f' {name}="{escaped(value)}"' for name, value in named.items() if value is not None)
    if tag in EMPTY_ELEMENTS:
        return Markup(f"<{tag}{given}/>")
    return Markup(f"<{tag}{given}>{join(children)}</{tag}>")


def text(x_px: float, y_px: float, words: Any, size_px: float = 11, **style: Any) -> Markup:
    """Words that begin at a place, or lie about it where `text_anchor` says so."""
    given = {"x": f"{x_px:.1f}", "y": f"{y_px:.1f}", "font_size": f"{size_px:g}", "fill": "#222"}
    return element("text", words, **{**given, **style})


def inline(picture: str, class_: str | None = None) -> Markup:
    """Element of an SVG document, to stand within a page, which has the name space already."""
    given = f' class="{escaped(class_)}"' if class_ else ""
    return Markup(picture.replace(f' xmlns="{NAMESPACE}"', given, 1))


def svg_file(width_px: float, height_px: float, body: Iterable[Markup], title: str = "") -> str:
    """Return an SVG document on white ground, one element a line, those behind first; viewers and screen readers show the title."""
    ground = element("rect", width=f"{width_px:g}", height=f"{height_px:g}", fill="#ffffff")
    named = [element("title", title)] if title else []
    box = {"width": f"{width_px:g}", "height": f"{height_px:g}", "viewBox": f"0 0 {width_px:g} {height_px:g}"}
    drawn = join(["", *named, ground, *body, ""], "\n")
    return f"{element('svg', drawn, xmlns=NAMESPACE, **box, font_family=FONT)}\n"

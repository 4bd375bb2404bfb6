"""How values show themselves: one short line at a prompt, a small table in a notebook, a plain text table on a terminal."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import Any

from ebamcheck.printable import printable

LONGEST = 200  # characters of a line at most: what is longer cannot be read at a prompt


def line(kind: str, *facts: str) -> str:
    """Write a value as its kind and the facts that tell it from others.

    >>> line("Layers", "42 layers", "", "planecut")
    '<Layers: 42 layers, planecut>'
    """
    said = ", ".join(fact for fact in facts if fact)
    # A name may hold what a terminal should not be told.
    said = "".join(c if c.isprintable() else "?" for c in said)
    room = LONGEST - len(kind) - len("<: >")
    return f"<{kind}: {said if len(said) <= room else said[: room - 2] + ' …'}>"


def counted(count: int, one: str, many: str = "") -> str:
    """Count things in words.

    >>> counted(1, "layer"), counted(3, "body", "bodies")
    ('1 layer', '3 bodies')
    """
    return f"{count} {one if count == 1 else many or one + 's'}"


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Ask for the known name that is nearest to an unknown one; empty where none is near.

    >>> did_you_mean("Inconel718", ["316L", "Inconel 718"])
    " (did you mean 'Inconel 718'?)"
    """
    near = difflib.get_close_matches(name, list(known), n=1)
    return f" (did you mean {near[0]!r}?)" if near else ""


def size(lengths_mm: Iterable[float]) -> str:
    """Write the extents of a box.

    >>> size([80.0, 40.0, 30.5])
    '80 x 40 x 30.5 mm'
    """
    return " x ".join(f"{length:.4g}" for length in lengths_mm) + " mm"


def heights(values_mm: Any) -> str:
    """Write from where to where heights go; nothing without any."""
    if not len(values_mm):
        return ""
    return f"z = {values_mm[0]:.6g} .. {values_mm[-1]:.6g} mm"


def html(title: str, facts: Mapping[str, Any], picture: str = "") -> str:
    """Build a table of names and values for a notebook, with a picture (SVG) under it.

    >>> html("a & b", {"facets": 12})
    '<div><b>a &amp; b</b><table><tr><th scope="row">facets</th><td>12</td></tr></table></div>'
    """
    told = [(escape(name), escape(str(value))) for name, value in facts.items()]
    rows = "".join(f'<tr><th scope="row">{name}</th><td>{value}</td></tr>' for name, value in told)
    return f"<div><b>{escape(title)}</b><table>{rows}</table>{picture}</div>"


def text_table(columns: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """Align columns with two blanks between them; numbers go right, text goes left.

    >>> print(text_table(["name", "mm"], [["a", 1.5], ["bcd", 12]]))
    name   mm
    a     1.5
    bcd    12
    """
    body = [list(row) for row in rows]
    cells = [[_cell(value) for value in row] for row in body]
    right = [bool(body) and all(isinstance(row[i], int | float) for row in body) for i in range(len(columns))]
    width = [max(len(row[i]) for row in [list(columns), *cells]) for i in range(len(columns))]
    lines = [
        "  ".join(c.rjust(w) if r else c.ljust(w) for c, w, r in zip(row, width, right, strict=True)).rstrip()
        for row in [list(columns), *cells]
    ]
    return "\n".join(lines)


def _cell(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.6g}"
    return printable(value)

"""Plain text tables for a terminal and for a log file."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from ebamcheck.printable import printable


def text_table(columns: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """Align columns with two blanks between them; numbers go right, text goes left.

    Examples
    --------
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

"""Formatting of a run's numbers for readers."""

from __future__ import annotations

import math
from typing import Any

DIGITS = 4
"""Significant digits shown; the exact value stands beside it in the markup and in ``run.json``."""

PLURALS = ("faults", "layers", "characters")
"""Units whose figures are counts."""

UNDEFINED = "not defined"


def number(value: Any) -> float:
    """Turn a number of ``run.json`` into a float: ``"NaN"``, ``"Infinity"`` and null as well.

    Examples
    --------
    >>> number("-Infinity"), number(3)
    (-inf, 3.0)
    """
    if value is None:
        return math.nan
    try:
        return float(value)
    except (TypeError, ValueError):
        return math.nan


def shown(value: Any, unit: str = "") -> str:
    """Write a number with few digits and its unit.

    Examples
    --------
    >>> shown(0.410115922, "mm"), shown(13084.0), shown("NaN", "mm"), shown("Infinity", "mm")
    ('0.4101 mm', '13084', 'not defined', 'infinite')
    """
    x = number(value)
    if math.isnan(x):
        return UNDEFINED
    if math.isinf(x):
        return "infinite" if x > 0 else "minus infinite"
    if x == 1.0 and unit in PLURALS:
        return f"1 {unit[:-1]}"
    if x == int(x) and abs(x) < 1e9:
        text = str(int(x))
    elif 1000.0 <= abs(x) < 1e9:
        text = f"{x:.1f}"
    else:
        text = f"{x:.{DIGITS}g}"
    return f"{text} {unit}".strip()


def percent(value: Any) -> str:
    """Write a fraction of 1 as per cent.

    Examples
    --------
    >>> percent(0.95227), percent("NaN")
    ('95.23 %', 'not defined')
    """
    x = number(value)
    return f"{100.0 * x:.2f} %" if math.isfinite(x) else UNDEFINED


def duration(seconds: Any) -> str:
    """Write a duration in a readable unit.

    Examples
    --------
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


def counted(count: int, one: str, many: str = "") -> str:
    """Count things in words.

    Examples
    --------
    >>> counted(1, "layer"), counted(3, "layer"), counted(2, "body", "bodies")
    ('1 layer', '3 layers', '2 bodies')
    """
    return f"{count} {one if count == 1 else many or one + 's'}"


def place(x_mm: Any, y_mm: Any) -> str:
    """Write a place on a layer."""
    x, y = number(x_mm), number(y_mm)
    return f"({x:.3f}, {y:.3f})" if math.isfinite(x) and math.isfinite(y) else "no place"

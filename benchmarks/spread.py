"""Medians with their spread, and how figures are written."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from statistics import median


@dataclass(frozen=True)
class Spread:
    """Repeated figures: their median, how far they lie apart, and how many there are."""

    median: float
    least: float
    greatest: float
    mad: float
    """Median of the distances from the median."""
    count: int


def spread(values: Iterable[float]) -> Spread:
    """Return the median and the spread of at least one figure.

    Examples
    --------
    >>> spread([3.0, 1.0, 2.0, 10.0, 2.0])
    Spread(median=2.0, least=1.0, greatest=10.0, mad=1.0, count=5)
    """
    given = [float(v) for v in values]
    if not given:
        raise ValueError("no figures: give at least one")
    middle = median(given)
    return Spread(middle, min(given), max(given), median(abs(v - middle) for v in given), len(given))


def seconds(value_s: float) -> str:
    """Write a time with three digits and the unit that suits it.

    Examples
    --------
    >>> [seconds(v) for v in (0.0042, 0.31415, 1.5512, 12.3456, 247.4)]
    ['4.20 ms', '314 ms', '1.55 s', '12.3 s', '247 s']
    """
    if value_s < 1.0:
        return f"{_digits(1e3 * value_s)} ms"
    return f"{_digits(value_s)} s"


def megabytes(value_mb: float) -> str:
    """Write an amount of memory.

    Examples
    --------
    >>> megabytes(941.4), megabytes(8192.0)
    ('941 MB', '8.19 GB')
    """
    return f"{value_mb:.0f} MB" if value_mb < 1000.0 else f"{_digits(value_mb / 1000.0)} GB"


def quantity(value: float, unit: str) -> str:
    """Write a figure in its unit: ``"s"``, ``"MB"``, ``"mm"``, or ``""`` for a ratio or a count."""
    if unit == "s":
        return seconds(value)
    if unit == "MB":
        return megabytes(value)
    return f"{value:.3g} {unit}".rstrip()


def spread_text(figures: Spread, unit: str = "s") -> str:
    """Write a median, with the least and greatest where there are several.

    Examples
    --------
    >>> spread_text(spread([0.31, 0.30, 0.35]))
    '310 ms (300 ms .. 350 ms, n = 3)'
    """
    middle = quantity(figures.median, unit)
    if figures.count == 1:
        return middle
    return f"{middle} ({quantity(figures.least, unit)} .. {quantity(figures.greatest, unit)}, n = {figures.count})"


def _digits(value: float) -> str:
    """Three digits, and all of them before the point."""
    if value <= 0.0 or not math.isfinite(value):
        return f"{value:.3g}"
    return f"{value:.{max(0, 2 - math.floor(math.log10(value) + 1e-12))}f}"

"""Units of length by the names that people give them."""

from __future__ import annotations

from typing import Any

from ebamcheck.errors import SettingsError

UNIT_NAMES = {
    "mm": ("millimetre", "millimetres", "millimeter", "millimeters"),
    "cm": ("centimetre", "centimetres", "centimeter", "centimeters"),
    "m": ("metre", "metres", "meter", "meters"),
    "um": ("\N{MICRO SIGN}m", "\N{GREEK SMALL LETTER MU}m", "micron", "microns", "micrometre", "micrometer"),
    "in": ("inch", "inches", '"'),
    "ft": ("foot", "feet"),
}
"""Other names of each unit."""

_KNOWN = {name: unit for unit, names in UNIT_NAMES.items() for name in (unit, *names)}


def known_as(name: Any) -> Any:
    """Short name of a unit; what is no name of one comes back as it is.

    Examples
    --------
    >>> known_as("Inches"), known_as(" MM "), known_as("furlong")
    ('in', 'mm', 'furlong')
    """
    return _KNOWN.get(name.strip().lower(), name) if isinstance(name, str) else name


def unit_named(name: str) -> str:
    """Short name of a unit; raises :class:`SettingsError` for one that is not known."""
    unit = known_as(name)
    if unit not in UNITS_MM:
        raise SettingsError(
            f"unknown unit {name!r}: use one of {', '.join(UNITS_MM)}, or a longer name such as inch or inches"
        )
    return str(unit)


UNITS_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "um": 0.001, "in": 25.4, "ft": 304.8}
"""Millimetres in one unit of a model's file."""

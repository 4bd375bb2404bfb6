"""Numbers as programs print process values."""

from __future__ import annotations

DECIMALS = 6
"""Decimals of a process value, trailing zeros left out."""


def plain(value: float) -> str:
    """Print a process value: no exponent, no trailing zeros, no negative zero.

    Examples
    --------
    >>> plain(33.50), plain(-1e-9)
    ('33.5', '0')
    """
    text = f"{float(value):.{DECIMALS}f}".rstrip("0").rstrip(".")
    return "0" if text == "-0" else text

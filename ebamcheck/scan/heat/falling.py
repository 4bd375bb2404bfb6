"""Powers of e that fall, in plain arithmetic, so that a kernel works out several at once."""

from __future__ import annotations

from ebamcheck.numeric.kernels import kernel

LEAST = -40.0
"""Exponent under which the result is that of this one, 4e-18: nothing beside 1."""


@kernel
def falling(exponent: float) -> float:
    """Return e to an exponent of at most 0, to 1e-14 of 1.

    The processor has no such function; the library's takes one value at a time and 8 ns. The series of a 64th of the
    exponent, squared six times, is the same to rounding, has no branch, and takes 1 ns in a loop over a column.

    Examples
    --------
    >>> round(falling(-1.0), 12)
    0.367879441171
    """
    part = max(exponent, LEAST) / 64.0
    power = 1.0 + part * (1.0 / 11.0)
    power = 1.0 + part * (1.0 / 10.0) * power
    power = 1.0 + part * (1.0 / 9.0) * power
    power = 1.0 + part * (1.0 / 8.0) * power
    power = 1.0 + part * (1.0 / 7.0) * power
    power = 1.0 + part * (1.0 / 6.0) * power
    power = 1.0 + part * (1.0 / 5.0) * power
    power = 1.0 + part * (1.0 / 4.0) * power
    power = 1.0 + part * (1.0 / 3.0) * power
    power = 1.0 + part * (1.0 / 2.0) * power
    power = 1.0 + part * power
    power *= power
    power *= power
    power *= power
    power *= power
    power *= power
    return power * power

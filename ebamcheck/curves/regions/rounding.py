"""Rounding of coordinates: the tolerance within which facets count as lying in one plane."""

from __future__ import annotations

import numpy as np

from ebamcheck.mesh.part import (
    Part,
    rotation_to_z,
)
from ebamcheck.numeric.rings import Floats
from ebamcheck.settings.base import UNITS_MM

LEAST_TOLERANCE_MM = 5e-5
"""Vertices this near to a plane lie in it, however fine the numbers of the file: programs that split an edge or rotate a part
leave some 1e-5 mm. It is a twentieth of the least distance of contour points, far below any chord error."""

DECIMALS = (3, 4, 5, 6)
"""Decimal places to look for in the numbers of an ASCII file; fewer are a part's own round dimensions."""

FLOAT32_STEP = 2.0**-23
"""Step between 32-bit floating-point numbers, over the power of two below them."""


def plane_tolerance_mm(part: Part) -> float:
    """How far a vertex of a plane may lie from it, mm: twice as far as half a step of each coordinate moves it.

    Twice, because the plane itself goes through rounded vertices.
    """
    return max(LEAST_TOLERANCE_MM, float(2.0 * np.sqrt(3.0) * coordinate_error_mm(part)))


def coordinate_error_mm(part: Part) -> float:
    """Greatest rounding of a coordinate: half a step of 32-bit numbers, or of the decimals of an ASCII file."""
    largest = float(np.abs(part.bounds).max(initial=0.0))
    if not len(part.faces) or largest == 0.0:
        return 0.0
    half_step: float = 0.5 * FLOAT32_STEP * 2.0 ** np.floor(np.log2(largest))
    digits = _decimals(_in_file(part), half_step / UNITS_MM[part.units])
    return half_step if digits is None else max(half_step, 0.5 * 10.0**-digits * UNITS_MM[part.units])


def _in_file(part: Part) -> Floats:
    """Vertices in the coordinates and unit of the file."""
    points: Floats = part.vertices / UNITS_MM[part.units]
    if part.direction != (0.0, 0.0, 1.0):
        points = points @ rotation_to_z(part.direction)
    return points


def _decimals(points: Floats, half_step: float) -> int | None:
    """Decimal places of all coordinates, of :data:`DECIMALS`; None if there are other ones, or if any number would fit."""
    for digits in (DECIMALS[0] - 1, *DECIMALS):
        scaled = points * 10.0**digits
        if 10.0**digits * half_step > 0.05:
            return None  # any 32-bit number of this size looks like a decimal
        if (np.abs(scaled - np.round(scaled)) <= 2.0 * 10.0**digits * half_step + 1e-9).all():
            return digits if digits >= DECIMALS[0] else None
    return None

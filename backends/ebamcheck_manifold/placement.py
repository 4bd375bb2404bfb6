"""Exact placement of a part near the origin and at a size at which manifold3d loses no digits.

manifold3d merges vertices within 1e-12 of the largest *coordinate* and rounds contours to 1e-8, whatever
the size of the part. A part far from the origin or a small one is therefore moved and scaled first, by
operations that are exact in floating point, so that `min <= h < max` stays the same comparison.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ebamcheck.mesh.part import Part

Floats = NDArray[np.float64]

WORKING_SIZE_EXPONENT = 10
"""Parts smaller than 2**10 mm are scaled to lie between half that size and that size."""


@dataclass(frozen=True)
class Placement:
    """Map from part to working coordinates, those that manifold3d gets: ``(x - shift_mm) * scale``."""

    shift_mm: Floats
    scale: float

    def apply(self, points: Floats) -> Floats:
        """Move and scale points (..., 3), exactly."""
        return np.ascontiguousarray((points - self.shift_mm) * self.scale)

    def height(self, z_mm: float) -> float:
        """Height of a plane in working coordinates."""
        return (z_mm - float(self.shift_mm[2])) * self.scale

    def undo(self, points: Floats) -> Floats:
        """Return contour points (N, 2) of working coordinates in mm, as placed."""
        placed = points / self.scale
        # Column by column: ten times faster than adding a row of two to each row.
        placed[:, 0] += self.shift_mm[0]
        placed[:, 1] += self.shift_mm[1]
        return placed


def exact_placement(part: Part) -> Placement:
    """Choose a shift and a power of two for the scale, so that no coordinate is rounded."""
    least, greatest = part.bounds
    size = float((greatest - least).max())
    exponent = WORKING_SIZE_EXPONENT - math.frexp(size)[1] if size > 0.0 else 0
    shift = [_exact_shift(float(a), float(b)) for a, b in zip(least, greatest, strict=True)]
    return Placement(np.array(shift), math.ldexp(1.0, min(max(0, exponent), 200)))


def _exact_shift(least: float, greatest: float) -> float:
    """Return the end nearer to 0 if all differences to it are exact (Sterbenz's lemma), else 0."""
    if least > 0.0 and greatest <= 2.0 * least:
        return least
    if greatest < 0.0 and least >= 2.0 * greatest:
        return greatest
    return 0.0

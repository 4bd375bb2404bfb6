"""Placing of a part on the machine: a turn about the vertical, then a shift."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from ebamcheck.mesh.part import Part
from ebamcheck.numeric.rings import Floats


@dataclass(frozen=True)
class Placing:
    """Turn about a vertical axis, then shift.

    Parameters
    ----------
    turn_deg
        Counter-clockwise seen from above.
    about_mm
        X and Y of the axis.
    shift_mm
        Shift along X, Y and Z.
    """

    turn_deg: float = 0.0
    about_mm: tuple[float, float] = (0.0, 0.0)
    shift_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def still(self) -> bool:
        """Whether nothing moves."""
        return self.turn_deg % 360.0 == 0.0 and self.shift_mm == (0.0, 0.0, 0.0)

    def moved(self, part: Part) -> Part:
        """Return the part where it is built; unchanged bit for bit if nothing moves."""
        if self.still:
            return part
        vertices = part.vertices.copy()
        if self.turn_deg % 360.0 != 0.0:
            x, y = vertices[:, 0] - self.about_mm[0], vertices[:, 1] - self.about_mm[1]
            cosine, sine = cosine_and_sine(self.turn_deg)
            vertices[:, 0] = cosine * x - sine * y + self.about_mm[0]
            vertices[:, 1] = sine * x + cosine * y + self.about_mm[1]
        for axis, way_mm in enumerate(self.shift_mm):
            if way_mm:
                vertices[:, axis] += way_mm
        return replace(part, vertices=vertices)


def cosine_and_sine(angle_deg: float) -> tuple[float, float]:
    """Cosine and sine of an angle in degrees; of quarter turns exactly.

    Examples
    --------
    >>> cosine_and_sine(90.0), cosine_and_sine(-180.0)
    ((0.0, 1.0), (-1.0, 0.0))
    """
    quarters, rest = divmod(angle_deg % 360.0, 90.0)
    if rest == 0.0:
        return ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[int(quarters) % 4]
    angle_rad = math.radians(angle_deg)
    return math.cos(angle_rad), math.sin(angle_rad)


def placing_of(part: Part, place_at_mm: tuple[float, ...] | None = None, turn_deg: float = 0.0) -> Placing:
    """Return the placing that turns a part about the middle of its box, then moves the middle of the turned box to a place.

    Parameters
    ----------
    part
        The part, with its slicing direction up.
    place_at_mm
        X and Y of the middle of its box and, if there are three numbers, Z of its lowest point; None: no shift.
    turn_deg
        Counter-clockwise seen from above.
    """
    x, y = _middle(part)
    turn = Placing(turn_deg, (x, y))
    if place_at_mm is None:
        return turn
    turned = turn.moved(part)
    low_mm = float(turned.bounds[0, 2])
    mid_x, mid_y = _middle(turned)
    rise_mm = place_at_mm[2] - low_mm if len(place_at_mm) > 2 else 0.0
    return Placing(turn_deg, (x, y), (place_at_mm[0] - mid_x, place_at_mm[1] - mid_y, rise_mm))


def _middle(part: Part) -> tuple[float, float]:
    middle: Floats = np.asarray(part.bounds.mean(axis=0), np.float64)
    return float(middle[0]), float(middle[1])

"""What the control makes of G2 and G3: centre and sweep of an arc."""

from __future__ import annotations

import math
from collections.abc import Mapping

RADIUS_TOLERANCE_MM = 0.01
"""Radii at start and end of an arc may differ by this; larger differences stop the control with an alarm."""

CHORD_ROUNDING = 1e-9
"""Share by which a chord may exceed the diameter, for the rounding of a half circle."""


def arc(
    start: tuple[float, float],
    end: tuple[float, float],
    values: Mapping[str, float],
    *,
    counter_clockwise: bool,
) -> tuple[float, float, float]:
    """Centre X, Y and signed sweep (radians) of an arc; with I and J alone, equal ends make a full circle.

    `values` are the block's: I and J from the start to the centre, or CR, the radius, negative for an arc of
    more than half a circle.

    Raises
    ------
    ValueError
        If no circle fits.
    """
    sense = 1.0 if counter_clockwise else -1.0
    x, y = start
    dx, dy = end[0] - x, end[1] - y
    if "CR" in values:
        chord, radius = math.hypot(dx, dy), abs(values["CR"])
        if not 0.0 < chord <= 2.0 * radius * (1.0 + CHORD_ROUNDING):
            raise ValueError(f"CR={values['CR']:g}: no circle of that radius joins start and end")
        rise = math.copysign(math.sqrt(max(radius**2 - 0.25 * chord**2, 0.0)), sense * values["CR"]) / chord
        cx, cy = x + 0.5 * dx - rise * dy, y + 0.5 * dy + rise * dx
    else:
        cx, cy = x + values.get("I", 0.0), y + values.get("J", 0.0)
    first, last = math.hypot(x - cx, y - cy), math.hypot(end[0] - cx, end[1] - cy)
    if not (first > 0.0 and abs(first - last) <= RADIUS_TOLERANCE_MM):
        raise ValueError(f"radius {first:.6g} mm at the start of the arc and {last:.6g} mm at its end")
    turn = math.atan2(end[1] - cy, end[0] - cx) - math.atan2(y - cy, x - cx)
    return cx, cy, sense * ((sense * turn) % (2.0 * math.pi) or 2.0 * math.pi)

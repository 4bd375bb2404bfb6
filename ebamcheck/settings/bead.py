"""One bead by itself: its height by the balance of its volume."""

from __future__ import annotations

import math

PARABOLA = 2.0 / 3.0
"""Area of a parabolic bead over its width times its height (Pixner et al. 2020, Materials 13:3310)."""


def bead_height_mm(
    wire_diameter_mm: float, wire_speed_mm_s: float, travel_speed_mm_s: float, bead_width_mm: float
) -> float:
    """Height of one bead from the mass balance ``v_wire pi d^2 / 4 = v_travel A`` with ``A = 2/3 w h``.

    Examples
    --------
    >>> round(bead_height_mm(1.6, 2000 / 60, 10.0, 6.0), 2)
    1.68
    """
    area_mm2 = wire_speed_mm_s * math.pi * wire_diameter_mm**2 / 4.0 / travel_speed_mm_s
    return area_mm2 / (PARABOLA * bead_width_mm)

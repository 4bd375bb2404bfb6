"""The wire speed of a bead, by the balance of its volume."""

from __future__ import annotations

import math

from ebamcheck.settings.config import Config


def wire_speed_mm_s(config: Config, width_mm: float, thickness_mm: float) -> float:
    """Wire speed of a bead that lays a width times the layer's height: ``v_wire pi d^2 / 4 = v_travel b h``.

    Examples
    --------
    >>> round(wire_speed_mm_s(Config(), 4.0, 1.6755), 2)
    33.33
    """
    return config.process.travel_speed_mm_s * width_mm * thickness_mm / wire_mm2(config)


def wire_mm2(config: Config) -> float:
    """Section of the wire."""
    return 0.25 * math.pi * config.process.wire_diameter_mm**2

"""The metal of each motion by its text alone: section of the wire, its speed, and the feed.

The section of the wire is worked out anew here, and not taken from what gives the wire of a program its speed: a mistake
there would else be made on both sides of the balance, and every check of the metal would confirm it.
"""

from __future__ import annotations

import math

import numpy as np

from ebamcheck.numeric.rings import Floats
from ebamcheck.program.reading.motions import NCProgram
from ebamcheck.settings.config import Config


def wire_section_mm2(config: Config) -> float:
    """Area of the circle that the wire is in section.

    Examples
    --------
    >>> round(wire_section_mm2(Config()), 4)
    2.0106
    """
    radius_mm = 0.5 * config.process.wire_diameter_mm
    return math.pi * radius_mm * radius_mm


def bead_sections_mm2(nc: NCProgram, config: Config) -> Floats:
    """Section of the bead that each motion lays, (B,) mm2; NaN where wire or feed is not known, infinite without feed."""
    with np.errstate(divide="ignore", invalid="ignore"):
        mm3_s = nc.wire_mm_s * wire_section_mm2(config)
        return np.asarray(mm3_s / (nc.feed_mm_min / 60.0), np.float64)

"""The metal of each motion by its text alone, and where a layer is to have metal: section of the wire, speed, feed, allowance.

All of it is worked out anew here, and not taken from what gives the wire of a program its speed: a mistake there would else be
made on both sides of the balance, and every check of the metal would confirm it.
"""

from __future__ import annotations

import math

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from ebamcheck.nc.motions import NCProgram
from ebamcheck.numeric.rings import Floats
from ebamcheck.settings.config import Config

ROUND = 16
"""Chords in a quarter turn around a corner: at an allowance of 3 mm they err by 4 um."""


def wire_section_mm2(config: Config) -> float:
    """Area of the circle that the wire is in section.

    Examples
    --------
    >>> round(wire_section_mm2(Config()), 4)
    2.0106
    """
    radius_mm = 0.5 * config.process.wire_diameter_mm
    return math.pi * radius_mm * radius_mm


def wanted_region(section: BaseGeometry, config: Config) -> BaseGeometry:
    """Region that the metal of a layer is to fill: its section, and what is left for machining around it."""
    around_mm = config.process.machining_allowance_mm
    return shapely.buffer(section, around_mm, quad_segs=ROUND) if around_mm > 0.0 else section


def bead_height_mm(config: Config) -> float:
    """Height of one bead of the set wire and feed by itself: a parabola, two thirds of its width times its height.

    Examples
    --------
    >>> round(bead_height_mm(Config()), 3)
    1.676
    """
    process = config.process
    laid_mm2 = wire_section_mm2(config) * process.wire_speed_mm_s / process.travel_speed_mm_s
    return 1.5 * laid_mm2 / process.bead_width_mm


def bead_sections_mm2(nc: NCProgram, config: Config) -> Floats:
    """Section of the bead that each motion lays, (B,) mm2; NaN where wire or feed is not known, infinite without feed."""
    with np.errstate(divide="ignore", invalid="ignore"):
        mm3_s = nc.wire_mm_s * wire_section_mm2(config)
        return np.asarray(mm3_s / (nc.feed_mm_min / 60.0), np.float64)

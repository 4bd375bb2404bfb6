"""Plates divided into islands, and the times of their orders, for the tests of heat and orders."""

from __future__ import annotations

import numpy as np
import shapely

from ebamcheck.geometry.regions import layer_section
from ebamcheck.scan.order.entries import clocked
from ebamcheck.scan.plan.laying import LaidLayer, lay_islands
from ebamcheck.settings.config import Config

PROFILE = Config()
RAPID = PROFILE.machine.rapid_mm_s
FREE = np.zeros((1000, 1000), np.bool_)
"""No island touches another: none is kept from following any."""

PLATE = shapely.box(0, 0, 160, 110).difference(shapely.Point(95, 60).buffer(22, 32))


def laid_plate() -> LaidLayer:
    return lay_islands(layer_section(PLATE), PROFILE, 0, 10.0)


def islands_of(section, **scan):
    config = PROFILE.changed(scan=scan)
    return lay_islands(layer_section(section), config, 0, 10.0).choices(config, 0)


def times_of(islands, order):
    """Begin and end of each island, and the travel."""
    return clocked(islands.known_schedule, np.asarray(order), RAPID)

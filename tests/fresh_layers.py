"""A plate of islands and the times of its orders, for the tests of fresh heat."""

from __future__ import annotations

import numpy as np
import shapely

from ebamcheck.geometry.regions import layer_section
from ebamcheck.scan.order.entries import clocked
from ebamcheck.scan.plan.laying import lay_islands
from ebamcheck.settings.config import Config

PROFILE = Config()
RAPID = PROFILE.machine.rapid_mm_s
HEIGHT_MM = 10.0
PLATE = shapely.box(0, 0, 160, 110)


def islands_of(section, **scan):
    config = PROFILE.changed(scan=scan)
    return lay_islands(layer_section(section), config, 0, HEIGHT_MM).choices(config, 0)


def times_of(islands, order):
    schedule = islands.known_schedule
    return clocked(schedule, np.asarray(order), RAPID)

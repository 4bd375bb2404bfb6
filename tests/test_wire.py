"""Widths of beads, from which their wire follows."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from ebamcheck.heat.medium import width_limits_mm
from ebamcheck.settings.config import Config
from ebamcheck.settings.process_window import wire_speed_mm_s
from ebamcheck.writing.wire import WIDTH_DIGITS, rounded_widths

UNIT_MM = 10.0**-WIDTH_DIGITS


@given(st.floats(0.5, 8.0), st.floats(0.01, 8.0), st.lists(st.floats(0.0, 1.0), min_size=1))
def test_rounding_moves_a_width_by_less_than_its_last_decimal_and_over_no_limit(least, room, shares):
    limits = (least, least + room)
    width = least + room * np.array(shares)
    found = rounded_widths(width, limits)
    assert (found >= limits[0]).all()
    assert (found <= limits[1]).all()
    assert np.abs(found - width).max() <= UNIT_MM
    assert np.abs(found / UNIT_MM - np.round(found / UNIT_MM)).max() < 1e-6


def test_a_bead_of_the_least_width_gets_no_less_than_the_least_wire():
    # 3.3157 mm by rounding, which is 16.6665 mm/s of wire: less than the feeder gives.
    config = Config().changed(process={"bead_width_mm": 4.0, "wire_speed_mm_s": 20.0, "current_ma": 70.0})
    limits = width_limits_mm(config, config.layer_height_mm)
    assert round(limits[0], WIDTH_DIGITS) < limits[0]
    least = float(rounded_widths(np.array([limits[0]]), limits)[0])
    wire_mm_s = wire_speed_mm_s(config, least, config.layer_height_mm)
    assert wire_mm_s >= config.process.wire_speed_min_mm_s

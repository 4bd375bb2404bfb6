"""Checks of the process values that a program sets: volts, milliamperes, power, wire and feed, each by itself.

A product hides an exchange of its factors (120 kV and 60 mA are the power of 60 kV and 120 mA), and wide limits hide a
program that is half as fast throughout: each value is held against the one of the settings.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ebamcheck.program.checking.checks import Check, count_check, event_place
from ebamcheck.program.language.increments import increments_of
from ebamcheck.program.reading.motions import NCProgram
from ebamcheck.settings.config import Config
from ebamcheck.settings.feed_along import along_window

VALUE_TOLERANCE = 1e-3
"""Of a value: the decimals with which it is printed."""

WIRE_LIMIT_SHARE = 1e-3
"""The same of wire that stands at a limit of its feeder."""


def value_check(nc: NCProgram, config: Config) -> Check:
    """Every value that is set, and the feed of every motion that lays metal, against the settings of the process.

    Voltage, feed and length of wire drawn back are those of the settings, or 0 where beam or wire are off; current and power are at most
    those of the settings, since ramps and the heat of the part take from them; the wire is within the feeder's limits.
    """
    faults = [*_set_values(nc, config), *_feeds(nc, config)]
    faults.sort(key=lambda fault: fault[0])
    process = config.process
    good = (
        f"{process.voltage_kv:g} kV, up to {process.current_ma:g} mA, at {process.travel_speed_mm_s:g} mm/s"
    )
    return count_check("process values", [(where, what) for _, where, what in faults], good)


def _set_values(nc: NCProgram, config: Config) -> Iterator[tuple[int, str, str]]:
    process = config.process
    fixed = {
        "voltage_kv": (process.voltage_kv, "kV"),
        "wire_retract_mm": (process.wire_retract_mm, "mm of wire drawn back"),
    }
    greatest = {
        "current_ma": (process.current_ma, "mA"),
        "power_w": (process.power_w, "W"),
        "wire_mm_s": (process.wire_speed_max_mm_s, "mm/s of wire"),
    }
    steps = increments_of(config.machine)
    for i, name in enumerate(nc.events.name):
        half = 0.5 * steps.get(name, 0.0)
        value, row = float(nc.events.value[i]), int(nc.events.row[i])
        if name in fixed:
            wanted, unit = fixed[name]
            if value != 0.0 and not abs(value - wanted) <= VALUE_TOLERANCE * wanted + half:
                yield row, event_place(nc, i), f"{value:g} {unit} in place of {wanted:g} {unit}"
        elif name in greatest:
            limit, unit = greatest[name]
            if not 0.0 <= value <= limit * (1.0 + VALUE_TOLERANCE) + half:
                yield row, event_place(nc, i), f"{value:g} {unit}, at most {limit:g} {unit} are set"


def _feeds(nc: NCProgram, config: Config) -> Iterator[tuple[int, str, str]]:
    wanted = config.process.travel_speed_mm_s
    half = 0.5 * increments_of(config.machine).get("feed_mm_min", 0.0) / 60.0
    rows = np.flatnonzero(nc.deposit)
    feed, wire = nc.feed_mm_min[rows] / 60.0, nc.wire_mm_s[rows]
    process, (slow, fast) = config.process, along_window(config)
    for row, value, fed in zip(rows.tolist(), feed.tolist(), wire.tolist(), strict=True):
        room = VALUE_TOLERANCE * wanted + half
        if abs(value - wanted) <= room:
            continue
        where = nc.where(row)
        if not process.feed_along_path:
            yield row, where, f"feed {value:g} mm/s in place of {wanted:g} mm/s"
            continue
        slower = value < wanted
        limit = process.wire_speed_max_mm_s if slower else process.wire_speed_min_mm_s
        # The feed goes on where the wire ends, and nowhere else.
        if not abs(fed - limit) <= WIRE_LIMIT_SHARE * limit:
            what = f"feed {value:g} mm/s in place of {wanted:g} mm/s, where the wire has {fed:g} mm/s and not its limit of {limit:g} mm/s"
            yield row, where, what
        elif not slow * wanted - room <= value <= fast * wanted + room:
            yield (
                row,
                where,
                f"feed {value:g} mm/s, from {slow * wanted:g} to {fast * wanted:g} mm/s are in the process window",
            )

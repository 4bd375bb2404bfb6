"""Increments of process values: the least steps in which a control takes feed, power, volts, milliamperes and wire."""

from __future__ import annotations

from collections.abc import Mapping

from ebamcheck.settings.machine import MachineSettings


def increments_of(machine: MachineSettings) -> dict[str, float]:
    """Increment of each process value by the name of its placeholder, of those that have one."""
    every = {
        "feed_mm_min": machine.feed_increment_mm_min,
        "power_w": machine.power_increment_w,
        "voltage_kv": machine.voltage_increment_kv,
        "current_ma": machine.current_increment_ma,
        "wire_mm_s": machine.wire_increment_mm_s,
    }
    return {name: increment for name, increment in every.items() if increment > 0.0}


def to_increment(value: float, increment: float) -> float:
    """Round a value to the nearest multiple of an increment; what is not 0 does not become 0. An increment of 0 leaves it.

    Examples
    --------
    >>> to_increment(46.83, 0.5), to_increment(0.1, 0.5), to_increment(0.0, 0.5), to_increment(46.83, 0.0)
    (47.0, 0.5, 0.0, 46.83)
    """
    if increment <= 0.0 or value == 0.0:
        return value
    return max(round(value / increment), 1) * increment


def power_slack_w(machine: MachineSettings, voltage_kv: float, current_ma: float) -> float:
    """By how much the beam's power may differ for the increments of its values: half a step of each.

    Examples
    --------
    >>> power_slack_w(MachineSettings(current_increment_ma=1.0), 60.0, 120.0)
    30.0
    """
    found: Mapping[str, float] = increments_of(machine)
    product = found.get("voltage_kv", 0.0) * current_ma + found.get("current_ma", 0.0) * voltage_kv
    return 0.5 * max(product, found.get("power_w", 0.0))

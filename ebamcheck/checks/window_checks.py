"""Check that a program stays within the process window: wire speed, line energy and layer height of every bead."""

from __future__ import annotations

import numpy as np

from ebamcheck.checks.checks import Check, count_check
from ebamcheck.checks.metal import bead_height_mm, wire_section_mm2
from ebamcheck.nc.motions import NCProgram
from ebamcheck.numeric.rings import Floats, Ints
from ebamcheck.settings.config import Config

ROUNDING = 1e-5
"""Of a figure: process values are printed with six decimals, wire speeds with the fewest."""


def window_check(nc: NCProgram, config: Config) -> Check:
    """Each value of every motion that lays metal, their ratios, and the step of Z of every layer, within their limits.

    Wire speed, feed, line energy, metal over length and energy over metal by motion; volts and milliamperes where they are set.
    A ramp belongs to its bead; but the wire runs along it, too, and what does not melt there stays in the part.
    """
    process = config.process
    rows = np.flatnonzero(nc.deposit)
    feed_mm_s = nc.feed_mm_min[rows] / 60.0
    # That of the bead: its greatest, which ramps rise to and fall from. One that is not known makes that of its bead one, too.
    beads = nc.beads.among(rows)
    power_w = beads.greatest(nc.power_w[rows])[beads.bead]
    fed = nc.wire[rows]
    laid = rows[fed]
    with np.errstate(divide="ignore", invalid="ignore"):
        energy = power_w / feed_mm_s
        metal_mm3_s = wire_section_mm2(config) * nc.wire_mm_s[laid]
        section, heat = metal_mm3_s / feed_mm_s[fed], power_w[fed] / metal_mm3_s
        own_heat = nc.power_w[laid] / metal_mm3_s
    ramp = nc.power_w[laid] < power_w[fed]
    least, greatest = process.wire_speed_min_mm_s, process.wire_speed_max_mm_s
    inside = rows[nc.layer[rows] >= 0]
    layers, first = np.unique(nc.layer[inside], return_index=True)
    over_bead = layer_steps_mm(nc, config)[layers] / bead_height_mm(config)
    known = np.isfinite(over_bead)
    faults = [
        *_outside(laid, nc.wire_mm_s[laid], (least, greatest), "mm/s of wire"),
        *_outside(rows, energy, process.line_energy_j_mm, "J/mm of line energy"),
        *_outside(rows, feed_mm_s, process.travel_window_mm_s, "mm/s along a bead"),
        *_outside(laid, section, process.bead_section_mm2, "mm2 of metal over the length of a bead"),
        *_outside(laid, heat, process.metal_energy_j_mm3, "J/mm3 of the wire that is melted"),
        *_outside(laid[ramp], own_heat[ramp], process.metal_energy_j_mm3, "J/mm3 of the wire along a ramp"),
        *_set_values(nc, config),
        *_outside(
            inside[first][known], over_bead[known], process.layer_over_bead, "of a bead's height a layer"
        ),
    ]
    faults.sort(key=lambda fault: fault[0])
    wire = f"wire {least:.4g} .. {greatest:.4g} mm/s"
    energies = "line energy {:g} .. {:g} J/mm".format(*process.line_energy_j_mm)
    heights = "layers {:g} .. {:g} of a bead".format(*process.layer_over_bead)
    places = [(nc.where(row), what) for row, what in faults]
    return count_check("process window", places, f"{wire}, {energies}, {heights}")


def _set_values(nc: NCProgram, config: Config) -> list[tuple[int, str]]:
    """Volts and milliamperes that are set outside of their windows; 0 switches off, and ramps rise from less."""
    process = config.process
    low, high = process.current_window_ma
    low *= process.ramp_power if process.ramps_beam else 1.0
    # The current of a layer is a share of the one that is set, down to the least at which the wire melts.
    windows = {
        "voltage_kv": (process.voltage_window_kv, "kV"),
        "current_ma": ((low, min(high, process.current_max_ma)), "mA"),
    }
    found, events = [], nc.events
    for i in np.flatnonzero(events.named(*windows) & (events.value != 0.0) & bool(len(nc))):
        window, unit = windows[events.name[i]]
        found += _outside(np.minimum(events.row[[i]], len(nc) - 1), events.value[[i]], window, unit)
    return found


def layer_steps_mm(nc: NCProgram, config: Config) -> Floats:
    """Height of each layer by the steps of Z, (L,) mm; NaN where it or the one below it has no bead."""
    return np.diff(nc.layer_heights, prepend=config.base_mm)


def _outside(rows: Ints, values: Floats, limits: tuple[float, float], what: str) -> list[tuple[int, str]]:
    """Motions whose value is outside of its limits, or is not known, and what it is."""
    low, high = limits
    bad = ~((values >= low * (1.0 - ROUNDING)) & (values <= high * (1.0 + ROUNDING)))
    return [
        (int(row), f"{_apart(float(value), limits)} {what}, allowed are {low:.4g} .. {high:.4g}")
        for row, value in zip(rows[bad], values[bad], strict=True)
    ]


def _apart(value: float, limits: tuple[float, float]) -> str:
    """Write a value with four digits, or as many as tell it from its limits.

    Examples
    --------
    >>> _apart(9.0, (16.6667, 100.0)), _apart(16.666479, (16.666667, 100.0))
    ('9', '16.666')
    """
    for digits in range(4, 17):
        text = f"{value:.{digits}g}"
        if text not in [f"{limit:.{digits}g}" for limit in limits]:
            break
    return text

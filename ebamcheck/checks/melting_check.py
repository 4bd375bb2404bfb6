"""Whether the beam melts the wire of each bead: power, feed and wire of every motion, as they stand in the program."""

from __future__ import annotations

import numpy as np

from ebamcheck.checks.checks import Check
from ebamcheck.checks.heat_again import melting_power_w
from ebamcheck.checks.metal import wire_section_mm2
from ebamcheck.checks.window_checks import layer_steps_mm
from ebamcheck.nc.increments import power_slack_w
from ebamcheck.nc.motions import NCProgram
from ebamcheck.numeric.rings import Bools, Floats, Ints
from ebamcheck.settings.config import Config

MELTING = "melting power"
"""Name of the check."""

MELTING_TOLERANCE = 1e-3
"""Share of the power: the decimals of voltage, current and wire speed."""

WIDER = 1.0005
"""Metal over that of one spacing from which on a bead has its own power: widths and wire speeds are rounded in a program."""


def spread_mm(nc: NCProgram, rows: Ints, config: Config) -> Floats:
    """Height of what motions (n,) lay where their metal is spread over one spacing, mm; NaN without a feed."""
    with np.errstate(divide="ignore", invalid="ignore"):
        section = wire_section_mm2(config) * nc.wire_mm_s[rows] / (nc.feed_mm_min[rows] / 60.0)
    laid = np.where(nc.wire[rows], section, 0.0)
    return np.asarray(laid / (config.process.bead_width_mm * config.process.bead_spacing), np.float64)


def own_shares(nc: NCProgram, rows: Ints, config: Config) -> Floats:
    """Share of the full power, (n,), that motions need for themselves since they lay more than one spacing; 0 for others.

    Written anew here: a fault of the writer would else confirm itself.
    """
    process, spread = config.process, np.nan_to_num(spread_mm(nc, rows, config), posinf=0.0)
    full_w = process.voltage_kv * process.current_ma
    metal_mm3_s = spread * process.bead_width_mm * process.bead_spacing * process.travel_speed_mm_s
    need_w = np.maximum(melting_power_w(config, spread), process.metal_energy_j_mm3[0] * metal_mm3_s)
    step_mm = np.append(layer_steps_mm(nc, config), np.nan)[nc.layer[rows]]
    wider = spread > WIDER * np.where(step_mm > 0.0, step_mm, config.layer_height_mm)
    return np.where(wider, np.minimum(need_w / full_w, 1.0), 0.0)


def melting_check(nc: NCProgram, config: Config, on_ramp: Bools) -> Check:
    """Power of every motion that lays metal over the least at which its wire, and what it remelts, melts.

    Parameters
    ----------
    on_ramp
        (n,) which of the motions that lay metal are on a ramp of their bead: there the pool is made, or ends, and the window of
        the process holds (`process.metal_energy_j_mm3`).
    """
    rows = np.flatnonzero(nc.deposit)[~on_ramp]
    need_w = melting_power_w(config, spread_mm(nc, rows, config))
    rows, need_w = rows[need_w > 0.0], need_w[need_w > 0.0]
    if not rows.size:
        return Check(MELTING, True, 0.0, 1.0, "of the power needed", "", "nothing is laid")
    power_w = np.nan_to_num(nc.power_w[rows])
    slack_w = power_slack_w(config.machine, config.process.voltage_kv, config.process.current_ma)
    value = (power_w + slack_w) / need_w
    worst = int(np.argmin(value))
    row = int(rows[worst])
    text = (
        f"a bead of layer {nc.layer[row] + 1} has {power_w[worst]:.6g} W, its wire of {nc.wire_mm_s[row]:.6g} mm/s and the metal "
        f"that it remelts need {need_w[worst]:.6g} W"
    )
    passed = bool(value[worst] >= 1.0 - MELTING_TOLERANCE)
    return Check(
        MELTING,
        passed,
        float(power_w[worst] / need_w[worst]),
        1.0,
        "of the power needed",
        nc.where(row),
        text,
    )

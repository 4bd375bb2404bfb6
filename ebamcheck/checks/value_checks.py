"""Checks of wire, power and feed of every bead: its metal, whether the beam melts it, and the window of the process."""

from __future__ import annotations

import math

import numpy as np

from ebamcheck.checks.checks import Check, count_check, worst_check
from ebamcheck.checks.heat_again import melting_power_w
from ebamcheck.checks.metal import bead_height_mm, bead_sections_mm2, wire_section_mm2
from ebamcheck.checks.tolerances import VALUE_SHARE, WINDOW_SHARE, WIRE_PLACE_MM, WIRE_TOLERANCE
from ebamcheck.heat.melting import width_limits_mm
from ebamcheck.nc.increments import increments_of, power_slack_w
from ebamcheck.nc.inputs import TrackColumns
from ebamcheck.nc.motions import NCProgram
from ebamcheck.numeric.rings import Bools, Floats, Ints
from ebamcheck.settings.config import Config

MELTING = "melting power"  # Name of the check
# Metal over that of one spacing from which on a bead has its own power: widths and wire speeds are rounded in a program.
WIDER = 1.0005


def wire_check(nc: NCProgram, config: Config, path: TrackColumns | None) -> Check:
    """Check the metal that each motion lays: wire speed times its section over the feed, against what it is to be.

    With the path that was planned, every bead has its own width; without it, the limits of the wire feed and of the pool
    hold.
    """
    rows = np.flatnonzero(nc.deposit & (nc.layer >= 0))
    bead_mm2 = bead_sections_mm2(nc, config)[rows]
    if path is None:
        return _within_limits(nc, rows, bead_mm2, config)
    wanted = _wanted_mm2(nc, rows, path)
    if wanted is None:
        text = "beads of the program are not those of the plan: their wire cannot be compared"
        where = nc.where(int(rows[0])) if rows.size else f"{nc.files[0].name}:1"
        return Check("mass balance", False, math.inf, WIRE_TOLERANCE, "of the bead", where, text)
    with np.errstate(divide="ignore", invalid="ignore"):
        off = np.abs(bead_mm2[:, None] / wanted - 1.0).min(axis=1) - _rounded(nc, rows, config)
    off = np.maximum(off, 0.0)
    return worst_check(
        "mass balance", nc, rows, off, WIRE_TOLERANCE, "of the bead", "metal of beads against the plan"
    )


def _within_limits(nc: NCProgram, rows: Ints, bead_mm2: Floats, config: Config) -> Check:
    """Check the beads of layers whose height the program tells: those over a layer with beads, and the lowest."""
    thickness = np.diff(nc.layer_heights, prepend=config.base_mm)[nc.layer[rows]]
    known = np.isfinite(thickness)
    rows, width, thickness = (
        rows[known],
        (bead_mm2 / np.where(known, thickness, 1.0))[known],
        thickness[known],
    )
    steps, step = np.unique(thickness, return_inverse=True)
    limits = np.array([width_limits_mm(config, float(h)) for h in steps]).reshape(-1, 2)[step]
    with np.errstate(divide="ignore", invalid="ignore"):
        off = np.maximum(limits[:, 0] / width, width / limits[:, 1]) - 1.0 - _rounded(nc, rows, config)
    off = np.maximum(off, 0.0)
    what = "metal of beads beyond what wire feed and pool allow"
    return worst_check("mass balance", nc, rows, off, WIRE_TOLERANCE, "of the bead", what)


def _rounded(nc: NCProgram, rows: Ints, config: Config) -> Floats:
    """Share of its metal by which each motion may be off for the increments of wire and feed, (n,): half a step of each."""
    steps = increments_of(config.machine)
    with np.errstate(divide="ignore", invalid="ignore"):
        wire = steps.get("wire_mm_s", 0.0) / nc.wire_mm_s[rows]
        feed = steps.get("feed_mm_min", 0.0) / nc.feed_mm_min[rows]
    return np.asarray(0.5 * np.nan_to_num(wire + feed, posinf=0.0), np.float64)


def _wanted_mm2(nc: NCProgram, rows: Ints, path: TrackColumns) -> Floats | None:
    """Sections that the plan asks for at and just beside the middle of each motion, (n, 3) mm2; None where beads differ."""
    ends = np.cumsum(path.lengths)
    bounds = np.concatenate([[0.0], ends])[
        path.track_starts[np.concatenate([[True], np.diff(path.track_starts) > 0])]
    ]
    height = np.repeat(path.thickness, np.diff(path.layer_starts))[np.diff(path.track_starts) > 0]
    beads = nc.beads.among(rows)
    middle, whole = beads.middles(nc.lengths[rows])
    if whole.size != bounds.size - 1:
        return None
    # Forms of curves differ in length by their tolerance: places are compared as shares of the bead.
    scale = np.diff(bounds) / np.maximum(whole, np.finfo(float).tiny)
    track = beads.bead
    at = bounds[:-1][track] + middle * scale[track]
    beside = np.stack([at - WIRE_PLACE_MM, at, at + WIRE_PLACE_MM], axis=1)
    beside = np.clip(beside, bounds[:-1][track][:, None] + 1e-9, bounds[1:][track][:, None] - 1e-9)
    segment = np.minimum(np.searchsorted(ends, beside), ends.size - 1)
    return np.asarray(path.width[segment] * height[track][:, None], np.float64)


# -- melting -------------------------------------------------------------------------------------------


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

    On a ramp (n,) of a bead the pool is made, or ends, and the window of the process holds (`process.metal_energy_j_mm3`).
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
    passed = bool(value[worst] >= 1.0 - VALUE_SHARE)
    return Check(
        MELTING,
        passed,
        float(power_w[worst] / need_w[worst]),
        1.0,
        "of the power needed",
        nc.where(row),
        text,
    )


# -- process window ------------------------------------------------------------------------------------


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
    bad = ~((values >= low * (1.0 - WINDOW_SHARE)) & (values <= high * (1.0 + WINDOW_SHARE)))
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

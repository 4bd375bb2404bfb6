"""Checks of values, wire, power and feed of every bead, by the settings and the window of the process; and which settings judge
loosely."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from operator import attrgetter

import numpy as np

from ebamcheck.checks.checks import (
    PRINTED,
    VALUE_SHARE,
    WINDOW_SHARE,
    WIRE_PLACE_MM,
    WIRE_TOLERANCE,
    Faults,
    count_check,
    limit_check,
    worst_check,
)
from ebamcheck.checks.heat_again import melting_power_w
from ebamcheck.checks.metal import bead_height_mm, bead_sections_mm2, wire_section_mm2
from ebamcheck.heat.medium import width_limits_mm
from ebamcheck.kernels import Bools, Floats, Ints
from ebamcheck.nc.conventions import increments_of, power_slack_w
from ebamcheck.nc.inputs import TrackColumns
from ebamcheck.nc.motions import NCProgram
from ebamcheck.result import Check
from ebamcheck.settings.config import Config
from ebamcheck.settings.materials import MaterialSettings, preset
from ebamcheck.settings.process_window import along_window

MELTING = "melting power"  # Name of the check
WIDER = 1.0005  # Metal over that of one spacing from which on a bead has its own power: values are rounded

At = tuple[int, str, str]  # Motions before it, where it is, and what is wrong


def _by_row(faults: Iterable[At]) -> Faults:
    return [(where, what) for _, where, what in sorted(faults, key=lambda fault: fault[0])]


def wire_check(nc: NCProgram, config: Config, path: TrackColumns | None) -> Check:
    """Check the metal that each motion lays: wire speed times its section over the feed, against what it is to be.
    With the path that was planned, every bead has its own width; without it, the limits of the wire feed and of the pool hold."""
    name, what = "mass balance", "metal of beads against the plan"
    rows = np.flatnonzero(nc.deposit & (nc.layer >= 0))
    bead_mm2 = bead_sections_mm2(nc, config)[rows]
    with np.errstate(divide="ignore", invalid="ignore"):
        if path is None:
            what = "metal of beads beyond what wire feed and pool allow"
            thickness = layer_steps_mm(nc, config)[nc.layer[rows]]
            known = np.isfinite(thickness)
            rows, thickness = rows[known], thickness[known]
            width = bead_mm2[known] / thickness
            steps, step = np.unique(thickness, return_inverse=True)
            limits = np.array([width_limits_mm(config, float(h)) for h in steps]).reshape(-1, 2)[step]
            off = np.maximum(limits[:, 0] / width, width / limits[:, 1]) - 1.0
        else:
            wanted = _wanted_mm2(nc, rows, path)
            if wanted is None:
                text = "beads of the program are not those of the plan: their wire cannot be compared"
                where = nc.where(int(rows[0])) if rows.size else f"{nc.files[0].name}:1"
                return limit_check(name, math.inf, WIRE_TOLERANCE, "of the bead", text, where)
            off = np.abs(bead_mm2[:, None] / wanted - 1.0).min(axis=1)
        # Half an increment of wire and feed each is no fault.
        increments = increments_of(config.machine)
        wire = increments.get("wire_mm_s", 0.0) / nc.wire_mm_s[rows]
        feed = increments.get("feed_mm_min", 0.0) / nc.feed_mm_min[rows]
    off = np.maximum(off - 0.5 * np.nan_to_num(wire + feed, posinf=0.0), 0.0)
    return worst_check(name, nc, rows, off, WIRE_TOLERANCE, "of the bead", what)


def _wanted_mm2(nc: NCProgram, rows: Ints, path: TrackColumns) -> Floats | None:
    """Sections that the plan asks for at and just beside the middle of each motion, (n, 3) mm2; None where beads differ."""
    ends, filled = np.cumsum(path.lengths), np.diff(path.track_starts) > 0
    bounds = np.concatenate([[0.0], ends])[path.track_starts[np.append(True, filled)]]
    height = np.repeat(path.thickness, np.diff(path.layer_starts))[filled]
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


def spread_mm(nc: NCProgram, rows: Ints, config: Config) -> Floats:
    """Height of what motions (n,) lay where their metal is spread over one spacing, mm; NaN without a feed."""
    with np.errstate(divide="ignore", invalid="ignore"):
        section = wire_section_mm2(config) * nc.wire_mm_s[rows] / (nc.feed_mm_min[rows] / 60.0)
    laid = np.where(nc.wire[rows], section, 0.0)
    return np.asarray(laid / (config.process.bead_width_mm * config.process.bead_spacing), np.float64)


def own_shares(nc: NCProgram, rows: Ints, config: Config) -> Floats:
    """Share of the full power, (n,), that motions need for themselves since they lay more than one spacing; 0 for others."""
    process, spread = config.process, np.nan_to_num(spread_mm(nc, rows, config), posinf=0.0)
    full_w = process.voltage_kv * process.current_ma
    metal_mm3_s = spread * process.bead_width_mm * process.bead_spacing * process.travel_speed_mm_s
    need_w = np.maximum(melting_power_w(config, spread), process.metal_energy_j_mm3[0] * metal_mm3_s)
    step_mm = np.append(layer_steps_mm(nc, config), np.nan)[nc.layer[rows]]
    wider = spread > WIDER * np.where(step_mm > 0.0, step_mm, config.layer_height_mm)
    return np.where(wider, np.minimum(need_w / full_w, 1.0), 0.0)


def melting_check(nc: NCProgram, config: Config, on_ramp: Bools) -> Check:
    """Power of every motion that lays metal over the least at which its wire, and what it remelts, melts; ramps (n,) are left out.
    There the pool is made, or ends, and the window of the process holds (`process.metal_energy_j_mm3`)."""
    rows, unit = np.flatnonzero(nc.deposit)[~on_ramp], "of the power needed"
    need_w = melting_power_w(config, spread_mm(nc, rows, config))
    rows, need_w = rows[need_w > 0.0], need_w[need_w > 0.0]
    if not rows.size:
        return Check(MELTING, True, 0.0, 1.0, unit, "", "nothing is laid")
    power_w = np.nan_to_num(nc.power_w[rows])
    slack_w = power_slack_w(config.machine, config.process.voltage_kv, config.process.current_ma)
    value = (power_w + slack_w) / need_w
    worst = int(np.argmin(value))
    row, passed = int(rows[worst]), bool(value[worst] >= 1.0 - VALUE_SHARE)
    text = (
        f"a bead of layer {nc.layer[row] + 1} has {power_w[worst]:.6g} W, its wire of {nc.wire_mm_s[row]:.6g} mm/s and the metal "
        f"that it remelts need {need_w[worst]:.6g} W"
    )
    return Check(MELTING, passed, float(power_w[worst] / need_w[worst]), 1.0, unit, nc.where(row), text)


def window_check(nc: NCProgram, config: Config) -> Check:
    """Each value of every motion that lays metal, their ratios, and the step of Z of every layer, within their limits.
    A ramp belongs to its bead; but the wire runs along it, too, and what does not melt there stays in the part."""
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
    wire_window = least, greatest = process.wire_speed_min_mm_s, process.wire_speed_max_mm_s
    inside = rows[nc.layer[rows] >= 0]
    layers, first = np.unique(nc.layer[inside], return_index=True)
    over_bead = layer_steps_mm(nc, config)[layers] / bead_height_mm(config)
    known = np.isfinite(over_bead)
    low, high = process.current_window_ma
    # Ramps rise from less. The current of a layer is a share of the one that is set, down to the least at which the wire melts.
    low *= process.ramp_power if process.ramps_beam else 1.0
    current_window = low, min(high, process.current_max_ma)
    faults = [
        *_outside(nc, laid, nc.wire_mm_s[laid], wire_window, "mm/s of wire"),
        *_outside(nc, rows, energy, process.line_energy_j_mm, "J/mm of line energy"),
        *_outside(nc, rows, feed_mm_s, process.travel_window_mm_s, "mm/s along a bead"),
        *_outside(nc, laid, section, process.bead_section_mm2, "mm2 of metal over the length of a bead"),
        *_outside(nc, laid, heat, process.metal_energy_j_mm3, "J/mm3 of the wire that is melted"),
        *_outside(nc, laid[ramp], own_heat[ramp], process.metal_energy_j_mm3, "J/mm3 of the wire along a ramp"),
    ]
    windows = {"voltage_kv": (process.voltage_window_kv, "kV"), "current_ma": (current_window, "mA")}
    e = nc.events
    # A value of 0 switches off.
    for i in np.flatnonzero(e.named(*windows) & (e.value != 0.0) & bool(len(nc))):
        window, unit = windows[e.name[i]]
        faults += _outside(nc, np.minimum(e.row[[i]], len(nc) - 1), e.value[[i]], window, unit)
    begins, what = inside[first][known], "of a bead's height a layer"
    faults += _outside(nc, begins, over_bead[known], process.layer_over_bead, what)
    energies = "line energy {:g} .. {:g} J/mm".format(*process.line_energy_j_mm)
    heights = "layers {:g} .. {:g} of a bead".format(*process.layer_over_bead)
    good = f"wire {least:.4g} .. {greatest:.4g} mm/s, {energies}, {heights}"
    return count_check("process window", _by_row(faults), good)


def layer_steps_mm(nc: NCProgram, config: Config) -> Floats:
    """Height of each layer by the steps of Z, (L,) mm; NaN where it or the one below it has no bead."""
    return np.diff(nc.layer_heights, prepend=config.base_mm)


def _outside(nc: NCProgram, rows: Ints, values: Floats, limits: tuple[float, float], what: str) -> list[At]:
    """Motions whose value is outside of its limits, or is not known, and what it is."""
    low, high = limits
    bad = ~((values >= low * (1.0 - WINDOW_SHARE)) & (values <= high * (1.0 + WINDOW_SHARE)))
    said = f"{what}, allowed are {low:.4g} .. {high:.4g}"
    each = zip(rows[bad].tolist(), values[bad].tolist(), strict=True)
    return [(row, nc.where(row), f"{_apart(value, limits)} {said}") for row, value in each]


def _apart(value: float, limits: tuple[float, float]) -> str:
    """Write a value with four digits, or as many as tell it from its limits.

    >>> _apart(9.0, (16.6667, 100.0)), _apart(16.666479, (16.666667, 100.0))
    ('9', '16.666')
    """
    for digits in range(4, 17):
        text = f"{value:.{digits}g}"
        if text not in [f"{limit:.{digits}g}" for limit in limits]:
            break
    return text


def value_check(nc: NCProgram, config: Config) -> Check:
    """Every value that is set, and the feed of every motion that lays metal, against the settings of the process. A product hides
    an exchange of its factors (120 kV and 60 mA are the power of 60 kV and 120 mA), and wide limits hide a program that is half as
    fast throughout: so each value is held against the one of the settings."""
    process = config.process
    speeds = f"up to {process.current_ma:g} mA, at {process.travel_speed_mm_s:g} mm/s"
    faults = _by_row([*_set_values(nc, config), *_feeds(nc, config)])
    return count_check("process values", faults, f"{process.voltage_kv:g} kV, {speeds}")


def _set_values(nc: NCProgram, config: Config) -> Iterator[At]:
    process, steps, e = config.process, increments_of(config.machine), nc.events
    # What a value is to be, or 0; or what it is at most.
    limits = {
        "voltage_kv": (True, process.voltage_kv, "kV"),
        "wire_retract_mm": (True, process.wire_retract_mm, "mm of wire drawn back"),
        "current_ma": (False, process.current_ma, "mA"),
        "power_w": (False, process.power_w, "W"),
        "wire_mm_s": (False, process.wire_speed_max_mm_s, "mm/s of wire"),
    }
    for i in np.flatnonzero(e.named(*limits)).tolist():
        name, value, row = e.name[i], float(e.value[i]), int(e.row[i])
        (fixed, limit, unit), half = limits[name], 0.5 * steps.get(name, 0.0)
        if fixed and value != 0.0 and not abs(value - limit) <= VALUE_SHARE * limit + half:
            yield row, nc.where_event(i), f"{value:g} {unit} in place of {limit:g} {unit}"
        elif not fixed and not 0.0 <= value <= limit * (1.0 + VALUE_SHARE) + half:
            yield row, nc.where_event(i), f"{value:g} {unit}, at most {limit:g} {unit} are set"


def _feeds(nc: NCProgram, config: Config) -> Iterator[At]:
    process, (slow, fast) = config.process, along_window(config)
    wanted = process.travel_speed_mm_s
    room = VALUE_SHARE * wanted + 0.5 * increments_of(config.machine).get("feed_mm_min", 0.0) / 60.0
    rows = np.flatnonzero(nc.deposit)
    feed, wire = nc.feed_mm_min[rows] / 60.0, nc.wire_mm_s[rows]
    off = ~(np.abs(feed - wanted) <= room)
    for row, value, fed in zip(rows[off].tolist(), feed[off].tolist(), wire[off].tolist(), strict=True):
        limit = process.wire_speed_max_mm_s if value < wanted else process.wire_speed_min_mm_s
        what = f"feed {value:g} mm/s in place of {wanted:g} mm/s"
        # The feed goes on where the wire ends, and nowhere else.
        if process.feed_along_path and not abs(fed - limit) <= VALUE_SHARE * limit:
            what += f", where the wire has {fed:g} mm/s and not its limit of {limit:g} mm/s"
        elif process.feed_along_path and slow * wanted - room <= value <= fast * wanted + room:
            continue
        elif process.feed_along_path:
            what = f"feed {value:g} mm/s, from {slow * wanted:g} to {fast * wanted:g} mm/s are in the process window"
        yield row, nc.where(row), what


def increment_check(nc: NCProgram, config: Config) -> Check:
    """Check values that are set, and feeds along beads, against the increments of the machine profile."""
    steps, e, faults = increments_of(config.machine), nc.events, list[At]()
    for name, step in sorted(steps.items(), key=lambda one: one[0] == "feed_mm_min"):
        feed = name == "feed_mm_min"
        at = np.flatnonzero(nc.deposit if feed else e.named(name))
        values = nc.feed_mm_min[at] if feed else e.value[at]
        between = ~(np.abs(values - np.round(values / step) * step) <= PRINTED)
        for i, value in zip(at[between].tolist(), values[between].tolist(), strict=True):
            said = f"feed {value:g} mm/min" if feed else f"{name} {value:g}"
            row, where = (i, nc.where(i)) if feed else (int(e.row[i]), nc.where_event(i))
            faults.append((row, where, f"{said} is no multiple of {step:g}"))
    known = ", ".join(f"{name} {step:g}" for name, step in steps.items())
    good = f"values are multiples of {known}" if known else "the profile names none (machine.*_increment_*)"
    return count_check("increments", _by_row(faults), good)


WIDER_IF_GREATER = (
    "comparison.tolerance_mm", "comparison.evidence_share", "comparison.doubt_mm", "curves.largest_lift_mm",
    "curves.largest_bulge_mm", "curves.section_tolerance_mm", "scan.gap_width", "process.mass_tolerance",
    "process.inside_tolerance", "process.edge_tolerance", "process.outside_share", "process.outside_reach_mm",
    "process.longest_wait_s", "process.wire_speed_max_mm_s", "process.melting_efficiency", "machine.smoothing_tolerance_mm",
)  # fmt: skip
WIDER_IF_LESS = (
    "scan.least_coverage", "process.wire_speed_min_mm_s", "process.dilution", "machine.clearance_mm",
)  # fmt: skip
# Settings that are a least and a greatest value.
WINDOWS = (
    "process.layer_over_bead", "process.line_energy_j_mm", "process.voltage_window_kv", "process.current_window_ma",
    "process.travel_window_mm_s", "process.bead_section_mm2", "process.metal_energy_j_mm3",
)  # fmt: skip
OF_PREHEATING = ("preheat.over_k", "preheat.evenness_k")  # Limits of a preheating, where there is one
MOST_SLACK = 0.01  # Share of the power that increments may change unsaid: no check of the power sees less
TOLD = 4  # Settings that are told by name


def loose_limits(config: Config) -> Iterator[Check]:
    """Tell which limits are wider than the default ones, each with both values, and which data of a known material are others."""
    kept = (
        "gates are judged by limits wider than the default ones",
        "say why on the certificate, or go back to the default limits",
    )
    others = (
        f"heat and melting are judged by data that are not those of {config.material.name}",
        "say where they come from on the certificate, or leave them out",
    )
    for found, code, unit, (text, remedy) in (
        (list(_other_material(config)), "material-data", "values", others),
        (list(_wider(config)), "limit-widened", "limits", kept),
    ):
        if found:
            more = f" and {len(found) - TOLD} more" if len(found) > TOLD else ""
            text = f"{text}: {', '.join(found[:TOLD])}{more}"
            place, count = found[0].split()[0], float(len(found))
            yield Check.finding("warning", code, text, place, count, 0.0, unit, remedy)


def _wider(config: Config) -> Iterator[str]:
    """Limits that are wider than by default, and windows that reach beyond the default ones on either side."""
    default, process, hottest_k = Config(), config.process, config.material.interpass_limit_k
    greater = WIDER_IF_GREATER + (OF_PREHEATING if config.preheat.when != "off" else ())
    for names, sign in ((greater, 1.0), (WIDER_IF_LESS, -1.0)):
        for name in names:
            value, usual = (attrgetter(name)(one) for one in (config, default))
            if sign * (value - usual) > 0.0:
                yield f"{name} {value:g} (default {usual:g})"
    for name in WINDOWS:
        (low, high), (least, greatest) = (attrgetter(name)(one) for one in (config, default))
        if low < least or high > greatest:
            yield f"{name} {low:g} .. {high:g} (default {least:g} .. {greatest:g})"
    # Limits whose default follows from other settings.
    unevenness_mm, half_mm = process.largest_unevenness_mm, 0.5 * process.bead_width_mm
    if unevenness_mm > half_mm:
        yield f"process.surface_tolerance_mm {unevenness_mm:g} (default {half_mm:g})"
    if process.interpass_limit_k is not None and process.interpass_limit_k > hottest_k:
        yield f"process.interpass_limit_k {process.interpass_limit_k:g} (of the material {hottest_k:g})"
    if process.interpass_at != "bead":
        yield f"process.interpass_at {process.interpass_at} (default bead)"
    slack = power_slack_w(config.machine, process.voltage_kv, process.current_ma) / process.power_w
    if slack > MOST_SLACK:
        names = ("power_increment_w", "current_increment_ma", "voltage_increment_kv")
        name = next(n for n in names if getattr(config.machine, n))
        yield f"machine.{name} {getattr(config.machine, name):g} (the power may be {100.0 * slack:.3g} % off for it)"


def _other_material(config: Config) -> Iterator[str]:
    """Data beside the name of a known material that are not those of that material."""
    material = config.material
    if preset(material.name) is None:
        return
    usual = MaterialSettings(name=material.name)
    for name in MaterialSettings.model_fields:
        value, known = getattr(material, name), getattr(usual, name)
        if value != known:
            both = isinstance(value, float) and isinstance(known, float)
            yield f"material.{name}" + (f" {value:g} (usual {known:g})" if both else "")

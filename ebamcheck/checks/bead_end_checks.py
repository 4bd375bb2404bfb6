"""Checks of where and how beads start and end: power along its ramps and their time, overlap of contours, wire drawn back.

A ramp is programmed by its length; what the pool sees is how long it takes, by the feed. The wire runs along all of a bead (check
``wire``), so that its lead-in is that of the beam.
"""

from __future__ import annotations

import numpy as np

from ebamcheck.checks.checks import Check, count_check, worst_check
from ebamcheck.checks.event_checks import retract_check
from ebamcheck.checks.melting_check import own_shares
from ebamcheck.checks.tolerances import PLACE_MM, VALUE_SHARE
from ebamcheck.nc.increments import power_slack_w
from ebamcheck.nc.inputs import SHORTEST_BLOCK_MM
from ebamcheck.nc.motions import NCProgram
from ebamcheck.numeric.rings import Bools, Floats, Ints
from ebamcheck.settings.config import Config

ROUNDING_MM = 2.0 * SHORTEST_BLOCK_MM
"""Length by which a ramp is shorter or longer, since it ends with a block that is near."""


def bead_end_checks(nc: NCProgram, config: Config, shares: Floats) -> list[Check]:
    """Check power, overlap and wire at the ends of all beads; `shares` (L,) of the power are those of the layers."""
    checks = [_power(nc, config, shares), _overlap(nc, config)]
    if config.process.wire_retract_mm > 0.0:
        checks.append(retract_check(nc, config))
    if nc.goes_on.any():
        checks.append(_parts_of_lines(nc))
    return checks


def _power(nc: NCProgram, config: Config, shares: Floats) -> Check:
    """Power of every deposit against that of its layer, or what its wire needs; on ramps against the straight ramp, within half a step."""
    process = config.process
    rows = np.flatnonzero(nc.deposit)
    share = nc.power_w[rows] / process.power_w
    wanted, step = ramp_power(nc, rows, config)
    # A program may have layers that the plan does not know.
    known = (nc.layer[rows] >= 0) & (nc.layer[rows] < shares.size)
    of_layer = np.ones(rows.size)
    of_layer[known] = shares[nc.layer[rows[known]]]
    of_layer = np.maximum(of_layer, own_shares(nc, rows, config))
    slack_w = power_slack_w(config.machine, process.voltage_kv, process.current_ma)
    wanted, step = wanted * of_layer, step * of_layer + slack_w / process.power_w
    off = np.maximum(np.abs(share - wanted) - step, 0.0)
    off[np.isnan(share)] = np.nan
    found = worst_check(
        "power", nc, rows, off, VALUE_SHARE, "of the power set", "deviation of the beam power"
    )
    highest = float(np.nanmax(nc.power_w[rows], initial=0.0))
    within = highest <= process.voltage_kv * process.current_max_ma * (1.0 + VALUE_SHARE) + slack_w
    text = f"{highest:g} W in the program, {process.power_w:g} W set"
    if (shares < 1.0).any():
        text += f", {np.nanmin(shares) * process.power_w:g} W in the layer of the least"
    if process.ramps_beam:
        lowest = float(np.nanmin(nc.power_w[rows], initial=highest))
        text += f", ramps from {lowest:g} W over {process.ramp_up_mm:g} mm and to it over {process.crater_fill_mm:g} mm"
    return Check("power", found.passed and within, found.value, VALUE_SHARE, found.unit, found.where, text)


def ramp_power(nc: NCProgram, rows: Ints, config: Config) -> tuple[Floats, Floats]:
    """Share of the full power in the middle of each motion, and how far a step of the ramp may be from it."""
    process = config.process
    if not process.ramps_beam:
        return np.ones(rows.size), np.zeros(rows.size)
    beads = nc.beads.among(rows)
    middle, whole = beads.middles(nc.lengths[rows])
    # Written anew here: a fault of the writer's ramps would else confirm itself.
    share = np.minimum(1.0, whole / (process.ramp_up_mm + process.crater_fill_mm))[beads.bead]
    up, down = share * process.ramp_up_mm, share * process.crater_fill_mm
    to_end = whole[beads.bead] - middle
    wanted = np.ones(rows.size)
    for along, length in ((middle, up), (to_end, down)):
        with np.errstate(divide="ignore", invalid="ignore"):
            risen = process.ramp_power + (1.0 - process.ramp_power) * along / length
        wanted = np.where(along < length, np.minimum(wanted, risen), wanted)
    # A motion may be shorter than a step, anywhere on it, and a step may begin at the end of a block that is near.
    on_ramp = (middle < up + SHORTEST_BLOCK_MM) & (up > 0.0)
    on_ramp |= (to_end < down + SHORTEST_BLOCK_MM) & (down > 0.0)
    rise = 1.0 - process.ramp_power
    shortest = np.minimum(np.where(up > 0.0, up, np.inf), np.where(down > 0.0, down, np.inf))
    allowed = rise * (0.5 / process.ramp_steps + np.minimum(SHORTEST_BLOCK_MM / shortest, 1.0))
    return wanted, np.where(on_ramp, allowed, 0.0)


def ramp_check(nc: NCProgram, config: Config) -> Check:
    """Check how long the beam of each bead rises and falls, by feed and length of its blocks, against the windows of the process."""
    process = config.process
    rows = np.flatnonzero(nc.deposit)
    beads = nc.beads.among(rows)
    if not rows.size:
        return count_check("ramps in time", [], "nothing is laid")
    with np.errstate(divide="ignore", invalid="ignore"):
        time_s = np.nan_to_num(60.0 * nc.lengths[rows] / nc.feed_mm_min[rows], posinf=0.0)
    rise, fall = _times(nc.power_w[rows], time_s, beads.bead)
    long = beads.total(nc.lengths[rows]) >= process.ramp_up_mm + process.crater_fill_mm
    slack_s = ROUNDING_MM / process.travel_speed_mm_s
    faults = [
        *_outside(nc, beads.first, rise, long, process.ramp_up_window_s, slack_s, "the beam rises to its full power in"),
        *_outside(nc, beads.last, fall, long, process.crater_fill_window_s, slack_s, "the beam falls to the end of its bead in"),
    ]  # fmt: skip
    faults.sort(key=lambda fault: fault[0])
    good = f"the beam rises in {rise.min():.3g} .. {rise.max():.3g} s and falls in {fall.min():.3g} .. {fall.max():.3g} s"
    return count_check("ramps in time", [(nc.where(row), what) for row, what in faults], good)


def _times(power_w: Floats, time_s: Floats, bead: Ints) -> tuple[Floats, Floats]:
    """Seconds (P,) of each bead before its first motion at full power, and after the last one."""
    first, stop = (np.searchsorted(bead, np.arange(bead[-1] + 1), side=side) for side in ("left", "right"))
    full = np.flatnonzero(power_w >= np.fmax.reduceat(power_w, first)[bead] * (1.0 - VALUE_SHARE))
    begins, ends = first.copy(), stop - 1
    begins[bead[full][::-1]] = full[::-1]
    ends[bead[full]] = full
    sums = np.concatenate([[0.0], np.cumsum(time_s)])
    return sums[begins] - sums[first], sums[stop] - sums[ends + 1]


def _outside(
    nc: NCProgram,
    row: Ints,
    times_s: Floats,
    long: Bools,
    window_s: tuple[float, float] | None,
    slack_s: float,
    what: str,
) -> list[tuple[int, str]]:
    """Beads whose time is outside of a window; one that is shorter than both ramps may take less."""
    if window_s is None:
        return []
    low, high = window_s
    bad = (times_s > high + slack_s) | (long & (times_s < low - slack_s))
    return [
        (int(row[k]), f"{what} {times_s[k]:.3g} s, allowed are {low:g} .. {high:g} s")
        for k in np.flatnonzero(bad)
    ]


def _overlap(nc: NCProgram, config: Config) -> Check:
    """Length by which each closed contour runs on over its start, against the one set or once around."""
    rows = np.flatnonzero(nc.deposit & (nc.ring >= 0))
    beads, over, length = nc.beads.among(rows), nc.overlap[rows], nc.lengths[rows]
    driven, whole = beads.total(np.where(over, length, 0.0)), beads.total(np.where(over, 0.0, length))
    closed = (nc.end[beads.last, :2] == nc.start[beads.first, :2]).all(axis=1) | (driven > 0.0)
    off = np.where(closed, np.abs(driven - np.minimum(config.process.overlap_mm, whole)), 0.0)
    what = f"off {config.process.overlap_mm:g} mm of overlap of {int(closed.sum())} closed contours"
    return worst_check("overlap of contours", nc, beads.last, off, 2.0 * SHORTEST_BLOCK_MM, "mm", what)


def _parts_of_lines(nc: NCProgram) -> Check:
    """Distance of the places where hatch lines change their power from the straight line."""
    rows = np.flatnonzero(nc.goes_on)
    vectors = nc.vectors()
    owner = np.searchsorted(vectors["row"].to_numpy(), rows, side="right") - 1
    a, b = vectors[["x0", "y0"]].to_numpy()[owner], vectors[["x1", "y1"]].to_numpy()[owner]
    way, place = b - a, nc.start[rows, :2] - a
    whole = np.hypot(way[:, 0], way[:, 1])
    with np.errstate(divide="ignore", invalid="ignore"):
        along = (place * way).sum(axis=1) / whole
        away = np.abs(way[:, 0] * place[:, 1] - way[:, 1] * place[:, 0]) / whole
    # A part on its own, on a ring, or beyond the line's ends is none.
    sound = (owner >= 0) & (nc.island[rows] >= 0) & nc.deposit[rows] & nc.deposit[rows - 1]
    sound &= (nc.island[rows] == nc.island[rows - 1]) & (along >= 0.0) & (along <= whole)
    what = "distance of their parts from the line"
    return worst_check("parts of hatch lines", nc, rows, np.where(sound, away, np.inf), PLACE_MM, "mm", what)

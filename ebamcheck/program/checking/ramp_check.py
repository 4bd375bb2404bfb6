"""Check of the ramps of the beam in time: from the start of a bead to its full power, and from there to its end.

A ramp is programmed by its length; what the pool sees is how long it takes, by the feed. The wire runs along all of a bead (check
``wire``), so that its lead-in is that of the beam.
"""

from __future__ import annotations

import numpy as np

from ebamcheck.numeric.rings import Bools, Floats, Ints
from ebamcheck.program.checking.checks import Check, count_check
from ebamcheck.program.reading.motions import NCProgram
from ebamcheck.program.toolpath.bead_parts import SHORTEST_BLOCK_MM
from ebamcheck.settings.config import Config

NAME = "ramps in time"

FULL = 1e-3
"""Power over the greatest of its bead from which on it is full, less than 1: the decimals of volts and milliamperes."""

ROUNDING_MM = 2.0 * SHORTEST_BLOCK_MM
"""Length by which a ramp is shorter or longer, since it ends with a block that is near."""


def ramp_check(nc: NCProgram, config: Config) -> Check:
    """Check how long the beam of each bead rises and falls, by feed and length of its blocks, against the windows of the process."""
    process = config.process
    rows = np.flatnonzero(nc.deposit)
    bead = nc.tracks(rows)
    count = int(bead.max(initial=-1)) + 1
    if not count:
        return count_check(NAME, [], "nothing is laid")
    first = np.searchsorted(bead, np.arange(count))
    last = np.searchsorted(bead, np.arange(count), side="right") - 1
    with np.errstate(divide="ignore", invalid="ignore"):
        time_s = np.nan_to_num(60.0 * nc.lengths[rows] / nc.feed_mm_min[rows], posinf=0.0)
    rise, fall = _times(nc.power_w[rows], time_s, bead, first, last)
    whole = np.bincount(bead, nc.lengths[rows], minlength=count)
    long = whole >= process.ramp_up_mm + process.crater_fill_mm
    slack_s = ROUNDING_MM / process.travel_speed_mm_s
    faults = [
        *_outside(nc, rows[first], rise, long, process.ramp_up_window_s, slack_s, "the beam rises to its full power in"),
        *_outside(nc, rows[last], fall, long, process.crater_fill_window_s, slack_s, "the beam falls to the end of its bead in"),
    ]  # fmt: skip
    faults.sort(key=lambda fault: fault[0])
    good = f"the beam rises in {rise.min():.3g} .. {rise.max():.3g} s and falls in {fall.min():.3g} .. {fall.max():.3g} s"
    return count_check(NAME, [(nc.where(row), what) for row, what in faults], good)


def _times(power_w: Floats, time_s: Floats, bead: Ints, first: Ints, last: Ints) -> tuple[Floats, Floats]:
    """Seconds (P,) of each bead before its first motion at full power, and after the last one."""
    most = np.full(first.size, -np.inf)
    np.fmax.at(most, bead, power_w)
    full = np.flatnonzero(power_w >= most[bead] * (1.0 - FULL))
    begins, ends = first.copy(), last.copy()
    begins[bead[full][::-1]] = full[::-1]
    ends[bead[full]] = full
    sums = np.concatenate([[0.0], np.cumsum(time_s)])
    return sums[begins] - sums[first], sums[last + 1] - sums[ends + 1]


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

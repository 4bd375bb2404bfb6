"""Waits and power that keep a layer under the interpass limit.

A layer has full power while no bead of it is entered above the limit, then the greatest power at which none is, down
to the least at which the wire melts. Where that is too much still, the beam waits: before the layer, before each further
contour, and before islands, each time until the next bead may be entered. Less power never takes longer, since speed and
wire stay; so power comes first, and the waits are what is left to do. With `process.interpass` "dwell" or "power" one of
the two is left out.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from ebamcheck.heat.balance import LayerShape
from ebamcheck.heat.melting import entry_limit_k, least_power_share, scheduled_share
from ebamcheck.numeric.rings import Floats
from ebamcheck.scan.heat.part_heat import Beads, PartHeat
from ebamcheck.settings.config import Config

MARGIN = 0.01
"""Share of the limit's rise over ambient by which a plan stays under it: waits are whole seconds, and the program rounds."""

LONGEST_WAIT_S = 4.0 * 3600.0
"""What does not cool down to the limit in this time is not waited for; the heat gate says so."""

PERCENT = 100
"""Steps of the power's share."""


@dataclass(frozen=True, eq=False)
class Drive:
    """One layer as it is driven.

    Parameters
    ----------
    power_share
        Share of the beam's power.
    wait_s, ring_wait_s
        Wait before the layer, and before each further contour.
    bead_wait_s
        (B,) waits before the beads, those of the contours included but for the first.
    bed_k, mean_k
        (B,) what each bead finds at its place when it is entered, and the mean over the section then, absolute, K.
    body_k
        Mean temperature rise of the part under the layer when it is begun, K.
    enter_k, leave_k
        Mean temperature of the surface when the layer is begun, and when it is done, absolute, K.
    time_s
        Time of the layer, moves and waits within it included.
    after
        The part's heat when it is done.
    """

    power_share: float
    wait_s: float
    ring_wait_s: float
    bead_wait_s: Floats
    bed_k: Floats
    mean_k: Floats
    body_k: float
    enter_k: float
    leave_k: float
    time_s: float
    after: PartHeat


@dataclass(frozen=True, eq=False)
class LayerJob:
    """What a layer needs to be driven: its beads, its shape, and where it lies.

    Parameters
    ----------
    beads
        In the sequence in which they are laid.
    shape
        Of the layer that is laid.
    height_mm
        Its height over the base plate.
    lowest
        Whether nothing lies under it, so that there is nothing to wait for.
    """

    beads: Beads
    shape: LayerShape
    height_mm: float
    lowest: bool


def cool_drive(job: LayerJob, found: PartHeat, profile: Config) -> Drive:
    """Choose power and waits of a layer by the settings, and drive it.

    Parameters
    ----------
    found
        The part's heat when the layer under it is done, in the modes of this layer.
    """
    share = power_share(job, found, profile)
    waits = profile.process.interpass in ("dwell", "both")
    ring_wait_s = 0.0
    while True:
        driven = drive(job, found, profile, share, waits, ring_wait_s)
        assert driven is not None
        if (driven.bead_wait_s[1 : job.beads.rings] == driven.ring_wait_s).all():
            return driven
        ring_wait_s = driven.ring_wait_s


def power_share(job: LayerJob, found: PartHeat, profile: Config) -> float:
    """Share of the power of a layer: that of the table, or the greatest at which no bead is entered above the limit."""
    scheduled = scheduled_share(profile, job.height_mm)
    if scheduled is not None:
        return scheduled
    if profile.process.interpass not in ("power", "both"):
        return 1.0
    least = min(1.0, least_power_share(profile, job.shape.thickness_mm))
    low, high = math.ceil(PERCENT * least), PERCENT

    def fits(percent: int) -> bool:
        return drive(job, found, profile, percent / PERCENT, waits=False, keep=True) is not None

    if fits(high):
        return 1.0
    if low >= high or not fits(low):
        return min(low / PERCENT, 1.0)
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if fits(middle) else (low, middle)
    return low / PERCENT


def drive(
    job: LayerJob,
    found: PartHeat,
    profile: Config,
    share: float,
    waits: bool,
    ring_wait_s: float = 0.0,
    keep: bool = False,
) -> Drive | None:
    """Drive a layer at a share of the power.

    Parameters
    ----------
    waits
        Wait wherever a bead would be entered above the limit.
    ring_wait_s
        Wait before each further contour at least: they share one, the longest that one of them asks for.
    keep
        Give up, with None, as soon as a bead is entered above the limit.
    """
    beads, process = job.beads, profile.process
    ambient_k = process.ambient_temperature_k
    limit_k = entry_limit_k(profile)
    limit_k -= MARGIN * max(limit_k - ambient_k, 0.0)
    power_w = share * process.power_w * profile.material.absorptivity
    part = found.copy()
    pause_s = 0.0 if job.lowest else process.layer_pause_s
    bed_k, mean_k, bead_wait_s = (np.zeros(len(beads)) for _ in range(3))
    body_k = enter_k = time_s = wait_s = 0.0
    for bead in range(len(beads)):
        first = bead == 0
        checked = first or process.interpass_at == "bead"
        away_s, rise_s = float(beads.move_s[bead]) + (pause_s if first else 0.0), float(beads.rise_s[bead])
        found_k = partial(_found_k, part, beads.shape(bead), away_s, rise_s)
        wait = 0.0
        if checked and waits and not (first and job.lowest):
            wait = shortest_wait_s(found_k, limit_k)
        if 0 < bead < beads.rings:
            ring_wait_s = wait = max(wait, ring_wait_s)
        away_s += wait + rise_s if wait > 0.0 else 0.0
        # All at once, as the balance of the text has it: the same steps of time give the same figures.
        part.rest(away_s)
        bed_k[bead], mean_k[bead] = part.bed_k(beads.shape(bead)), part.column.bed_k
        if keep and checked and bed_k[bead] > limit_k:
            return None
        if first:
            wait_s = pause_s + wait
            body_k, enter_k = part.column.mean_rise_k, part.column.bed_k
            part.column.lay(job.shape)
        else:
            bead_wait_s[bead] = wait
        time_s += away_s - (wait_s if first else 0.0)
        part.lay_bead(beads, bead, power_w)
        time_s += float(beads.time_s[beads.first[bead] : beads.first[bead + 1]].sum())
    return Drive(
        share, wait_s, ring_wait_s, bead_wait_s, bed_k, mean_k, body_k, enter_k, part.column.surface_k, time_s,
        part,
    )  # fmt: skip


def _found_k(part: PartHeat, shape: Floats, away_s: float, rise_s: float, wait_s: float) -> float:
    """What a bead finds after the way to it and a wait, for which the beam rises."""
    return part.bed_k(shape, away_s + (wait_s + rise_s if wait_s > 0.0 else 0.0))


def shortest_wait_s(bed_k: Callable[[float], float], limit_k: float) -> float:
    """Shortest wait after which a bead finds no more than the limit, whole seconds; 0 where none is long enough."""
    if bed_k(0.0) <= limit_k:
        return 0.0
    low, high = 0, 1
    while bed_k(float(high)) > limit_k:
        low, high = high, 2 * high
        if high > LONGEST_WAIT_S:
            return 0.0
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if bed_k(float(middle)) <= limit_k else (middle, high)
    return float(high)

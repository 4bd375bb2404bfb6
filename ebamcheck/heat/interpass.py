"""Waits and power that keep a layer under the interpass limit.

A layer has full power while no bead of it is entered above the limit, then the greatest power at which none is, down
to the least at which the wire melts. Where that is too much still, the beam waits: before the layer, before each further
contour, before islands, and before each further bead of an island, each time until the next bead may be entered. A bead is
entered wherever the beam comes on. Less power never takes longer, since speed and wire stay; so power comes first, and the
waits are what is left to do. With `process.interpass` "dwell" or "power" one of
the two is left out.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np

from ebamcheck.heat.balance import LayerShape
from ebamcheck.heat.field import Field
from ebamcheck.heat.medium import entry_limit_k, least_power_share, scheduled_share
from ebamcheck.heat.part_heat import AgedColumns, Beads, PartHeat
from ebamcheck.kernels import Floats
from ebamcheck.settings.config import Config
from ebamcheck.settings.process_window import least_window_share

# Share of the limit's rise over ambient by which a plan stays under it: waits are whole seconds, and the program rounds
MARGIN = 0.01
# What does not cool down to the limit in this time is not waited for; the heat gate says so
LONGEST_WAIT_S = 4.0 * 3600.0
PERCENT = 100  # steps of the power's share


@dataclass(frozen=True, eq=False)
class SimulatedLayer:
    """One layer as it is simulated, with a share of the beam's power. Temperatures are absolute, but for the rise `body_mean_k`."""

    power_share: float
    wait_s: float  # before the layer
    ring_wait_s: float  # before each further contour
    bead_wait_s: Floats  # (B,) before each bead but the first; further beads of one island share the longest that one of them asks for
    bed_k: Floats  # (B,) what each bead finds at its place when it is entered
    mean_k: Floats  # (B,) mean over the section then
    body_mean_k: float  # mean rise of the part under the layer when it is begun
    enter_k: float  # mean of the surface when the layer is begun
    leave_k: float  # the same when it is done
    time_s: float  # moves and waits within the layer included
    after: PartHeat  # the part's heat when the layer is done


@dataclass(frozen=True, eq=False)
class LayerJob:
    """What a layer needs to be simulated."""

    beads: Beads  # in the sequence in which they are laid
    shape: LayerShape
    height_mm: float  # over the base plate
    lowest: bool  # nothing lies under it, so that there is nothing to wait for


def cooled_layer(job: LayerJob, found: PartHeat, config: Config, guess: float = 0.0) -> SimulatedLayer:
    """Choose power and waits of a layer by the settings, and simulate it.

    `found`: the part's heat when the layer under it is done, in the modes of this layer; `guess`: share of the power of the layer
    below: that of this one is found sooner where it is near.
    """
    kept: dict[float, SimulatedLayer] = {}
    share = power_share(job, found, config, guess, kept)
    if share in kept:
        # No bead is over the limit, so that none waits: it would be the same layer, simulated again.
        return kept[share]
    waits = config.process.interpass in ("dwell", "both")
    ring_wait_s = 0.0
    while True:
        done = simulate(job, found, config, share, waits, ring_wait_s)
        assert done is not None
        if (done.bead_wait_s[1 : job.beads.rings] == done.ring_wait_s).all():
            return done
        ring_wait_s = done.ring_wait_s


def power_share(
    job: LayerJob, found: PartHeat, config: Config, guess: float, kept: dict[float, SimulatedLayer]
) -> float:
    """Share of the power of a layer: that of the table, or the greatest at which no bead is entered above the limit.

    The search begins at a guess; its result is the same wherever it begins, since less power is never hotter. The layer at each
    share that was tried and fits is `kept`.
    """
    scheduled = scheduled_share(config, job.height_mm)
    if scheduled is not None:
        return scheduled
    if config.process.interpass not in ("power", "both"):
        return 1.0
    melts = least_power_share(config, job.shape.thickness_mm)
    least = min(1.0, max(melts, least_window_share(config)))
    low, high = math.ceil(PERCENT * least), PERCENT

    def fits(percent: int) -> bool:
        done = simulate(job, found, config, percent / PERCENT, waits=False, keep=True)
        if done is not None:
            kept[percent / PERCENT] = done
        return done is not None

    if fits(high):
        return 1.0
    if low >= high:
        return min(low / PERCENT, 1.0)
    return greatest_that_fits(fits, low, high, round(PERCENT * guess)) / PERCENT


def greatest_that_fits(fits: Callable[[int], bool], low: int, high: int, guess: int) -> int:
    """Greatest whole number from `low` to under `high` that fits, where all under one that fits do; `low` where none does.

    From the guess the search goes up or down in steps that double, and then halves what is left. `high` does not fit.

    >>> greatest_that_fits(lambda n: n <= 70, 40, 100, 68)
    70
    """
    known, step = False, 1
    if low < guess < high:
        if fits(guess):
            low, known = guess, True
            while low + step < high and fits(low + step):
                low, step = low + step, 2 * step
            high = min(high, low + step)
        else:
            high = guess
            while high - step > low and not fits(high - step):
                high, step = high - step, 2 * step
            if high - step > low:
                low, known = high - step, True
    if not known and not fits(low):
        return low
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if fits(middle) else (low, middle)
    return low


def simulate(
    job: LayerJob,
    found: PartHeat,
    config: Config,
    share: float,
    waits: bool,
    ring_wait_s: float = 0.0,
    keep: bool = False,
) -> SimulatedLayer | None:
    """Simulate a layer at a share of the power.

    `waits`: wait wherever a bead would be entered above the limit; `ring_wait_s`: wait before each further contour at least: they
    share one, the longest that one of them asks for; `keep`: give up, with None, as soon as a bead is entered above the limit.
    """
    run = _Run(job, config, share, found.copy(), waits, keep)
    beads, bead = job.beads, 0
    while bead < len(beads):
        if beads.inner[bead]:
            others = np.flatnonzero(~beads.inner[bead:])
            last = bead + int(others[0]) if len(others) else len(beads)
            done = run.lay_island(bead, last)
            bead = last
        else:
            done = run.lay(bead, ring_wait_s if 0 < bead < beads.rings else 0.0)
            if 0 < bead < beads.rings:
                ring_wait_s = max(ring_wait_s, float(run.wait_s[bead]))
            bead += 1
        if not done:
            return None
    return run.result(ring_wait_s)


class _Run:
    """A layer while it is simulated: the part's heat, and waits and temperatures, bead by bead."""

    def __init__(self, job: LayerJob, config: Config, share: float, part: PartHeat, waits: bool, keep: bool) -> None:
        process, limit_k = config.process, entry_limit_k(config)
        self.part = part
        self.wait_s, self.bed_k, self.mean_k, self.away_s = (np.zeros(len(job.beads)) for _ in range(4))
        self._job, self._share, self._waits, self._keep = job, share, waits, keep
        self._beads = job.beads.at_share(share)
        self._limit_k = limit_k - MARGIN * max(limit_k - process.ambient_temperature_k, 0.0)
        self._power_w = process.power_w * config.material.absorptivity
        self._pause_s = 0.0 if job.lowest else process.layer_pause_s
        self._every = process.interpass_at == "bead"
        self._body_k = self._enter_k = 0.0
        self._before: Field | None = None  # what differs across the section when the island of further beads is begun
        self._begun = 0  # its first bead

    def lay_island(self, first: int, last: int) -> bool:
        """Lay the further beads of an island, each after the same wait; False where one is too hot and none is waited for."""
        begun, least_s = self.part, 0.0
        while True:
            self.part = begun.copy()
            if not all(self.lay(bead, least_s) for bead in range(first, last)):
                return False
            longest_s = float(self.wait_s[first:last].max())
            if (self.wait_s[first:last] == longest_s).all():
                return True
            least_s = longest_s

    def lay(self, bead: int, least_s: float) -> bool:
        """Wait, not less than `least_s`, and lay a bead; False where it is too hot and that ends the simulation."""
        beads, first = self._job.beads, bead == 0
        checked = first or self._every
        move_s = float(beads.move_s[bead]) + (self._pause_s if first else 0.0)
        rise_s, shape = float(beads.rise_s[bead]), beads.shapes[bead]
        part, before, aged = self.part, self._own_apart(bead), AgedColumns(self.part.column)

        def away_s(wait_s: float) -> float:
            """Time with the beam off before the bead; where it waits, the beam rises."""
            return move_s + (wait_s + rise_s if wait_s > 0.0 else 0.0)

        @cache
        def bed_k(wait_s: float) -> float:
            # All at once, as the balance of the text has it: the same steps of time give the same figures.
            return part.bed_k(shape, away_s(wait_s), before, aged)

        wait_s = 0.0
        if checked and self._waits and not (first and self._job.lowest):
            wait_s = shortest_wait_s(bed_k, self._limit_k)
        wait_s = max(wait_s, least_s)
        self.bed_k[bead] = bed_k(wait_s)
        if not beads.inner[bead]:
            self._before, self._begun = None, bead
        part.rest(away_s(wait_s), aged)
        self.mean_k[bead] = part.column.bed_k
        if self._keep and checked and self.bed_k[bead] > self._limit_k:
            return False
        if not beads.inner[bead] and beads.inner[bead + 1 : bead + 2].any():
            self._before = part.field.copy()
        if first:
            self._body_k, self._enter_k = part.column.mean_rise_k, self.mean_k[0]
            part.column.lay(self._job.shape)
        self.wait_s[bead], self.away_s[bead] = wait_s, away_s(wait_s)
        part.lay_bead(self._beads, bead, self._power_w)
        return True

    def _own_apart(self, bead: int) -> tuple[Field, float] | None:
        """Field before the island of a further bead was begun, and the time from then until the bead before it is done, s."""
        if self._before is None or not self._job.beads.inner[bead]:
            return None
        first, time_s = self._job.beads.first, self._job.beads.time_s
        laid_s = float(time_s[first[self._begun] : first[bead]].sum())
        return self._before, laid_s + float(self.away_s[self._begun + 1 : bead].sum())

    def result(self, ring_wait_s: float) -> SimulatedLayer:
        """Summary of the whole layer."""
        bead_wait_s = self.wait_s.copy()
        bead_wait_s[:1] = 0.0
        before_s = self._pause_s + float(self.wait_s[:1].sum())
        time_s = float(self.away_s.sum()) - before_s + float(self._job.beads.time_s.sum())
        return SimulatedLayer(
            self._share, before_s, ring_wait_s, bead_wait_s, self.bed_k, self.mean_k, self._body_k, self._enter_k,
            self.part.column.surface_k, time_s, self.part,
        )  # fmt: skip


def shortest_wait_s(bed_k: Callable[[float], float], limit_k: float) -> float:
    """Shortest wait after which a bead finds no more than the limit, whole seconds; 0 where none is long enough.

    What a bead finds falls with the wait, ever more slowly. So a line through two waits reaches the limit too early: the next wait
    that is tried is where it does, and where it is not past that, twice as long a wait or half of what is left.
    """
    low, low_k = 0.0, bed_k(0.0)
    if low_k <= limit_k:
        return 0.0
    high, high_k = 1.0, bed_k(1.0)
    while high_k > limit_k:
        if 2.0 * high > LONGEST_WAIT_S:
            return 0.0
        slope = (low_k - high_k) / (high - low)
        reached = high + (high_k - limit_k) / slope if slope > 0.0 else math.inf
        low, low_k = high, high_k
        high = float(math.ceil(min(max(reached, high + 1.0), 4.0 * high)))
        high_k = bed_k(high)
    while high - low > 1.0:
        # Between the two the line lies over what is found: it reaches the limit too late, by less the nearer they are.
        reached = low + (high - low) * (low_k - limit_k) / (low_k - high_k)
        middle = min(max(math.floor(reached), low + 1.0), high - 1.0)
        found_k = bed_k(middle)
        if found_k <= limit_k:
            high, high_k = middle, found_k
        else:
            low, low_k = middle, found_k
    return high

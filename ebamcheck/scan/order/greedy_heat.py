"""One plan by heat, island by island: the next one is that with the least score when the beam gets there.

The score of an island is its temperature at the time it would be entered, plus the travel to it and the start of the
wire, each at its price in kelvin; see :mod:`ebamcheck.scan.order.thermal`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Bools, Floats, Ints
from ebamcheck.scan.filling.schedule import IslandSchedule
from ebamcheck.scan.filling.turns import JOINED_MM
from ebamcheck.scan.heat.aged_heat import Modes, Timetable, by_depth, late_modes, read_surface, with_late_heat
from ebamcheck.scan.heat.island_heat import IslandHeat
from ebamcheck.scan.heat.near_field import NearField, young_rise
from ebamcheck.scan.order.annealing import power
from ebamcheck.scan.order.entry_options import nearest_option
from ebamcheck.scan.order.path import Touching

TIE_K = 1e-6
"""Scores closer than this are equal: rounding must not decide between islands that mirror each other."""

SURELY = 1.01
"""A plan is given up as too hot when its entries, between whose times it takes old heat as linear, are it by this factor."""


def greedy_order(
    heat: IslandHeat,
    schedule: IslandSchedule,
    beside: Touching,
    rapid_mm_s: float,
    first: int,
    price_k_mm: float,
    start_k: float,
    most_k: float = np.inf,
) -> Ints:
    """Order islands by heat for one price of travel (K/mm) and of a wire start (K).

    A plan whose :func:`~ebamcheck.scan.order.annealing.high_mean` is more than `most_k` as soon as that of the islands so far
    is, as far as the plan knows it; then they alone are returned, to be looked at.
    """
    layer = _Layer(
        heat.modes, heat.fresh, beside, schedule.entry, schedule.leave, schedule.time_s, rapid_mm_s
    )
    prices = _Prices(price_k_mm, start_k)
    return coolest_first(layer, prices, first, heat.modes.mean.copy(), heat.start_k, most_k)


class _Layer(NamedTuple):
    """What a greedy plan reads; see :class:`~ebamcheck.scan.filling.schedule.IslandSchedule`."""

    modes: Modes
    near: NearField
    beside: Touching
    entry: Floats
    leave: Floats
    time_s: Floats
    rapid_mm_s: float


class _Prices(NamedTuple):
    """What travel and a start of the wire cost in the choice of the next island."""

    travel_k_mm: float
    start_k: float


class _Greedy(NamedTuple):
    """A greedy plan while it grows, by island (I,) but for its order."""

    order: Ints
    start_s: Floats
    end_s: Floats
    option: Ints
    scanned: Bools
    jump_mm: Floats
    """Travel to an island that is left, ..."""
    by: Ints
    """... and its entry option then."""
    fresh_mean_k: Floats
    fresh_entry_k: Floats
    touches: Ints
    """Place in the order of the last island that an island touches."""


@kernel
def _begun(count: int) -> _Greedy:
    """Room for a plan of some islands."""
    return _Greedy(
        np.empty(count, np.int64),
        np.empty(count),
        np.empty(count),
        np.empty(count, np.int64),
        np.zeros(count, np.bool_),
        np.empty(count),
        np.empty(count, np.int64),
        np.zeros(count),
        np.zeros(count),
        np.full(count, -1),
    )


@kernel
def coolest_first(
    layer: _Layer, prices: _Prices, first: int, mean: Floats, start: Floats, most_k: float
) -> Ints:
    """Order by score; `mean` (K, I) is used up, and `start` (K, N) are the amplitudes that the layer begins with.

    Old heat, of which the modes have all, is linear between the earliest and the latest entry. It ends with the island by
    which the high mean of all is more than `most_k`.
    """
    count, horizon = mean.shape[1], layer.near.horizon_s
    plan = _begun(count)
    aged, state = late_modes(layer.modes, horizon), by_depth(start)
    ahead, early, late = np.empty_like(state), np.empty(len(mean)), np.empty(len(mean))
    left = np.arange(count)
    now, soon = np.empty(count), np.empty(count)
    latest = _longest_jump_s(layer)
    clock, reached = 0.0, 0
    place, option, jump = first, 0, 0.0
    read_surface(state, layer.modes.in_layer, early)
    entry_k, powers, most = _rise(mean, early, first), 0.0, count * power(SURELY * most_k)
    for n in range(count):
        island = left[place]
        plan.order[n] = island
        last, plan.start_s[island] = clock, clock + jump / layer.rapid_mm_s
        clock = plan.start_s[island] + layer.time_s[island]
        plan.option[island], plan.end_s[island], plan.scanned[island] = option, clock, True
        timetable = Timetable(plan.order[: n + 1], plan.start_s, plan.end_s)
        reached = with_late_heat(state, aged, timetable, horizon, last, clock, reached)
        rest = count - n - 1
        powers += power(entry_k)
        if rest == 0 or powers > most:
            break
        # The last island takes the place of the one that was scanned: those left stay side by side.
        left[place] = left[rest]
        mean[:, place] = mean[:, rest]
        ahead[:] = state
        with_late_heat(ahead, aged, timetable, horizon, clock, clock + latest, reached)
        read_surface(state, layer.modes.in_layer, early)
        read_surface(ahead, layer.modes.in_layer, late)
        _set_old_heat(mean, early, late, now[:rest], soon[:rest])
        x, y = layer.leave[island, option, 0], layer.leave[island, option, 1]
        for candidate in left[:rest]:
            plan.jump_mm[candidate], plan.by[candidate] = nearest_option(layer.entry[candidate], x, y)
        _set_fresh_heat(layer, plan, n)
        for m in range(layer.beside.first[island], layer.beside.first[island + 1]):
            plan.touches[layer.beside.other[m]] = n
        place, entry_k = _coolest(layer, plan, n, left[:rest], now, soon, latest, prices)
        option, jump = plan.by[left[place]], plan.jump_mm[left[place]]
    return plan.order[: n + 1]


@kernel
def _longest_jump_s(layer: _Layer) -> float:
    """Time of a jump along both sides of the layer's bounding rectangle, which none exceeds."""
    longest = 0.0
    for axis in range(2):
        longest += np.ptp(layer.entry[:, :, axis]) / layer.rapid_mm_s
    return longest


@kernel
def _rise(mean: Floats, surface: Floats, island: int) -> float:
    """Rise of one island by amplitudes (K,), by the means (K, I)."""
    rise = 0.0
    for k in range(len(surface)):
        rise += surface[k] * mean[k, island]
    return rise


@kernel
def _set_old_heat(mean: Floats, early: Floats, late: Floats, now: Floats, soon: Floats) -> None:
    """Rises of the islands left by two amplitudes (K,), by their means (K, I), which are read once, four modes in one pass."""
    now[:], soon[:] = 0.0, 0.0
    paired = len(mean) // 4 * 4
    for k in range(0, paired, 4):
        a, b, c, d = early[k], early[k + 1], early[k + 2], early[k + 3]
        e, f, g, h = late[k], late[k + 1], late[k + 2], late[k + 3]
        for j in range(len(now)):
            p, q, r, s = mean[k, j], mean[k + 1, j], mean[k + 2, j], mean[k + 3, j]
            now[j] = now[j] + a * p + b * q + c * r + d * s
            soon[j] = soon[j] + e * p + f * q + g * r + h * s
    for k in range(paired, len(mean)):
        for j in range(len(now)):
            now[j] += early[k] * mean[k, j]
            soon[j] += late[k] * mean[k, j]


@kernel
def _set_fresh_heat(layer: _Layer, plan: _Greedy, n: int) -> None:
    """What heat younger than the horizon, of the first n + 1 islands, does to those left: their means and entries."""
    near, source, now = layer.near, layer.modes.source_k_s, plan.end_s[plan.order[n]]
    plan.fresh_mean_k[:] = 0.0
    plan.fresh_entry_k[:] = 0.0
    for earlier in range(n, -1, -1):
        last = plan.order[earlier]
        if now - plan.end_s[last] > near.horizon_s:
            break
        for p in range(near.first[last], near.first[last + 1]):
            i = near.other[p]
            if plan.scanned[i]:
                continue
            since = now - plan.end_s[last] + plan.jump_mm[i] / layer.rapid_mm_s
            mean, entry = young_rise(
                near, near.pair[p], i, plan.by[i], last, plan.option[last], since, layer.time_s[last]
            )
            plan.fresh_mean_k[i] += source[last] * mean
            plan.fresh_entry_k[i] += source[last] * entry


@kernel
def _coolest(
    layer: _Layer,
    plan: _Greedy,
    n: int,
    left: Ints,
    now: Floats,
    soon: Floats,
    latest_s: float,
    prices: _Prices,
) -> tuple[int, float]:
    """Place among the islands left of that with the least score, and its temperature; of one that touches the last only where all do.

    Parameters
    ----------
    now, soon
        Rises by old heat at the earliest and at the latest entry.
    latest_s
        Time between the two.
    """
    place, best, best_island, best_touches, entry_k = 0, np.inf, -1, True, 0.0
    for j in range(left.size):
        candidate = left[j]
        jump = plan.jump_mm[candidate]
        share = jump / layer.rapid_mm_s / latest_s if latest_s > 0.0 else 0.0
        warm = now[j] + (soon[j] - now[j]) * share
        warm += max(plan.fresh_mean_k[candidate], plan.fresh_entry_k[candidate])
        score = warm + prices.travel_k_mm * jump
        if jump > JOINED_MM:
            score += prices.start_k
        hot = plan.touches[candidate] == n
        if hot and not best_touches:
            continue
        cooler = score < best - TIE_K or (score < best + TIE_K and candidate < best_island)
        if cooler or (best_touches and not hot):
            place, best, best_island, best_touches, entry_k = j, score, candidate, hot, warm
    return place, entry_k

"""Simulation of an order on the heat model: when, and how warm each is when the beam enters it."""

from __future__ import annotations

import numpy as np

from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Floats, Ints
from ebamcheck.scan.filling.schedule import IslandSchedule
from ebamcheck.scan.heat.aged_heat import (
    LEAST_DECAY,
    Modes,
    Timetable,
    at_surface,
    decay,
    entered_with_aged,
    field,
    heat_island,
)
from ebamcheck.scan.heat.island_heat import IslandHeat
from ebamcheck.scan.heat.near_field import NearField, young_rise
from ebamcheck.scan.order.entries import nearest_options


def entry_temperatures(
    heat: IslandHeat, area_mm2: Floats, order: Ints, start_s: Floats, end_s: Floats
) -> tuple[Floats, Floats]:
    """Simulate an order on the heat model.

    Parameters
    ----------
    order
        (I,) islands in scan order.
    start_s, end_s
        (I,) times by island.

    Returns
    -------
    entry_k
        (I,) by island: its mean temperature rise when the beam enters it.
    excess
        (I,) by island: spread of the temperature over the layer when the beam leaves it, without the
        island's own heat, over the mean temperature (excess uniformity).
    """
    share = area_mm2 / area_mm2.sum()
    timetable = Timetable(order, start_s, end_s)
    entry_k, excess = simulated(heat.modes, share, timetable, heat.start_k.copy())
    if heat.near is None:
        return entry_k, excess
    young_k, _ = _young_k(heat, heat.near, timetable)
    return _old_k(heat, heat.near, timetable) + young_k, excess


def entered(heat: IslandHeat, order: Ints, start_s: Floats, end_s: Floats) -> tuple[Floats, Floats]:
    """Entry temperatures (I,) by island alone, which is far less work, and the amplitudes (K, N) at the end."""
    state, timetable = heat.start_k.copy(), Timetable(order, start_s, end_s)
    entry_k = entered_into(heat.modes, timetable, state)
    if heat.near is not None:
        entry_k = _old_k(heat, heat.near, timetable) + _young_k(heat, heat.near, timetable)[0]
    return entry_k, state


def entry_points(
    heat: IslandHeat, schedule: IslandSchedule, order: Ints, start_s: Floats, end_s: Floats
) -> tuple[Floats, Floats]:
    """Mean temperature rise of each island, and that under the beam, when the beam enters it, (I,) K by island."""
    timetable = Timetable(order, start_s, end_s)
    old_k = _old_k(heat, heat.fresh, timetable)
    option = nearest_options(order, schedule.entry, schedule.leave)
    means_k, points_k = _young_k(heat, heat.fresh, timetable, option)
    return old_k + means_k, old_k + points_k


def _old_k(heat: IslandHeat, near: NearField, timetable: Timetable) -> Floats:
    """Entry temperatures (I,) by heat older than the horizon, of which the modes have all."""
    return entered_with_aged(heat.modes, timetable, near.horizon_s, heat.start_k)


def _young_k(
    heat: IslandHeat, near: NearField, timetable: Timetable, option: Ints | None = None
) -> tuple[Floats, Floats]:
    """What younger heat adds, (I,) K: to the means of islands, and to the places where they are entered by an option."""
    options = np.zeros(len(timetable.start_s), np.int64) if option is None else option
    return freshly_heated(near, heat.modes.source_k_s, timetable, options)


@kernel
def freshly_heated(
    near: NearField, source: Floats, timetable: Timetable, option: Ints
) -> tuple[Floats, Floats]:
    """Rises by heat younger than the horizon, (I,) K: of the means of islands, and of their entries."""
    order, start, end = timetable
    means, points = np.zeros(len(start)), np.zeros(len(start))
    place = np.full(len(start), -1)
    for n in range(len(order)):
        place[order[n]] = n
    for i in order:
        for p in range(near.first[i], near.first[i + 1]):
            j = near.other[p]
            since = start[i] - end[j]
            if place[j] >= place[i] or place[j] < 0 or since > near.horizon_s:
                continue
            time = end[j] - start[j]
            mean, point = young_rise(near, near.pair[p], i, option[i], j, option[j], since, time)
            means[i] += source[j] * mean
            points[i] += source[j] * point
    return means, points


@kernel
def entered_into(modes: Modes, timetable: Timetable, state: Floats) -> Floats:
    """Entry temperature of each island; `state` goes from the first to the last amplitudes."""
    plane_rate, depth_rate, in_layer = modes.plane_rate, modes.depth_rate, modes.in_layer
    entry_k = np.zeros(modes.mean.shape[1])
    clock = 0.0
    for island in timetable.order:
        pause = timetable.start_s[island] - clock
        duration = timetable.end_s[island] - timetable.start_s[island]
        through_pause, through = np.exp(-depth_rate * pause), np.exp(-depth_rate * duration)
        temperature = 0.0
        for k in range(len(plane_rate)):
            shape = modes.mean[k, island]
            across_pause, across = np.exp(-plane_rate[k] * pause), np.exp(-plane_rate[k] * duration)
            for n in range(len(depth_rate)):
                before = state[k, n] * (across_pause * through_pause[n])
                temperature += shape * in_layer[n] * before
                rate, fall = plane_rate[k] + depth_rate[n], across * through[n]
                held = duration if rate * duration < LEAST_DECAY else (1.0 - fall) / rate
                state[k, n] = before * fall + modes.source_k_s[island] * held * shape * in_layer[n]
        entry_k[island] = temperature
        clock = timetable.end_s[island]
    return entry_k


@kernel
def simulated(modes: Modes, share: Floats, timetable: Timetable, state: Floats) -> tuple[Floats, Floats]:
    """Entry temperature and excess uniformity of each island, see :func:`entry_temperatures`."""
    count = modes.mean.shape[1]
    entry_k, excess = np.zeros(count), np.zeros(count)
    clock = 0.0
    for island in timetable.order:
        decay(state, modes, timetable.start_s[island] - clock)
        entry_k[island] = field(modes, at_surface(state, modes))[island]
        duration = timetable.end_s[island] - timetable.start_s[island]
        decay(state, modes, duration)
        others = field(modes, at_surface(state, modes))
        heat_island(state, modes, island, duration)
        total = field(modes, at_surface(state, modes))
        middle, average, spread = 0.0, 0.0, 0.0
        for j in range(count):
            middle += share[j] * others[j]
            average += share[j] * total[j]
        for j in range(count):
            spread += share[j] * (others[j] - middle) ** 2
        excess[island] = np.sqrt(spread) / average if average > 0.0 else 0.0
        clock = timetable.end_s[island]
    return entry_k, excess


# -- Temperature of every island over the time in which a layer is scanned, for pictures -----------------------


def island_history(heat: IslandHeat, order: Ints, start_s: Floats, end_s: Floats) -> Floats:
    """Mean temperature rises (I, I) K: a row for the end of each island in scan order, a column an island."""
    modes = heat.modes
    state = heat.start_k.copy()
    rows = np.empty((len(order), len(modes.source_k_s)))
    clock = 0.0
    for n, island in enumerate(order.tolist()):
        duration = end_s[island] - start_s[island]
        decay(state, modes, start_s[island] - clock + duration)
        heat_island(state, modes, island, duration)
        rows[n] = field(modes, at_surface(state, modes))
        clock = float(end_s[island])
    return rows

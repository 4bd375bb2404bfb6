"""Islands driven one after the other on the heat model: when, and how warm each is when the beam enters it."""

from __future__ import annotations

import numpy as np

from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Floats, Ints
from ebamcheck.scan.filling.schedule import IslandDrive
from ebamcheck.scan.heat.aged_heat import entered_with_aged
from ebamcheck.scan.heat.island_heat import IslandHeat
from ebamcheck.scan.heat.near_field import NearField, young_rise
from ebamcheck.scan.order.entry_options import nearest_way

LEAST_DECAY = 1e-9
"""Amplitudes that fall by less than this while an island is scanned do not fall."""


def entry_temperatures(
    heat: IslandHeat, area_mm2: Floats, order: Ints, start_s: Floats, end_s: Floats
) -> tuple[Floats, Floats]:
    """Drive an order on the heat model.

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
    entry_k, excess = driven(*heat.columns, share, order, start_s, end_s, heat.start_k.copy())
    if heat.near is None:
        return entry_k, excess
    return _old_k(heat, heat.near, order, start_s, end_s) + _young_k(heat, heat.near, order, start_s, end_s)[
        0
    ], excess


def entered(heat: IslandHeat, order: Ints, start_s: Floats, end_s: Floats) -> tuple[Floats, Floats]:
    """Entry temperatures (I,) by island alone, which is far less work, and the amplitudes (K, N) at the end."""
    state = heat.start_k.copy()
    entry_k = entered_into(*heat.columns, order, start_s, end_s, state)
    if heat.near is not None:
        entry_k = _old_k(heat, heat.near, order, start_s, end_s)
        entry_k += _young_k(heat, heat.near, order, start_s, end_s)[0]
    return entry_k, state


def entry_points(
    heat: IslandHeat, drive: IslandDrive, order: Ints, start_s: Floats, end_s: Floats
) -> tuple[Floats, Floats]:
    """Mean temperature rise of each island, and that under the beam, when the beam enters it, (I,) K by island."""
    old_k = _old_k(heat, heat.fresh, order, start_s, end_s)
    way = ways_driven(order, drive.entry, drive.leave)
    means_k, points_k = _young_k(heat, heat.fresh, order, start_s, end_s, way)
    return old_k + means_k, old_k + points_k


def _old_k(heat: IslandHeat, near: NearField, order: Ints, start_s: Floats, end_s: Floats) -> Floats:
    """Entry temperatures (I,) by heat older than the horizon, of which the modes have all."""
    return entered_with_aged(*heat.columns, order, start_s, end_s, near.horizon_s, heat.start_k.copy())


def _young_k(
    heat: IslandHeat, near: NearField, order: Ints, start_s: Floats, end_s: Floats, way: Ints | None = None
) -> tuple[Floats, Floats]:
    """What younger heat adds, (I,) K: to the means of islands, and to the places where they are entered by a way."""
    ways = np.zeros(len(start_s), np.int64) if way is None else way
    return freshly_heated(near, heat.source_k_s, order, start_s, end_s, ways)


@kernel
def freshly_heated(
    near: NearField, source: Floats, order: Ints, start: Floats, end: Floats, way: Ints
) -> tuple[Floats, Floats]:
    """Rises by heat younger than the horizon, (I,) K: of the means of islands, and of their entries."""
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
            mean, point = young_rise(near, near.pair[p], i, way[i], j, way[j], since, time)
            means[i] += source[j] * mean
            points[i] += source[j] * point
    return means, points


@kernel
def decay(state: Floats, plane_rate: Floats, depth_rate: Floats, time: float) -> None:
    """Let all amplitudes (K, N) fall for a time."""
    through = np.exp(-depth_rate * time)
    for k in range(state.shape[0]):
        across = np.exp(-plane_rate[k] * time)
        for n in range(state.shape[1]):
            state[k, n] *= across * through[n]


@kernel
def heat_island(
    state: Floats,
    mean: Floats,
    plane_rate: Floats,
    depth_rate: Floats,
    in_layer: Floats,
    source: float,
    time: float,
) -> None:
    """Add what an island with mode means (K,) leaves at the end of the time in which it is heated."""
    through = np.exp(-depth_rate * time)
    for k in range(state.shape[0]):
        across = np.exp(-plane_rate[k] * time)
        for n in range(state.shape[1]):
            rate = plane_rate[k] + depth_rate[n]
            held = time if rate * time < LEAST_DECAY else (1.0 - across * through[n]) / rate
            state[k, n] += source * held * mean[k] * in_layer[n]


@kernel
def at_surface(
    state: Floats, plane_rate: Floats, depth_rate: Floats, in_layer: Floats, time: float
) -> Floats:
    """Amplitudes (K,) of the section's modes in the layer, after another time."""
    through = in_layer * np.exp(-depth_rate * time)
    result = np.empty(state.shape[0])
    for k in range(state.shape[0]):
        total = 0.0
        for n in range(state.shape[1]):
            total += state[k, n] * through[n]
        result[k] = total * np.exp(-plane_rate[k] * time)
    return result


@kernel
def entered_into(
    mean: Floats,
    plane_rate: Floats,
    depth_rate: Floats,
    in_layer: Floats,
    source: Floats,
    order: Ints,
    start: Floats,
    end: Floats,
    state: Floats,
) -> Floats:
    """Entry temperature of each island; `state` goes from the first to the last amplitudes."""
    modes, waves, count = mean.shape[0], len(depth_rate), mean.shape[1]
    entry_k = np.zeros(count)
    clock = 0.0
    for island in order:
        pause, duration = start[island] - clock, end[island] - start[island]
        through_pause, through = np.exp(-depth_rate * pause), np.exp(-depth_rate * duration)
        temperature = 0.0
        for k in range(modes):
            shape = mean[k, island]
            across_pause, across = np.exp(-plane_rate[k] * pause), np.exp(-plane_rate[k] * duration)
            for n in range(waves):
                before = state[k, n] * (across_pause * through_pause[n])
                temperature += shape * in_layer[n] * before
                rate, fall = plane_rate[k] + depth_rate[n], across * through[n]
                held = duration if rate * duration < LEAST_DECAY else (1.0 - fall) / rate
                state[k, n] = before * fall + source[island] * held * shape * in_layer[n]
        entry_k[island] = temperature
        clock = end[island]
    return entry_k


@kernel
def driven(
    mean: Floats,
    plane_rate: Floats,
    depth_rate: Floats,
    in_layer: Floats,
    source: Floats,
    share: Floats,
    order: Ints,
    start: Floats,
    end: Floats,
    state: Floats,
) -> tuple[Floats, Floats]:
    """Entry temperature and excess uniformity of each island, see :func:`entry_temperatures`."""
    count = mean.shape[1]
    entry_k, excess = np.zeros(count), np.zeros(count)
    clock = 0.0
    for island in order:
        decay(state, plane_rate, depth_rate, start[island] - clock)
        entry_k[island] = field(mean, at_surface(state, plane_rate, depth_rate, in_layer, 0.0))[island]
        duration = end[island] - start[island]
        decay(state, plane_rate, depth_rate, duration)
        others = field(mean, at_surface(state, plane_rate, depth_rate, in_layer, 0.0))
        own = mean[:, island]
        heat_island(state, own, plane_rate, depth_rate, in_layer, source[island], duration)
        total = field(mean, at_surface(state, plane_rate, depth_rate, in_layer, 0.0))
        middle, average, spread = 0.0, 0.0, 0.0
        for j in range(count):
            middle += share[j] * others[j]
            average += share[j] * total[j]
        for j in range(count):
            spread += share[j] * (others[j] - middle) ** 2
        excess[island] = np.sqrt(spread) / average if average > 0.0 else 0.0
        clock = end[island]
    return entry_k, excess


@kernel
def field(mean: Floats, amplitudes: Floats) -> Floats:
    """Temperature rise of all islands, (I,)."""
    result = np.zeros(mean.shape[1])
    for k in range(mean.shape[0]):
        for j in range(mean.shape[1]):
            result[j] += amplitudes[k] * mean[k, j]
    return result


@kernel
def ways_driven(order: Ints, entry: Floats, leave: Floats) -> Ints:
    """Way by which each island is driven, by island (I,), entering each the nearest way."""
    ways = np.zeros(len(entry), np.int64)
    for n in range(1, len(order)):
        x, y = leave[order[n - 1], ways[order[n - 1]]]
        ways[order[n]] = nearest_way(entry[order[n]], x, y)[1]
    return ways


@kernel
def clocked(
    order: Ints, entry: Floats, leave: Floats, time: Floats, rapid: float
) -> tuple[Floats, Floats, float]:
    """Start and end of each island by island (I,), s, and the travel between them, mm, entering each the nearest way."""
    start, end = np.empty(len(order)), np.empty(len(order))
    clock, travel = 0.0, 0.0
    x, y = entry[order[0], 0, 0], entry[order[0], 0, 1]
    for n in range(len(order)):
        island = order[n]
        nearest, way = nearest_way(entry[island], x, y)
        if n == 0:
            nearest, way = 0.0, 0
        clock += nearest / rapid
        travel += nearest
        start[island] = clock
        clock += time[island]
        end[island] = clock
        x, y = leave[island, way, 0], leave[island, way, 1]
    return start, end, travel

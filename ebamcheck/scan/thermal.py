"""Orders by heat: at every step the island that is coolest when the beam gets there, and not too far away.

The score of an island is its mean temperature at the time it would be entered, plus the travel to it and the
start of the wire, each at its price in kelvin. A low price of travel makes cool but long ways; so plans for
several prices are made, and the coolest is kept among those whose way is short enough.
"""

from __future__ import annotations

import numpy as np

from ebamcheck.kernels import kernel
from ebamcheck.rings import Floats, Ints
from ebamcheck.scan.drive import IslandDrive
from ebamcheck.scan.island_heat import IslandHeat
from ebamcheck.scan.path import JOINED_MM

TIE_K = 1e-6
"""Scores closer than this are equal: rounding must not decide between islands that mirror each other."""


def greedy_order(
    heat: IslandHeat, drive: IslandDrive, rapid_mm_s: float, first: int, price_k_mm: float, start_k: float
) -> Ints:
    """Order islands by heat for one price of travel (K/mm) and of a wire start (K)."""
    return coolest_first(
        heat.mean.copy(),
        heat.plane_rate,
        heat.depth_rate,
        heat.in_layer,
        heat.source_k_s,
        drive.entry,
        drive.leave,
        drive.time_s,
        rapid_mm_s,
        first,
        price_k_mm,
        start_k,
    )


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
    return driven(
        heat.mean,
        heat.plane_rate,
        heat.depth_rate,
        heat.in_layer,
        heat.source_k_s,
        area_mm2 / area_mm2.sum(),
        order,
        start_s,
        end_s,
    )


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
    state: Floats, mean: Floats, plane_rate: Floats, depth_rate: Floats, in_layer: Floats, source: float, time: float
) -> None:
    """Add what an island with mode means (K,) leaves at the end of the time in which it is heated."""
    through = np.exp(-depth_rate * time)
    for k in range(state.shape[0]):
        across = np.exp(-plane_rate[k] * time)
        for n in range(state.shape[1]):
            rate = plane_rate[k] + depth_rate[n]
            held = time if rate * time < 1e-9 else (1.0 - across * through[n]) / rate
            state[k, n] += source * held * mean[k] * in_layer[n]


@kernel
def at_surface(state: Floats, plane_rate: Floats, depth_rate: Floats, in_layer: Floats, time: float) -> Floats:
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
def coolest_first(
    mean: Floats,
    plane_rate: Floats,
    depth_rate: Floats,
    in_layer: Floats,
    source: Floats,
    entry: Floats,
    leave: Floats,
    time: Floats,
    rapid: float,
    first: int,
    price: float,
    start_price: float,
) -> Ints:
    """Order by score; `mean` (K, I) is used up. Between the earliest and the latest entry temperature is linear."""
    modes, count = mean.shape
    order = np.empty(count, np.int64)
    left = np.arange(count)
    state = np.zeros((modes, len(depth_rate)))
    now, soon = np.empty(count), np.empty(count)
    latest = 0.0
    for axis in range(2):
        latest += np.ptp(entry[:, :, axis]) / rapid
    place, way, jump = first, 0, 0.0
    for n in range(count):
        island = left[place]
        order[n] = island
        x, y = leave[island, way, 0], leave[island, way, 1]
        decay(state, plane_rate, depth_rate, jump / rapid + time[island])
        heat_island(state, mean[:, place], plane_rate, depth_rate, in_layer, source[island], time[island])
        rest = count - n - 1
        if rest == 0:
            break
        # The last island takes the place of the one that was scanned: those left stay side by side.
        left[place] = left[rest]
        mean[:, place] = mean[:, rest]
        early = at_surface(state, plane_rate, depth_rate, in_layer, 0.0)
        late = at_surface(state, plane_rate, depth_rate, in_layer, latest)
        now[:rest] = 0.0
        soon[:rest] = 0.0
        for k in range(modes):
            e, s = early[k], late[k]
            row = mean[k]
            for j in range(rest):
                now[j] += e * row[j]
                soon[j] += s * row[j]
        best, best_island = np.inf, -1
        for j in range(rest):
            candidate = left[j]
            nearest, nearest_way = np.inf, 0
            for v in range(4):
                distance = np.hypot(entry[candidate, v, 0] - x, entry[candidate, v, 1] - y)
                if distance < nearest - JOINED_MM:
                    nearest, nearest_way = distance, v
            share = nearest / rapid / latest if latest > 0.0 else 0.0
            score = now[j] + (soon[j] - now[j]) * share + price * nearest
            if nearest > JOINED_MM:
                score += start_price
            if score < best - TIE_K or (score < best + TIE_K and candidate < best_island):
                best, best_island = score, candidate
                place, way, jump = j, nearest_way, nearest
    return order


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
) -> tuple[Floats, Floats]:
    """Entry temperature and excess uniformity of each island, see :func:`entry_temperatures`."""
    modes, count = mean.shape
    state = np.zeros((modes, len(depth_rate)))
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
def clocked(order: Ints, entry: Floats, leave: Floats, time: Floats, rapid: float) -> tuple[Floats, Floats, float]:
    """Start and end of each island by island (I,), s, and the travel between them, mm, entering each the nearest way."""
    start, end = np.empty(len(order)), np.empty(len(order))
    clock, travel = 0.0, 0.0
    x, y = entry[order[0], 0, 0], entry[order[0], 0, 1]
    for n in range(len(order)):
        island = order[n]
        nearest, way = np.inf, 0
        for v in range(4):
            distance = np.hypot(entry[island, v, 0] - x, entry[island, v, 1] - y)
            if distance < nearest - JOINED_MM:
                nearest, way = distance, v
        if n == 0:
            nearest, way = 0.0, 0
        clock += nearest / rapid
        travel += nearest
        start[island] = clock
        clock += time[island]
        end[island] = clock
        x, y = leave[island, way, 0], leave[island, way, 1]
    return start, end, travel

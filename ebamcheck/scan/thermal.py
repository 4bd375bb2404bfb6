"""Orders by heat: at every step the island that is coolest when the beam gets there, and not too far away.

The score of an island is its mean temperature at the time it would be entered, plus the travel to it and the
start of the wire, each at its price in kelvin. A low price of travel makes cool but long ways; so plans for
several prices are made, and the coolest is kept among those whose way is short enough.
"""

from __future__ import annotations

import math

import numpy as np

from ebamcheck.kernels import kernel
from ebamcheck.rings import Floats, Ints
from ebamcheck.scan.drive import IslandDrive
from ebamcheck.scan.island_heat import IslandHeat
from ebamcheck.scan.path import JOINED_MM

PRICES = (0.005, 0.01, 0.02, 0.04, 0.08, 0.16, 0.32)
"""Prices of travel that are tried: in temperature rises of an island by its own heat, over widths of an island.
The best one differs from layer to layer by chance."""

STARTS = 8
"""Islands from which each price is tried."""

MOST_WORK = 2e9
"""Multiplications in one search, which limits the plans tried on a layer of thousands of islands."""

ANNEALING_WORK = 1e8
"""Amplitudes followed in one annealing, which limits its steps there."""

LEAST_DECAY = 1e-9
"""Amplitudes that fall by less than this while an island is scanned do not fall."""

TIE_K = 1e-6
"""Scores closer than this are equal: rounding must not decide between islands that mirror each other."""


def thermal_order(
    heat: IslandHeat,
    drive: IslandDrive,
    rapid_mm_s: float,
    width_mm: float,
    longest_mm: float,
    start_travel_mm: float,
    annealing: Ints | None = None,
) -> Ints:
    """Order islands by heat: the coolest of several greedy plans whose travel is not too long.

    Parameters
    ----------
    width_mm
        Width of an island.
    longest_mm
        Travel between islands that is allowed; where no plan keeps it, the one of least travel is taken.
    start_travel_mm
        Travel that counts as much as a start of the wire.
    annealing
        (S, 2) moves as :func:`annealed` takes them; none if None.
    """
    count = len(drive)
    own_k = float(np.mean(own_rise(heat, drive)))
    tries = [(price, first) for first in _starts(count) for price in PRICES]
    affordable = max(1, int(MOST_WORK / (count**2 * heat.mean.shape[0])))
    if affordable < len(tries):
        # The middle prices first: they are the likeliest to be best.
        tries = sorted(tries, key=lambda t: (abs(PRICES.index(t[0]) - len(PRICES) // 2), t[1]))[:affordable]
    best, best_rank = np.arange(count), (math.inf, math.inf)
    for price, first in tries:
        price_k_mm = price * own_k / width_mm
        order = greedy_order(heat, drive, rapid_mm_s, first, price_k_mm, price_k_mm * start_travel_mm)
        rank, _ = ranked(heat, drive, rapid_mm_s, order, longest_mm)
        if better(rank, best_rank):
            best, best_rank = order, rank
    if annealing is None:
        return best
    steps = int(ANNEALING_WORK / (count * heat.mean.shape[0] * len(heat.depth_rate)))
    return annealed(heat, drive, rapid_mm_s, best, longest_mm, annealing[:steps])


def annealed(
    heat: IslandHeat, drive: IslandDrive, rapid_mm_s: float, order: Ints, longest_mm: float, moves: Ints
) -> Ints:
    """Move islands to other places of an order, or exchange two, where that makes it better.

    Parameters
    ----------
    moves
        (S, 2) pairs of places; in every other one the first is that of the hottest island instead.
    """
    best = order
    best_rank, hottest = ranked(heat, drive, rapid_mm_s, best, longest_mm)
    for n, (a, b) in enumerate(moves.tolist()):
        place = hottest if n % 2 else a
        if n % 4 < 2:
            tried = np.insert(np.delete(best, place), b, best[place])
        else:
            tried = best.copy()
            tried[place], tried[b] = best[b], best[place]
        rank, hot = ranked(heat, drive, rapid_mm_s, tried, longest_mm)
        if better(rank, best_rank):
            best, best_rank, hottest = tried, rank, hot
    return best


def better(rank: tuple[float, float], than: tuple[float, float]) -> bool:
    """Whether a plan has less travel too much, or is as short and cooler."""
    return rank[0] < than[0] or (rank[0] == than[0] and rank[1] < than[1] - TIE_K)


def _starts(count: int) -> list[int]:
    """Islands spread over the layer."""
    return sorted({count * n // STARTS for n in range(STARTS)})


def own_rise(heat: IslandHeat, drive: IslandDrive) -> Floats:
    """Mean temperature rise of each island by its own heat when the beam leaves it, (I,) K."""
    rise = np.zeros(len(drive))
    for n, wave in enumerate(heat.in_layer):
        decay_s = heat.plane_rate[:, None] + heat.depth_rate[n]
        held = -np.expm1(-decay_s * drive.time_s) / np.where(decay_s > 0.0, decay_s, 1.0)
        held = np.where(decay_s > 0.0, held, drive.time_s)
        rise += wave**2 * heat.source_k_s * (heat.mean**2 * held).sum(axis=0)
    return rise


def ranked(
    heat: IslandHeat, drive: IslandDrive, rapid_mm_s: float, order: Ints, longest_mm: float
) -> tuple[tuple[float, float], int]:
    """Rank of a plan, and the place in it of the island that is entered hottest.

    The rank is the travel beyond what is allowed, then greatest plus spread of the entry temperatures, K.
    """
    start_s, end_s, travel = clocked(order, drive.entry, drive.leave, drive.time_s, rapid_mm_s)
    entry_k = entered(
        heat.mean, heat.plane_rate, heat.depth_rate, heat.in_layer, heat.source_k_s, order, start_s, end_s
    )
    rank = max(0.0, travel - longest_mm), float(entry_k.max() + entry_k.std())
    return rank, int(np.argmax(entry_k[order]))


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
def entered(
    mean: Floats,
    plane_rate: Floats,
    depth_rate: Floats,
    in_layer: Floats,
    source: Floats,
    order: Ints,
    start: Floats,
    end: Floats,
) -> Floats:
    """Entry temperature of each island alone, which is far less work than :func:`driven`."""
    modes, waves, count = mean.shape[0], len(depth_rate), mean.shape[1]
    state = np.zeros((modes, waves))
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
def clocked(
    order: Ints, entry: Floats, leave: Floats, time: Floats, rapid: float
) -> tuple[Floats, Floats, float]:
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

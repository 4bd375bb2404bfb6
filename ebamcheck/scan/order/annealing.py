"""Improve an order of islands by moves that are kept where they help, or at first where they do little harm.

Simulated annealing (Kirkpatrick, Gelatt & Vecchi 1983) on the temperatures of :mod:`ebamcheck.scan.heat.influence`,
with a budget of moves, not of seconds.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Bools, Floats, Ints
from ebamcheck.scan.heat.influence import Influence, looked_up
from ebamcheck.scan.order.entry_options import EntryOptions
from ebamcheck.scan.order.moves import Simulated, least_travel_mm, more_touches, move
from ebamcheck.scan.order.touching import Touching, touch_table

WARMTH = 0.005
"""Worsening taken at the beginning, unless another is asked for."""

TOUCH_SHARE = 100.0
"""Price of an island that touches the one before, over the first cost: no gain in heat or travel is worth it."""

HOTTEST_EVERY = 10
"""One move in so many starts at the hottest island; the others anywhere."""

HIGH = 12
"""Exponent of :func:`high_mean`: a maximum alone would see no gain until the very hottest island is cooler."""


class Layer(NamedTuple):
    """What orders of a layer's islands are tried on.

    Parameters
    ----------
    table
        Temperature rises of islands by each other.
    options
        Jumps between islands.
    beside
        Islands that touch.
    time_s
        (I,) time in which each island is scanned.
    rapid_mm_s
        Speed of jumps.
    """

    table: Influence
    options: EntryOptions
    beside: Touching
    time_s: Floats
    rapid_mm_s: float


class Log(NamedTuple):
    """An order simulated, by place (I,): begin of the island, s, entry option, travel so far, mm, entry temperature, K,
    and how many islands so far touch the one before them."""

    start_s: Floats
    option: Ints
    travel_mm: Floats
    entry_k: Floats
    touches: Ints


def high_mean(entry_k: Floats) -> float:
    """Mean of the twelfth powers of the entry temperatures, as a temperature: near the greatest, yet all count."""
    return float(np.mean(np.maximum(entry_k, 0.0) ** HIGH) ** (1.0 / HIGH))


def annealed(
    layer: Layer,
    order: Ints,
    longest_mm: float,
    price_k_mm: float,
    steps: int,
    random: np.random.Generator,
    warmth: float = WARMTH,
) -> Ints:
    """Exchange, move and turn around islands of an order.

    The cost is :func:`high_mean`, K, plus prices on travel that is too long, and on islands that touch the one before.

    Parameters
    ----------
    order
        (I,) islands in scan order.
    longest_mm
        Travel that costs nothing.
    price_k_mm
        Cost of travel beyond it.
    steps
        Moves tried.
    warmth
        Worsening, as a share of the first cost, that is taken at the beginning about every third time.
    """
    count = len(order)
    if steps == 0 or count < 2:
        return order
    places = random.integers(0, count, (steps, 2))
    leniency = random.exponential(size=steps) * np.linspace(1.0, 0.0, steps)
    return improved(layer, np.asarray(order, np.int64), longest_mm, price_k_mm, places, leniency, warmth)


@kernel
def improved(
    layer: Layer,
    order: Ints,
    longest: float,
    price: float,
    places: Ints,
    leniency: Floats,
    warm_share: float,
) -> Ints:
    """Return the best order met."""
    count = len(order)
    kept, tried, best = order.copy(), order.copy(), order.copy()
    log, tried_log = new_log(count), new_log(count)
    beside, options = touch_table(layer.beside), layer.options
    timed_from(0, kept, layer, beside, log)
    total = powers_from(0, 0, 0, np.arange(count), kept, layer, np.inf, log)
    cost = (total / count) ** (1.0 / HIGH)
    touch_price = TOUCH_SHARE * cost
    cost += price * max(0.0, log.travel_mm[-1] - longest) + touch_price * log.touches[-1]
    best_cost, warmth = cost, warm_share * cost
    by_heat = np.argsort(-log.entry_k)
    simulated = Simulated(kept, log.option, log.travel_mm)
    for step in range(len(places)):
        a, b = places[step, 0], places[step, 1]
        if step % HOTTEST_EVERY == 0:
            a = by_heat[0]
        if a == b:
            continue
        first, kind = min(a, b), step % 3
        allowed = cost + warmth * leniency[step]
        touched = touch_price * (log.touches[-1] + more_touches(kept, a, b, kind, beside))
        # Most moves are given up by the touches, or by a travel that is too long in any case.
        if touched >= allowed:
            continue
        least_mm = least_travel_mm(simulated, a, b, kind, options)
        if price * max(0.0, least_mm - longest) + touched >= allowed:
            continue
        move(kept, a, b, kind, tried)
        copy_start(log, first, tried_log)
        timed_from(first, tried, layer, beside, tried_log)
        too_far = price * max(0.0, tried_log.travel_mm[-1] - longest) + touch_price * tried_log.touches[-1]
        if too_far >= allowed:
            continue
        most = count * power(allowed - too_far)
        total = powers_from(first, a, b, by_heat, tried, layer, most, tried_log)
        if total > most:
            continue
        cost = (total / count) ** (1.0 / HIGH) + too_far
        kept, tried = tried, kept
        log, tried_log = tried_log, log
        by_heat, simulated = np.argsort(-log.entry_k), Simulated(kept, log.option, log.travel_mm)
        if cost < best_cost:
            best[:], best_cost = kept, cost
    return best


@kernel
def powers_from(
    first: int, a: int, b: int, by_heat: Ints, order: Ints, layer: Layer, most: float, log: Log
) -> float:
    """Sum of the powers of the entry temperatures, those from a place on worked out; any sum beyond `most` if it is more.

    The two places that were moved come first, then the hottest: most moves are given up after a few.
    """
    total = 0.0
    for place in range(first):
        total += power(log.entry_k[place])
    for n in range(-2, len(order)):
        place = a if n == -2 else b if n == -1 else by_heat[n]
        if place < first or (n == -1 and a == b) or (n >= 0 and place in (a, b)):
            continue
        log.entry_k[place] = entry_temperature(place, order, layer, log)
        total += power(log.entry_k[place])
        if total > most:
            break
    return total


@kernel
def copy_start(log: Log, stop: int, result: Log) -> None:
    """Copy what a log says of the places before one."""
    result.start_s[:stop], result.option[:stop] = log.start_s[:stop], log.option[:stop]
    result.travel_mm[:stop], result.entry_k[:stop] = log.travel_mm[:stop], log.entry_k[:stop]
    result.touches[:stop] = log.touches[:stop]


@kernel
def new_log(count: int) -> Log:
    """Room for a log."""
    return Log(
        np.zeros(count),
        np.zeros(count, np.int64),
        np.zeros(count),
        np.zeros(count),
        np.zeros(count, np.int64),
    )


@kernel
def power(temperature: float) -> float:
    """Its twelfth power (:data:`HIGH`); the model can ring under zero, which is cold."""
    warm = max(temperature, 0.0)
    fourth = (warm * warm) * (warm * warm)
    return fourth * fourth * fourth


@kernel
def timed_from(first: int, order: Ints, layer: Layer, beside: Bools, log: Log) -> None:
    """Time the islands from a place on, entering each by the nearest option; `beside` (I, I) tells which touch."""
    jump, option, time = layer.options.jump_mm, layer.options.option, layer.time_s
    for n in range(first, len(order)):
        if n == 0:
            log.start_s[0], log.option[0], log.travel_mm[0], log.touches[0] = 0.0, 0, 0.0, 0
            continue
        last, island, left_by = order[n - 1], order[n], log.option[n - 1]
        distance = jump[last, left_by, island]
        log.start_s[n] = log.start_s[n - 1] + time[last] + np.true_divide(distance, layer.rapid_mm_s)
        log.option[n] = option[last, left_by, island]
        log.travel_mm[n] = log.travel_mm[n - 1] + distance
        log.touches[n] = log.touches[n - 1] + beside[last, island]


@kernel
def entry_temperature(place: int, order: Ints, layer: Layer, log: Log) -> float:
    """Rise of the island at a place when the beam enters it: its mean, or that of its entry if it is more."""
    # Taken out of their tuples once: the first loop is where planning spends its time.
    rise, nodes, fresh = layer.table.rise_k[order[place]], layer.table.nodes_per_root_s, layer.table.fresh
    horizon, time, start = fresh.horizon_s, layer.time_s, log.start_s
    island, now = order[place], start[place]
    temperature = looked_up(rise, nodes, horizon, len(order), now)
    for earlier in range(place):
        source = order[earlier]
        since = now - start[earlier] - time[source]
        temperature += looked_up(rise, nodes, horizon, source, since)
    excess_k, slot, by = fresh.excess_k, fresh.slot, log.option[place]
    excess, last = 0.0, fresh.excess_k.shape[3] - 1
    for earlier in range(place - 1, -1, -1):
        source = order[earlier]
        since = now - start[earlier] - time[source]
        if since >= horizon:
            break
        row, left_by = slot[island, source], log.option[earlier]
        if row >= 0:
            at = np.sqrt(np.true_divide(max(since, 0.0), horizon)) * last
            node = min(int(at), last - 1)
            low, high = excess_k[row, by, left_by, node], excess_k[row, by, left_by, node + 1]
            excess += low + (high - low) * min(at - node, 1.0)
    return temperature + max(excess, 0.0)

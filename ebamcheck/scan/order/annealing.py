"""Improve an order of islands by moves that are kept where they help, or at first where they do little harm.

Simulated annealing (Kirkpatrick, Gelatt & Vecchi 1983) on the temperatures of :mod:`ebamcheck.scan.heat.influence`,
with a budget of moves, not of seconds.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Bools, Floats, Ints
from ebamcheck.scan.heat.influence import Influence, table_place, work_out
from ebamcheck.scan.order.entry_options import EntryOptions
from ebamcheck.scan.order.moves import least_travel_mm, more_touches, move
from ebamcheck.scan.order.path import Touching, touch_table

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
    how many islands so far touch the one before them, and the time in which the island is scanned, s; with room for the place of
    one island: time since the others, s, and where this lies in the table of influences."""

    start_s: Floats
    option: Ints
    travel_mm: Floats
    entry_k: Floats
    touches: Ints
    time_s: Floats
    since_s: Floats
    node: NDArray[np.int32]
    share: Floats


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
    beside, jump_mm, option = touch_table(layer.beside), layer.options.jump_mm, layer.options.option
    timed_from(0, kept, layer, beside, log)
    total = powers_from(0, 0, 0, np.arange(count), kept, layer, np.inf, log)
    cost = (total / count) ** (1.0 / HIGH)
    touch_price = TOUCH_SHARE * cost
    cost += price * max(0.0, log.travel_mm[-1] - longest) + touch_price * log.touches[-1]
    best_cost, warmth = cost, warm_share * cost
    by_heat = np.arange(count)
    sort_by_heat(by_heat, log.entry_k)
    by, travel_mm, touches = log.option, log.travel_mm, log.touches
    for step in range(len(places)):
        a, b = places[step, 0], places[step, 1]
        if step % HOTTEST_EVERY == 0:
            a = by_heat[0]
        if a == b:
            continue
        first, kind = min(a, b), step % 3
        allowed = cost + warmth * leniency[step]
        touched = touch_price * (touches[count - 1] + more_touches(kept, a, b, kind, beside))
        # Most moves are given up by the touches, or by a travel that is too long in any case.
        if touched >= allowed:
            continue
        least_mm = least_travel_mm(kept, by, travel_mm, a, b, kind, jump_mm, option)
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
        by, travel_mm, touches = log.option, log.travel_mm, log.touches
        sort_by_heat(by_heat, log.entry_k)
        if cost < best_cost:
            best[:], best_cost = kept, cost
    return best


@kernel
def powers_from(
    first: int, a: int, b: int, by_heat: Ints, order: Ints, layer: Layer, most: float, log: Log
) -> float:
    """Sum of the powers of the entry temperatures, those from a place on worked out; any sum beyond `most` if it is more.

    The rise of an island when the beam enters it is its mean, or that of its entry if it is more. The two places that were
    moved come first, then the hottest: most moves are given up after a few.
    """
    # Taken out of their tuples once for all places: each column that is taken out is counted as one more in use.
    fresh, nodes, start, time, options = (
        layer.table.fresh, layer.table.nodes_per_root_s, log.start_s, log.time_s, log.option,
    )  # fmt: skip
    rise, excess_k, slot, horizon = layer.table.rise_k, fresh.excess_k, fresh.slot, fresh.near.horizon_s
    known = fresh.known
    since, node, share, entry_k = log.since_s, log.node, log.share, log.entry_k
    count, columns, last = len(order), rise.shape[2], excess_k.shape[3] - 1
    total = 0.0
    for place in range(first):
        total += power(entry_k[place])
    for n in range(-2, count):
        place = a if n == -2 else b if n == -1 else by_heat[n]
        if place < first or (n == -1 and a == b) or (n >= 0 and place in (a, b)):
            continue
        now, island = start[place], order[place]
        for earlier in range(place):
            since[earlier] = now - start[earlier] - time[earlier]
        since[place] = now
        for m in range(place + 1):
            node[m], share[m] = table_place(since[m], nodes, horizon, columns)
        low, high = rise[island, count, node[place]], rise[island, count, node[place] + 1]
        temperature = float(low + (high - low) * share[place])
        for earlier in range(place):
            low, high = (
                rise[island, order[earlier], node[earlier]],
                rise[island, order[earlier], node[earlier] + 1],
            )
            temperature += low + (high - low) * share[earlier]
        excess = 0.0
        for earlier in range(place - 1, -1, -1):
            if since[earlier] >= horizon:
                break
            row, by, left_by = slot[island, order[earlier]], options[place], options[earlier]
            if row >= 0:
                if not known[row, left_by]:
                    work_out(fresh, row, island, order[earlier], left_by)
                at = np.sqrt(np.true_divide(max(since[earlier], 0.0), horizon)) * last
                under = min(int(at), last - 1)
                low, high = excess_k[row, by, left_by, under], excess_k[row, by, left_by, under + 1]
                excess += low + (high - low) * min(at - under, 1.0)
        entry_k[place] = temperature + max(excess, 0.0)
        total += power(entry_k[place])
        if total > most:
            break
    return total


@kernel
def sort_by_heat(by_heat: Ints, entry_k: Floats) -> None:
    """Put places in order again, the hottest first: few changed theirs since the last time, which insertion is made for."""
    for n in range(1, len(by_heat)):
        place = by_heat[n]
        temperature, m = entry_k[place], n
        while m > 0 and entry_k[by_heat[m - 1]] < temperature:
            by_heat[m] = by_heat[m - 1]
            m -= 1
        by_heat[m] = place


@kernel
def copy_start(log: Log, stop: int, result: Log) -> None:
    """Copy what a log says of the places before one."""
    for n in range(stop):
        result.start_s[n], result.option[n], result.travel_mm[n] = (
            log.start_s[n],
            log.option[n],
            log.travel_mm[n],
        )
        result.entry_k[n], result.touches[n], result.time_s[n] = log.entry_k[n], log.touches[n], log.time_s[n]


@kernel
def new_log(count: int) -> Log:
    """Room for a log."""
    return Log(
        np.zeros(count),
        np.zeros(count, np.int64),
        np.zeros(count),
        np.zeros(count),
        np.zeros(count, np.int64),
        np.zeros(count),
        np.zeros(count),
        np.zeros(count, np.int32),
        np.zeros(count),
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
    # What is carried from place to place stays out of memory: the next place would wait for it.
    start, travel, touches, left_by, last = 0.0, 0.0, 0, 0, -1
    if first > 0:
        last, left_by = order[first - 1], log.option[first - 1]
        start, travel, touches = log.start_s[first - 1], log.travel_mm[first - 1], log.touches[first - 1]
    for n in range(first, len(order)):
        island = order[n]
        if last >= 0:
            distance = jump[last, left_by, island]
            start = start + time[last] + np.true_divide(distance, layer.rapid_mm_s)
            left_by = option[last, left_by, island]
            travel += distance
            touches += beside[last, island]
        log.start_s[n], log.option[n], log.travel_mm[n], log.touches[n] = start, left_by, travel, touches
        log.time_s[n] = time[island]
        last = island

"""Improve an order of islands by moves that are kept where they help, or at first where they do little harm.

Simulated annealing (Kirkpatrick, Gelatt & Vecchi 1983) on the temperatures of :mod:`ebamcheck.scan.influence`,
with a budget of moves, not of seconds.
"""

from __future__ import annotations

import numpy as np

from ebamcheck.kernels import kernel
from ebamcheck.rings import Floats, Ints
from ebamcheck.scan.drive import IslandDrive
from ebamcheck.scan.influence import Influence, Table, looked_up
from ebamcheck.scan.path import JOINED_MM

WARMTH = 0.02
"""Worsening, as a share of the first cost, that is taken at the beginning about every third time."""


def annealed(
    table: Influence,
    drive: IslandDrive,
    rapid_mm_s: float,
    order: Ints,
    longest_mm: float,
    price_k_mm: float,
    steps: int,
    random: np.random.Generator,
) -> Ints:
    """Exchange, move and turn around islands of an order.

    The cost is the greatest entry temperature plus their spread, K, plus a price on travel that is too long.

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
    """
    count = len(order)
    if steps == 0 or count < 2:
        return order
    places = random.integers(0, count, (steps, 2))
    leniency = random.exponential(size=steps) * np.linspace(1.0, 0.0, steps)
    return improved(
        table.rise_k,
        table.spacing_s,
        drive.entry,
        drive.leave,
        drive.time_s,
        rapid_mm_s,
        np.asarray(order, np.int64),
        longest_mm,
        price_k_mm,
        places,
        leniency,
    )


@kernel
def improved(
    rise: Table,
    spacing: float,
    entry: Floats,
    leave: Floats,
    time: Floats,
    rapid: float,
    order: Ints,
    longest: float,
    price: float,
    places: Ints,
    leniency: Floats,
) -> Ints:
    """Return the best order met."""
    count = len(order)
    # By place: end of the island, where it was left (x, y), travel so far, temperature at entry.
    log, tried_log = np.zeros((count, 5)), np.zeros((count, 5))
    kept, best = order.copy(), order.copy()
    drive_from(0, kept, rise, spacing, entry, leave, time, rapid, np.inf, log)
    cost = cost_of(log, longest, price)
    best_cost, warmth = cost, WARMTH * cost
    for step in range(len(places)):
        a, b = places[step]
        if step % 2:
            a = np.argmax(log[:, 4])
        if a == b:
            continue
        tried = moved(kept, a, b, step // 2 % 3)
        first = min(a, b)
        tried_log[:first] = log[:first]
        allowed = cost + warmth * leniency[step]
        if not drive_from(first, tried, rise, spacing, entry, leave, time, rapid, allowed, tried_log):
            continue
        new_cost = cost_of(tried_log, longest, price)
        if new_cost < allowed:
            kept, cost = tried, new_cost
            log, tried_log = tried_log, log
            if cost < best_cost:
                best, best_cost = kept.copy(), cost
    return best


@kernel
def moved(order: Ints, a: int, b: int, kind: int) -> Ints:
    """Exchange two places, move one to the other, or turn around all between them."""
    result = order.copy()
    if kind == 0:
        result[a], result[b] = order[b], order[a]
    elif kind == 1:
        step = 1 if b > a else -1
        for place in range(a, b, step):
            result[place] = order[place + step]
        result[b] = order[a]
    else:
        low, high = min(a, b), max(a, b)
        for n in range(high - low + 1):
            result[low + n] = order[high - n]
    return result


@kernel
def drive_from(
    first: int,
    order: Ints,
    rise: Table,
    spacing: float,
    entry: Floats,
    leave: Floats,
    time: Floats,
    rapid: float,
    hottest: float,
    log: Floats,
) -> bool:
    """Drive the islands from a place on; give up as soon as one is entered hotter than `hottest`."""
    count = len(order)
    for n in range(first, count):
        island = order[n]
        nearest, way = 0.0, 0
        clock, travel = 0.0, 0.0
        if n > 0:
            clock, x, y, travel = log[n - 1, 0], log[n - 1, 1], log[n - 1, 2], log[n - 1, 3]
            nearest = np.inf
            for v in range(4):
                distance = np.hypot(entry[island, v, 0] - x, entry[island, v, 1] - y)
                if distance < nearest - JOINED_MM:
                    nearest, way = distance, v
        clock += nearest / rapid
        temperature = looked_up(rise, spacing, island, count, clock)
        for m in range(n):
            temperature += looked_up(rise, spacing, island, order[m], clock - log[m, 0])
        log[n, 0] = clock + time[island]
        log[n, 1], log[n, 2] = leave[island, way, 0], leave[island, way, 1]
        log[n, 3], log[n, 4] = travel + nearest, temperature
        if temperature > hottest:
            return False
    return True


@kernel
def cost_of(log: Floats, longest: float, price: float) -> float:
    """Greatest and spread of the entry temperatures, and the price of travel beyond what is allowed."""
    temperature = log[:, 4]
    return float(temperature.max() + temperature.std() + price * max(0.0, log[-1, 3] - longest))

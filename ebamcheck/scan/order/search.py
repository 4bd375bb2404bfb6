"""Orders by heat: greedy plans, of which the coolest is improved by moves of islands that make it cooler.

The score of an island is its mean temperature at the time it would be entered, or that under the beam where it would be entered,
whichever is more, plus the travel to it and the start of the wire, each at its price in kelvin. No island follows one that it
touches while another is left. A low price of travel makes cool but long ways, so plans for several prices are made."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ebamcheck.heat.field import Modes, Timetable, late_heat, read_surface
from ebamcheck.heat.influence import MOST_ISLANDS, Influence, influence, table_place, work_out
from ebamcheck.heat.island_heat import IslandHeat
from ebamcheck.heat.near_field import NearField, entry_rise, young_mean
from ebamcheck.kernels import Bools, Floats, Ints, kernel
from ebamcheck.scan.filling.schedule import JOINED_MM, IslandSchedule
from ebamcheck.scan.order.entries import (
    EntryOptions,
    clocked,
    entry_options,
    entry_points,
    high_mean,
    nearest_option,
)
from ebamcheck.threads import run_each

# Prices of travel of the greedy plans: in temperature rises of an island by its own heat, over widths of an island
PRICES = (0.005, 0.01, 0.0025, 0.02)
FEW_ISLANDS = 8  # islands whose plan moves improve whatever the settings say: it takes no time, and comes near the best of all orders
STARTS = 2  # first islands of the greedy plans for each price, where no moves follow
MOST_WORK = (
    4e9  # multiplications in the greedy plans of a layer, which limits their number on a layer of thousands of islands
)
# Moves that improve a plan, over its islands; and moves times islands, so that a layer of 300 gets 3300
MOVES_AN_ISLAND, MOST_MOVES = 800, 1e6
# Worsening taken at first by a move, as a share of the first cost: over the islands, and at most; without it the hottest entry is 4 % warmer
WARMTH, MOST_WARMTH = 0.2, 0.005
HOTTEST_EVERY = 10  # one move in so many starts at the hottest island; the others anywhere
TOUCH_SHARE = (
    100.0  # price of an island that touches the one before, over the first cost: no gain in heat or travel is worth it
)
TIE_K = 1e-6  # temperatures closer than this are equal: rounding must not decide between islands that mirror each other


def thermal_order(
    heat: IslandHeat,
    schedule: IslandSchedule,
    beside: Bools,
    rapid_mm_s: float,
    width_mm: float,
    longest_mm: float,
    start_travel_mm: float,
    steps: int,
    random: np.random.Generator,
) -> Ints:
    """Islands (I,) in scan order: the coolest greedy plan whose travel is not too long, improved by moves.

    `beside` (I, I) tells which islands touch, `width_mm` is the width of one, `longest_mm` the travel that is allowed (else the
    shortest plan is taken), `start_travel_mm` the travel that counts as much as a start of the wire, and `steps` the most moves.
    """
    count = len(schedule)
    price_k_mm = float(own_rise(heat, schedule).mean()) / width_mm
    steps = max(steps, MOVES_AN_ISLAND * FEW_ISLANDS) if count <= FEW_ISLANDS else steps
    moves = min(steps, MOVES_AN_ISLAND * count, int(MOST_MOVES / count)) if count <= MOST_ISLANDS else 0
    # A plan that no move improves is chosen among more: with one first island the coolest may touch the one before it.
    starts = [0] if moves else sorted({count * n // STARTS for n in range(STARTS)})
    affordable = max(1, int(MOST_WORK / (count**2 * len(heat.modes.plane_rate))))
    tries = [(price * price_k_mm, first) for price in PRICES for first in starts][:affordable]

    def greedy(price: tuple[float, int]) -> Ints:
        k_mm, first = price
        return greedy_order(heat, schedule, beside, rapid_mm_s, first, k_mm, k_mm * start_travel_mm)

    def rank(order: Ints) -> tuple[int, float, float]:
        return ranked(heat, schedule, beside, rapid_mm_s, order, longest_mm)

    least, best = min(((rank(order), order) for order in run_each(greedy, tries)), key=lambda plan: plan[0])
    if moves == 0:
        return best
    _, end_s, travel_mm = clocked(schedule, best, rapid_mm_s)
    # Twice the time of a way that is too long: none met in the search takes longer.
    latest_s = float(end_s.max()) + max(travel_mm, longest_mm) / rapid_mm_s
    table = influence(heat, schedule.time_s, latest_s)
    layer = Layer(table, entry_options(schedule), beside, schedule.time_s, rapid_mm_s)
    places, warmth = random.integers(0, count, (moves, 2)), min(WARMTH / count, MOST_WARMTH)
    leniency = warmth * random.exponential(size=moves) * np.linspace(1.0, 0.0, moves)
    logs = new_log(count), new_log(count)
    tried = improved(layer, best, longest_mm, price_k_mm, places, leniency, *logs)
    return tried if rank(tried) < least else best


def own_rise(heat: IslandHeat, schedule: IslandSchedule) -> Floats:
    """Mean temperature rise of each island by its own heat when the beam leaves it, (I,) K."""
    rise = np.zeros(len(schedule))
    for n, wave in enumerate(heat.modes.in_layer):
        decay_s = heat.modes.plane_rate[:, None] + heat.modes.depth_rate[n]
        held = -np.expm1(-decay_s * schedule.time_s) / np.where(decay_s > 0.0, decay_s, 1.0)
        held = np.where(decay_s > 0.0, held, schedule.time_s)
        rise += wave**2 * heat.modes.source_k_s * (heat.modes.mean**2 * held).sum(axis=0)
    return rise


def ranked(
    heat: IslandHeat,
    schedule: IslandSchedule,
    beside: Bools,
    rapid_mm_s: float,
    order: Ints,
    longest_mm: float,
) -> tuple[int, float, float]:
    """Rank of a plan: touching successors; travel beyond what is allowed, mm; high mean of the entry temperatures, K."""
    start_s, end_s, travel_mm = clocked(schedule, order, rapid_mm_s)
    high_k = high_mean(np.maximum(*entry_points(heat, schedule, order, start_s, end_s)))
    too_far_mm = max(0.0, travel_mm - longest_mm)
    return int(touching_successors(beside, order).sum()), too_far_mm, round(high_k / TIE_K) * TIE_K


# -- Islands that touch: a border just laid is the hottest place of a layer, and no island is begun on it without need.


def touching(neighbours: Ints, count: int) -> Bools:
    """Whether each two islands (I, I) have a common border, by the pairs (P, 2) that have one."""
    table = np.zeros((count, count), np.bool_)
    table[neighbours[:, 0], neighbours[:, 1]] = table[neighbours[:, 1], neighbours[:, 0]] = True
    return table


def touching_successors(beside: Bools, order: Ints) -> Bools:
    """Whether each island (I,) of an order, by place, touches the one before it while another one was left that does not."""
    after = np.triu(beside[np.ix_(order, order)], 1)
    found = np.zeros(len(order), np.bool_)
    found[1:] = after.diagonal(1) & (after.sum(axis=1)[:-1] < np.arange(len(order) - 1, 0, -1))
    return found


# -- Greedy: the next island is that with the least score when the beam gets there.


class _Heated(NamedTuple):
    """What a greedy plan reads; see :class:`~ebamcheck.scan.filling.schedule.IslandSchedule`."""

    modes: Modes
    late: Modes
    near: NearField
    beside: Bools
    entry: Floats
    leave: Floats
    time_s: Floats
    rapid_mm_s: float
    travel_k_mm: float
    start_k: float


class _Greedy(NamedTuple):
    """A greedy plan while it grows, by island (I,) but for its order; jump and option are those to an island that is left."""

    order: Ints
    start_s: Floats
    end_s: Floats
    option: Ints
    scanned: Bools
    jump_mm: Floats
    fresh_mean_k: Floats
    fresh_entry_k: Floats


def greedy_order(
    heat: IslandHeat,
    schedule: IslandSchedule,
    beside: Bools,
    rapid_mm_s: float,
    first: int,
    price_k_mm: float,
    start_k: float,
) -> Ints:
    """Order islands by heat from a first one on, for one price of travel (K/mm) and of a wire start (K)."""
    count, columns = len(schedule), (schedule.entry, schedule.leave, schedule.time_s, rapid_mm_s)
    late = heat.modes.late(heat.fresh.horizon_s)
    layer = _Heated(heat.modes, late, heat.fresh, beside, *columns, price_k_mm, start_k)
    order, option = np.zeros((2, count), np.int64)
    start_s, end_s, jump_mm, mean_k, entry_k = np.zeros((5, count))
    scanned = np.zeros(count, np.bool_)
    plan = _Greedy(order, start_s, end_s, option, scanned, jump_mm, mean_k, entry_k)
    # No jump is longer than both sides of the bounding rectangle.
    latest_s = float(np.ptp(schedule.entry, axis=(0, 1)).sum()) / rapid_mm_s
    coolest_first(layer, plan, first, heat.modes.mean.copy(), heat.start_k, latest_s)
    return plan.order


@kernel
def coolest_first(layer: _Heated, plan: _Greedy, first: int, mean: Floats, start: Floats, latest: float) -> None:
    """Fill a plan by score; `mean` (K, I) is used up, and `start` (K, N) are the amplitudes that the layer begins with.

    Old heat, of which the modes have all, is linear between the earliest entry and the latest one, so much time later.
    """
    count, horizon = mean.shape[1], layer.near.horizon_s
    late_modes, state = layer.late, start.copy()
    ahead, early, late = np.empty_like(state), np.empty(len(mean)), np.empty(len(mean))
    left, now, soon = np.arange(count), np.empty(count), np.empty(count)
    clock, reached, place, option, jump = 0.0, 0, first, 0, 0.0
    for n in range(count):
        island = left[place]
        plan.order[n] = island
        last, plan.start_s[island] = clock, clock + jump / layer.rapid_mm_s
        clock = plan.start_s[island] + layer.time_s[island]
        plan.option[island], plan.end_s[island], plan.scanned[island] = option, clock, True
        timetable = Timetable(plan.order[: n + 1], plan.start_s, plan.end_s)
        reached = late_heat(state, late_modes, timetable, horizon, last, clock, reached)
        rest = count - n - 1
        if rest == 0:
            break
        # The last island takes the place of the one that was scanned: those left stay side by side.
        left[place] = left[rest]
        mean[:, place] = mean[:, rest]
        ahead[:] = state
        late_heat(ahead, late_modes, timetable, horizon, clock, clock + latest, reached)
        read_surface(state, layer.modes.in_layer, early)
        read_surface(ahead, layer.modes.in_layer, late)
        now[:rest], soon[:rest] = 0.0, 0.0
        for k in range(len(mean)):
            for j in range(rest):
                now[j] += early[k] * mean[k, j]
                soon[j] += late[k] * mean[k, j]
        x, y = layer.leave[island, option, 0], layer.leave[island, option, 1]
        for candidate in left[:rest]:
            plan.jump_mm[candidate], plan.option[candidate] = nearest_option(layer.entry[candidate], x, y)
        _set_fresh_heat(layer, plan, n)
        place = _coolest(layer, plan, island, left[:rest], now, soon, latest)
        option, jump = plan.option[left[place]], plan.jump_mm[left[place]]


@kernel
def _set_fresh_heat(layer: _Heated, plan: _Greedy, n: int) -> None:
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
            time, by, left_by = layer.time_s[last], plan.option[i], plan.option[last]
            plan.fresh_mean_k[i] += source[last] * young_mean(near, near.pair[p], since, time)
            plan.fresh_entry_k[i] += source[last] * entry_rise(near, i, by, last, left_by, since, time)


@kernel
def _coolest(layer: _Heated, plan: _Greedy, last: int, left: Ints, now: Floats, soon: Floats, latest: float) -> int:
    """Place among the islands left of that with the least score; of one that touches the last only where all do."""
    place, best, best_island, best_touches = 0, np.inf, -1, True
    for j in range(left.size):
        candidate = left[j]
        jump = plan.jump_mm[candidate]
        share = jump / layer.rapid_mm_s / latest if latest > 0.0 else 0.0
        score = now[j] + (soon[j] - now[j]) * share
        score += max(plan.fresh_mean_k[candidate], plan.fresh_entry_k[candidate]) + layer.travel_k_mm * jump
        if jump > JOINED_MM:
            score += layer.start_k
        touches = layer.beside[last, candidate]
        if touches and not best_touches:
            continue
        cooler = score < best - TIE_K or (score < best + TIE_K and candidate < best_island)
        if cooler or (best_touches and not touches):
            place, best, best_island, best_touches = j, score, candidate, touches
    return place


# -- Improvement: the cost is the high mean of the entry temperatures, K, plus prices on travel that is too long, and on
# islands that touch the one before.


class Layer(NamedTuple):
    """What orders are tried on: rises by each other, jumps, which islands (I, I) touch, the time of each (I,), the speed of
    jumps."""

    table: Influence
    options: EntryOptions
    beside: Bools
    time_s: Floats
    rapid_mm_s: float


class Log(NamedTuple):
    """An order simulated, by place (I,): begin of the island, s, entry option, travel so far, mm, how many islands so far touch
    the one before, entry temperature, K; and room for one place: node and share in the table for the time since each other one."""

    start_s: Floats
    option: Ints
    travel_mm: Floats
    touches: Ints
    entry_k: Floats
    node: NDArray[np.int32]
    share: Floats


def new_log(count: int) -> Log:
    """Room for the log of an order."""
    ints = np.zeros((2, count), np.int64)
    floats = np.zeros((4, count))
    return Log(floats[0], ints[0], floats[1], ints[1], floats[2], np.zeros(count, np.int32), floats[3])


@kernel
def improved(
    layer: Layer,
    order: Ints,
    longest: float,
    price: float,
    places: Ints,
    leniency: Floats,
    log: Log,
    other: Log,
) -> Ints:
    """Best order met by moves between places (S, 2): exchanges, shifts and turned stretches by turns.

    A move is kept if it worsens the cost by less than its `leniency` (S,), a share of the first cost (annealing: Kirkpatrick,
    Gelatt & Vecchi 1983)."""
    count = len(order)
    kept, tried = order.copy(), order.copy()
    by_heat = np.arange(count)
    # A number, not a literal, which would be compiled once more.
    begin, changed = count - count, True
    time_from(begin, kept, layer, log)
    total = powers_from(begin, begin, begin, by_heat, kept, layer, np.inf, log)
    cost = (total / count) ** (1.0 / 12.0)
    touch_price, warmth = TOUCH_SHARE * cost, cost
    cost += price * max(0.0, log.travel_mm[-1] - longest) + touch_price * log.touches[-1]
    best, least = kept.copy(), cost
    for step in range(len(places)):
        if changed:
            # Few changed their place since the last time, which insertion is made for: the hottest comes first.
            for n in range(1, count):
                place, m = by_heat[n], n
                while m > 0 and log.entry_k[by_heat[m - 1]] < log.entry_k[place]:
                    by_heat[m] = by_heat[m - 1]
                    m -= 1
                by_heat[m] = place
            changed = False
        a, b = places[step, 0], places[step, 1]
        if step % HOTTEST_EVERY == 0:
            a = by_heat[0]
        if a == b:
            continue
        low, high, allowed = min(a, b), max(a, b), cost + warmth * leniency[step]
        tried[:] = kept
        if step % 3 == 0:
            tried[a], tried[b] = kept[b], kept[a]
        elif step % 3 == 2:
            tried[low : high + 1] = kept[low : high + 1][::-1]
        elif a < b:
            tried[a:b] = kept[a + 1 : b + 1]
            tried[b] = kept[a]
        else:
            tried[b + 1 : a + 1] = kept[b:a]
            tried[b] = kept[a]
        for n in range(low):
            other.start_s[n], other.option[n] = log.start_s[n], log.option[n]
            other.travel_mm[n], other.touches[n] = log.travel_mm[n], log.touches[n]
            other.entry_k[n] = log.entry_k[n]
        time_from(low, tried, layer, other)
        rest = price * max(0.0, other.travel_mm[-1] - longest) + touch_price * other.touches[-1]
        if rest >= allowed:
            continue
        most = count * (allowed - rest) ** 12
        total = powers_from(low, a, b, by_heat, tried, layer, most, other)
        if total >= most:
            continue
        cost = (total / count) ** (1.0 / 12.0) + rest
        kept, tried, changed = tried, kept, True
        log, other = other, log
        if cost < least:
            best[:], least = kept, cost
    return best


@kernel
def time_from(first: int, order: Ints, layer: Layer, log: Log) -> None:
    """Time the islands from a place on, entering each by the nearest option."""
    jump, option, time, beside = layer.options.jump_mm, layer.options.option, layer.time_s, layer.beside
    # What is carried from place to place stays out of memory: the next place would wait for it.
    start, travel, touches, left_by, last = 0.0, 0.0, 0, 0, -1
    if first > 0:
        last, left_by = order[first - 1], log.option[first - 1]
        start, travel, touches = log.start_s[first - 1], log.travel_mm[first - 1], log.touches[first - 1]
    for n in range(first, len(order)):
        island = order[n]
        if last >= 0:
            distance = jump[last, left_by, island]
            start = start + time[last] + distance / layer.rapid_mm_s
            left_by = option[last, left_by, island]
            travel += distance
            if beside[last, island]:
                # It counts only while another one is left that does not touch.
                m = n + 1
                while m < len(order) and beside[last, order[m]]:
                    m += 1
                touches += m < len(order)
        log.start_s[n], log.option[n], log.travel_mm[n], log.touches[n] = start, left_by, travel, touches
        last = island


@kernel
def powers_from(first: int, a: int, b: int, by_heat: Ints, order: Ints, layer: Layer, most: float, log: Log) -> float:
    """Sum of the twelfth powers of the entry temperatures, those from a place on worked out; any sum beyond `most` if it is more.

    The rise of an island when the beam enters it is its mean, or that of its entry if it is more. The places that were moved come
    first, then the hottest."""
    # Taken out of their tuples once for all places: each column that is taken out is counted as one more in use.
    fresh, nodes, start, time, options = (
        layer.table.fresh, layer.table.nodes_per_root_s, log.start_s, layer.time_s, log.option,
    )  # fmt: skip
    rise, excess_k, slot, horizon = layer.table.rise_k, fresh.excess_k, fresh.slot, fresh.near.horizon_s
    node, share, entry_k, known = log.node, log.share, log.entry_k, fresh.known
    count, columns, last = len(order), rise.shape[2], excess_k.shape[3] - 1
    total = 0.0
    for place in range(first):
        total += max(entry_k[place], 0.0) ** 12
    for n in range(-2, count):
        place = a if n == -2 else b if n == -1 else by_heat[n]
        if place < first or (n == -1 and a == b) or (n >= 0 and place in (a, b)):
            continue
        now, island = start[place], order[place]
        for earlier in range(place):
            since = now - start[earlier] - time[order[earlier]]
            node[earlier], share[earlier] = table_place(since, nodes, horizon, columns)
        at, part = table_place(now, nodes, horizon, columns)
        low, high = rise[island, count, at], rise[island, count, at + 1]
        temperature = float(low + (high - low) * part)
        for earlier in range(place):
            other, at = order[earlier], node[earlier]
            low, high = rise[island, other, at], rise[island, other, at + 1]
            temperature += low + (high - low) * share[earlier]
        excess = 0.0
        for earlier in range(place - 1, -1, -1):
            since = now - start[earlier] - time[order[earlier]]
            if since >= horizon:
                break
            row, by, left_by = slot[island, order[earlier]], options[place], options[earlier]
            if row >= 0:
                if not known[row, left_by]:
                    work_out(fresh, row, island, order[earlier], left_by)
                root = np.sqrt(max(since, 0.0) / horizon) * last
                under = min(int(root), last - 1)
                low, high = excess_k[row, by, left_by, under], excess_k[row, by, left_by, under + 1]
                excess += low + (high - low) * min(root - under, 1.0)
        entry_k[place] = temperature + max(excess, 0.0)
        total += max(entry_k[place], 0.0) ** 12
        if total > most:
            break
    return total

"""Orders by heat: at every step the island that is coolest when the beam gets there, and not too far away.

The score of an island is its temperature at the time it would be entered, plus the travel to it and the start of the
wire, each at its price in kelvin. Its temperature is its mean, or that under the beam where it would be entered
(:mod:`~ebamcheck.scan.heat.near_field`), whichever is more. No island follows one that it touches while another is left. A
low price of travel makes cool but long ways; so plans for several prices are made, and the coolest of those whose way
is short enough are improved (:mod:`~ebamcheck.scan.order.annealing`). Of a few islands all orders are tried
(:mod:`~ebamcheck.scan.order.all_orders`).
"""

from __future__ import annotations

import itertools
import math
from functools import partial
from typing import NamedTuple

import numpy as np

from ebamcheck.numeric.kernels import kernel, run_blocks
from ebamcheck.numeric.rings import Bools, Floats, Ints
from ebamcheck.scan.filling.schedule import IslandSchedule
from ebamcheck.scan.filling.turns import JOINED_MM
from ebamcheck.scan.heat.aged_heat import by_depth, late_modes, read_surface, with_late_heat
from ebamcheck.scan.heat.amplitudes import Modes, Timetable
from ebamcheck.scan.heat.influence import MOST_ISLANDS, influence
from ebamcheck.scan.heat.island_heat import IslandHeat
from ebamcheck.scan.heat.near_field import NearField, young_rise
from ebamcheck.scan.order.all_orders import MOST_LISTED, best_of_all
from ebamcheck.scan.order.annealing import Layer, annealed, high_mean
from ebamcheck.scan.order.entry_options import entry_options, nearest_option
from ebamcheck.scan.order.simulation import clocked, entry_points
from ebamcheck.scan.order.touching import Touching, touching, touching_successors

PRICES = (0.005, 0.01, 0.0025, 0.02, 0.04, 0.08, 0.16)
"""Prices of travel that are tried: in temperature rises of an island by its own heat, over widths of an island.
The best one differs from layer to layer by chance; on the largest layers, which can afford few, it is the first."""

MOST_MOVES = 7e6
"""Moves times islands in the improvement of plans: enough for two plans of 80 islands, for all of 20, for one of 300."""

WARMTH_OF_MANY, MOST_WARMTH, WARMTH_OF_FEW = 0.2, 0.005, 0.05
"""Worsening taken at first when a plan is improved, as a share of its cost: the first over the islands, since a move of one
of them changes the less the more there are, but no more than the second. Every third plan of few islands, which find no
way out by less, takes the third; plans of many lose what they have by it."""

FEW_ISLANDS = 20
"""Islands of which every third plan is improved by more worsening."""

STARTS = 2
"""Islands from which each price is tried."""

MOST_WORK = 4e9
"""Multiplications in one search, which limits the plans tried on a layer of thousands of islands: to two of 2100."""

MOVES_AN_ISLAND, MOVES_A_PLAN = 800, 30_000
"""Moves tried for each island, and at most, when a plan is improved: more find nothing that is worth their time."""

AT_ONCE, AGREED = 4, 3
"""Plans that are improved before their ranks are looked at, and how many have to have come to the least one to end it."""

Rank = tuple[int, float, float]
"""Rank of a plan, see :func:`ranked`: the less the better."""

FEWEST_A_THREAD = 100
"""Islands in all the plans that a thread is worth: one island takes some ten microseconds."""

TIE_K = 1e-6
"""Scores closer than this are equal: rounding must not decide between islands that mirror each other."""


def thermal_order(
    heat: IslandHeat,
    schedule: IslandSchedule,
    neighbours: Ints,
    rapid_mm_s: float,
    width_mm: float,
    longest_mm: float,
    start_travel_mm: float,
    steps: int,
    random: np.random.Generator,
) -> Ints:
    """Order islands by heat: the coolest of several greedy plans whose travel is not too long, improved.

    Of a few islands all orders are tried.

    Parameters
    ----------
    neighbours
        (P, 2) pairs of islands that touch.
    width_mm
        Width of an island.
    longest_mm
        Travel between islands that is allowed; where no plan keeps it, the one of least travel is taken.
    start_travel_mm
        Travel that counts as much as a start of the wire.
    steps
        Moves by which the plan is improved, at most.
    random
        Source of these moves.
    """
    count = len(schedule)
    price_k_mm = float(np.mean(own_rise(heat, schedule))) / width_mm
    beside = touching(neighbours, count)
    if count <= MOST_LISTED:
        options = entry_options(schedule)
        latest_s = float(schedule.time_s.sum() + (count - 1) * options.jump_mm.max() / rapid_mm_s)
        table = influence(heat, schedule.time_s, latest_s)
        return best_of_all(Layer(table, options, beside, schedule.time_s, rapid_mm_s), longest_mm)
    tries = _tries(count, len(heat.modes.plane_rate))

    def plans(start: int, stop: int) -> list[tuple[Ints, Rank]]:
        done = []
        for price, first in tries[start:stop]:
            paid = price * price_k_mm
            order = greedy_order(heat, schedule, beside, rapid_mm_s, first, paid, paid * start_travel_mm)
            done.append((order, ranked(heat, schedule, beside, rapid_mm_s, order, longest_mm)))
        return done

    found = run_blocks(plans, len(tries), smallest=math.ceil(FEWEST_A_THREAD / count))
    plans_made = sorted(itertools.chain(*found), key=lambda plan: plan[1])
    best, best_rank = plans_made[0]
    if count > MOST_ISLANDS or steps == 0:
        return best
    *_, end_s, travel = clocked(best, schedule.entry, schedule.leave, schedule.time_s, rapid_mm_s)
    # Twice the time of a way that is too long: none met in the search takes longer.
    table = influence(heat, schedule.time_s, float(end_s.max()) + max(travel, longest_mm) / rapid_mm_s)
    layer = Layer(table, entry_options(schedule), beside, schedule.time_s, rapid_mm_s)
    most = min(steps, MOVES_AN_ISLAND * count, MOVES_A_PLAN, int(MOST_MOVES / count))
    begun = [start for start, _ in plans_made[: max(1, int(MOST_MOVES / (most * count)))]]
    sources = random.spawn(len(begun))

    def improved(begin: int, start: int, stop: int) -> list[tuple[Ints, Rank]]:
        done = []
        for n in range(begin + start, begin + stop):
            order = annealed(layer, begun[n], longest_mm, price_k_mm, most, sources[n], _warmth(n, count))
            done.append((order, ranked(heat, schedule, beside, rapid_mm_s, order, longest_mm)))
        return done

    ranks: list[Rank] = []
    for begin in range(0, len(begun), AT_ONCE):
        end = min(begin + AT_ONCE, len(begun))
        for tried, rank in itertools.chain(*run_blocks(partial(improved, begin), end - begin)):
            ranks.append(rank)
            if better(rank, best_rank):
                best, best_rank = tried, rank
        if sum(not better(best_rank, rank) for rank in ranks) >= AGREED:
            break
    return best


def _warmth(plan: int, count: int) -> float:
    """Worsening that is taken at first when one of the plans of a layer of some islands is improved."""
    if count <= FEW_ISLANDS and plan % 3 == 2:
        return WARMTH_OF_FEW
    return min(WARMTH_OF_MANY / count, MOST_WARMTH)


def _tries(count: int, modes: int) -> list[tuple[float, int]]:
    """Prices and first islands of the greedy plans that a layer can afford."""
    starts = sorted({count * n // STARTS for n in range(STARTS)})
    tries = [(price, first) for price in PRICES for first in starts]
    return tries[: max(1, int(MOST_WORK / (count**2 * modes)))]


def better(rank: Rank, than: Rank) -> bool:
    """Whether a plan has fewer touching successors, or less travel too much, or is as good in both and cooler."""
    return rank[:2] < than[:2] or (rank[:2] == than[:2] and rank[2] < than[2] - TIE_K)


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
    beside: Touching,
    rapid_mm_s: float,
    order: Ints,
    longest_mm: float,
) -> Rank:
    """Rank of a plan: touching successors; travel beyond what is allowed, mm; high mean of the entry temperatures, K."""
    start_s, end_s, travel = clocked(order, schedule.entry, schedule.leave, schedule.time_s, rapid_mm_s)
    means_k, points_k = entry_points(heat, schedule, order, start_s, end_s)
    too_near = int(touching_successors(beside, order).sum())
    return too_near, max(0.0, travel - longest_mm), high_mean(np.maximum(means_k, points_k))


def greedy_order(
    heat: IslandHeat,
    schedule: IslandSchedule,
    beside: Touching,
    rapid_mm_s: float,
    first: int,
    price_k_mm: float,
    start_k: float,
) -> Ints:
    """Order islands by heat for one price of travel (K/mm) and of a wire start (K)."""
    layer = _Layer(
        heat.modes, heat.fresh, beside, schedule.entry, schedule.leave, schedule.time_s, rapid_mm_s
    )
    return coolest_first(layer, _Prices(price_k_mm, start_k), first, heat.modes.mean.copy(), heat.start_k)


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
def coolest_first(layer: _Layer, prices: _Prices, first: int, mean: Floats, start: Floats) -> Ints:
    """Order by score; `mean` (K, I) is used up, and `start` (K, N) are the amplitudes that the layer begins with.

    Old heat, of which the modes have all, is linear between the earliest and the latest entry.
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
    for n in range(count):
        island = left[place]
        plan.order[n] = island
        last, plan.start_s[island] = clock, clock + jump / layer.rapid_mm_s
        clock = plan.start_s[island] + layer.time_s[island]
        plan.option[island], plan.end_s[island], plan.scanned[island] = option, clock, True
        timetable = Timetable(plan.order[: n + 1], plan.start_s, plan.end_s)
        reached = with_late_heat(state, aged, timetable, horizon, last, clock, reached)
        rest = count - n - 1
        if rest == 0:
            break
        # The last island takes the place of the one that was scanned: those left stay side by side.
        left[place] = left[rest]
        mean[:, place] = mean[:, rest]
        ahead[:] = state
        with_late_heat(ahead, aged, timetable, horizon, clock, clock + latest, reached)
        read_surface(state, layer.modes.in_layer, early)
        read_surface(ahead, layer.modes.in_layer, late)
        _set_old_heat(mean, early, now[:rest])
        _set_old_heat(mean, late, soon[:rest])
        x, y = layer.leave[island, option, 0], layer.leave[island, option, 1]
        for candidate in left[:rest]:
            plan.jump_mm[candidate], plan.by[candidate] = nearest_option(layer.entry[candidate], x, y)
        _set_fresh_heat(layer, plan, n)
        for m in range(layer.beside.first[island], layer.beside.first[island + 1]):
            plan.touches[layer.beside.other[m]] = n
        place = _coolest(layer, plan, n, left[:rest], now, soon, latest, prices)
        option, jump = plan.by[left[place]], plan.jump_mm[left[place]]
    return plan.order


@kernel
def _longest_jump_s(layer: _Layer) -> float:
    """Time of a jump along both sides of the layer's bounding rectangle, which none exceeds."""
    longest = 0.0
    for axis in range(2):
        longest += np.ptp(layer.entry[:, :, axis]) / layer.rapid_mm_s
    return longest


@kernel
def _set_old_heat(mean: Floats, surface: Floats, rise: Floats) -> None:
    """Rises of the islands left by amplitudes (K,), by their means (K, I), four modes in one pass."""
    rise[:] = 0.0
    paired = len(surface) // 4 * 4
    for k in range(0, paired, 4):
        a, b, c, d = surface[k], surface[k + 1], surface[k + 2], surface[k + 3]
        for j in range(len(rise)):
            rise[j] = rise[j] + a * mean[k, j] + b * mean[k + 1, j] + c * mean[k + 2, j] + d * mean[k + 3, j]
    for k in range(paired, len(surface)):
        for j in range(len(rise)):
            rise[j] += surface[k] * mean[k, j]


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
) -> int:
    """Place among the islands left of that with the least score; of one that touches the last only where all do.

    Parameters
    ----------
    now, soon
        Rises by old heat at the earliest and at the latest entry.
    latest_s
        Time between the two.
    """
    place, best, best_island, best_touches = 0, np.inf, -1, True
    for j in range(left.size):
        candidate = left[j]
        jump = plan.jump_mm[candidate]
        share = jump / layer.rapid_mm_s / latest_s if latest_s > 0.0 else 0.0
        score = now[j] + (soon[j] - now[j]) * share
        score += max(plan.fresh_mean_k[candidate], plan.fresh_entry_k[candidate])
        score += prices.travel_k_mm * jump
        if jump > JOINED_MM:
            score += prices.start_k
        hot = plan.touches[candidate] == n
        if hot and not best_touches:
            continue
        cooler = score < best - TIE_K or (score < best + TIE_K and candidate < best_island)
        if cooler or (best_touches and not hot):
            place, best, best_island, best_touches = j, score, candidate, hot
    return place

"""Orders by heat: at every step the island that is coolest when the beam gets there, and not too far away.

The score of an island is its temperature at the time it would be entered, plus the travel to it and the start of the
wire, each at its price in kelvin. Its temperature is its mean, or that under the beam where it would be entered
(:mod:`~ebamcheck.scan.heat.near_field`), whichever is more. No island follows one that it touches while another is left. A
low price of travel makes cool but long ways; so plans for several prices are made, and the coolest of those whose way
is short enough are improved (:mod:`~ebamcheck.scan.order.annealing`). Of a few islands all orders are tried
(:mod:`~ebamcheck.scan.order.thermal`).
"""

from __future__ import annotations

import itertools
import math
from functools import partial

import numpy as np

from ebamcheck.numeric.kernels import kernel, run_blocks
from ebamcheck.numeric.rings import Floats, Ints
from ebamcheck.scan.filling.schedule import IslandSchedule
from ebamcheck.scan.filling.turns import JOINED_MM
from ebamcheck.scan.heat.influence import MOST_ISLANDS, influence
from ebamcheck.scan.heat.island_heat import IslandHeat
from ebamcheck.scan.order.annealing import Layer, annealed, high_mean, new_log, powers_from, timed_from
from ebamcheck.scan.order.entry_options import entry_options
from ebamcheck.scan.order.greedy_heat import TIE_K, greedy_order
from ebamcheck.scan.order.path import Touching, touch_table, touching, touching_successors
from ebamcheck.scan.order.simulation import clocked, entry_points

PRICES = (0.005, 0.01, 0.0025, 0.02, 0.04, 0.08, 0.16)
"""Prices of travel that are tried: in temperature rises of an island by its own heat, over widths of an island.
The best one differs from layer to layer by chance; on the largest layers, which can afford few, it is the first."""

MOST_MOVES = 1e6
"""Moves times islands in the improvement of plans: enough for three plans of 20 islands, or for one of 300 with 3300 moves.
Seven times as many shorten the sample build by 0.1 %."""

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
    moves = min(steps, MOVES_AN_ISLAND * count, MOVES_A_PLAN, int(MOST_MOVES / count))
    if count > MOST_ISLANDS:
        moves = 0
    wanted = max(1, int(MOST_MOVES / (moves * count))) if moves > 0 else 1
    tries, known = _tries(count, len(heat.modes.plane_rate)), _KnownRanks(wanted)

    def plans(start: int, stop: int) -> list[tuple[Ints, Rank]]:
        done = []
        for price, first in tries[start:stop]:
            paid, most_k = price * price_k_mm, known.most_k()
            columns = heat, schedule, beside, rapid_mm_s, first, paid, paid * start_travel_mm
            order = greedy_order(*columns, most_k)
            if len(order) < count:
                if _driven(heat, schedule, rapid_mm_s, order)[0] > most_k:
                    continue
                order = greedy_order(*columns)
            rank = ranked(heat, schedule, beside, rapid_mm_s, order, longest_mm)
            known.ranks.append(rank)
            done.append((order, rank))
        return done

    found = run_blocks(plans, len(tries), smallest=math.ceil(FEWEST_A_THREAD / count))
    plans_made = sorted(itertools.chain(*found), key=lambda plan: plan[1])[:wanted]
    best, best_rank = plans_made[0]
    if moves == 0:
        return best
    *_, end_s, travel = clocked(best, schedule.entry, schedule.leave, schedule.time_s, rapid_mm_s)
    # Twice the time of a way that is too long: none met in the search takes longer.
    latest_s = float(end_s.max()) + max(travel, longest_mm) / rapid_mm_s
    table = influence(heat, schedule.time_s, latest_s, whole=wanted > 1)
    layer = Layer(table, entry_options(schedule), beside, schedule.time_s, rapid_mm_s)
    begun = [start for start, _ in plans_made]
    sources = random.spawn(len(begun))

    def improved(begin: int, start: int, stop: int) -> list[tuple[Ints, Rank]]:
        done = []
        for n in range(begin + start, begin + stop):
            order = annealed(layer, begun[n], longest_mm, price_k_mm, moves, sources[n], _warmth(n, count))
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


class _KnownRanks:
    """Ranks of the plans made so far, in whatever order the threads make them, of which the best ones are `wanted`."""

    def __init__(self, wanted: int) -> None:
        self.ranks: list[Rank] = []
        self._wanted = wanted

    def most_k(self) -> float:
        """High mean beyond which no plan, whatever its way, is among those wanted."""
        last = sorted(self.ranks)[self._wanted - 1 : self._wanted]
        if not last or last[0][:2] > (0, 0.0):
            return math.inf
        return last[0][2] + TIE_K


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
    high_k, travel = _driven(heat, schedule, rapid_mm_s, order)
    return int(touching_successors(beside, order).sum()), max(0.0, travel - longest_mm), high_k


def _driven(
    heat: IslandHeat, schedule: IslandSchedule, rapid_mm_s: float, order: Ints
) -> tuple[float, float]:
    """High mean of the entry temperatures of an order, K, and its travel, mm; of the beginning of one, what they are at least."""
    start_s, end_s, travel = clocked(order, schedule.entry, schedule.leave, schedule.time_s, rapid_mm_s)
    means_k, points_k = entry_points(heat, schedule, order, start_s, end_s)
    return high_mean(np.maximum(means_k, points_k)), travel


# -- All orders of a few islands, one after the other: what a search can only approach is known on small layers


MOST_LISTED = 8
"""Islands of which all orders are tried: 40320."""


@kernel
def best_of_all(layer: Layer, longest_mm: float) -> Ints:
    """Order islands by trying all orders: fewest touching successors, then least travel too long, then coolest.

    Parameters
    ----------
    longest_mm
        Travel that is allowed.

    Returns
    -------
    Ints
        (I,) the best order; the first of equal ones in the order of the alphabet.
    """
    count = len(layer.time_s)
    order, places = np.arange(count), np.arange(count)
    best, best_touches, best_far, best_total = order.copy(), count, np.inf, np.inf
    log, first, beside = new_log(count), 0, touch_table(layer.beside)
    while first >= 0:
        timed_from(first, order, layer, beside, log)
        total = powers_from(first, first, first, places, order, layer, np.inf, log)
        far, touches = (
            max(0.0, log.travel_mm[-1] - longest_mm),
            int(touching_successors(layer.beside, order).sum()),
        )
        shorter, as_short = far < best_far - JOINED_MM, far <= best_far + JOINED_MM
        as_good = touches == best_touches and (shorter or (as_short and total < best_total))
        if touches < best_touches or as_good:
            best[:], best_touches, best_far, best_total = order, touches, far, total
        first = next_order(order)
    return best


@kernel
def next_order(order: Ints) -> int:
    """Turn an order into the next one of the alphabet; returns the first place that changed, -1 after the last order."""
    place = len(order) - 2
    while place >= 0 and order[place] > order[place + 1]:
        place -= 1
    if place < 0:
        return -1
    later = len(order) - 1
    while order[later] < order[place]:
        later -= 1
    order[place], order[later] = order[later], order[place]
    order[place + 1 :] = order[place + 1 :][::-1].copy()
    return place

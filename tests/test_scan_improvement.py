"""Improvement of orders by heat: its table of influences is the heat model, and no order of a few islands is much better."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
import shapely
from islands_of_a_plate import FREE, PLATE, PROFILE, RAPID, islands_of, laid_plate, times_of

from ebamcheck.geometry.regions import layer_section
from ebamcheck.heat.influence import FALLEN, LEAST_RATE, influence, old_heat
from ebamcheck.scan.order.entries import clocked, entry_options, entry_points, high_mean
from ebamcheck.scan.order.orders import scan_order
from ebamcheck.scan.order.search import (
    HOTTEST_EVERY,
    TOUCH_SHARE,
    Layer,
    greedy_order,
    improved,
    new_log,
    own_rise,
    powers_from,
    ranked,
    thermal_order,
    time_from,
    touching,
    touching_successors,
)
from ebamcheck.scan.plan.laying import lay_islands


@pytest.fixture(scope="module")
def choices():
    return laid_plate().choices(PROFILE, 0)


@pytest.mark.parametrize("base", ["cooled", "insulated"])
def test_the_table_of_influences_is_the_heat_model(base):
    config = PROFILE.changed(process={"base": base})
    choices = lay_islands(layer_section(PLATE), config, 0, 10.0).choices(config, 0)
    schedule, heat = choices.known_schedule, choices.cold_heat()
    before = np.random.default_rng(5).normal(size=heat.start_k.shape) * np.exp(-heat.modes.plane_rate)[:, None]
    heat = replace(heat, start_k=300.0 * before)
    order = np.random.default_rng(4).permutation(len(choices))
    start, end, travel = clocked(schedule, order, RAPID)
    exact = np.maximum(*entry_points(heat, schedule, order, start, end))
    table, options = influence(heat, schedule.time_s, float(end.max())), entry_options(schedule)
    log = new_log(len(order))
    layer = Layer(table, options, FREE[: len(order), : len(order)], schedule.time_s, RAPID)
    time_from(0, order, layer, log)
    assert log.start_s == pytest.approx(start[order])
    assert log.travel_mm[-1] == pytest.approx(travel)
    powers_from(0, 0, 0, np.arange(len(order)), order, layer, np.inf, log)
    assert log.entry_k == pytest.approx(exact[order], rel=0.02, abs=0.02 * np.abs(exact).max())


def test_old_heat_of_the_table_is_the_sum_over_all_modes(choices):
    heat, time_s = choices.cold_heat(), choices.known_schedule.time_s
    modes, horizon_s = heat.modes, heat.fresh.horizon_s
    rate = np.add.outer(modes.plane_rate, np.maximum(modes.depth_rate, LEAST_RATE))
    # From the horizon to where hardly a mode of the section is left.
    since = np.concatenate([horizon_s * np.array([0.0, 0.6]), horizon_s * np.geomspace(1.0, 400.0, 30)])
    assert (modes.plane_rate * since[-1] > FALLEN).mean() > 0.9
    rise = np.zeros((len(choices), len(choices) + 1, len(since)), np.float32)
    old_heat(heat, time_s, horizon_s, since, rise, range(len(choices)))
    for source in (0, 7, len(choices) - 1):
        for n, ago in enumerate(since):
            oldest, youngest = ago + time_s[source], max(ago, horizon_s)
            lasting = np.maximum(np.exp(-rate * youngest) - np.exp(-rate * oldest), 0.0) / rate
            by_mode = (modes.in_layer**2 * lasting).sum(axis=1) * modes.mean[:, source]
            exact = modes.source_k_s[source] * modes.mean.T @ by_mode
            assert rise[:, source, n] == pytest.approx(exact, abs=3e-6 * np.abs(exact).max())


def test_options_are_the_nearest_ones(choices):
    schedule, options = choices.known_schedule, entry_options(choices.known_schedule)
    apart = np.linalg.norm(schedule.leave[:, :, None, None] - schedule.entry[None, None], axis=-1)
    assert options.jump_mm == pytest.approx(apart.min(axis=-1), abs=1e-5)
    assert np.take_along_axis(apart, options.option[..., None], -1)[..., 0] == pytest.approx(options.jump_mm)


@pytest.mark.parametrize(("low", "high"), [(0.0, 500.0), (-3.0, 20.0)])
def test_the_high_mean_lies_between_the_mean_and_the_greatest(low, high):
    entry_k = np.random.default_rng(1).uniform(low, high, 40)
    assert entry_k.mean() < high_mean(entry_k) < entry_k.max()
    assert high_mean(np.full(5, high)) == pytest.approx(high)
    assert high_mean(3.0 * entry_k) == pytest.approx(3.0 * high_mean(entry_k))


def improved_by(layer, order, longest_mm, price, places, leniency):
    logs = new_log(len(order)), new_log(len(order))
    return improved(layer, order, longest_mm, price, places, leniency, *logs)


def test_improvement_keeps_to_the_travel_that_is_allowed(choices):
    schedule, heat, count = choices.known_schedule, choices.cold_heat(), len(choices)
    order = greedy_order(heat, schedule, FREE, RAPID, 0, 1.0, 0.0)
    start, end, travel = clocked(schedule, order, RAPID)
    table, beside = (
        influence(heat, schedule.time_s, 2 * float(end.max())),
        touching(choices.neighbours, count),
    )
    layer = Layer(table, entry_options(schedule), beside, schedule.time_s, RAPID)
    places = np.random.default_rng(0).integers(0, count, (3000, 2))
    better = improved_by(layer, order, travel, 100.0, places, np.zeros(3000))
    begin, stop, option = clocked(schedule, better, RAPID)
    assert option <= travel + 1e-6
    hottest = [
        np.maximum(*entry_points(heat, schedule, *plan)).max() for plan in ((better, begin, stop), (order, start, end))
    ]
    assert hottest[0] < hottest[1]
    assert not touching_successors(beside, better).any()


def moved(order, a, b, kind):
    """The order after a move: two places exchanged, one shifted to the other, or all between them turned around."""
    tried = order.tolist()
    if kind == 0:
        tried[a], tried[b] = tried[b], tried[a]
    elif kind == 1:
        tried.insert(b, tried.pop(a))
    else:
        low, high = min(a, b), max(a, b) + 1
        tried[low:high] = tried[low:high][::-1]
    return np.array(tried)


def test_giving_moves_up_early_changes_nothing(choices):
    schedule, heat, steps, price = choices.known_schedule, choices.cold_heat(), 300, 0.5
    count, beside = len(choices), touching(choices.neighbours, len(choices))
    kept = order = np.random.default_rng(2).permutation(count)
    *_, end, travel = clocked(schedule, order, RAPID)
    table, allowed_mm = influence(heat, schedule.time_s, 2 * float(end.max())), 0.9 * travel
    layer = Layer(table, entry_options(schedule), beside, schedule.time_s, RAPID)

    def cost_of(tried):
        log = new_log(count)
        time_from(0, tried, layer, log)
        powers_from(0, 0, 0, np.arange(count), tried, layer, np.inf, log)
        far_k = price * max(0.0, log.travel_mm[-1] - allowed_mm)
        return log, high_mean(log.entry_k), far_k + int(log.touches[-1]) * TOUCH_SHARE * first_k

    first_k = 0.0
    log, first_k, _ = cost_of(kept)
    cost = sum(cost_of(kept)[1:])
    places = np.random.default_rng(7).integers(0, count, (steps, 2))
    leniency = 0.005 * np.random.default_rng(8).exponential(size=steps)
    best, least = kept, cost
    for step, (a, b) in enumerate(places):
        a = int(np.argmax(log.entry_k)) if step % HOTTEST_EVERY == 0 else a
        if a == b:
            continue
        tried = moved(kept, a, b, step % 3)
        tried_log, *parts = cost_of(tried)
        if sum(parts) < cost + first_k * leniency[step]:
            kept, log, cost = tried, tried_log, sum(parts)
            if cost < least:
                best, least = kept, cost
    found = improved_by(layer, order, allowed_mm, price, places, leniency)
    assert np.array_equal(found, best)
    assert not np.array_equal(found, order)


# -- orders planned with fresh heat -------------------------------------------------------------------------


def test_touching_successors_are_counted_where_there_was_a_choice():
    pairs, count = np.array([[0, 1], [0, 2], [1, 3], [2, 3]]), 4
    beside = touching(pairs, count)
    sets = {frozenset(pair) for pair in pairs.tolist()}
    for order in itertools.permutations(range(count)):
        found = touching_successors(beside, np.array(order))
        for n in range(count):
            last, rest = order[n - 1], order[n:]
            hot = n > 0 and {last, order[n]} in sets
            choice = n > 0 and any({last, other} not in sets for other in rest)
            assert found[n] == (hot and choice)
    assert touching_successors(beside, np.array([0, 1, 2, 3])).tolist() == [False, True, False, False]


@pytest.mark.parametrize("partition", ["hexagons", "squares"])
def test_no_island_follows_one_that_it_touches(partition):
    islands = islands_of(PLATE, partition=partition, hexagon_side_mm=10.0)
    beside = touching(islands.neighbours, len(islands))
    for order in ("thermal", "least-heat"):
        assert not touching_successors(beside, scan_order(order, islands)).any()
    assert touching_successors(beside, scan_order("raster", islands)).mean() > 0.5


@pytest.mark.parametrize("share", [0.5, 1.2, 1e3])
def test_the_order_of_five_islands_is_near_the_best_of_all_orders(share):
    islands = islands_of(shapely.box(0, 0, 62, 34).difference(shapely.box(20, 0, 24, 20)), hexagon_side_mm=11.0)
    count, schedule, heat = len(islands), islands.known_schedule, islands.cold_heat()
    assert 5 <= count <= 6
    beside = touching(islands.neighbours, count)
    every = [np.array(order) for order in itertools.permutations(range(count))]
    longest_mm = share * min(times_of(islands, order)[2] for order in every)
    found = thermal_order(heat, schedule, beside, RAPID, 19.0, longest_mm, 10.0, 40000, np.random.default_rng(0))
    price_k_mm = own_rise(heat, schedule).mean() / 19.0

    def cost_of(order):
        touches, far_mm, warm_k = ranked(heat, schedule, beside, RAPID, order, longest_mm)
        return touches, warm_k + price_k_mm * far_mm

    costs = [cost_of(order) for order in every]
    touches, cost_k = cost_of(found)
    best = min(costs)
    assert touches == best[0]
    # The table lies between nodes of time.
    assert cost_k <= 1.05 * best[1]
    assert max(cost for _, cost in costs) > 1.3 * best[1]

"""Annealing of orders by heat: it helps or leaves it, and its table of influences is the heat model itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from islands_of_a_plate import FREE, PLATE, PROFILE, RAPID, laid_plate

from ebamcheck.geometry.regions import layer_section
from ebamcheck.scan.heat.influence import (
    FALLEN,
    LEAST_RATE,
    YOUNG_NODES,
    influence,
    looked_up,
    old_heat,
    table_place,
    work_out,
)
from ebamcheck.scan.heat.near_field import entry_rise, young_mean
from ebamcheck.scan.order.annealing import (
    HOTTEST_EVERY,
    TOUCH_SHARE,
    WARMTH,
    Layer,
    annealed,
    high_mean,
    new_log,
    powers_from,
    timed_from,
)
from ebamcheck.scan.order.entry_options import entry_options
from ebamcheck.scan.order.greedy_heat import greedy_order
from ebamcheck.scan.order.moves import least_travel_mm, more_touches, move
from ebamcheck.scan.order.orders import scan_order
from ebamcheck.scan.order.path import touch_table, touching, touching_successors
from ebamcheck.scan.order.simulation import clocked, entered, entry_points
from ebamcheck.scan.plan.comparing import OrderComparison
from ebamcheck.scan.plan.laying import lay_islands


@pytest.fixture(scope="module")
def choices():
    return laid_plate().choices(PROFILE, 0)


def test_annealing_helps_or_leaves_it():
    settings = {"order": "thermal"}
    plain = OrderComparison.of(PLATE, PROFILE.changed(scan={**settings, "annealing_steps": 0}), 0, 0.0)
    long = OrderComparison.of(PLATE, PROFILE.changed(scan={**settings, "annealing_steps": 400}), 0, 0.0)
    keys = []
    for compared in (plain, long):
        islands = compared.islands
        schedule, heat = islands.known_schedule, islands.cold_heat()
        order = scan_order("thermal", islands)
        start, end, _ = clocked(order, schedule.entry, schedule.leave, schedule.time_s, RAPID)
        entry, _ = entered(heat, order, start, end)
        keys.append(high_mean(entry))
    assert keys[1] < keys[0]


@pytest.mark.parametrize("base", ["cooled", "insulated"])
def test_the_table_of_influences_is_the_heat_model(base):
    config = PROFILE.changed(process={"base": base})
    choices = lay_islands(layer_section(PLATE), config, 0, 10.0).choices(config, 0)
    schedule, heat = choices.known_schedule, choices.cold_heat()
    before = (
        np.random.default_rng(5).normal(size=heat.start_k.shape) * np.exp(-heat.modes.plane_rate)[:, None]
    )
    heat = replace(heat, start_k=300.0 * before)
    order = np.random.default_rng(4).permutation(len(choices))
    start, end, travel = clocked(order, schedule.entry, schedule.leave, schedule.time_s, RAPID)
    exact = np.maximum(*entry_points(heat, schedule, order, start, end))
    table, options = influence(heat, schedule.time_s, float(end.max())), entry_options(schedule)
    log = new_log(len(order))
    layer = Layer(table, options, FREE, schedule.time_s, RAPID)
    timed_from(0, order, layer, touch_table(layer.beside), log)
    assert log.start_s == pytest.approx(start[order])
    assert log.travel_mm[-1] == pytest.approx(travel)
    powers_from(0, 0, 0, np.arange(len(order)), order, layer, np.inf, log)
    assert log.entry_k == pytest.approx(exact[order], rel=0.02, abs=0.02 * np.abs(exact).max())


@pytest.mark.parametrize("base", ["cooled", "insulated"])
def test_a_rise_of_the_table_is_that_of_two_islands_driven_alone(base):
    config = PROFILE.changed(process={"base": base})
    choices = lay_islands(layer_section(PLATE), config, 0, 10.0).choices(config, 0)
    schedule, heat, count = choices.known_schedule, choices.cold_heat(), len(choices)
    horizon_s = heat.fresh.horizon_s
    table = influence(heat, schedule.time_s, 300.0)
    pairs = [*choices.neighbours[::9].tolist(), *np.random.default_rng(8).integers(0, count, (8, 2)).tolist()]
    for source, island in pairs:
        if source == island:
            continue
        before = 0.0
        for since in horizon_s * np.array([0.0, 0.3, 0.7, 0.999, 1.001, 1.5, 3.0, 12.0]):
            start, end = np.zeros(count), np.zeros(count)
            start[island] = end[source] = schedule.time_s[source]
            start[island] += since
            end[island] = start[island] + schedule.time_s[island]
            exact = entered(heat, np.array([source, island]), start, end)[0][island]
            found = looked_up(
                table.rise_k[island], table.nodes_per_root_s, table.fresh.near.horizon_s, source, since
            )
            assert found == pytest.approx(exact, rel=0.02, abs=1.0)
            before = max(before, abs(exact))
        assert before > 0.0


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


def test_entries_of_the_table_are_those_of_single_pieces(choices):
    heat, time_s = choices.cold_heat(), choices.known_schedule.time_s
    near, source_k_s = heat.fresh, heat.modes.source_k_s
    table = influence(heat, time_s, 300.0).fresh
    since = near.horizon_s * (np.arange(YOUNG_NODES) / (YOUNG_NODES - 1)) ** 2
    greatest = float(np.abs(table.excess_k).max())
    compared = 0
    for i in range(0, len(choices), 3):
        for p in range(near.first[i], near.first[i + 1]):
            j = near.other[p]
            assert table.slot[i, j] == p
            if i == j:
                assert not table.excess_k[p].any()
                continue
            for option, left_by, n in ((0, 3, 0), (1, 2, 4), (2, 1, 7), (3, 0, YOUNG_NODES - 1)):
                entry = entry_rise(near, i, option, j, left_by, since[n], time_s[j])
                exact = source_k_s[j] * (entry - young_mean(near, near.pair[p], since[n], time_s[j]))
                assert table.excess_k[p, option, left_by, n] == pytest.approx(exact, abs=1e-6 * greatest)
                compared += abs(exact) > 1e-3 * greatest
    assert compared > 20


@pytest.mark.slow
def test_entries_worked_out_where_asked_for_are_those_of_the_whole_table(choices):
    heat, time_s = choices.cold_heat(), choices.known_schedule.time_s
    whole, asked = (influence(heat, time_s, 300.0, whole=whole).fresh for whole in (True, False))
    near = heat.fresh
    assert whole.known.all()
    assert not asked.known.any()
    for island in range(0, len(choices), 4):
        for row in range(near.first[island], near.first[island + 1]):
            if near.other[row] != island:
                work_out(asked, row, island, near.other[row], 2)
                assert np.flatnonzero(asked.known[row]).tolist() == [2]
                assert asked.excess_k[row, :, 2] == pytest.approx(
                    whole.excess_k[row, :, 2], rel=1e-6, abs=1e-9
                )
    assert np.abs(asked.excess_k).max() > 0.0


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


@pytest.mark.parametrize("kind", [0, 1, 2])
def test_moves_keep_every_island(kind):
    order = np.arange(9)[::-1].copy()
    for a, b in ((2, 6), (6, 2), (0, 8), (8, 0), (3, 4)):
        tried = np.empty_like(order)
        move(order, a, b, kind, tried)
        assert np.array_equal(np.sort(tried), np.arange(9))
        assert np.array_equal(tried[: min(a, b)], order[: min(a, b)])
        assert tried[b] == order[a]


@pytest.mark.parametrize("kind", [0, 1, 2])
def test_what_a_move_changes_is_what_the_moved_order_has(choices, kind):
    schedule, heat, count = choices.known_schedule, choices.cold_heat(), len(choices)
    beside = touching(choices.neighbours, count)
    layer = Layer(
        influence(heat, schedule.time_s, 1e3), entry_options(schedule), beside, schedule.time_s, RAPID
    )
    random = np.random.default_rng(11)
    edges = [(0, 1), (1, 0), (0, count - 1), (count - 1, 0), (count - 2, count - 1), (count - 1, count - 3)]
    for a, b in [*edges, *random.integers(0, count, (60, 2)).tolist()]:
        if a == b:
            continue
        order, tried = random.permutation(count), np.empty(count, np.int64)
        log, moved = new_log(count), new_log(count)
        timed_from(0, order, layer, touch_table(layer.beside), log)
        move(order, a, b, kind, tried)
        timed_from(0, tried, layer, touch_table(layer.beside), moved)
        assert more_touches(order, a, b, kind, touch_table(beside)) == moved.touches[-1] - log.touches[-1]
        least_mm = least_travel_mm(order, log.option, log.travel_mm, a, b, kind, *layer.options)
        assert least_mm <= moved.travel_mm[-1] == pytest.approx(least_mm, rel=1e-8)


def test_places_in_the_table_are_those_of_a_lookup(choices):
    schedule, heat = choices.known_schedule, choices.cold_heat()
    table = influence(heat, schedule.time_s, 500.0)
    rise, horizon, nodes = table.rise_k, table.fresh.near.horizon_s, table.nodes_per_root_s
    below, above = np.nextafter(horizon, [0.0, np.inf])
    for since in (-1e-12, 0.0, 0.3 * horizon, below, horizon, above, 77.7, 500.0, 900.0):
        node, share = table_place(since, nodes, horizon, rise.shape[2])
        low, high = rise[1, 2, node], rise[1, 2, node + 1]
        assert low + (high - low) * share == looked_up(rise[1], nodes, horizon, 2, since)


def test_annealing_keeps_to_the_travel_that_is_allowed(choices):
    schedule, heat = choices.known_schedule, choices.cold_heat()
    order = greedy_order(heat, schedule, FREE, RAPID, 0, 1.0, 0.0)
    start, end, travel = clocked(order, schedule.entry, schedule.leave, schedule.time_s, RAPID)
    table = influence(heat, schedule.time_s, 2 * float(end.max()))
    options, random = entry_options(schedule), np.random.default_rng(0)
    beside = touching(choices.neighbours, len(choices))
    better = annealed(
        Layer(table, options, beside, schedule.time_s, RAPID), order, travel, 100.0, 3000, random
    )
    begin, stop, option = clocked(better, schedule.entry, schedule.leave, schedule.time_s, RAPID)
    assert option <= travel + 1e-6
    hottest = [
        np.maximum(*entry_points(heat, schedule, *plan)).max()
        for plan in ((better, begin, stop), (order, start, end))
    ]
    assert hottest[0] < hottest[1]
    assert not touching_successors(beside, better).any()


def test_giving_moves_up_early_changes_nothing(choices):
    schedule, heat, steps, price = choices.known_schedule, choices.cold_heat(), 300, 0.5
    count, beside = len(choices), touching(choices.neighbours, len(choices))
    order = np.random.default_rng(2).permutation(count)
    *_, end, travel = clocked(order, schedule.entry, schedule.leave, schedule.time_s, RAPID)
    table, options, allowed_mm = (
        influence(heat, schedule.time_s, 2 * float(end.max())),
        entry_options(schedule),
        0.9 * travel,
    )

    layer = Layer(table, options, beside, schedule.time_s, RAPID)

    def simulated(tried):
        log = new_log(count)
        timed_from(0, tried, layer, touch_table(layer.beside), log)
        powers_from(0, 0, 0, np.arange(count), tried, layer, np.inf, log)
        warm, far = high_mean(log.entry_k), max(0.0, log.travel_mm[-1] - allowed_mm)
        return log, warm, price * far, int(log.touches[-1])

    def cost_of(warm, far, touches):
        return warm + far + touches * TOUCH_SHARE * first_warm

    random = np.random.default_rng(7)
    places = random.integers(0, count, (steps, 2))
    leniency = random.exponential(size=steps) * np.linspace(1.0, 0.0, steps)
    kept, (log, *parts) = order, simulated(order)
    first_warm = parts[0]
    cost = cost_of(*parts)
    best, least, warmth = kept, cost, WARMTH * cost
    for step, (a, b) in enumerate(places):
        a = int(np.argmax(log.entry_k)) if step % HOTTEST_EVERY == 0 else a
        if a == b:
            continue
        tried = np.empty_like(kept)
        move(kept, a, b, step % 3, tried)
        tried_log, *parts = simulated(tried)
        new_cost = cost_of(*parts)
        if new_cost < cost + warmth * leniency[step]:
            kept, log, cost = tried, tried_log, new_cost
            if cost < least:
                best, least = kept, cost
    found = annealed(layer, order, allowed_mm, price, steps, np.random.default_rng(7))
    assert np.array_equal(found, best)
    assert not np.array_equal(found, order)

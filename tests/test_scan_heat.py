"""Orders by heat: greedy choice, comparison and installed orders, and islands entered at cool ends."""

from __future__ import annotations

import itertools
import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
import shapely
from fake_distribution import found_here, install
from islands_of_a_plate import FREE, PLATE, PROFILE, RAPID, laid_plate
from threadpoolctl import threadpool_info

import ebamcheck
from ebamcheck.errors import SettingsError
from ebamcheck.heat import Medium
from ebamcheck.heat.modes import one_blas_thread
from ebamcheck.heat.near_field import OPTIONS
from ebamcheck.plugins import registry
from ebamcheck.scan import plan_scan
from ebamcheck.scan.filling.schedule import turns_and_jumps_mm
from ebamcheck.scan.order.entries import (
    NEAREST,
    affordable,
    clocked,
    cool_options,
    entered,
    entry_points,
    entry_temperatures,
    high_mean,
    in_sequence,
    modes_at_entries,
    nearest_options,
    options_by_price,
    rises_at_entries,
)
from ebamcheck.scan.order.orders import chosen_options, longest_travel_mm, scan_order
from ebamcheck.scan.order.search import greedy_order, own_rise
from ebamcheck.scan.plan.comparing import FIGURES, OrderComparison, compared_orders


@pytest.fixture(scope="module")
def laid():
    return laid_plate()


@pytest.fixture(scope="module")
def choices(laid):
    return laid.choices(PROFILE, 0)


def test_driven_islands_are_the_heat_model_step_by_step(laid, choices):
    schedule = choices.known_schedule
    heat = replace(choices.cold_heat(), near=None)
    order = np.random.default_rng(3).permutation(len(choices))
    start, end, _ = clocked(schedule, order, RAPID)
    entry_k, excess = entry_temperatures(heat, choices.area_mm2, order, start, end)
    assert entry_k == pytest.approx(entered(heat, order, start, end)[0])
    # By the model itself, from the same modes.
    rate = np.add.outer(heat.modes.plane_rate, heat.modes.depth_rate)
    state, clock = np.zeros_like(rate), 0.0
    for island in order[:12]:
        state = state * np.exp(-rate * (start[island] - clock))
        assert entry_k[island] == pytest.approx(heat.modes.mean[:, island] @ (state @ heat.modes.in_layer), abs=1e-6)
        decay = rate * (end[island] - start[island])
        gain = np.multiply.outer(heat.modes.mean[:, island], heat.modes.in_layer) * -np.expm1(-decay) / rate
        cooled = state * np.exp(-decay)
        others, state = cooled, cooled + heat.modes.source_k_s[island] * gain
        weight = choices.area_mm2 / choices.area_mm2.sum()
        rest, total = ((s @ heat.modes.in_layer) @ heat.modes.mean for s in (others, state))
        spread = math.sqrt(weight @ (rest - weight @ rest) ** 2)
        assert excess[island] == pytest.approx(spread / (weight @ total), abs=1e-9)
        clock = end[island]


def test_an_island_is_heated_by_the_power_that_the_part_takes_up(laid, choices):
    heat, schedule = choices.cold_heat(), choices.known_schedule
    medium = Medium.of(PROFILE)
    energy = heat.modes.source_k_s * schedule.time_s * medium.heat_capacity_j_mm3k
    lines, spacing = laid.lines, PROFILE.process.hatch_spacing_mm
    length = np.hypot(*(lines.end - lines.start).T).sum()
    # The turns at either side of an island count by their mean.
    either = [(lines.start, lines.end), (lines.end, lines.start)]
    length += 0.5 * sum(turns_and_jumps_mm(lines.island, a, b, spacing)[0].sum() for a, b in either)
    process = PROFILE.process
    wanted = length / process.travel_speed_mm_s * process.power_w * PROFILE.material.absorptivity
    assert energy.sum() == pytest.approx(wanted, rel=1e-9)


def test_greedy_takes_the_best_score_at_every_step(choices):
    schedule, heat = choices.known_schedule, choices.cold_heat()
    price, start_k = 0.7, 5.0
    order = greedy_order(heat, schedule, FREE, RAPID, 4, price, start_k)
    assert order[0] == 4
    assert np.array_equal(np.sort(order), np.arange(len(choices)))
    start, end, _ = clocked(schedule, order, RAPID)
    option = 0
    for n in range(len(order) - 1):
        x, y = schedule.leave[order[n], option]
        reach = np.hypot(schedule.entry[:, :, 0] - x, schedule.entry[:, :, 1] - y)
        score = np.full(len(order), np.inf)
        for j in order[n + 1 :]:
            # Temperature at exactly the time of entry, by driving the order so far and then this island.
            tried = np.append(order[: n + 1], j)
            begin, stop = start.copy(), end.copy()
            begin[j] = end[order[n]] + reach[j].min() / RAPID
            stop[j] = begin[j] + schedule.time_s[j]
            warm = np.maximum(*entry_points(heat, schedule, tried, begin, stop))[j]
            score[j] = warm + price * reach[j].min() + start_k
        # Between the earliest and the latest entry the kernel takes temperature as linear: 3 % at most.
        assert score[order[n + 1]] <= 1.03 * score.min() + 1.0
        option = int(np.argmin(reach[order[n + 1]]))


def test_own_rise_is_that_of_one_island_alone(choices):
    modes, time_s, island = choices.cold_heat().modes, choices.known_schedule.time_s, 7
    rate = np.add.outer(modes.plane_rate, modes.depth_rate)
    held = -np.expm1(-rate * time_s[island]) / rate
    by_mode = modes.source_k_s[island] * modes.mean[:, island, None] ** 2 * held * modes.in_layer**2
    own = own_rise(choices.cold_heat(), choices.known_schedule)[island]
    assert own == pytest.approx(by_mode.sum(), rel=1e-9)
    assert own > 50.0


@pytest.mark.parametrize("base", ["cooled", "insulated"])
def test_thermal_is_cooler_and_shorter_than_farthest(base):
    config = PROFILE.changed(process={"base": base})
    table = ebamcheck.compare_orders(PLATE, config, ["raster", "farthest", "thermal"]).set_index("order")
    thermal = table.loc["thermal"]
    assert thermal["travel_mm"] <= 0.5 * table.loc["farthest", "travel_mm"] + 1e-6
    assert thermal["time_s"] <= 1.1 * table.loc["raster", "time_s"]
    if base == "cooled":
        assert thermal["entry_max_k"] <= 0.5 * table.loc["farthest", "entry_max_k"]
        assert thermal["entry_max_k"] <= 0.25 * table.loc["raster", "entry_max_k"]
    else:
        assert thermal["entry_max_k"] < table.loc["raster", "entry_max_k"]


def test_comparison_has_a_row_an_order_and_the_figures_of_the_plans():
    names = ["raster", "random", "thermal"]
    table = ebamcheck.compare_orders(PLATE, PROFILE, names, seeds=3)
    assert list(table.columns) == list(FIGURES)
    assert table["order"].tolist() == names
    assert table["seeds"].tolist() == [1, 3, 1]
    plan = plan_scan(PLATE, PROFILE, order="raster")
    row = table.iloc[0]
    for name in ("time_s", "interval_p10_s", "interval_min_s", "starts"):
        assert row[name] == pytest.approx(plan.metrics[name][0])
    with pytest.raises(SettingsError, match="give at least 1"):
        ebamcheck.compare_orders(PLATE, PROFILE, ["random"], seeds=0)


@pytest.mark.parametrize("section", [shapely.Polygon(), shapely.box(0, 0, 4, 4), shapely.box(0, 0, 90, 2)])
def test_layers_of_no_or_one_island_are_compared(section):
    table = ebamcheck.compare_orders(section, PROFILE, ["farthest", "thermal"])
    assert len(table) == 2
    assert table["travel_mm"].tolist() == [0.0, 0.0]


ORDERS_MODULE = """
import numpy as np
def backwards(islands): return np.arange(len(islands))[::-1]
def half(islands): return np.arange(len(islands) // 2)
"""


def test_an_installed_order_plans(tmp_path, monkeypatch):
    points = {name: f"installed_orders:{name}" for name in ("backwards", "half")}
    install(tmp_path, "orders", {registry.ORDERS: points}, {"installed_orders": ORDERS_MODULE})
    found_here(tmp_path, monkeypatch)
    assert {"backwards", "thermal"} <= set(compared_orders())
    plan = plan_scan(PLATE, PROFILE, order="backwards")
    assert plan.order.tolist() == list(range(len(plan.islands)))[::-1]
    with pytest.raises(SettingsError, match="'half' did not return every island of layer 1 once"):
        plan_scan(PLATE, PROFILE, order="half")
    with pytest.raises(SettingsError, match=r"choose one of backwards, farthest, half.*thermal"):
        plan_scan(PLATE, PROFILE, order="spiral")


def blas_threads():
    return {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"}


def test_blas_has_one_thread_whichever_thread_asks_first_and_leaves_last():
    before = blas_threads()

    def held():
        with one_blas_thread():
            return blas_threads()

    for _ in range(2):
        with ThreadPoolExecutor(1) as worker:
            assert held() == {1}
            assert worker.submit(held).result() == {1}
            here = one_blas_thread()
            here.__enter__()
            there = one_blas_thread()
            worker.submit(there.__enter__).result()
            here.__exit__(None, None, None)
            assert blas_threads() == {1}
            worker.submit(there.__exit__, None, None, None).result()
        assert blas_threads() == before


# -- islands entered at cool ends ---------------------------------------------------------------------------


@pytest.fixture(scope="module")
def order(choices):
    return scan_order("thermal", choices)


def driven_by(islands, order, options):
    """Start, end, travel, and the rises at all ends."""
    schedule = islands.known_schedule
    start, end, travel = clocked(schedule, order, RAPID, options)
    heat = islands.cold_heat()
    at = modes_at_entries(heat, schedule)
    return start, end, travel, rises_at_entries(heat, at, order, start, end, options)


def entered_at(islands, order, options):
    """Rises (I,) where the beam enters the islands, and the travel."""
    *_, travel, rise_k = driven_by(islands, order, options)
    return rise_k[np.arange(len(order)), options], travel


@pytest.mark.parametrize("seed", range(12))
def test_no_options_at_all_are_better_at_a_price(seed):
    random = np.random.default_rng(seed)
    count = 5
    entry, leave = random.uniform(0, 60, (2, count, OPTIONS, 2))
    share, price = random.uniform(0.3, 1.3, (count, OPTIONS)), 10.0 ** random.uniform(-5, 0)
    order = random.permutation(count)

    def spent(options):
        jumps = entry[order[1:], options[order[1:]]] - leave[order[:-1], options[order[:-1]]]
        travel = np.hypot(*jumps.T).sum()
        return (share[np.arange(count), options] ** 12).sum() + price * travel, travel

    options, travel_mm = options_by_price(share, order, entry, leave, price)
    best = min(spent(np.array(tried))[0] for tried in itertools.product(range(OPTIONS), repeat=count))
    assert spent(options)[0] == pytest.approx(best)
    assert spent(options)[1] == pytest.approx(travel_mm)


def test_travel_is_kept_and_more_of_it_is_never_warmer(choices, order):
    schedule = choices.known_schedule
    options = nearest_options(order, schedule.entry, schedule.leave)
    *_, nearest_mm, rise_k = driven_by(choices, order, options)
    warm = np.inf
    for share in (0.5, 0.97, 1.0, 1.05, 1.2, 3.0):
        chosen = affordable(rise_k, order, schedule.entry, schedule.leave, share * nearest_mm)
        travel_mm = entered_at(choices, order, chosen)[1]
        if share < 0.9:  # no ways are as short: the shortest, which are no longer than the nearest
            shortest_mm = travel_mm
            assert shortest_mm <= nearest_mm
            continue
        assert travel_mm <= max(share * nearest_mm, shortest_mm) + 1e-6
        found = high_mean(rise_k[np.arange(len(order)), chosen])
        assert found <= warm * (1.0 + 1e-9)
        warm = found
    assert warm == pytest.approx(high_mean(rise_k.min(axis=1)), rel=1e-6)


def test_thermal_enters_islands_at_cooler_ends_within_its_travel(choices, order):
    schedule = choices.known_schedule
    nearest = nearest_options(order, schedule.entry, schedule.leave)
    before_k, before_mm = entered_at(choices, order, nearest)
    options = chosen_options("thermal", choices, order)
    after_k, after_mm = entered_at(choices, order, options)
    assert after_mm <= max(longest_travel_mm(choices), before_mm) + 1e-6
    assert high_mean(after_k) < 0.97 * high_mean(before_k)
    assert np.array_equal(
        cool_options(choices.cold_heat(), schedule, order, RAPID, longest_travel_mm(choices)), options
    ), "the same whenever it is asked"


@pytest.mark.parametrize("name", ["raster", "farthest", "nearest", "least-heat"])
def test_other_orders_take_the_nearest_end(choices, name):
    found = scan_order(name, choices)
    assert (chosen_options(name, choices, found) == NEAREST).all()


def test_lines_are_driven_from_the_end_that_was_chosen():
    # Two islands of two lines each, and one whose lines follow each other.
    start = np.array([[0.0, 0.0], [9.0, 4.0], [30.0, 0.0], [39.0, 4.0], [60.0, 0.0], [69.0, 0.0]])
    end = np.array([[9.0, 0.0], [0.0, 4.0], [39.0, 0.0], [30.0, 4.0], [69.0, 0.0], [69.0, 9.0]])
    first, chained = np.array([0, 2, 4, 6]), np.array([False, False, True])
    order = np.arange(3)
    entries = {0: (30.0, 0.0), 1: (39.0, 0.0), 2: (30.0, 4.0), 3: (39.0, 4.0)}
    for option, place in entries.items():
        rows, turned = in_sequence(start, end, first, order, chained, np.array([0, option, NEAREST]))
        begins = np.where(turned[:, None], end[rows], start[rows])
        assert tuple(begins[2]) == place
        assert sorted(rows) == list(range(6))
    rows, turned = in_sequence(start, end, first, order, chained, np.array([0, 0, 2]))
    assert (rows[4:].tolist(), turned[4:].tolist()) == ([5, 4], [True, True]), "backwards as a whole"


def test_islands_of_a_plan_begin_at_the_ends_that_were_chosen():
    compared = OrderComparison.of(PLATE, PROFILE, 0, 10.0)
    result = compared.result("thermal", 0)
    first = result.plan.vectors.drop_duplicates("island").set_index("island").sort_index()
    options = chosen_options("thermal", compared.islands, np.argsort(result.rank))
    entries = compared.islands.known_schedule.entry[first.index, options[first.index]]
    assert first[["x0", "y0"]].to_numpy() == pytest.approx(entries)

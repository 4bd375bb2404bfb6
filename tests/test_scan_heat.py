"""Orders by heat and their comparison, driven by the heat model."""

from __future__ import annotations

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
from ebamcheck.geometry.regions import layer_section
from ebamcheck.heat import Medium
from ebamcheck.heat.island_heat import island_heat
from ebamcheck.heat.modes import one_blas_thread
from ebamcheck.plugins import registry
from ebamcheck.scan import LayerIslands, plan_scan
from ebamcheck.scan.filling.schedule import turns_and_jumps_mm
from ebamcheck.scan.order.entries import clocked, entered, entry_points, entry_temperatures
from ebamcheck.scan.order.orders import scan_order
from ebamcheck.scan.order.search import greedy_order, own_rise
from ebamcheck.scan.plan.comparing import FIGURES, compared_orders
from ebamcheck.scan.plan.laying import lay_islands
from ebamcheck.settings.stages import order_names

HOUSE_ORDERS = {
    "nearest", "nearest-any", "nearest-last", "nearest-sum", "farthest", "raster",
    "stride", "random", "least-heat", "thermal",
}  # fmt: skip


@pytest.fixture(scope="module")
def laid():
    return laid_plate()


@pytest.fixture(scope="module")
def choices(laid):
    return laid.choices(PROFILE, 0)


def test_the_orders_of_the_house_are_installed_as_those_of_others():
    assert set(order_names()) == HOUSE_ORDERS
    assert set(compared_orders()) == HOUSE_ORDERS - {"nearest"}
    with pytest.raises(SettingsError, match="unknown order: choose one of farthest"):
        PROFILE.changed(scan={"order": "spiral"})


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
        assert entry_k[island] == pytest.approx(
            heat.modes.mean[:, island] @ (state @ heat.modes.in_layer), abs=1e-6
        )
        time = end[island] - start[island]
        gain = (
            np.multiply.outer(heat.modes.mean[:, island], heat.modes.in_layer)
            * -np.expm1(-rate * time)
            / rate
        )
        cooled = state * np.exp(-rate * time)
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


def test_heat_of_a_thin_plate_is_energy_over_heat_capacity():
    config = PROFILE.changed(process={"base": "insulated"}, material={"emissivity": 0.0})
    section = layer_section(PLATE)
    choices = lay_islands(section, config, 0, 0.0).choices(config, 0)
    schedule, heat = choices.known_schedule, choices.cold_heat()
    order = np.arange(len(choices))
    start, end, _ = clocked(schedule, order, RAPID)
    medium = Medium.of(config)
    end[order[-1]] += 1e6
    start[order[-1]] += 1e6
    late, _ = entered(heat, order, start, end)
    energy = (heat.modes.source_k_s * schedule.time_s)[:-1].sum() * medium.heat_capacity_j_mm3k
    even = energy / (medium.heat_capacity_j_mm3k * section.area * config.process.base_plate_mm)
    assert late[-1] == pytest.approx(even, rel=1e-6)


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
    heat, schedule = choices.cold_heat(), choices.known_schedule
    island = 7
    own = own_rise(heat, schedule)[island]
    begin, stop = np.zeros(len(choices)), np.zeros(len(choices))
    stop[island] = begin[island] + schedule.time_s[island]
    begin_again = stop[island]
    twice = np.array([island, island])
    assert own > 50.0
    # Entered again the moment it is left, it has its own rise: drive a copy of it second.
    doubled = replace(
        heat,
        near=None,
        modes=heat.modes._replace(
            mean=np.hstack([heat.modes.mean, heat.modes.mean[:, [island]]]),
            source_k_s=np.append(heat.modes.source_k_s, 0.0),
        ),
    )
    twice[1] = len(choices)
    entry, _ = entered(doubled, twice, np.append(begin, begin_again), np.append(stop, begin_again))
    assert entry[-1] == pytest.approx(own, rel=1e-9)


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


def test_plans_by_heat_repeat_to_the_last_bit():
    one, two = (plan_scan(PLATE, PROFILE, order="thermal", seed=3) for _ in range(2))
    assert np.array_equal(one.order, two.order)
    assert one.vectors.equals(two.vectors)


def test_travel_is_paid_for(choices):
    schedule, heat = choices.known_schedule, choices.cold_heat()
    travel = []
    for price in (0.0, 1.0, 100.0):
        order = greedy_order(heat, schedule, FREE, RAPID, 0, price, 0.0)
        travel.append(clocked(schedule, order, RAPID)[2])
    assert travel[0] > travel[1] > travel[2]


def test_stride_and_random(choices):
    rows = scan_order("raster", choices)
    assert np.array_equal(scan_order("stride", choices)[: len(rows[::7])], rows[::7])
    other = LayerIslands(choices.centroid, choices.area_mm2, choices.neighbours, 0, 1)
    assert not np.array_equal(scan_order("random", choices), scan_order("random", other))
    assert np.array_equal(scan_order("random", choices), scan_order("random", choices))


def test_a_finer_simulation_agrees_with_the_plan_on_what_is_hot(laid, choices):
    schedule, coarse = choices.known_schedule, choices.cold_heat()
    fine = island_heat(PLATE, laid.islands, schedule.beam_s, schedule.time_s, PROFILE, 10.0, fine=True)
    assert fine.modes.mean.shape[0] > coarse.modes.mean.shape[0]
    order = scan_order("farthest", choices)
    start, end, _ = clocked(schedule, order, RAPID)
    coarse_k, _ = entry_temperatures(coarse, choices.area_mm2, order, start, end)
    fine_k, _ = entry_temperatures(fine, choices.area_mm2, order, start, end)
    assert np.corrcoef(coarse_k, fine_k)[0, 1] > 0.99


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


@pytest.mark.slow
def test_two_thousand_islands_are_planned():
    config = PROFILE.changed(scan={"hexagon_side_mm": 4.0})
    plan = plan_scan(shapely.box(0, 0, 400, 230), config, order="thermal")
    assert len(plan.islands) > 2000
    assert np.array_equal(np.sort(plan.order), np.arange(len(plan.islands)))


def blas_threads():
    return {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"}


def test_blas_has_one_thread_while_any_layer_is_planned():
    before = blas_threads()
    with one_blas_thread():
        with one_blas_thread():
            assert blas_threads() == {1}
        assert blas_threads() == {1}
    assert blas_threads() == before


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

"""Islands entered at cool ends: rises against other sums of the same heat, ways against all ways, travel that is kept."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import shapely

from benchmarks.orders import layers
from ebamcheck.geometry.regions import layer_section
from ebamcheck.heat.near_field import OPTIONS
from ebamcheck.scan.order.entries import (
    NEAREST,
    affordable,
    clocked,
    cool_options,
    entry_points,
    high_mean,
    in_sequence,
    modes_at_entries,
    nearest_options,
    options_by_price,
    rises_at_entries,
)
from ebamcheck.scan.order.orders import chosen_options, longest_travel_mm, scan_order
from ebamcheck.scan.plan.comparing import OrderComparison
from ebamcheck.scan.plan.laying import lay_islands
from ebamcheck.scan.plan.stacking import plan_scan
from ebamcheck.settings.config import Config

PROFILE = Config()
RAPID = PROFILE.machine.rapid_mm_s
HEIGHT_MM = 10.0
PLATE = shapely.box(0, 0, 160, 110).difference(shapely.Point(60, 50).buffer(22, 32))


def islands_of(section, layer=0, height_mm=HEIGHT_MM):
    return lay_islands(layer_section(section), PROFILE, layer, height_mm).choices(PROFILE, 0)


@pytest.fixture(scope="module")
def choices():
    return islands_of(PLATE)


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


def test_the_mean_over_many_ends_is_near_that_of_the_island(choices, order):
    # Old heat is read at the very ends, not as the mean over the island: the two agree in the mean over all islands.
    schedule = choices.known_schedule
    options = nearest_options(order, schedule.entry, schedule.leave)
    start, end, _, rise_k = driven_by(choices, order, options)
    means_k, points_k = entry_points(choices.cold_heat(), schedule, order, start, end)
    at_entry = rise_k[np.arange(len(order)), options]
    assert np.corrcoef(at_entry, points_k)[0, 1] > 0.9
    assert rise_k.mean() == pytest.approx(means_k.mean(), rel=0.1)
    # Yet the ends of one island are far apart: by their mean they would all be alike.
    assert np.median(np.ptp(rise_k, axis=1)[order[5:]]) > 0.1 * np.median(means_k[order[5:]])


def test_a_field_of_one_mode_is_read_at_the_ends_by_its_own_shape(choices):
    # Nothing heats before the first island: it finds what the layer begins with, at the place of each end.
    heat, schedule = choices.cold_heat(), choices.known_schedule
    start_k = heat.model.cold()
    start_k[1, 0] = 700.0
    warm = heat.__class__(**{**vars(heat), "start_k": start_k})
    first = np.arange(len(choices))
    zeros = np.zeros(len(choices), np.int64)
    start, end, _ = clocked(schedule, first, RAPID, zeros)
    rise_k = rises_at_entries(warm, modes_at_entries(warm, schedule), first, start, end, zeros)
    exact = heat.model.plane.at(schedule.entry[0]) @ (start_k @ heat.modes.in_layer)
    assert np.ptp(exact) > 0.0
    assert rise_k[0] == pytest.approx(exact)


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


def test_the_plan_has_the_options_that_were_chosen_and_the_comparison_reads_them():
    height_mm = 10.0
    plan = plan_scan(PLATE, PROFILE, order="thermal", height_mm=height_mm)
    plain = plan_scan(
        PLATE, PROFILE.changed(scan={"carry_heat": False}), order="thermal", height_mm=height_mm
    )
    for made in (plan, plain):
        vectors = made.vectors
        jumps = vectors[["x0", "y0"]].to_numpy()[1:] - vectors[["x1", "y1"]].to_numpy()[:-1]
        between = np.diff(vectors["island"].to_numpy()) != 0
        assert np.hypot(*jumps[between].T).sum() <= made.metrics["travel_mm"].iloc[0] + 1e-6
    compared = OrderComparison.of(PLATE, PROFILE, 0, height_mm)
    result = compared.result("thermal", 0)
    first = result.plan.vectors.drop_duplicates("island")
    schedule = compared.islands.known_schedule
    order = np.argsort(result.rank)
    options = chosen_options("thermal", compared.islands, order)
    begun = first.set_index("island")[["x0", "y0"]].to_numpy()[np.argsort(first["island"].to_numpy())]
    assert begun == pytest.approx(
        schedule.entry[first["island"].sort_values(), options[first["island"].sort_values()]]
    )


@pytest.mark.slow
@pytest.mark.parametrize("model", ["prism", "torus"])
def test_on_layers_of_models_the_hottest_entry_is_cooler_than_by_the_nearest_ends(model):
    ratios = []
    for _, height_mm, section in layers((model,)):
        islands = islands_of(section, int(height_mm / PROFILE.layer_height_mm), height_mm)
        order = scan_order("thermal", islands)
        schedule = islands.known_schedule
        before_k, _ = entered_at(islands, order, nearest_options(order, schedule.entry, schedule.leave))
        after_k, _ = entered_at(islands, order, chosen_options("thermal", islands, order))
        ratios.append(after_k.max() / before_k.max())
    assert np.median(ratios) < 0.95
    assert max(ratios) < 1.02

"""Orders planned with fresh heat: they do not hang on names or places, and small layers take the best of all."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
import shapely
from fresh_layers import PLATE, RAPID, islands_of, times_of
from shapely import affinity

from ebamcheck.scan.filling.hatch import Vectors
from ebamcheck.scan.order.entries import entered, entry_points, high_mean, nearest_options
from ebamcheck.scan.order.orders import scan_order
from ebamcheck.scan.order.search import own_rise, ranked, thermal_order, touching, touching_successors


@pytest.fixture(scope="module")
def choices():
    return islands_of(PLATE)


def renumbered(islands, order):
    """Return the same islands with other numbers: number n is what was order[n]."""
    place = np.argsort(order)
    schedule = islands.known_schedule
    lines = islands.lines
    by_island = np.argsort(place[lines.island], kind="stable")
    return replace(
        islands,
        centroid=islands.centroid[order],
        area_mm2=islands.area_mm2[order],
        neighbours=np.sort(place[islands.neighbours], axis=1),
        polygons=islands.polygons[order],
        schedule=replace(
            schedule,
            entry=schedule.entry[order],
            leave=schedule.leave[order],
            beam_s=schedule.beam_s[order],
            time_s=schedule.time_s[order],
        ),
        lines=Vectors(place[lines.island][by_island], lines.start[by_island], lines.end[by_island]),
    )


def moved(islands, angle_deg, shift_mm):
    """Return the same islands turned and shifted as a whole."""
    turn = np.deg2rad(angle_deg)
    matrix = np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]])

    def there(points):
        return points @ matrix + shift_mm

    def body(shape):
        return affinity.translate(affinity.rotate(shape, angle_deg, origin=(0, 0)), *shift_mm)

    polygons = np.empty(len(islands), object)
    polygons[:] = [body(p) for p in islands.polygons]
    schedule, lines = islands.known_schedule, islands.lines
    return replace(
        islands,
        centroid=there(islands.centroid),
        section=body(islands.section),
        polygons=polygons,
        schedule=replace(schedule, entry=there(schedule.entry), leave=there(schedule.leave)),
        lines=Vectors(lines.island, there(lines.start), there(lines.end)),
    )


def cost_of(islands, order):
    start, end, travel = times_of(islands, order)
    return travel, np.maximum(*entry_points(islands.cold_heat(), islands.known_schedule, order, start, end))


def test_numbers_of_islands_change_no_cost(choices):
    shuffle = np.random.default_rng(1).permutation(len(choices))
    order = scan_order("farthest", choices)
    travel, entry_k = cost_of(choices, order)
    other = renumbered(choices, shuffle)
    same_travel, same_k = cost_of(other, np.argsort(shuffle)[order])
    assert same_travel == pytest.approx(travel)
    assert same_k == pytest.approx(entry_k[shuffle], rel=1e-6, abs=1e-3)


@pytest.mark.parametrize(
    ("angle_deg", "shift_mm", "share"),
    [(0.0, (300.0, -70.0), 1e-6), (90.0, (0.0, 0.0), 1e-6), (33.0, (5.0, 8.0), 0.05)],
)
def test_the_cost_does_not_depend_on_where_the_layer_lies(choices, angle_deg, shift_mm, share):
    order = scan_order("thermal", choices)
    travel, entry_k = cost_of(choices, order)
    same_travel, same_k = cost_of(moved(choices, angle_deg, np.array(shift_mm)), order)
    assert same_travel == pytest.approx(travel)
    # Cells of the modes lie along the axes: a turn between changes them a little.
    assert high_mean(same_k) == pytest.approx(high_mean(entry_k), rel=share)


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
    islands = islands_of(
        shapely.box(0, 0, 62, 34).difference(shapely.box(20, 0, 24, 20)), hexagon_side_mm=11.0
    )
    count, schedule, heat = len(islands), islands.known_schedule, islands.cold_heat()
    assert 5 <= count <= 6
    beside = touching(islands.neighbours, count)
    every = [np.array(order) for order in itertools.permutations(range(count))]
    longest_mm = share * min(times_of(islands, order)[2] for order in every)
    found = thermal_order(
        heat, schedule, beside, RAPID, 19.0, longest_mm, 10.0, 40000, np.random.default_rng(0)
    )
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


def test_options_are_those_that_are_clocked(choices):
    schedule, order = choices.known_schedule, scan_order("farthest", choices)
    option = nearest_options(order, schedule.entry, schedule.leave)
    gone = np.hypot(
        *(schedule.entry[order[1:], option[order[1:]]] - schedule.leave[order[:-1], option[order[:-1]]]).T
    ).sum()
    assert gone == pytest.approx(times_of(choices, order)[2])


def test_without_fresh_heat_the_modes_stand_alone(choices):
    order = scan_order("raster", choices)
    start, end, _ = times_of(choices, order)
    heat = choices.cold_heat()
    alone, _ = entered(replace(heat, near=None), order, start, end)
    means, points = entry_points(heat, choices.known_schedule, order, start, end)
    assert means == pytest.approx(entered(heat, order, start, end)[0])
    # In rows, each island is begun beside the border just laid: far hotter than its mean.
    assert np.median(points[order[1:]] / alone[order[1:]]) > 1.5

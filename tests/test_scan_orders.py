"""Orders of islands against brute force."""

from __future__ import annotations

import math

import numpy as np
import pytest
from planned_sections import PROFILE, SECTIONS

from ebamcheck.errors import SettingsError
from ebamcheck.scan import plan_scan
from ebamcheck.scan.order.orders import LayerIslands, scan_order
from ebamcheck.settings.stages import order_names

BY_DISTANCE = ("nearest", "nearest-any", "nearest-last", "nearest-sum", "farthest")


def brute_force(name, centroid, first):
    """The orders as their docstrings say, in plain Python."""
    rule = {
        "nearest": lambda d: -min(d),
        "nearest-any": lambda d: -min(d),
        "nearest-last": lambda d: -d[-1],
        "nearest-sum": lambda d: -sum(d),
        "farthest": min,
    }[name]
    order = [first]
    while len(order) < len(centroid):
        left = [i for i in range(len(centroid)) if i not in order]
        order.append(max(left, key=lambda i: rule([math.dist(centroid[i], centroid[j]) for j in order])))
    return order


def islands_at(centroid, seed=0, layer=0):
    return LayerIslands(centroid, np.ones(len(centroid)), np.zeros((0, 2), np.int64), layer, seed)


@pytest.mark.in_turn(2)
@pytest.mark.parametrize("name", BY_DISTANCE)
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_orders_are_what_they_say(name, seed):
    centroid = np.random.default_rng(seed).uniform(0, 100, (40, 2))
    order = scan_order(name, islands_at(centroid, seed))
    assert order.tolist() == brute_force(name, centroid, int(order[0]))


def test_start_is_random_but_seeded_by_seed_and_layer():
    centroid = np.random.default_rng(0).uniform(0, 100, (200, 2))
    starts = {
        (s, k): int(scan_order("nearest", islands_at(centroid, s, k))[0]) for s in range(5) for k in range(5)
    }
    again = {(s, k): int(scan_order("farthest", islands_at(centroid, s, k))[0]) for s, k in starts}
    assert starts == again
    assert len(set(starts.values())) > 15


def test_ties_do_not_hang_on_rounding():
    grid = np.stack(np.meshgrid(np.arange(6.0), np.arange(5.0)), axis=-1).reshape(-1, 2) * 10
    shaken = grid + np.random.default_rng(0).uniform(-1e-9, 1e-9, grid.shape)
    for name in (*BY_DISTANCE, "raster", "stride"):
        assert np.array_equal(scan_order(name, islands_at(grid)), scan_order(name, islands_at(shaken)))


def test_raster_goes_to_and_fro():
    grid = np.stack(np.meshgrid(np.arange(4.0), np.arange(3.0)), axis=-1).reshape(-1, 2)
    assert scan_order("raster", islands_at(grid)).tolist() == [0, 1, 2, 3, 7, 6, 5, 4, 8, 9, 10, 11]


@pytest.mark.parametrize("name", order_names())
def test_every_order_plans_a_layer(name):
    plan = plan_scan(SECTIONS["box"], PROFILE, order=name, seed=4)
    assert np.array_equal(np.sort(plan.order), np.arange(len(plan.islands)))
    assert plan.settings["order"] == name


def test_farthest_parts_neighbours_in_time_where_nearest_does_not():
    near, far = (
        plan_scan(SECTIONS["box"], PROFILE, order=n).metrics.iloc[0] for n in ("nearest-last", "farthest")
    )
    assert far["interval_p10_s"] > 2 * near["interval_p10_s"]
    assert far["travel_mm"] > near["travel_mm"]


def test_an_unknown_order_is_named():
    with pytest.raises(SettingsError, match="'spiral' is unknown: choose one of farthest"):
        plan_scan(SECTIONS["box"], PROFILE, order="spiral")

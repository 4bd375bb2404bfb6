"""Plans of stacks, contour beads, degenerate layers, and the measure of coverage."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd
import pytest
import shapely
from inset_layers import contour_paths
from planned_sections import PROFILE, beads_of, blade, disc, equal_plans, stack

from ebamcheck.errors import GeometryError
from ebamcheck.geometry.raster import covered_fraction
from ebamcheck.geometry.regions import ARC_SEGMENTS, inset
from ebamcheck.layers.stack import from_polygons, from_rings
from ebamcheck.scan import plan_scan, plan_stack, simulate_order

# -- stacks --------------------------------------------------------------------------------------------


def test_a_stack_is_its_layers():
    layers = stack()
    counted = []
    cold = PROFILE.changed(scan={"carry_heat": False})
    plan = plan_stack(layers, cold, progress=counted.append)
    assert sum(counted) == len(layers) == len(plan)
    assert plan.heights.tolist() == layers.heights.tolist()
    assert (np.diff(plan.island_layer) >= 0).all()
    assert np.array_equal(plan.island_layer[plan.order], plan.island_layer), "order goes layer by layer"
    assert plan.metrics["islands"].tolist() == np.bincount(plan.island_layer, minlength=7).tolist()
    assert plan.metrics["islands"][3] == 0
    for k in (0, 5):
        alone = plan_scan(layers.polygons(k), cold, layer=k, height_mm=layers.heights[k])
        base = np.searchsorted(plan.island_layer, k)
        assert np.array_equal(plan.islands_of(k) - base, alone.order)
        columns = ["x0", "y0", "x1", "y1", "angle"]
        assert np.array_equal(plan.vectors_of(k)[columns].to_numpy(), alone.vectors[columns].to_numpy())
        # Whatever the order knows, layers are driven on the heat of those below for their power and waits.
        heat = ["body_mean_k", "entry_max_k", "wait_s", "ring_wait_s", "power_share", "enter_k", "leave_k"]
        pd.testing.assert_series_equal(
            plan.metrics.iloc[k].drop(heat), alone.metrics.iloc[0].drop(heat), check_names=False
        )


@pytest.mark.slow
def test_threads_do_not_change_a_bit(monkeypatch):
    layers = stack(4)
    monkeypatch.setenv("EBAMCHECK_THREADS", "1")
    one = plan_stack(layers, PROFILE)
    monkeypatch.setenv("EBAMCHECK_THREADS", "3")
    equal_plans(one, plan_stack(layers, PROFILE))


# -- contour beads -------------------------------------------------------------------------------------


def test_contour_paths_keep_corners_points_and_labels():
    square = shapely.box(0, 0, 40, 30).difference(shapely.box(10, 10, 20, 20))
    layers = from_polygons(
        [1.0, 2.0, 3.0], [[square], [shapely.box(0, 0, 50, 5.9)], [disc(0, 0, 50)]], part="p"
    )
    paths = contour_paths(layers, 3.0)
    assert paths.part == "p"
    assert paths.settings["contour_offset_mm"] == 3.0
    grown_hole = 10 * 10 + 4 * 10 * 3 + math.pi * 9
    assert paths.areas()[:2].tolist() == pytest.approx([34 * 24 - grown_hole, 0.0], abs=0.1)
    assert len(paths.ring(0)) == 4
    assert paths.ring_counts().tolist() == [2, 0, 1]
    assert len(paths.ring(2)) >= 4 * 48
    assert np.hypot(*paths.ring(2).T) == pytest.approx(47.0, abs=0.01)
    assert contour_paths(layers, 0.0).areas() == pytest.approx(layers.areas())


def test_contour_paths_lie_one_offset_inside():
    paths = contour_paths(from_polygons([0.0], [[blade()]]), 3.0)
    points = shapely.points(paths.points)
    gap = shapely.distance(points, blade().boundary)
    sagitta = 3.0 * (1 - math.cos(math.pi / 4 / ARC_SEGMENTS))
    assert gap.min() >= 3.0 - sagitta - 1e-9
    assert gap.max() == pytest.approx(3.0, abs=1e-6)
    assert np.median(gap) == pytest.approx(3.0, abs=1e-6)


@pytest.mark.parametrize("distance", [3.0, 3.84, 5.16])
def test_insets_do_not_lose_regions(distance):
    # Mitred offsets of GEOS 3.14.1 return nothing for shapes like these.
    rng = np.random.default_rng(7)
    for _ in range(12):
        corners = rng.uniform(-150, 150, (7, 2))
        shape = shapely.make_valid(shapely.Polygon(corners)).difference(disc(*rng.uniform(-90, 90, 2), 20))
        grid = shapely.points(
            *(g.ravel() for g in np.meshgrid(np.arange(-150, 150, 5.0), np.arange(-150, 150, 5.0)))
        )
        deep = shapely.contains(shape, grid) & (shapely.distance(grid, shape.boundary) > distance + 0.01)
        shallow = ~shapely.contains(shape, grid) | (shapely.distance(grid, shape.boundary) < distance - 0.01)
        found = inset(shape, distance)
        assert shapely.contains(found, grid[deep]).all()
        assert not shapely.contains(found, grid[shallow]).any()


# -- degenerate layers ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "given", [[], shapely.Polygon(), [shapely.Polygon()], shapely.LineString([(0, 0), (1, 1)])]
)
def test_a_layer_without_area_is_planned_as_empty(given):
    plan = plan_scan(given, PROFILE)
    assert len(plan.islands) == len(plan.vectors) == 0
    assert plan.metrics["time_s"].tolist() == [0.0]
    assert plan.metrics["covered_fraction"].tolist() == [1.0]
    assert len(simulate_order(plan, PROFILE)) == 0


def test_no_layers_at_all():
    plan = plan_stack(from_rings([], []), PROFILE)
    assert len(plan) == len(plan.metrics) == 0


@pytest.mark.parametrize("size", [1e-3, 0.5, 3.0, 6.0, 9.0, 12.0, 16.0, 21.0])
def test_small_islands_of_metal_are_not_lost(size):
    for shape in (shapely.box(0, 0, size, size), disc(0, 0, size / 2), shapely.box(0, 0, 8 * size, size)):
        plan = plan_scan(shape, PROFILE)
        exact = beads_of(plan).intersection(shape).area / shape.area
        assert exact >= 0.98


def test_invalid_polygons_are_made_valid():
    bow = shapely.Polygon([(0, 0), (100, 80), (100, 0), (0, 80)])
    overlapping = [shapely.box(0, 0, 100, 50), shapely.box(60, 0, 160, 50)]
    assert plan_scan(bow, PROFILE).metrics["area_mm2"][0] == pytest.approx(4000.0)
    plan = plan_scan(overlapping, PROFILE)
    assert plan.metrics["area_mm2"][0] == pytest.approx(8000.0)
    assert shapely.union_all(plan.islands).area == pytest.approx(plan.island_area_mm2.sum())


def test_a_coordinate_that_is_not_finite_is_refused():
    with pytest.raises(GeometryError, match="polygon 1 of the layer"):
        plan_scan([shapely.box(0, 0, 1, 1), shapely.Polygon([(0, 0), (1, 0), (math.inf, 1)])], PROFILE)


@pytest.mark.long
def test_ten_thousand_islands():
    config = PROFILE.changed(scan={"hexagon_side_mm": 2.5})
    plan = plan_scan(disc(0, 0, 235).difference(disc(50, 50, 40)), config)
    assert len(plan.islands) > 9_900
    assert np.array_equal(np.sort(plan.order), np.arange(len(plan.islands)))
    assert plan.metrics["covered_fraction"][0] > 0.999


# -- coverage ------------------------------------------------------------------------------------------


def test_coverage_of_one_bead_is_a_stadium():
    section = shapely.box(-50, -50, 150, 50)
    share = covered_fraction(section, np.array([[0.0, 0.0, 80.0, 30.0]]), 20.0)
    assert share == pytest.approx((20 * math.hypot(80, 30) + math.pi * 100) / section.area, rel=0.01)


@pytest.mark.parametrize("seed", range(4))
def test_coverage_is_that_of_shapely(seed):
    rng = np.random.default_rng(seed)
    section = blade()
    segments = rng.uniform(-150, 150, (12, 4))
    segments[0, 2:] = segments[0, :2]  # a spot
    segments[1, 3] = segments[1, 1]
    beads = shapely.buffer(shapely.linestrings(segments.reshape(-1, 2, 2)), 3.0, quad_segs=64)
    exact = shapely.union_all(beads).intersection(section).area / section.area
    assert covered_fraction(section, segments, 6.0) == pytest.approx(exact, abs=2e-3)


@pytest.mark.slow
def test_a_stack_is_planned_alike_at_any_height_of_the_part():
    layers = stack(4)
    raised = from_polygons(layers.heights + 500.0, [layers.polygons(k) for k in range(4)])
    assert np.array_equal(plan_stack(layers, PROFILE).order, plan_stack(raised, PROFILE).order)

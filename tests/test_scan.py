"""Plans of layers and stacks: laws over sections of every sort, times of a simulation, and orders against brute force."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd
import pytest
import shapely
from planned_sections import PROFILE, blade, disc, equal_plans, stack
from section_zoo import ZOO
from shapely import affinity

from ebamcheck.errors import GeometryError
from ebamcheck.geometry.raster import covered_fraction
from ebamcheck.geometry.regions import ARC_SEGMENTS, JOIN_MM
from ebamcheck.layers.stack import from_polygons, from_rings
from ebamcheck.scan import plan_scan, plan_stack, simulate_order
from ebamcheck.scan.filling.fill import LEAST_SPOT, TRIM, spot_widths_mm
from ebamcheck.scan.islands.regions import CRUMB, layer_regions
from ebamcheck.scan.order.orders import LayerIslands, scan_order
from ebamcheck.scan.plan.columns import METRICS
from ebamcheck.settings.stages import order_names

RASTER = PROFILE.changed(scan={"order": "raster"}, process={"interpass": "off"})
"""What is covered does not hang on the order, and this one takes no heat model."""

WIDTH = PROFILE.process.bead_width_mm
SECTIONS = {**ZOO, "blade far away": affinity.translate(blade(), 5e4, -5e4)}


@pytest.fixture(scope="module", params=SECTIONS, ids=list(SECTIONS))
def planned(request):
    section = shapely.union_all([SECTIONS[request.param]])
    return section, plan_scan(section, RASTER, layer=3)  # a layer whose cells are shifted and turned


def lines_of(plan):
    return shapely.linestrings(plan.vectors[["x0", "y0", "x1", "y1"]].to_numpy().reshape(-1, 2, 2))


def beads_of(plan):
    borders = shapely.get_parts(shapely.boundary(plan.contours))
    return shapely.union_all(shapely.buffer([*lines_of(plan), *borders], WIDTH / 2, quad_segs=16))


def widest(region):
    spots = [p for p in shapely.get_parts(region) if p.area > LEAST_SPOT * WIDTH**2]
    return spot_widths_mm(spots).max(initial=0.0)


# -- laws of any plan ----------------------------------------------------------------------------------


@pytest.mark.in_turn(3)
def test_at_least_98_percent_are_covered_and_no_spot_is_wider_than_set(planned):
    section, plan = planned
    bare = section.difference(beads_of(plan))
    covered = 1.0 - bare.area / section.area
    assert covered >= RASTER.scan.least_coverage == 0.98
    assert plan.metrics["covered_fraction"][0] == pytest.approx(covered, abs=0.003)
    # Chords of the round ends and the spot's cut on the grid blur its width by some hundredths.
    assert widest(bare) <= RASTER.scan.gap_width * WIDTH + 0.02
    assert plan.metrics["widest_gap_mm"][0] <= RASTER.scan.gap_width * WIDTH


@pytest.mark.in_turn(3)
def test_every_island_once_and_no_line_outside_of_it(planned):
    section, plan = planned
    assert np.array_equal(np.sort(plan.order), np.arange(len(plan.islands)))
    island = plan.vectors["island"].to_numpy()
    assert np.array_equal(island[np.flatnonzero(np.diff(island, prepend=-1))], plan.order)
    reach = 1e-9 * max(1.0, np.abs(section.bounds).max())
    own = shapely.buffer(plan.islands, reach)
    assert shapely.covers(own[island], lines_of(plan)).all()
    assert shapely.covers(section.buffer(reach), lines_of(plan)).all()


@pytest.mark.in_turn(3)
def test_beads_do_not_pile_up(planned):
    section, plan = planned
    # A bead covers its spacing; where a wall is narrower, no less than one bead can be laid: what it spills
    # over the border counts with the area. Round ends and walls of a bead and a bit cost the rest.
    spilled = shapely.union_all([section, beads_of(plan)]).area
    laid = plan.metrics["laid_share"][0] * section.area
    assert laid <= 1.3 * spilled


@pytest.mark.in_turn(3)
def test_bare_walls_are_what_no_contour_bead_can_go_around(planned):
    section, plan = planned
    reached = plan.contours[0].buffer(WIDTH / 2 + JOIN_MM, quad_segs=ARC_SEGMENTS)
    least_mm2 = CRUMB * WIDTH**2
    left = [p for p in shapely.get_parts(section.difference(reached)) if p.area >= least_mm2]
    alone = [p for p in shapely.get_parts(section) if p.area < least_mm2]
    walls = layer_regions(section, RASTER).bare_walls
    assert shapely.area(walls).sum() == pytest.approx(shapely.area([*left, *alone]).sum(), rel=1e-9)


@pytest.mark.in_turn(3)
def test_islands_do_not_overlap_and_are_the_regions_to_fill(planned):
    section, plan = planned
    regions = layer_regions(section, RASTER)
    wanted = shapely.union_all([*regions.solids, *regions.narrow_fills, *regions.bare_walls])
    closing = plan.island_kind == "gap"
    assert plan.island_area_mm2[~closing].sum() == pytest.approx(wanted.area, rel=1e-6)
    assert shapely.union_all(plan.islands[~closing]).symmetric_difference(wanted).area <= 2e-4 * wanted.area
    # Gaps lie beside all of these: the areas of all islands add up to that of their union.
    assert shapely.union_all(plan.islands).area == pytest.approx(plan.island_area_mm2.sum(), rel=1e-6)
    assert shapely.union_all(plan.islands).difference(section.buffer(1e-6)).is_empty


@pytest.mark.in_turn(3)
def test_columns_fit_together(planned):
    section, plan = planned
    assert plan.island_area_mm2 == pytest.approx(shapely.area(plan.islands))
    way = plan.vectors[["x1", "y1"]].to_numpy() - plan.vectors[["x0", "y0"]].to_numpy()
    length = np.hypot(*way.T)
    angle = np.radians(plan.vectors["angle"].to_numpy())
    assert length[:, None] * np.column_stack([np.cos(angle), np.sin(angle)]) == pytest.approx(way, abs=1e-9)
    row = plan.metrics.iloc[0]
    assert list(plan.metrics.columns) == list(METRICS)
    assert row["area_mm2"] == pytest.approx(section.area)
    assert row["hatch_length_mm"] == pytest.approx(length.sum())
    assert row["islands"] == len(plan.islands)
    assert row["contour_length_mm"] == pytest.approx(plan.contours[0].length)
    beads = length.sum() + row["turn_length_mm"] + plan.contours[0].length
    laid = beads * RASTER.process.hatch_spacing_mm
    assert row["laid_share"] == pytest.approx(laid / section.area)
    assert (plan.neighbours[:, 0] < plan.neighbours[:, 1]).all()
    assert (plan.border_mm > 0).all()


def test_deposited_area_is_the_area_to_fill():
    # Lines times spacing are the area of the islands, before they are shortened: the law behind the place of lines.
    plan = plan_scan(shapely.box(0, 0, 300, 200), PROFILE)
    spacing = PROFILE.process.hatch_spacing_mm
    whole = plan.metrics["hatch_length_mm"][0] + 2.0 * TRIM * spacing * len(plan.vectors)
    laid = whole * spacing
    assert laid == pytest.approx(plan.island_area_mm2.sum(), rel=0.06)


def test_hatch_turns_from_layer_to_layer_and_from_hexagon_to_hexagon():
    for layer in (0, 1, 7):
        plan = plan_scan(shapely.box(0, 0, 200, 120), PROFILE, layer=layer)
        area_mm2 = 1.5 * math.sqrt(3) * plan.metrics["side_mm"][0] ** 2
        full = np.flatnonzero(np.isclose(plan.island_area_mm2, area_mm2, rtol=1e-9))
        on_full = plan.vectors[np.isin(plan.vectors["island"], full)]
        found = np.unique(np.round(on_full["angle"], 6) % 180.0)
        assert found == pytest.approx(np.sort((layer * 15.0 + np.array([0.0, 60.0, 120.0])) % 180.0))
        for a, b in plan.neighbours[np.isin(plan.neighbours, full).all(axis=1)]:
            first = plan.vectors[plan.vectors["island"] == a]["angle"].iloc[0] % 180
            second = plan.vectors[plan.vectors["island"] == b]["angle"].iloc[0] % 180
            assert abs(math.remainder(first - second, 180.0)) > 59.0


# -- simulation ----------------------------------------------------------------------------------------


def test_times_of_one_island_by_hand():
    # One whole solid whose fill is 24 x 10.8 mm: three lines, 3.6 mm apart at most 4.32, each 0.3 spacings short of both
    # borders, and two turns between them with the beam on.
    inset = PROFILE.contour_offset_mm + PROFILE.process.hatch_spacing_mm / 2
    config = PROFILE.changed(scan={"hexagon_side_mm": 30.0})
    plan = plan_scan(shapely.box(0, 0, 24 + 2 * inset, 10.8 + 2 * inset), config)
    driven = simulate_order(plan, config)
    assert plan.island_kind.tolist() == ["whole"]
    lines = 3 * (24 - 2 * 0.3 * 4.32)
    assert driven["end_s"].tolist() == pytest.approx([(lines + 2 * 3.6) / 10.0])
    assert driven["start_s"].tolist() == [0.0]
    assert driven["inner_travel_mm"].tolist() == [0.0]
    assert driven["turn_mm"].tolist() == pytest.approx([7.2])
    assert driven["starts"].tolist() == [1]


@pytest.mark.in_turn(3)
def test_simulation_adds_up(planned):
    _, plan = planned
    driven = simulate_order(plan, RASTER)
    assert driven["island"].tolist() == plan.order.tolist()
    assert (driven["end_s"] > driven["start_s"]).all()
    gap = driven["start_s"].to_numpy()[1:] - driven["end_s"].to_numpy()[:-1]
    assert gap == pytest.approx(driven["travel_mm"].to_numpy()[1:] / RASTER.machine.rapid_mm_s, abs=1e-6)
    row = plan.metrics.iloc[0]
    assert driven["end_s"].to_numpy().max(initial=0.0) == pytest.approx(row["time_s"])
    assert driven["length_mm"].sum() == pytest.approx(row["hatch_length_mm"])
    assert driven["travel_mm"].sum() + driven["inner_travel_mm"].sum() == pytest.approx(row["travel_mm"])
    assert driven["starts"].sum() == row["starts"]
    if len(plan.neighbours):
        end = driven.set_index("island")["end_s"]
        interval = [abs(end[a] - end[b]) for a, b in plan.neighbours]
        assert row["interval_min_s"] == pytest.approx(min(interval))
        assert row["interval_p10_s"] == pytest.approx(np.quantile(interval, 0.1))


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


# -- degenerate layers ---------------------------------------------------------------------------------


@pytest.mark.parametrize("given", [[], shapely.Polygon(), [shapely.Polygon()], shapely.LineString([(0, 0), (1, 1)])])
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


# -- coverage ------------------------------------------------------------------------------------------


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


# -- orders of islands against brute force ------------------------------------------------------------------


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
    plan = plan_scan(shapely.box(0, 0, 200, 80), PROFILE, order=name, seed=4)
    assert np.array_equal(np.sort(plan.order), np.arange(len(plan.islands)))
    assert plan.settings["order"] == name

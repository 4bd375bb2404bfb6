"""Plans of whole layers: the laws that hold on any section, orders against brute force, degenerate layers."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd
import pytest
import shapely
from shapely import affinity

from ebamcheck.errors import GeometryError, InputError, SettingsError
from ebamcheck.layers.stack import from_polygons, from_rings
from ebamcheck.scan import ORDERS, ScanPlan, contour_paths, plan_scan, plan_stack, simulate_order
from ebamcheck.scan.filling.coverage import covered_fraction
from ebamcheck.scan.filling.fill import TRIM
from ebamcheck.scan.islands.clipping import clip_lattice, partition
from ebamcheck.scan.islands.lattice import hexagon_lattice
from ebamcheck.scan.islands.rectangle import minimum_rectangle
from ebamcheck.scan.islands.regions import ARC_SEGMENTS, inset, layer_regions
from ebamcheck.scan.order.orders import LayerIslands, scan_order
from ebamcheck.scan.plan.columns import METRICS
from ebamcheck.settings.config import Config

PROFILE = Config()
WIDTH = PROFILE.process.bead_width_mm
ANGLE = np.linspace(0, 2 * math.pi, 500, endpoint=False)


def disc(x, y, radius, fine=48):
    return shapely.Point(x, y).buffer(radius, quad_segs=fine)


def blade():
    outline = np.column_stack(
        [150 * np.cos(ANGLE) + 12 * np.cos(3 * ANGLE), 70 * np.sin(ANGLE) + 10 * np.sin(5 * ANGLE)]
    )
    body = shapely.Polygon(outline).difference(disc(-60, 0, 22)).difference(shapely.box(30, -20, 90, 15))
    walls = [shapely.box(140, -4, 260, 4), shapely.box(255, -80, 260, 80), shapely.box(200, 30, 258, 34)]
    return shapely.union_all([body, *walls])


SECTIONS = {
    "box": shapely.box(0, 0, 200, 80),
    "blade with holes and walls": blade(),
    "two regions, one in the hole of the other": shapely.union_all(
        [disc(0, 0, 90).difference(disc(0, 0, 60)), disc(5, 5, 35)]
    ),
    "turned comb": affinity.rotate(
        shapely.union_all(
            [shapely.box(0, 0, 180, 40), *(shapely.box(k, 40, k + 5, 110) for k in range(0, 180, 30))]
        ),
        23,
    ),
    "ring thinner than a bead": disc(0, 0, 60).difference(disc(0, 0, 56)),
    "ring of three beads": disc(0, 0, 60).difference(disc(0, 0, 43)),
    "wedge": shapely.Polygon([(0, 0), (150, 0), (0, 30)]),
    "far away": affinity.translate(blade(), 5e4, -5e4),
}


@pytest.fixture(scope="module", params=SECTIONS, ids=list(SECTIONS))
def planned(request):
    section = SECTIONS[request.param]
    return section, plan_scan(section, PROFILE)


def lines_of(plan):
    return shapely.linestrings(plan.vectors[["x0", "y0", "x1", "y1"]].to_numpy().reshape(-1, 2, 2))


def beads_of(plan):
    return shapely.union_all(
        [
            *shapely.buffer(lines_of(plan), WIDTH / 2),
            *shapely.buffer(shapely.boundary(plan.contours), WIDTH / 2),
        ]
    )


def whole_hexagons(plan):
    area = 1.5 * math.sqrt(3) * plan.metrics["side_mm"][0] ** 2
    return np.flatnonzero(np.isclose(plan.island_area_mm2, area, rtol=1e-9))


def equal_plans(a, b):
    for name in ("heights", "island_layer", "island_kind", "island_area_mm2", "island_centroid"):
        assert np.array_equal(getattr(a, name), getattr(b, name)), name
    for name in ("neighbours", "border_mm", "order"):
        assert np.array_equal(getattr(a, name), getattr(b, name)), name
    for name in ("islands", "contours"):
        assert np.array_equal(shapely.to_wkb(getattr(a, name)), shapely.to_wkb(getattr(b, name))), name
    pd.testing.assert_frame_equal(a.vectors, b.vectors, check_exact=True)
    pd.testing.assert_frame_equal(a.metrics, b.metrics, check_exact=True)
    assert a.settings == b.settings


# -- laws of any plan ----------------------------------------------------------------------------------


def test_every_island_is_scanned_once_and_in_one_go(planned):
    _, plan = planned
    assert np.array_equal(np.sort(plan.order), np.arange(len(plan.islands)))
    island = plan.vectors["island"].to_numpy()
    runs = island[np.flatnonzero(np.diff(island, prepend=-1))]
    assert np.array_equal(runs, plan.order), "the lines follow the order, and no island is left out"


def test_no_line_leaves_its_island_or_the_section(planned):
    section, plan = planned
    lines = lines_of(plan)
    reach = 1e-9 if section.bounds[2] < 1e3 else 1e-8
    grown = section.buffer(reach)
    shapely.prepare(grown)
    assert shapely.covers(grown, lines).all()
    own = shapely.buffer(plan.islands, reach)[plan.vectors["island"].to_numpy()]
    assert shapely.covers(own, lines).all()


def test_beads_cover_the_section_and_the_metric_says_so(planned):
    section, plan = planned
    exact = beads_of(plan).intersection(section).area / section.area
    assert exact >= 0.98
    assert plan.metrics["covered_fraction"][0] == pytest.approx(exact, abs=0.003)


def test_islands_do_not_overlap_and_are_the_regions_to_fill(planned):
    section, plan = planned
    regions = layer_regions(section, PROFILE)
    wanted = shapely.union_all([*regions.solids, *regions.narrow_fills, *regions.bare_walls])
    closing = plan.island_kind == "gap"
    assert plan.island_area_mm2[~closing].sum() == pytest.approx(wanted.area, rel=1e-6)
    assert shapely.union_all(plan.islands[~closing]).symmetric_difference(wanted).area < 1e-4 * wanted.area
    # Gaps lie beside all of these: the areas of all islands add up to that of their union.
    assert shapely.union_all(plan.islands).area == pytest.approx(plan.island_area_mm2.sum(), rel=1e-6)
    assert section.buffer(1e-6).covers(shapely.union_all(plan.islands))


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
    laid = beads * PROFILE.process.hatch_spacing_mm
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


def test_islands_turn_with_the_part():
    section = affinity.rotate(blade(), 10, origin=(0, 0))
    turned = affinity.rotate(section, 20, origin=(0, 0))
    one, two = plan_scan(section, PROFILE), plan_scan(turned, PROFILE)
    back = affinity.rotate(shapely.MultiPoint(two.island_centroid), -20, origin=(0, 0))
    distance = shapely.distance(shapely.points(one.island_centroid)[:, None], np.array(back.geoms)[None, :])
    assert len(one.islands) == len(two.islands)
    assert np.median(distance.min(axis=1)) < 1e-6
    assert distance.min(axis=1).max() < 0.2


def test_walls_get_lines_and_solids_get_hexagons():
    plan = plan_scan(SECTIONS["turned comb"], PROFILE)
    assert np.count_nonzero(plan.island_kind == "thin wall") == 6
    assert np.count_nonzero(plan.island_kind == "hexagon") > 10
    regions = layer_regions(SECTIONS["turned comb"], PROFILE)
    assert len(regions.bare_walls) == 6
    for wall in plan.islands[plan.island_kind == "thin wall"]:
        assert wall.area == pytest.approx(5 * 70, rel=0.05)


def test_slivers_are_merged():
    section = blade()
    process = PROFILE.process
    regions = layer_regions(section, PROFILE)
    lattice = hexagon_lattice(minimum_rectangle(shapely.get_coordinates(section)), 13.0)
    clipped, owner = clip_lattice(regions.solids, lattice)
    found = partition(regions.solids, lattice, process.bead_width_mm, process.hatch_spacing_mm)
    assert shapely.area(clipped).min() < WIDTH**2, "the part has slivers to begin with"
    assert shapely.area(found.polygons).min() >= WIDTH**2
    assert shapely.area(found.polygons).sum() == pytest.approx(shapely.area(clipped).sum(), rel=1e-6)
    expected = shapely.area(shapely.intersection(lattice.cells, shapely.union_all(regions.solids)))
    assert np.bincount(owner, shapely.area(clipped), len(expected)) == pytest.approx(expected, abs=1e-6)


def test_hatch_turns_from_layer_to_layer_and_from_hexagon_to_hexagon():
    for layer in (0, 1, 7):
        plan = plan_scan(shapely.box(0, 0, 200, 120), PROFILE, layer=layer)
        full = whole_hexagons(plan)
        on_full = plan.vectors[np.isin(plan.vectors["island"], full)]
        found = np.unique(np.round(on_full["angle"], 6) % 180.0)
        assert found == pytest.approx(np.sort((layer * 15.0 + np.array([0.0, 60.0, 120.0])) % 180.0))
        for a, b in plan.neighbours[np.isin(plan.neighbours, full).all(axis=1)]:
            first = plan.vectors[plan.vectors["island"] == a]["angle"].iloc[0] % 180
            second = plan.vectors[plan.vectors["island"] == b]["angle"].iloc[0] % 180
            assert abs(math.remainder(first - second, 180.0)) > 59.0


def test_settings_reach_the_plan():
    section = shapely.box(0, 0, 200, 120)
    wide = PROFILE.changed(scan={"hexagon_side_mm": 20.0, "first_angle_deg": 45.0, "island_angle_deg": 0.0})
    plan = plan_scan(section, wide)
    assert plan.metrics["side_mm"][0] == 20.0
    on_whole = plan.vectors[np.isin(plan.vectors["island"], whole_hexagons(plan))]
    assert len(on_whole) > 20
    assert on_whole["angle"].to_numpy() % 180.0 == pytest.approx(45.0)
    offset = PROFILE.changed(scan={"contour_offset_mm": 1.0})
    assert plan_scan(section, offset).contours[0].area == pytest.approx(198 * 118)
    paper = plan_scan(blade(), PROFILE.changed(scan={"rectangle": "paper"}))
    assert paper.metrics["covered_fraction"][0] > 0.98


# -- orders --------------------------------------------------------------------------------------------


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


@pytest.mark.parametrize("name", ORDERS)
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
    with pytest.raises(SettingsError, match="'spiral' is unknown: choose one of nearest"):
        plan_scan(SECTIONS["box"], PROFILE, order="spiral")


# -- simulation ----------------------------------------------------------------------------------------


def test_times_of_one_island_by_hand():
    # One whole solid whose fill is 24 x 10.8 mm: three lines, 3.6 mm apart at most 4.32, each 0.3 spacings short of both
    # borders, and two turns between them with the beam on.
    inset = PROFILE.contour_offset_mm + PROFILE.process.hatch_spacing_mm / 2
    profile = PROFILE.changed(scan={"hexagon_side_mm": 30.0})
    plan = plan_scan(shapely.box(0, 0, 24 + 2 * inset, 10.8 + 2 * inset), profile)
    driven = simulate_order(plan, profile)
    assert plan.island_kind.tolist() == ["whole"]
    lines = 3 * (24 - 2 * 0.3 * 4.32)
    assert driven["end_s"].tolist() == pytest.approx([(lines + 2 * 3.6) / 10.0])
    assert driven["start_s"].tolist() == [0.0]
    assert driven["inner_travel_mm"].tolist() == [0.0]
    assert driven["turn_mm"].tolist() == pytest.approx([7.2])
    assert driven["starts"].tolist() == [1]


def test_simulation_adds_up(planned):
    _, plan = planned
    driven = simulate_order(plan, PROFILE)
    assert driven["island"].tolist() == plan.order.tolist()
    assert (driven["end_s"] > driven["start_s"]).all()
    gap = driven["start_s"].to_numpy()[1:] - driven["end_s"].to_numpy()[:-1]
    assert gap == pytest.approx(driven["travel_mm"].to_numpy()[1:] / PROFILE.machine.rapid_mm_s, abs=1e-6)
    row = plan.metrics.iloc[0]
    assert driven["end_s"].max() == pytest.approx(row["time_s"])
    assert driven["length_mm"].sum() == pytest.approx(row["hatch_length_mm"])
    assert driven["travel_mm"].sum() + driven["inner_travel_mm"].sum() == pytest.approx(row["travel_mm"])
    assert driven["starts"].sum() == row["starts"]
    if len(plan.neighbours):
        end = driven.set_index("island")["end_s"]
        interval = [abs(end[a] - end[b]) for a, b in plan.neighbours]
        assert row["interval_min_s"] == pytest.approx(min(interval))
        assert row["interval_p10_s"] == pytest.approx(np.quantile(interval, 0.1))


# -- stacks and files ----------------------------------------------------------------------------------


def stack(count=7):
    bodies = [[affinity.rotate(blade(), 3.0 * k)] for k in range(count)]
    bodies[3] = []
    # The lowest cut lies half a layer over the plate: heights are then those over the plate.
    heights = 0.5 * PROFILE.layer_height_mm + np.arange(count) * 1.7
    return from_polygons(heights, bodies, part="abc", backend="planecut")


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


def test_threads_do_not_change_a_bit(monkeypatch):
    layers = stack(4)
    monkeypatch.setenv("EBAMCHECK_THREADS", "1")
    one = plan_stack(layers, PROFILE)
    monkeypatch.setenv("EBAMCHECK_THREADS", "3")
    equal_plans(one, plan_stack(layers, PROFILE))


def test_a_plan_survives_its_file(tmp_path):
    plan = plan_stack(stack(), PROFILE)
    plan.to_parquet(tmp_path / "scan.parquet")
    equal_plans(plan, ScanPlan.from_parquet(tmp_path / "scan.parquet"))
    empty = plan_scan([], PROFILE)
    empty.to_parquet(tmp_path / "empty.parquet")
    equal_plans(empty, ScanPlan.from_parquet(tmp_path / "empty.parquet"))


def test_what_is_no_plan_is_refused(tmp_path):
    pd.DataFrame({"x": [1]}).to_parquet(tmp_path / "other.parquet")
    with pytest.raises(InputError, match="is not a scan plan"):
        ScanPlan.from_parquet(tmp_path / "other.parquet")
    (tmp_path / "text.parquet").write_text("hello")
    with pytest.raises(InputError, match="cannot be read"):
        ScanPlan.from_parquet(tmp_path / "text.parquet")


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


def test_ten_thousand_islands():
    profile = PROFILE.changed(scan={"hexagon_side_mm": 2.5})
    plan = plan_scan(disc(0, 0, 235).difference(disc(50, 50, 40)), profile)
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


def test_a_stack_is_planned_alike_at_any_height_of_the_part():
    layers = stack(4)
    raised = from_polygons(layers.heights + 500.0, [layers.polygons(k) for k in range(4)])
    assert np.array_equal(plan_stack(layers, PROFILE).order, plan_stack(raised, PROFILE).order)

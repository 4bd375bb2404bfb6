"""Plans of whole layers: the laws that hold on any section, and the times of a simulation."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely
from planned_sections import PROFILE, SECTIONS, WIDTH, beads_of, blade, lines_of, whole_hexagons
from shapely import affinity

from ebamcheck.scan import plan_scan, simulate_order
from ebamcheck.scan.filling.fill import TRIM
from ebamcheck.scan.islands.clipping import clip_lattice, partition
from ebamcheck.scan.islands.lattice import hexagon_lattice, minimum_rectangle
from ebamcheck.scan.islands.regions import layer_regions
from ebamcheck.scan.plan.columns import METRICS


@pytest.fixture(scope="module", params=SECTIONS, ids=list(SECTIONS))
def planned(request):
    section = SECTIONS[request.param]
    return section, plan_scan(section, PROFILE)


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

"""Coverage of any section: shapely as the oracle of what beads cover, on sections of every sort."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely
from section_zoo import ZOO
from shapely import affinity

from ebamcheck.geometry.raster import bare_samples
from ebamcheck.geometry.regions import ARC_SEGMENTS, JOIN_MM
from ebamcheck.scan import plan_scan
from ebamcheck.scan.filling.fill import (
    LEAST_SPOT,
    bare_spots,
    gap_beads,
    spot_widths_mm,
    spots_to_close,
)
from ebamcheck.scan.islands.regions import CRUMB, layer_regions
from ebamcheck.settings.config import Config

PROFILE = Config().changed(scan={"order": "raster"}, process={"interpass": "off"})
"""What is covered does not hang on the order, and this one takes no heat model."""

WIDTH, SPACING = PROFILE.process.bead_width_mm, PROFILE.process.hatch_spacing_mm
LAYER = 3
"""A layer whose cells are shifted and turned."""


@pytest.fixture(scope="module", params=ZOO, ids=list(ZOO))
def planned(request):
    section = shapely.union_all([ZOO[request.param]])
    return section, plan_scan(section, PROFILE, layer=LAYER)


def lines_of(plan):
    return shapely.linestrings(plan.vectors[["x0", "y0", "x1", "y1"]].to_numpy().reshape(-1, 2, 2))


def beads_of(plan):
    borders = shapely.get_parts(shapely.boundary(plan.contours))
    return shapely.union_all(shapely.buffer([*lines_of(plan), *borders], WIDTH / 2, quad_segs=16))


def widest(region):
    spots = [p for p in shapely.get_parts(region) if p.area > LEAST_SPOT * WIDTH**2]
    return spot_widths_mm(spots).max(initial=0.0)


# -- laws of any section -------------------------------------------------------------------------------


@pytest.mark.in_turn(3)
def test_at_least_98_percent_are_covered_and_no_spot_is_wider_than_set(planned):
    section, plan = planned
    bare = section.difference(beads_of(plan))
    covered = 1.0 - bare.area / section.area
    assert covered >= PROFILE.scan.least_coverage == 0.98
    assert plan.metrics["covered_fraction"][0] == pytest.approx(covered, abs=0.003)
    # Chords of the round ends and the spot's cut on the grid blur its width by some hundredths.
    assert widest(bare) <= PROFILE.scan.gap_width * WIDTH + 0.02
    assert plan.metrics["widest_gap_mm"][0] <= PROFILE.scan.gap_width * WIDTH


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
    assert shapely.union_all(plan.islands).area == pytest.approx(plan.island_area_mm2.sum(), rel=1e-6)


@pytest.mark.in_turn(3)
def test_beads_do_not_pile_up(planned):
    section, plan = planned
    # A bead covers its spacing; where a wall is narrower, no less than one bead can be laid: what it spills
    # over the border counts with the area. Round ends and walls of a bead and a bit cost the rest.
    spilled = shapely.union_all([section, beads_of(plan)]).area
    laid = plan.metrics["laid_share"][0] * section.area
    assert laid <= 1.3 * spilled


@pytest.mark.in_turn(3)
def test_gap_beads_are_few_against_the_others(planned):
    section, plan = planned
    length = shapely.length(lines_of(plan))
    gaps = length[plan.island_kind[plan.vectors["island"]] == "gap"].sum()
    # Islands of metal of a few beads are mostly corners: a square of 7 mm has 4 mm of contour bead.
    small = min(part.area for part in shapely.get_parts(section)) < 9.0 * WIDTH**2
    assert gaps <= (0.6 if small else 0.1) * (length.sum() + plan.contours[0].length)


@pytest.mark.in_turn(3)
def test_bare_walls_are_what_no_contour_bead_can_go_around(planned):
    section, plan = planned
    reached = plan.contours[0].buffer(WIDTH / 2 + JOIN_MM, quad_segs=ARC_SEGMENTS)
    least_mm2 = CRUMB * WIDTH**2
    left = [p for p in shapely.get_parts(section.difference(reached)) if p.area >= least_mm2]
    alone = [p for p in shapely.get_parts(section) if p.area < least_mm2]
    walls = layer_regions(section, PROFILE).bare_walls
    assert shapely.area(walls).sum() == pytest.approx(shapely.area([*left, *alone]).sum(), rel=1e-9)


# -- spots ---------------------------------------------------------------------------------------------


def corner_spots(section, segments):
    return bare_spots(section, bare_samples(section, segments, WIDTH), segments, WIDTH)


@pytest.mark.parametrize("turn", [0.0, 20.0, 45.0])
def test_spots_of_a_square_contour_are_its_four_corners(turn):
    square = affinity.rotate(shapely.box(0, 0, 10, 10), turn)
    ring = shapely.get_coordinates(affinity.rotate(shapely.box(3, 3, 7, 7), turn))
    spots = corner_spots(square, np.hstack([ring[:-1], ring[1:]]))
    assert len(spots) == 4
    tip = (1.0 - math.pi / 4) * 3.0**2
    assert [spot.area for spot in spots] == pytest.approx([tip] * 4, rel=0.02)
    # The circle that touches both sides and the bead's end: (R + r) / R = sqrt 2 of its depth, doubled.
    across = 2.0 * 3.0 * (math.sqrt(2) - 1) / (math.sqrt(2) + 1)
    assert spot_widths_mm(spots) == pytest.approx(across, abs=0.02)


def test_spots_are_those_of_shapely():
    rng = np.random.default_rng(3)
    section = shapely.union_all([ZOO["gear"]])
    segments = rng.uniform(-90, 90, (150, 4))
    beads = shapely.union_all(shapely.buffer(shapely.linestrings(segments.reshape(-1, 2, 2)), WIDTH / 2))
    exact = [p for p in shapely.get_parts(section.difference(beads)) if p.area > LEAST_SPOT * WIDTH**2]
    found = corner_spots(section, segments)
    assert sum(p.area for p in found) == pytest.approx(sum(p.area for p in exact), rel=0.01)


def test_wide_spots_are_closed_and_narrow_ones_only_while_coverage_is_missing():
    spots = [shapely.box(10 * k, 0, 10 * k + size, size) for k, size in enumerate([1.0, 2.0, 0.5])]
    chosen, left = spots_to_close(spots, 1.5, 1000.0, 0.99, 0.98)
    assert (chosen, left) == ([spots[1]], pytest.approx(1.0, abs=1e-3))
    chosen, left = spots_to_close(spots, 1.5, 100.0, 0.94, 0.98)
    assert (chosen, left) == ([spots[1], spots[0]], pytest.approx(0.5, abs=1e-3))
    assert spots_to_close([], 1.5, 100.0, 0.5, 0.98) == ([], 0.0)


@pytest.mark.parametrize(
    "spot",
    [
        shapely.Polygon([(0, 0), (2, 0), (0, 2)]),
        shapely.box(20, 20, 50, 21.5),
        shapely.LineString([(20, 20), (40, 20), (40, 40)]).buffer(0.8, cap_style="flat"),
        shapely.MultiLineString([[(12, 45), (44, 45)], [(28, 45), (28, 58)]]).buffer(0.8, cap_style="flat"),
        shapely.Point(30, 30).buffer(1.4),
    ],
    ids=["tip", "slit", "bent slit", "fork", "round"],
)
def test_a_gap_bead_covers_its_spot_within_the_section_and_beside_the_islands(spot):
    section = shapely.box(0, 0, 60, 60)
    islands = np.array([shapely.box(5, 25, 55, 35)], object)
    beads, island, polygons = gap_beads([spot], section, islands, WIDTH, SPACING)
    lines = shapely.union_all(beads)
    assert spot.difference(lines.buffer(WIDTH / 2)).area <= 0.02 * spot.area
    assert section.covers(lines)
    homes = np.concatenate([islands, polygons])[island]
    assert shapely.covers(shapely.buffer(homes, 1e-9), beads).all()
    together = shapely.union_all([*islands, *polygons])
    assert together.area == pytest.approx(shapely.area([*islands, *polygons]).sum(), rel=1e-9)


def test_gaps_are_left_where_the_settings_say_so():
    wedge = ZOO["triangle of 15.0 mm"]
    bare = PROFILE.changed(scan={"gap_width": 2.0, "least_coverage": 0.5})
    assert "gap" in plan_scan(wedge, PROFILE).island_kind
    plan = plan_scan(wedge, bare)
    assert "gap" not in plan.island_kind
    assert plan.metrics["widest_gap_mm"][0] == pytest.approx(
        widest(wedge.difference(beads_of(plan))), abs=0.03
    )


def test_gaps_turn_with_the_part():
    section = shapely.union_all([ZOO["sharp star"]])
    turned = affinity.translate(affinity.rotate(section, 24.0, origin=(0, 0)), 70.0, -20.0)
    one, two = (plan_scan(s, PROFILE).metrics["covered_fraction"][0] for s in (section, turned))
    assert one == pytest.approx(two, abs=0.004)

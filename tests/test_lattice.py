"""Lattices of hexagons, squares and stripes: closed forms, laws, and where their cells lie from layer to layer."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely import affinity

from ebamcheck.errors import GeometryError, SettingsError
from ebamcheck.scan import plan_scan
from ebamcheck.scan.islands.clipping import shared_borders
from ebamcheck.scan.islands.lattice import (
    BEADS_ACROSS,
    LATTICES,
    Rectangle,
    hexagon_lattice,
    hexagons_across,
    layer_place,
    minimum_rectangle,
    planned_side_mm,
    rectangle_along,
    shift_shares,
    square_lattice,
    stripe_lattice,
)
from ebamcheck.settings.config import Config

ROOT3 = math.sqrt(3.0)


def turned(points, angle, about=(0.0, 0.0)):
    c, s = math.cos(angle), math.sin(angle)
    return (np.asarray(points, float) - about) @ np.array([[c, s], [-s, c]]) + about


def box(width, height):
    return np.array([(0, 0), (width, 0), (width, height), (0, height)], float)


@pytest.mark.parametrize("angle", np.linspace(0.0, math.pi, 13)[:-1])
def test_rectangle_of_a_turned_box_is_the_box(angle):
    found = minimum_rectangle(turned(box(30.0, 70.0), angle) + np.array([500.0, -40.0]))
    assert (found.short_mm, found.long_mm) == pytest.approx((30.0, 70.0), abs=1e-9)
    assert math.remainder(found.angle_rad - angle, math.pi) == pytest.approx(0.0, abs=1e-9)
    assert 0.0 <= found.angle_rad < math.pi
    assert (found.x_mm, found.y_mm) == pytest.approx(tuple(turned([[15.0, 35.0]], angle)[0] + [500, -40]))


@settings(max_examples=60, deadline=None)
@given(st.integers(3, 60), st.integers(0, 10_000))
def test_exact_rectangle_is_the_least_over_all_hull_edges(count, seed):
    points = np.random.default_rng(seed).normal(size=(count, 2)) * [40.0, 15.0]
    found = minimum_rectangle(points)
    hull = shapely.get_coordinates(shapely.MultiPoint(points).convex_hull)
    areas = []
    for a, b in itertools.pairwise(hull):
        direction = turned(points, -math.atan2(*(b - a)[::-1]))
        areas.append(np.prod(np.ptp(direction, axis=0)))
    assert found.area_mm2 == pytest.approx(min(areas), rel=1e-9)
    assert found.area_mm2 <= shapely.MultiPoint(points).minimum_rotated_rectangle.area * (1 + 1e-9)
    assert found.polygon().buffer(1e-9).covers(shapely.MultiPoint(points))


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000))
def test_paper_rectangle_is_the_least_of_equation_11(seed):
    points = np.random.default_rng(seed).normal(size=(25, 2)) * [40.0, 15.0]
    found = minimum_rectangle(points, "paper")
    areas = [np.prod(np.ptp(turned(points, -i * math.pi / 10), axis=0)) for i in range(11)]
    assert found.area_mm2 == pytest.approx(min(areas), rel=1e-12)
    assert found.area_mm2 >= minimum_rectangle(points).area_mm2 * (1 - 1e-12)
    assert found.polygon().buffer(1e-9).covers(shapely.MultiPoint(points))


@pytest.mark.parametrize("points", [np.zeros((0, 2)), [[0.0, math.nan]]])
def test_rectangle_of_nothing_is_an_error(points):
    with pytest.raises(GeometryError, match="minimum rectangle"):
        minimum_rectangle(points)


@given(st.floats(0.5, 200.0))
def test_hexagons_across_is_odd_and_one_or_two_over_the_ratio(ratio):
    count = hexagons_across(ratio, 1.0)
    assert count % 2 == 1
    assert math.floor(ratio + 0.5) + 1 <= count <= math.floor(ratio + 0.5) + 2


def test_centres_lie_as_the_paper_says():
    d = 7.0
    rectangle = Rectangle(0.0, 0.0, 0.0, 60.0, 150.0)
    lattice = hexagon_lattice(rectangle, d)
    across = hexagons_across(60.0, d)
    rows = lattice.centres.reshape(-1, across, 2)
    assert np.abs(rows[0] - [0.0, -75.0]).sum(axis=1).min() == pytest.approx(0.0, abs=1e-12)
    assert np.diff(rows[:, :, 0], axis=1) == pytest.approx(ROOT3 * d)
    assert np.diff(rows[:, 0, 1]) == pytest.approx(1.5 * d)
    assert rows[0, 0, 0] == pytest.approx(-rows[0, -1, 0])
    shift = rows[1:, :, 0] - rows[:-1, :, 0]
    assert np.abs(shift) == pytest.approx(ROOT3 * d / 2)
    assert rows[2, :, 0] == pytest.approx(rows[0, :, 0])


def test_hexagons_tile_and_no_two_neighbours_have_one_colour():
    d = 4.0
    lattice = hexagon_lattice(Rectangle(1.0, 2.0, 0.3, 30.0, 47.0), d)
    assert shapely.area(lattice.cells) == pytest.approx(1.5 * ROOT3 * d**2)
    assert shapely.union_all(lattice.cells, grid_size=1e-9).area == pytest.approx(
        1.5 * ROOT3 * d**2 * len(lattice.cells), rel=1e-6
    )
    pairs, border = shared_borders(lattice.cells)
    assert border == pytest.approx(d)
    assert (lattice.colour[pairs[:, 0]] != lattice.colour[pairs[:, 1]]).all()
    assert np.bincount(pairs.ravel()).max() == 6
    corners = {tuple(c) for h in lattice.cells for c in shapely.get_coordinates(h)[:-1].tolist()}
    rounded = {tuple(np.round(c, 6)) for c in corners}
    assert len(corners) == len(rounded), "neighbours share their corners to the last bit"


def test_planned_side_holds_whole_beads_and_grows_with_the_area():
    spacing = 4.32
    sides = [planned_side_mm(area, 0.0, spacing) for area in np.geomspace(1.0, 1e7, 60)]
    beads = np.array(sides) * ROOT3 / spacing
    assert beads == pytest.approx(np.round(beads))
    assert (np.diff(sides) >= 0).all()
    assert (round(beads.min()), round(beads.max())) == BEADS_ACROSS
    thin = planned_side_mm(30_000.0, 3_500.0, spacing)
    assert thin < planned_side_mm(30_000.0, 800.0, spacing)


def test_a_mistyped_side_is_refused():
    with pytest.raises(SettingsError, match="hexagon_side_mm"):
        hexagon_lattice(Rectangle(0.0, 0.0, 0.0, 200.0, 300.0), 0.05)


# -- cells from layer to layer ------------------------------------------------------------------------------


PROFILE = Config()
LAID = PROFILE.changed(scan={"order": "raster"}, process={"interpass": "off"})
"""For what is asked of cells alone: they do not hang on the order, and this one takes no heat model."""

PAPER = PROFILE.changed(scan={"lattice_angle_deg": 0.0, "lattice_shift": False})
WIDTH = PROFILE.process.bead_width_mm
PLATE = shapely.box(0, 0, 220, 140)
CORNERS = shapely.get_coordinates(PLATE)
LAYERS = 24
APART = 6
"""Layers below each with which it is compared line by line."""


def with_partition(name, base=PROFILE):
    return base.changed(scan={"partition": name})


def inner_borders(plan):
    """Borders between islands, away from the contour."""
    return shapely.union_all(shapely.boundary(plan.islands)).intersection(PLATE.buffer(-WIDTH))


# -- from layer to layer -------------------------------------------------------------------------------


@pytest.fixture(scope="module", params=list(LATTICES))
def stacked(request):
    config = with_partition(request.param, LAID)
    plans = [plan_scan(PLATE, config, layer=k) for k in range(LAYERS)]
    return request.param, plans


def test_borders_do_not_stack_on_a_line(stacked):
    name, plans = stacked
    borders = [shapely.line_merge(inner_borders(plan)) for plan in plans]
    unturned = with_partition(name, LAID.changed(scan={"lattice_angle_deg": 0.0, "lattice_shift": False}))
    fixed = inner_borders(plan_scan(PLATE, unturned, layer=7))
    assert fixed.equals_exact(inner_borders(plan_scan(PLATE, unturned, layer=0)), 1e-9)
    # Crossing borders have points in common: a tenth of a millimetre at each.
    for k, border in enumerate(borders):
        line = shapely.buffer(border, 0.05, quad_segs=1)
        shapely.prepare(line)
        for other in borders[max(0, k - APART) : k]:
            places = shapely.line_interpolate_point(other, np.linspace(0.0, other.length, 500))
            assert shapely.covers(line, places).mean() < 0.1


def test_no_place_is_a_border_in_more_layers_than_chance_has_it(stacked):
    _, plans = stacked
    rng = np.random.default_rng(0)
    places = shapely.points(rng.uniform([10, 10], [210, 130], (3000, 2)))
    hit = np.stack([shapely.distance(inner_borders(plan), places) < 1.0 for plan in plans])
    share = hit.mean()
    # Of so many places the most unlucky one, if layers were independent: five standard deviations.
    most = LAYERS * share + 5.0 * math.sqrt(LAYERS * share * (1.0 - share))
    assert hit.sum(axis=0).max() <= most < 0.75 * LAYERS
    over_below = (hit[1:] & hit[:-1]).sum() / hit[1:].sum()
    assert over_below < 1.4 * share, "a border over a border below is no more common than anywhere"


def test_the_lowest_layer_is_that_of_the_paper():
    one, two = plan_scan(PLATE, PROFILE, layer=0), plan_scan(PLATE, PAPER, layer=9)
    assert np.array_equal(shapely.to_wkb(one.islands), shapely.to_wkb(two.islands))


@pytest.mark.in_turn(5, 1)
@pytest.mark.parametrize("layer", [0, 1, 2, 5, 17, 100])
@pytest.mark.parametrize("name", list(LATTICES))
def test_cells_cover_the_section_wherever_they_lie(name, layer):
    section = affinity.rotate(shapely.box(0, 0, 91, 33).union(shapely.Point(0, 0).buffer(31)), 12)
    for side in (7.0, 19.0, 60.0):
        place = layer_place(shapely.get_coordinates(section), side, PROFILE, layer)
        lattice = LATTICES[name](place, side)
        assert section.difference(shapely.union_all(lattice.cells, grid_size=1e-9)).area < 1e-6
        assert shapely.area(lattice.cells).sum() < 12 * (section.area + 40 * side**2), "and not much more"


def test_the_place_turns_by_the_angle_and_shifts_by_the_shares():
    smallest = minimum_rectangle(CORNERS)
    turned = layer_place(CORNERS, 9.0, PROFILE.changed(scan={"lattice_shift": False}), 2)
    assert turned.angle_rad == pytest.approx(smallest.angle_rad + math.radians(74.0))
    assert (turned.x_mm, turned.y_mm) == pytest.approx((110.0, 70.0))
    moved = layer_place(CORNERS, 9.0, PROFILE.changed(scan={"lattice_angle_deg": 0.0}), 2)
    plain, other = hexagon_lattice(smallest, 9.0), hexagon_lattice(moved, 9.0)
    step = np.array(rectangle_frame(smallest, other.centres[0] - plain.centres[0]))
    first, second = shift_shares(2)
    periods = (step - [(first - 0.5) * math.sqrt(3) * 9.0, -second * 27.0]) / [math.sqrt(3) * 9.0, 27.0]
    assert periods == pytest.approx(np.round(periods), abs=1e-9)


def rectangle_frame(rectangle, way):
    c, s = math.cos(rectangle.angle_rad), math.sin(rectangle.angle_rad)
    return c * way[0] + s * way[1], -s * way[0] + c * way[1]


def test_a_rectangle_along_a_direction_holds_the_points_tightly():
    points = np.random.default_rng(2).normal(size=(50, 2)) * [30.0, 8.0]
    for angle in (0.0, 0.4, 2.0, 5.0):
        found = rectangle_along(points, angle).polygon()
        assert found.buffer(1e-9).covers(shapely.MultiPoint(points))
        assert (shapely.distance(shapely.get_rings(found), shapely.MultiPoint(points)) < 1e-9).all()
        flat = affinity.rotate(shapely.MultiPoint(points), -angle, origin=(0, 0), use_radians=True)
        assert found.area == pytest.approx(shapely.box(*flat.bounds).area)


# -- baselines -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("lay", [square_lattice, stripe_lattice])
def test_squares_and_stripes_tile_and_alternate(lay):
    rectangle = Rectangle(5.0, 1.0, 0.3, 70.0, 131.0)
    lattice = lay(rectangle, 6.0)
    union = shapely.union_all(lattice.cells, grid_size=1e-9)
    assert rectangle.polygon().difference(union).area < 1e-6
    assert union.area == pytest.approx(shapely.area(lattice.cells).sum())
    sides = shapely.area(lattice.cells) / lattice.width_mm
    assert sides == pytest.approx(lattice.width_mm if lay is square_lattice else 70.0)
    pairs, _ = shared_borders(lattice.cells)
    assert (lattice.colour[pairs[:, 0]] != lattice.colour[pairs[:, 1]]).all()
    assert shapely.get_coordinates(shapely.centroid(lattice.cells)) == pytest.approx(lattice.centres)


# -- degenerate layers ---------------------------------------------------------------------------------


def square(x, y, size):
    return shapely.box(x, y, x + size, y + size)


DEGENERATE = {
    "smaller than a hexagon": square(0, 0, 14.0),
    "ring thinner than a bead": shapely.Point(0, 0).buffer(40).difference(shapely.Point(0, 0).buffer(39)),
    "five hundred specks": shapely.union_all([square(4 * i, 4 * j, 2.0) for i in range(25) for j in range(20)]),
    "squares that touch at corners": shapely.MultiPolygon([square(0, 0, 40), square(40, 40, 40)]),
    "boxes with a common side": [square(0, 0, 40), square(40, 0, 40)],
    "collinear points": shapely.segmentize(square(0, 0, 60), 0.5),
    "a hole that touches the border": shapely.Polygon(
        [(0, 0), (80, 0), (80, 60), (0, 60)], [[(0, 30), (20, 40), (20, 20)]]
    ),
    "a slit of no width": shapely.Polygon([(0, 0), (80, 0), (80, 60), (40, 60), (40, 20), (40, 60), (0, 60)]),
    "a hair": shapely.box(0, 0, 100, 1e-6),
}


@pytest.mark.in_turn(3)
@pytest.mark.parametrize("name", ["hexagons", "squares", "stripes", "whole"])
@pytest.mark.parametrize("case", DEGENERATE, ids=list(DEGENERATE))
def test_degenerate_layers_are_planned_soundly(case, name):
    given = DEGENERATE[case]
    # An order knows of cells, not of how they were cut: the one by heat is asked for once.
    config = with_partition(name, PROFILE if name == "hexagons" else LAID)
    plan = plan_scan(given, config, layer=5)
    row = plan.metrics.iloc[0]
    assert row["covered_fraction"] >= 0.98
    assert np.isfinite(row[["area_mm2", "hatch_length_mm", "time_s", "laid_share"]].to_numpy(float)).all()
    assert np.array_equal(np.sort(plan.order), np.arange(len(plan.islands)))
    assert len(plan.islands) == 0 or np.unique(plan.vectors["island"]).size == len(plan.islands)

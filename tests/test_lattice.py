"""The smallest rectangle and the hexagons laid over it: closed forms, laws and independent oracles."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from ebamcheck.errors import GeometryError, SettingsError
from ebamcheck.scan.islands.clipping import shared_borders
from ebamcheck.scan.islands.lattice import (
    BEADS_ACROSS,
    Rectangle,
    hexagon_lattice,
    hexagons_across,
    minimum_rectangle,
    planned_side_mm,
)

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


def test_calipers_hold_on_a_dense_circle_with_runs_of_equal_points():
    angle = np.linspace(0, 2 * math.pi, 3000)
    circle = np.repeat(np.column_stack([np.cos(angle), np.sin(angle)]) * 50.0, 2, axis=0)
    found = minimum_rectangle(circle)
    assert (found.short_mm, found.long_mm) == pytest.approx((100.0, 100.0), rel=1e-5)


def test_rectangle_without_area():
    assert minimum_rectangle([[3.0, 4.0]]).area_mm2 == 0.0
    line = minimum_rectangle([[0.0, 0.0], [1.0, 1.0], [3.0, 3.0]])
    assert line.long_mm == pytest.approx(3 * math.sqrt(2))
    assert line.short_mm == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("points", [np.zeros((0, 2)), [[0.0, math.nan]]])
def test_rectangle_of_nothing_is_an_error(points):
    with pytest.raises(GeometryError, match="minimum rectangle"):
        minimum_rectangle(points)


@pytest.mark.parametrize(
    ("short", "expected"), [(100.0, 11), (104.9, 11), (105.0, 13), (110.0, 13), (114.9, 13), (120.0, 13)]
)
def test_odd_and_even_rule_of_the_paper(short, expected):
    # round(L1/d) + 1 = 11 is odd and stays; 12 is even and becomes 13; 13 is odd again.
    assert hexagons_across(short, 10.0) == expected


@given(st.floats(0.5, 200.0))
def test_hexagons_across_is_odd_and_one_or_two_over_the_ratio(ratio):
    count = hexagons_across(ratio, 1.0)
    assert count % 2 == 1
    assert math.floor(ratio + 0.5) + 1 <= count <= math.floor(ratio + 0.5) + 2


@pytest.mark.in_turn(3)
@pytest.mark.parametrize("short", [0.1, 0.4, 0.6, 1.4, 1.6, 2.5, 5.0, 6.0, 9.3, 10.6])
@pytest.mark.parametrize("long", [0.0, 0.4, 0.6, 2.0, 2.1, 7.7, 15.5])
@pytest.mark.parametrize("angle", [0.0, 0.7])
def test_lattice_covers_the_whole_rectangle(short, long, angle):
    rectangle = Rectangle(3.0, -8.0, angle, short, max(short, long))
    lattice = hexagon_lattice(rectangle, 1.0)
    union = shapely.union_all(lattice.cells, grid_size=1e-9)
    assert rectangle.polygon().difference(union).area == pytest.approx(0.0, abs=1e-8)


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


def test_lattice_turns_with_the_part():
    points = np.random.default_rng(3).normal(size=(40, 2)) * [20.0, 60.0]
    angle, about = 0.4, (12.0, -7.0)
    first = minimum_rectangle(points)
    second = minimum_rectangle(turned(points, angle, about))
    assert first.angle_rad + angle < math.pi, "the seed gives a direction that does not wrap around"
    one, two = hexagon_lattice(first, 9.0), hexagon_lattice(second, 9.0)
    assert turned(one.centres, angle, about) == pytest.approx(two.centres, abs=1e-8)
    assert np.array_equal(one.colour, two.colour)


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

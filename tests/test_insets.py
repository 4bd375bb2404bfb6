"""Insets: held against distances, made another way where GEOS loses one, and found again by who checks a program."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
import shapely.affinity

from ebamcheck.geometry.regions import eroded, is_inset, valid_polygons
from ebamcheck.nc.roles import depth_lines, inside

LOST = shapely.Polygon(
    [(-1.81, 8.08), (-0.44, 1.97), (0.51, 0.07), (37.85, 4.92), (39.55, 6.09), (38.77, 7.69), (-0.28, 8.76)]
)
"""A bar whose inset by 3 mm GEOS 3.14.1 loses: it takes the seven moved sides for turned over."""
DUMBBELL = shapely.union_all([shapely.box(0, 0, 20, 20), shapely.box(19, 8, 41, 12), shapely.box(40, 4, 52, 16)])
SHAPES = {
    "bar": LOST,
    "dumbbell": DUMBBELL,
    "ring": shapely.Point(0, 0).buffer(30, 64).difference(shapely.Point(4, 0).buffer(9, 32)),
    "two": shapely.union_all([shapely.box(0, 0, 20, 10), shapely.Point(50, 5).buffer(12, 16)]),
    "holes": shapely.box(0, 0, 90, 60).difference(shapely.MultiPoint([(20, 20), (60, 25), (45, 45)]).buffer(8)),
}


def by_sides(region, distance_mm):
    """The inset by widening every side of the border."""
    rings = [r for p in shapely.get_parts(region) for r in (p.exterior, *p.interiors)]
    points = [shapely.get_coordinates(r) for r in rings]
    sides = shapely.linestrings(np.concatenate([np.stack([p[:-1], p[1:]], axis=1) for p in points]))
    return shapely.difference(region, shapely.union_all(shapely.buffer(sides, distance_mm, quad_segs=16)))


def chance_polygons(count, seed):
    rng = np.random.default_rng(seed)
    while count > 0:
        corners = int(rng.integers(3, 13))
        angle, radius = np.sort(rng.uniform(0, 2 * np.pi, corners)), rng.uniform(2, 30, corners)
        around = np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
        polygon = shapely.Polygon(around if rng.random() < 0.6 else rng.uniform(0, 40, (corners, 2)))
        if polygon.is_valid and polygon.area > 1.0:
            count -= 1
            yield polygon, float(rng.uniform(0.5, 6.0))


def test_the_inset_that_geos_loses_is_there():
    assert eroded(LOST, 3.0).area == pytest.approx(18.269, abs=0.2)
    assert eroded(LOST, 3.0).area == pytest.approx(by_sides(LOST, 3.0).area, rel=1e-3)
    both = shapely.union_all([LOST, shapely.box(60, 0, 80, 20)])
    assert len(valid_polygons(eroded(both, 3.0))) == 2


def test_insets_of_chance_polygons_are_those_of_their_sides():
    for polygon, distance_mm in chance_polygons(300, 11):
        found, true = eroded(polygon, distance_mm), by_sides(polygon, distance_mm)
        off = shapely.symmetric_difference(found, true).area
        assert off <= 0.03 * distance_mm * (1.0 + true.length), polygon.wkt


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize(("share", "good"), [(0.97, False), (0.995, True), (1.0, True), (1.005, True), (1.05, False)])
def test_an_inset_by_another_distance_is_none(name, share, good):
    assert is_inset(by_sides(SHAPES[name], 3.0 * share), SHAPES[name], 3.0) == good


def test_an_inset_that_lacks_a_piece_or_lies_elsewhere_is_none():
    whole = by_sides(DUMBBELL, 3.0)
    parts = valid_polygons(whole)
    assert len(parts) == 2
    assert is_inset(whole, DUMBBELL, 3.0)
    for part in parts:
        assert not is_inset(part, DUMBBELL, 3.0)
    assert not is_inset(shapely.Polygon(), DUMBBELL, 3.0)
    assert not is_inset(shapely.union_all([whole, shapely.box(70, 0, 80, 9)]), DUMBBELL, 3.0)
    assert is_inset(shapely.Polygon(), shapely.box(0, 0, 40, 5.9), 3.0)
    holes = SHAPES["holes"]
    assert not is_inset(shapely.box(3, 3, 87, 57), holes, 3.0)


@pytest.mark.parametrize("fold_mm", [1e-12, -1e-12, 1e-9, 1e-8])
@pytest.mark.parametrize("distance_mm", [0.05, 0.5, 3.0])
def test_a_border_that_folds_back_on_itself_within_rounding_has_an_inset(fold_mm, distance_mm):
    """A side of the hole runs there, back and there again, as the union of bodies that touch leaves it."""
    hole = [(5, 5), (15, 5), (15, 14), (15 + fold_mm, 7), (15 + 2.0 * fold_mm, 14.5), (15, 15), (5, 15)]
    plate = shapely.affinity.rotate(shapely.Polygon(shapely.box(0, 0, 40, 30).exterior, [hole]), 32.05, origin=(0, 0))
    whole = by_sides(plate, distance_mm)
    assert is_inset(whole, plate, distance_mm)
    assert shapely.symmetric_difference(eroded(plate, distance_mm), whole).area < 1e-2 * distance_mm
    assert not is_inset(by_sides(plate, 1.05 * distance_mm), plate, distance_mm)
    lacking = whole.difference(shapely.Point(whole.exterior.coords[0]).buffer(distance_mm))
    assert not is_inset(lacking, plate, distance_mm)


@pytest.mark.parametrize("sliver_mm", [1e-12, 1e-9, 1e-7])
def test_a_hole_without_width_has_an_inset(sliver_mm):
    plate = shapely.box(0, 0, 40, 30).difference(shapely.box(10, 10, 25, 10.0 + sliver_mm))
    assert shapely.get_num_interior_rings(plate) == 1
    for turned in (plate, shapely.affinity.rotate(plate, 57.8, origin=(0, 0))):
        assert eroded(turned, 0.06).area == pytest.approx(by_sides(turned, 0.06).area, rel=1e-6)


@pytest.mark.parametrize("name", SHAPES)
def test_lines_of_one_depth_are_the_border_of_the_inset(name):
    lines = depth_lines(SHAPES[name], 3.0)
    border = by_sides(SHAPES[name], 3.0).boundary
    places = shapely.points(shapely.get_coordinates(shapely.segmentize(border, 0.2)))
    drawn = shapely.multilinestrings(shapely.linestrings(lines.reshape(-1, 2, 2)))
    assert shapely.distance(drawn, places).max() <= 0.05
    assert shapely.distance(border, shapely.points(lines.reshape(-1, 2))).max() <= 0.05


@pytest.mark.parametrize("name", SHAPES)
def test_one_place_of_a_run_away_from_the_border_tells_whether_all_lie_inside(name):
    region = SHAPES[name]
    x0, y0, x1, y1 = region.bounds
    walk = np.cumsum(np.random.default_rng(5).normal(0.0, 0.8, (2000, 2)), axis=0)
    places = np.ascontiguousarray([x0, y0] + np.abs(walk) % [x1 - x0, y1 - y0])
    away = np.asarray(shapely.distance(shapely.points(places), shapely.boundary(region)))
    assert (inside(region, places, away) == shapely.intersects_xy(region, *places.T)).all()

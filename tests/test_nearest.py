"""The nearest segment, and distances of paths as shapes: those of trying all, and of GEOS bit by bit."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from ebamcheck.checks import matching
from ebamcheck.geometry.nearest import (
    distances,
    nearest,
    nearest_segment,
    segments_along,
    segments_of,
    signed_distance,
    tree_over,
)


@pytest.mark.parametrize("count", [1, 3, 4, 5, 33, 700])
def test_the_nearest_point_does_not_depend_on_the_guess(count):
    random = np.random.default_rng(count)
    points = np.cumsum(random.normal(size=(count + 1, 2)), axis=0)
    tree, line = tree_over(segments_along(points, False)), shapely.LineString(points)
    segments = shapely.linestrings(np.stack([points[:-1], points[1:]], axis=1))
    for x, y in random.normal(0.0, 10.0, (40, 2)):
        found = [nearest(tree, x, y, int(guess)) for guess in {-1, 0, count - 1, *random.integers(0, count, 5)}]
        exact = shapely.distance(line, shapely.Point(x, y))
        for one in found:
            assert one.distance == pytest.approx(exact, abs=1e-12)
            assert shapely.distance(segments[one.segment], shapely.Point(x, y)) == pytest.approx(exact, abs=1e-12)
            place = points[one.segment] + one.t * (points[one.segment + 1] - points[one.segment])
            assert np.hypot(*(place - [x, y])) == pytest.approx(exact, abs=1e-9)


def test_a_place_on_a_vertex_is_at_no_distance_from_any_guess():
    points = np.column_stack([np.arange(50.0), np.arange(50.0) % 2])
    tree = tree_over(segments_along(points, False))
    assert {nearest(tree, 17.0, 1.0, guess).distance for guess in range(49)} == {0.0}


@pytest.mark.parametrize("far_mm", [0.0, 250.0])
@pytest.mark.parametrize("count", [1, 4, 5, 37, 400])
def test_distances_are_those_of_geos(count, far_mm):
    random = np.random.default_rng(count)
    ends = far_mm + np.cumsum(3.0 * random.normal(size=(count + 1, 2)), axis=0)
    segments = np.hstack([ends[:-1], ends[1:]])
    segments[::7, 2:] = segments[::7, :2]  # some have no length
    places = random.uniform(ends.min() - 5.0, ends.max() + 5.0, (2000, 2))
    places[: count + 1] = ends  # on a vertex, and half-way
    places[count + 1 : 2 * count + 1] = 0.5 * (ends[1:] + ends[:-1])
    tree = shapely.STRtree(np.atleast_1d(shapely.linestrings(segments.reshape(-1, 2, 2))))
    _, wanted = tree.query_nearest(shapely.points(places), return_distance=True, all_matches=False)
    assert distances(places, segments).tolist() == wanted.tolist()


def test_segments_join_no_two_rings():
    region = shapely.box(0, 0, 10, 10).difference(shapely.box(3, 3, 6, 6)).union(shapely.box(20, 0, 30, 10))
    segments = segments_of(region.boundary)
    assert len(segments) == 12
    assert np.hypot(*(segments[:, 2:] - segments[:, :2]).T).sum() == pytest.approx(region.length)
    assert distances(np.array([[15.0, 5.0]]), segments) == pytest.approx([5.0])


def test_without_segments_nothing_is_near():
    assert np.isinf(distances(np.zeros((3, 2)), np.zeros((0, 4)))).all()
    assert nearest_segment(tree_over(np.zeros((0, 4))), 1.0, 2.0, -1) == (np.inf, -1)


def test_signed_distances_are_positive_outside_of_a_ring_that_runs_counter_clockwise():
    ring = shapely.Point(3.0, -2.0).buffer(5.0, quad_segs=7).difference(shapely.box(2.0, -2.0, 9.0, 9.0))
    ring = shapely.orient_polygons(ring)
    tree = tree_over(segments_along(shapely.get_coordinates(ring)[:-1], True))
    for x, y in np.random.default_rng(4).uniform(-6.0, 9.0, (300, 2)):
        signed = signed_distance(tree, x, y, nearest(tree, x, y, 0))
        away = shapely.distance(shapely.boundary(ring), shapely.Point(x, y))
        assert signed == pytest.approx(-away if shapely.contains_xy(ring, x, y) else away, abs=1e-12)


# -- the distance of two paths as shapes, against shapely's distance of every place -------------------------


def shape_distance(driven, wanted):
    """Distance of motions (A, n, 2), and of spans (E, m, 2)."""
    motion = np.repeat(np.arange(len(driven)), driven.shape[1])
    return matching.shape_distance(driven.reshape(-1, 2), motion, wanted.reshape(-1, 2))


def wavy(count, samples, shift=0.0, noise_mm=0.0, seed=0):
    """A closed wavy path as `count` motions of `samples` places each, which begins at a share of its way."""
    ends = shift + np.arange(count + 1) / count
    t = 2.0 * np.pi * (ends[:-1, None] + np.diff(ends)[:, None] * np.linspace(0.0, 1.0, samples))
    radius = 40.0 + 4.0 * np.sin(5.0 * t) + noise_mm * np.random.default_rng(seed).standard_normal(t.shape)
    return np.stack([radius * np.cos(t), radius * np.sin(t)], axis=-1)


def by_shapely(driven, wanted):
    """Distance of every motion both ways, each place of either path against the whole of the other."""
    path, target = (shapely.linestrings(np.reshape(way, (-1, 2))) for way in (driven, wanted))
    away = shapely.distance(shapely.points(driven), target).max(axis=1)
    places = shapely.points(np.reshape(wanted, (-1, 2)))
    missed = shapely.distance(places, path)
    motion = shapely.distance(places[:, None], shapely.linestrings(driven)).argmin(axis=1)
    np.maximum.at(away, motion, missed)
    return away


@pytest.mark.parametrize(
    ("noise_mm", "shift", "spans"), [(0.0, 0.0, 60), (1e-3, 0.37, 7), (0.5, 0.37, 60), (0.5, 0.0, 400)]
)
def test_the_farthest_place_is_that_of_every_place_looked_for(noise_mm, shift, spans):
    driven, wanted = wavy(90, 9, shift, noise_mm), wavy(spans, 17)
    found, expected = shape_distance(driven, wanted), by_shapely(driven, wanted)
    assert found.max() == pytest.approx(expected.max(), rel=1e-9)
    assert expected[found.argmax()] == pytest.approx(expected.max(), rel=1e-9)


@pytest.mark.parametrize("motion", [0, 41, 89])
def test_one_motion_that_leaves_the_way_is_found_where_it_is(motion):
    driven, wanted = wavy(90, 9), wavy(60, 17)
    driven[motion, 4] *= 1.05
    found = shape_distance(driven, wanted)
    assert found.argmax() == motion
    assert found.max() == pytest.approx(by_shapely(driven, wanted).max(), rel=1e-9)

"""Distances from sides are those of GEOS, bit by bit: the checks of a program read the same as with its search tree."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from ebamcheck.numeric.near_sides import side_distances, sides_of


@pytest.mark.parametrize("far_mm", [0.0, 250.0])
@pytest.mark.parametrize("count", [1, 4, 5, 37, 400])
def test_distances_are_those_of_geos(count, far_mm):
    random = np.random.default_rng(count)
    ends = far_mm + np.cumsum(3.0 * random.normal(size=(count + 1, 2)), axis=0)
    sides = np.hstack([ends[:-1], ends[1:]])
    sides[::7, 2:] = sides[::7, :2]  # some have no length
    places = random.uniform(ends.min() - 5.0, ends.max() + 5.0, (2000, 2))
    places[: count + 1] = ends  # on a vertex, and half-way
    places[count + 1 : 2 * count + 1] = 0.5 * (ends[1:] + ends[:-1])
    tree = shapely.STRtree(np.atleast_1d(shapely.linestrings(sides.reshape(-1, 2, 2))))
    _, wanted = tree.query_nearest(shapely.points(places), return_distance=True, all_matches=False)
    assert side_distances(places, sides).tolist() == wanted.tolist()


def test_sides_join_no_two_rings():
    region = shapely.box(0, 0, 10, 10).difference(shapely.box(3, 3, 6, 6)).union(shapely.box(20, 0, 30, 10))
    sides = sides_of(region.boundary)
    assert len(sides) == 12
    assert np.hypot(*(sides[:, 2:] - sides[:, :2]).T).sum() == pytest.approx(region.length)
    assert side_distances(np.array([[15.0, 5.0]]), sides) == pytest.approx([5.0])


def test_without_sides_nothing_is_near():
    assert np.isinf(side_distances(np.zeros((3, 2)), np.zeros((0, 4)))).all()

"""The distance of two paths as shapes, against shapely's distance of every place."""

import numpy as np
import pytest
import shapely

from ebamcheck.checks import matching


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


@pytest.mark.parametrize("noise_mm", [0.0, 1e-3, 0.5])
@pytest.mark.parametrize("shift", [0.0, 0.37])
@pytest.mark.parametrize("spans", [7, 60, 400])
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


@pytest.mark.parametrize("lost", [0, 200, 350])
def test_a_stretch_that_is_not_driven_is_found_by_the_way_back(lost):
    wanted = wavy(400, 9)
    driven = np.delete(wanted, np.arange(lost, lost + 50), axis=0)
    found = shape_distance(driven, wanted)
    assert found.max() == pytest.approx(by_shapely(driven, wanted).max(), rel=1e-9)
    assert found.max() > 1.0


def test_paths_against_the_same_way_driven_backwards_and_places_that_jump():
    wanted = wavy(120, 9)
    assert shape_distance(wanted[::-1, ::-1], wanted).max() == pytest.approx(0.0, abs=1e-12)
    jumping = np.random.default_rng(1).permutation(wanted)
    expected = by_shapely(jumping, wanted).max()
    assert shape_distance(jumping, wanted).max() == pytest.approx(expected, abs=1e-9)

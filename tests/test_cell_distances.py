"""Distances between cells, against those of SciPy; and what depends on them."""

import numpy as np
import pytest
from scipy import ndimage

from ebamcheck.metal.target import border_distance, moved_to_neighbours


def masks():
    """Masks of many shapes, from single rows to blobs."""
    rng = np.random.default_rng(7)
    for _ in range(60):
        shape = tuple(rng.integers(1, 40, 2))
        yield rng.random(shape) < rng.random() ** 0.3
        yield np.kron(rng.random((5, 6)) < 0.7, np.ones(shape)).astype(bool)[:50, :50]


def test_distances_are_those_of_scipy_to_the_last_bit():
    for cells in masks():
        if not cells.all():
            assert np.array_equal(border_distance(cells), ndimage.distance_transform_edt(cells))


def test_without_a_border_the_distance_is_endless():
    assert np.isinf(border_distance(np.ones((3, 4), bool))).all()


def test_values_move_to_the_nearest_cell_that_touches():
    rng = np.random.default_rng(8)
    for to in masks():
        field, moved = rng.random(to.shape), ~to & (rng.random(to.shape) < 0.5)
        found = np.zeros(to.shape)
        moved_to_neighbours(found, field, moved, to)
        touching = ndimage.binary_dilation(to, np.ones((3, 3)))
        assert found.sum() == pytest.approx(field[moved & touching].sum(), abs=1e-9)
        assert not found[~to].any()


def test_a_side_is_nearer_than_a_corner():
    to = np.array([[True, False, False], [False, False, True], [False, False, False]])
    found, moved = np.zeros((3, 3)), np.zeros((3, 3), bool)
    moved[1, 1] = True
    moved_to_neighbours(found, np.full((3, 3), 5.0), moved, to)
    assert found[1, 2] == 5.0
    assert found.sum() == 5.0

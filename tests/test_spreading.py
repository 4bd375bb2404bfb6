"""Spreading by a Gaussian: what is spread stays, alike in all directions, and by the filter of others to the last bit."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from ebamcheck.metal.spreading import gaussian_weights, spread_by

SIGMAS = (0.1, 0.5, 1.5, 3.0, 3.7)


@pytest.mark.parametrize("sigma", SIGMAS)
@pytest.mark.parametrize("shape", [(1, 1), (3, 50), (50, 3), (17, 29), (64, 40)])
def test_it_is_the_filter_of_scipy(sigma, shape):
    rng = np.random.default_rng(7)
    field = np.where(rng.random(shape) < 0.3, 0.0, rng.normal(size=shape))
    expected = ndimage.gaussian_filter(field, sigma, mode="constant")
    assert spread_by(field, gaussian_weights(sigma)).tobytes() == expected.tobytes()


@pytest.mark.parametrize("sigma", SIGMAS)
def test_weights_of_both_sides_add_up_to_one(sigma):
    weights = gaussian_weights(sigma)
    assert (np.diff(weights) > 0.0).all()
    assert 2.0 * weights[:-1].sum() + weights[-1] == pytest.approx(1.0, abs=1e-15)


def test_what_is_spread_stays_and_is_as_wide_as_it_should_be():
    field = np.zeros((41, 41))
    field[20, 20] = 5.0
    found = spread_by(field, gaussian_weights(3.0))
    x = np.arange(-20, 21)
    assert found.sum() == pytest.approx(5.0, rel=1e-12)
    assert (found * x**2).sum() / found.sum() == pytest.approx(9.0, rel=1e-2)
    assert found == pytest.approx(found.T, rel=1e-12)
    assert found[::-1, ::-1] == pytest.approx(found, rel=1e-12)


def test_nothing_lies_beyond_the_grid():
    found = spread_by(np.ones((9, 9)), gaussian_weights(2.0))
    assert found[4, 4] > found[0, 4] > found[0, 0] > 0.2

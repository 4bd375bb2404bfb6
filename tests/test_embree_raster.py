"""Contours of rasters of nodes in the vertical mode of the ray-casting backend, against scikit-image."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from skimage.measure import find_contours

from ebamcheck.layers.stack import Layers, from_rings
from ebamcheck_embree.raster import contours, empty_raster, turn_over


def rings_of_image(image, cell_mm=1.0) -> Layers:
    """Our contours of one image of nodes, the first of them at (0, 0)."""
    lattice = (0.0, 0.0, cell_mm, image.shape[1], image.shape[0])
    raster = empty_raster(lattice)
    turn_over(raster, np.flatnonzero(image), lattice)
    points, starts = contours(raster, lattice)
    return from_rings([0.0], [[points[a:b] for a, b in pairwise(starts)]])


def images(seed: int, shape: tuple[int, int], density: float):
    rng = np.random.default_rng(seed)
    return [np.pad(rng.random(shape) < density, 1) for _ in range(5)]


@pytest.mark.parametrize("density", [0.02, 0.3, 0.5, 0.7, 0.98])
@pytest.mark.parametrize("shape", [(9, 9), (40, 150), (3, 126)])
def test_contours_are_those_of_scikit_image(density, shape):
    for image in images(shape[0], shape, density):
        ours = rings_of_image(image)
        raw = find_contours(image.astype(float), 0.5, fully_connected="low", positive_orientation="low")
        theirs = from_rings([0.0], [[ring[:-1, ::-1] for ring in raw]])
        assert sorted(ours.ring_areas) == pytest.approx(sorted(theirs.ring_areas), abs=1e-9)
        assert sorted(ours.ring_lengths) == pytest.approx(sorted(theirs.ring_lengths), abs=1e-9)
        assert {tuple(p) for p in ours.points} <= {tuple(p) for p in theirs.points}


@pytest.mark.parametrize("cell_mm", [0.1, 1.0 / 3.0])
def test_the_contour_does_not_depend_on_how_the_cell_rounds(cell_mm):
    for image in images(7, (30, 70), 0.5):
        by_one, scaled = rings_of_image(image), rings_of_image(image, cell_mm)
        assert np.array_equal(by_one.ring_starts, scaled.ring_starts)
        assert np.abs(scaled.points - cell_mm * by_one.points).max() < 1e-12


def test_no_point_lies_within_a_straight_run():
    layers = rings_of_image(images(3, (60, 60), 0.6)[0])
    for r in range(layers.closed.size):
        ahead = np.roll(layers.ring(r), -1, axis=0) - layers.ring(r)
        behind = np.roll(ahead, 1, axis=0)
        assert (ahead[:, 0] * behind[:, 1] != ahead[:, 1] * behind[:, 0]).all()

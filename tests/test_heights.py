"""Heights of layers, and blocks of them that fit in memory."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from parts import box, join, sphere, tilted, torus

import ebamcheck
from ebamcheck.layers.heights import LARGEST_BLOCK, crossing_counts, layer_blocks
from ebamcheck.mesh.part import from_arrays

PARTS = {"sphere": sphere(10.0, 24), "torus": tilted(torus()), "two": join(box(), box((0, 0, 5), (1, 1, 9)))}


@pytest.mark.parametrize("name", PARTS)
def test_the_facets_that_a_plane_crosses_are_the_points_of_its_contours(name):
    part = PARTS[name]
    heights = ebamcheck.layer_heights(part, part.size[2] / 37.3)
    layers = ebamcheck.slice(part, heights, backend="planecut")
    points = np.diff(layers.ring_starts[layers.layer_starts])
    assert crossing_counts(part, heights).tolist() == points.tolist()


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 400), st.integers(0, 300))
def test_blocks_cover_every_layer_once_and_stay_under_the_limit(seed, most, count):
    rng = np.random.default_rng(seed)
    facets = rng.uniform(-5, 5, (60, 3, 3))
    part = from_arrays(facets.reshape(-1, 3), np.arange(180).reshape(60, 3))
    heights = np.sort(rng.uniform(-6, 6, count))
    borders = layer_blocks(part, heights, most)
    crossed = crossing_counts(part, heights)
    assert (borders[0], borders[-1]) == (0, count)
    for a, b in itertools.pairwise(borders.tolist()):
        assert b > a or count == 0
        assert crossed[a:b].sum() <= most or b - a == 1
        # No block could have taken the next layer, too.
        assert b == count or crossed[a : b + 1].sum() > most


def test_empty_layers_are_cut_into_blocks_too():
    """A gap of air may be higher than the part."""
    part = join(box((0, 0, 0), (1, 1, 1)), box((0, 0, 1e4), (1, 1, 1e4 + 1)))
    borders = layer_blocks(part, np.arange(0.5, 1e4, 1.0), 1_000_000)
    assert np.diff(borders).max() == LARGEST_BLOCK


def test_no_layers_are_one_empty_block():
    assert layer_blocks(PARTS["sphere"], [], 1000).tolist() == [0, 0]

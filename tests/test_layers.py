"""The canonical form of layers, their measures, and their polygons."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from parts import box, join, sphere, tilted, torus

import ebamcheck
from ebamcheck.layers.heights import LARGEST_BLOCK, crossing_counts, layer_blocks
from ebamcheck.layers.stack import concatenate, from_rings, stacked
from ebamcheck.mesh.part import from_arrays
from ebamcheck.slicers.slicing import slice_part
from ebamcheck_models import MODELS

SQUARE = np.array([(0, 0), (4, 0), (4, 4), (0, 4)], float)
HOLE = np.array([(1, 1), (1, 2), (2, 2), (2, 1)], float)


def test_canonical_form_does_not_depend_on_where_a_ring_starts():
    expected = from_rings([1.0], [[SQUARE, HOLE]])
    for shift in range(4):
        turned = from_rings([1.0], [[np.roll(HOLE, shift, axis=0), np.roll(SQUARE, -shift, axis=0)]])
        assert np.array_equal(turned.points, expected.points)
        assert np.array_equal(turned.ring_starts, expected.ring_starts)
    assert expected.points[0].tolist() == [0, 0]


def test_repeated_points_go_and_rings_without_area_are_counted():
    doubled = np.repeat(SQUARE, 3, axis=0)
    closed_again = np.vstack([SQUARE, SQUARE[:1]])
    spike = np.array([(0, 0), (1, 1), (2, 2), (1, 1)], float)
    layers = from_rings([1.0], [[doubled, closed_again + 10, spike, spike[:1]]])
    assert layers.ring_counts().tolist() == [2]
    assert layers.dropped.tolist() == [2]
    assert np.diff(layers.ring_starts).tolist() == [4, 4]
    assert layers.areas().tolist() == [32.0]


def test_measures_of_a_square_with_two_holes_and_an_open_path():
    layers = from_rings([1.0, 2.0], [[SQUARE, HOLE, HOLE + 1.5], []], [[[(9, 9), (10, 9)]], []])
    assert layers.areas().tolist() == [14.0, 0.0]
    assert layers.perimeters().tolist() == [24.0, 0.0]
    assert layers.ring_counts().tolist() == [3, 0]
    assert layers.hole_counts().tolist() == [2, 0]
    assert layers.open_counts().tolist() == [1, 0]
    (polygon,) = layers.polygons(0)
    assert polygon.area == 14.0
    assert len(polygon.interiors) == 2
    assert layers.polygons(1) == []


def test_a_ring_in_one_that_is_inside_out_bounds_nothing():
    assert from_rings([0.0], [[SQUARE[::-1] * 2.0 - 2.0, SQUARE]]).polygons(0) == []


def test_nesting_finds_the_smallest_enclosing_ring():
    island = HOLE[::-1] * 0.25 + 1.0
    layers = from_rings([0.0], [[SQUARE, HOLE, island, SQUARE * 1.5 + 100]])
    by_area = {round(float(a), 6): r for r, a in enumerate(layers.ring_areas)}
    outer, hole, inner = by_area[16.0], by_area[-1.0], by_area[round(1 / 16, 6)]
    assert layers.parents[hole] == outer
    assert layers.parents[inner] == hole
    assert layers.parents[outer] == -1
    assert sorted(p.area for p in layers.polygons(0)) == pytest.approx([1 / 16, 15.0, 36.0])


def test_take_block_and_concatenate_agree():
    rng = np.random.default_rng(1)
    stack = [[SQUARE * s + rng.normal(size=2) for s in rng.uniform(0.5, 2, n)] for n in (2, 0, 3, 1)]
    layers = from_rings(np.arange(4.0), stack)
    joined = concatenate([layers.block(0, 1), layers.block(1, 4)])
    for column in ("heights", "points", "ring_starts", "layer_starts", "closed"):
        assert np.array_equal(getattr(joined, column), getattr(layers, column))
    taken = layers.take([2, 0, 2])
    assert taken.areas().tolist() == layers.areas()[[2, 0, 2]].tolist()


def test_blocks_that_are_stacked_as_they_come_are_the_whole():
    whole = slice_part(MODELS["torus"].tessellate(0.5), [-3.0, -1.0, 1.0, 3.0], "planecut")
    blocks = (whole.block(k, k + 1) for k in range(len(whole)))
    found = stacked(blocks)
    assert found.edge is None
    for name in ("heights", "points", "ring_starts", "layer_starts", "closed", "dropped"):
        assert np.array_equal(getattr(found, name), getattr(whole, name)), name


# -- heights of layers, and blocks of them that fit in memory -------------------------------------------------


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

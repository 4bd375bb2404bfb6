"""Bare parts between beads: cut out where samples are bare, the widest is that which the union of all beads leaves."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from ebamcheck.checks.bead_checks import widest_part
from ebamcheck.geometry.regions import ground

WIDTH_MM = 6.0
REGION = shapely.box(0.0, 0.0, 120.0, 80.0).difference(shapely.Point(70.0, 40.0).buffer(9.0))


def lines_without(*missing):
    """Hatch lines 5 mm apart over the region, some left out."""
    y = np.array([2.0 + 5.0 * n for n in range(17) if n not in missing])
    return np.column_stack([np.zeros(y.size), y, np.full(y.size, 120.0), y])


def widest_of_all(segments):
    """Diameter of the widest part that the union of all beads leaves, mm."""
    beads = shapely.buffer(shapely.linestrings(segments.reshape(-1, 2, 2)), 0.5 * WIDTH_MM)
    parts = shapely.get_parts(REGION.difference(shapely.union_all(beads)))
    return max(2.0 * float(shapely.length(shapely.maximum_inscribed_circle(part))) for part in parts)


@pytest.mark.parametrize("missing", [(5,), (2, 3), (4, 9, 10, 11), (0,)])
def test_the_widest_part_is_that_of_the_union_of_all_beads(missing):
    segments = lines_without(*missing)
    found, part = widest_part(REGION, segments, WIDTH_MM)
    assert found == pytest.approx(widest_of_all(segments), abs=0.05)
    assert REGION.buffer(1e-9).covers(part)


@pytest.mark.parametrize("seed", range(6))
def test_crooked_lines_leave_the_same(seed):
    segments = lines_without() + np.random.default_rng(seed).normal(0.0, 0.8, (17, 4))
    found, part = widest_part(REGION, segments, WIDTH_MM)
    assert found == pytest.approx(widest_of_all(segments), abs=0.05)
    beads = shapely.buffer(shapely.linestrings(segments.reshape(-1, 2, 2)), 0.5 * WIDTH_MM)
    assert shapely.intersection(part, shapely.union_all(beads)).area < 1e-6


def test_what_is_no_wider_than_asked_for_is_not_found():
    segments = lines_without(5)
    widest, _ = widest_part(REGION, segments, WIDTH_MM)
    assert widest_part(REGION, segments, WIDTH_MM, widest - 0.01)[1] is not None
    assert widest_part(REGION, segments, WIDTH_MM, widest) == (widest, None)


def test_beads_that_leave_nothing_leave_no_part():
    assert widest_part(REGION, lines_without(), WIDTH_MM) == (0.0, None)


@pytest.mark.parametrize("seed", range(6))
def test_ground_under_chains_of_beads_is_that_of_all_beads_one_by_one(seed):
    """Chains that cross, meet and come back, one that is closed, a bead twice, and beads of no length."""
    random = np.random.default_rng(seed)
    chains = [np.cumsum(random.normal(0.0, 4.0, (12, 2)), axis=0) for _ in range(4)]
    chains += [np.array([(0, 0), (40, 0), (40, 30), (0, 0)], float), np.array([(80, 80), (80, 80)], float)]
    pairs = np.concatenate([np.stack([chain[:-1], chain[1:]], axis=1) for chain in chains])
    lines = np.asarray(shapely.linestrings([*pairs, pairs[3], pairs[3]]), object)
    every = shapely.union_all(shapely.buffer(lines, 0.5 * WIDTH_MM, quad_segs=64))
    found = ground(random.permutation(lines), WIDTH_MM)
    # Both are widened by polygons in place of circles, which lack a micrometre or two of the radius.
    assert shapely.hausdorff_distance(found.boundary, every.boundary, densify=0.2) < 0.05
    assert every.buffer(1e-3).covers(found)
    assert found.buffer(3e-3).covers(every)
    assert ground(np.zeros(0, object), WIDTH_MM).is_empty

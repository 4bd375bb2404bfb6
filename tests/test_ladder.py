"""The ladder of the paper: its layers and size, its meshes, its channels, and how far they are from the surface."""

from __future__ import annotations

import math

import numpy as np
import pytest

import ebamcheck
from ebamcheck.layers.heights import layer_heights
from ebamcheck_models import (
    LADDER,
    LADDER_TOLERANCES_MM,
)
from ebamcheck_models.ring_wall import RingWall


def open_rings(layers):
    return int(layers.open_counts().sum())


def test_the_ladder_has_the_papers_layers_and_size():
    low, high = LADDER.bounds
    assert (high - low) == pytest.approx([245.0, 207.0, 897.6], rel=2e-3)
    assert len(layer_heights(LADDER.tessellate(1.0), 0.2)) == 4488
    assert LADDER_TOLERANCES_MM == (1.0, 0.8, 0.4, 0.08, 0.06, 0.04, 0.01, 0.006, 0.004, 0.002, 0.001)


def test_the_ladders_meshes_grow_as_the_papers_files():
    # Its binary STL files, MB; 50 bytes a facet. The 0.4 and 0.8 mm are swapped in the printed list.
    sizes = (0.23, 0.30, 0.46, 0.91, 1.14, 1.80, 5.88, 9.04)
    counts = [len(LADDER.tessellate(t).faces) for t in LADDER_TOLERANCES_MM[: len(sizes)]]
    assert counts == sorted(counts)
    for count, megabytes in zip(counts, sizes, strict=True):
        assert 0.6 < count * 50e-6 / megabytes < 1.6


@pytest.mark.parametrize("tolerance_mm", [1.0, 0.1, 0.01])
def test_no_point_of_the_ladder_is_farther_from_its_surface_than_the_tolerance(tolerance_mm):
    assert farthest_from_ladder(tolerance_mm, 20_000) <= tolerance_mm


@pytest.mark.slow
def test_the_top_of_the_ladder():
    part = LADDER.tessellate(0.001)
    assert 1_440_000 < len(part.faces) < 1_520_000
    assert np.array_equal(part.vertices, part.vertices.astype(np.float32))
    assert farthest_from_ladder(0.001, 100_000) <= 0.001
    heights = layer_heights(part, 0.2)
    cut = ebamcheck.slice(part, heights, backend="planecut")
    assert open_rings(cut) == 0
    wanted = np.array([LADDER.area(z) for z in heights.tolist()])
    # A third of the deepest lack of a chord, all along the walls; lips lean and show more of it.
    assert np.abs(cut.areas() - wanted)[60:-60].max() <= 0.001 * 1400.0
    assert np.abs(cut.areas() - wanted).sum() * 0.2 <= 0.001 * 1400.0 * 897.6


def farthest_from_ladder(tolerance_mm, count):
    """Greatest distance of random points of facets from the surface, by its implicit forms."""
    rng = np.random.default_rng(2)
    triangles = LADDER.tessellate(tolerance_mm).triangles
    chosen = triangles[rng.integers(0, len(triangles), count)]
    weights = rng.dirichlet([1.0, 1.0, 1.0], count)
    weights[::3] = [0.5, 0.0, 0.5]
    points = np.einsum("ij,ijk->ik", weights, chosen)
    step = 1e-4
    forms = [ring_form, *(channel_form(c) for c in LADDER.channels)]
    found = np.full(count, np.inf)
    for form in forms:
        value = form(points)
        slope = [(form(points + step * e) - form(points - step * e)) / (2 * step) for e in np.eye(3)]
        # First order; forms are squared distances in units of the half axes, hence (1 + |value|).
        found = np.minimum(found, np.abs(value) / np.linalg.norm(slope, axis=0))
    return found.max()


def ring_form(points):
    """Distance, in half widths and lips, from the middle of the wall less one: 0 on the surface."""
    x, y, z = points.T
    angle = np.arctan2(y, x)
    turned = angle - math.radians(LADDER.twist_deg) * z / LADDER.height_mm
    middle = LADDER.radius_mm * (1 + LADDER.bulge * np.sin(math.pi * z / LADDER.height_mm))
    middle = middle + LADDER.oval_mm * np.cos(2 * turned) + LADDER.lobes_mm * np.cos(3 * turned)
    half = LADDER.half_mm + LADDER.half_oval_mm * np.cos(2 * turned)
    off = (np.hypot(x, y) - middle) / half
    return np.hypot(off, beyond(z, 0.0, LADDER.height_mm, LADDER.lip_mm)) - 1.0


def channel_form(channel):
    def form(points):
        x, y, z = points.T
        place = math.radians(channel.angle_deg) + math.radians(LADDER.twist_deg) * z / LADDER.height_mm
        turned = place - math.radians(LADDER.twist_deg) * z / LADDER.height_mm
        middle = LADDER.radius_mm * (1 + LADDER.bulge * np.sin(math.pi * z / LADDER.height_mm))
        middle = middle + LADDER.oval_mm * np.cos(2 * turned) + LADDER.lobes_mm * np.cos(3 * turned)
        out = (x * np.cos(place) + y * np.sin(place) - middle) / channel.through_mm
        along = (-x * np.sin(place) + y * np.cos(place)) / channel.along_mm
        ends = channel.ends
        return np.sqrt(out**2 + along**2 + beyond(z, ends.low_mm, ends.high_mm, ends.cap_mm) ** 2) - 1.0

    return form


def beyond(z, low, high, cap):
    return np.maximum(0.0, np.maximum(low + cap - z, z - high + cap)) / cap


def test_the_ladders_channels_are_closed_and_lie_in_the_wall():
    assert isinstance(LADDER, RingWall)
    for z in (0.1, 20.0, 100.0, 500.0, 855.0, 890.0, 897.5):
        (region,) = LADDER.section(z)
        open_here = sum(c.ends.low_mm < z < c.ends.high_mm for c in LADDER.channels)
        assert len(region.interiors) == 1 + open_here
        rings = [region.exterior, *region.interiors]
        assert min(a.distance(b) for i, a in enumerate(rings) for b in rings[:i]) > (
            2.0 if open_here else 0.5
        )

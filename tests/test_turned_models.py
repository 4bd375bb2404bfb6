"""Reference models turned along any direction: sections, volumes and closed forms of turned solids."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
import shapely

import ebamcheck
from ebamcheck.errors import SettingsError
from ebamcheck_models import (
    BRACKET,
    CONE,
    CUBE,
    CYLINDER,
    MODELS,
    PRISM,
    PYRAMID,
    SPHERE,
    TWO_SPHERES,
    TurnableModel,
)

TURNABLE = [m for m in MODELS.values() if isinstance(m, TurnableModel) and m.name != "menger-3"]
DIRECTIONS = [
    (1.0, 0.0, 0.0),
    (0.0, 0.0, -1.0),
    (0.3, -0.5, 0.8),
    (-0.7, 0.6, -0.2),
    (0.0, 1.0, 1e-3),
    (1e-4, 0.0, 1.0),
]


def heights_of(model, count, seed=0):
    """Heights all over the model, away from its steps by chance."""
    low, high = model.bounds[:, 2]
    return np.sort(low + (high - low) * np.random.default_rng(seed).uniform(0.001, 0.999, count))


def difference(polygons, layers, layer):
    return shapely.union_all(polygons).symmetric_difference(shapely.union_all(layers.polygons(layer))).area


@pytest.mark.in_turn(3)
@pytest.mark.parametrize("model", TURNABLE, ids=lambda m: m.name)
@pytest.mark.parametrize("direction", DIRECTIONS[:4], ids=str)
def test_a_turned_model_is_the_part_turned_along_the_direction(model, direction):
    turned = model.turned(direction)
    part = model.tessellate(0.02).along(direction)
    assert turned.volume == pytest.approx(model.volume, rel=1e-9)
    assert np.abs(turned.bounds - part.bounds).max() <= 0.021
    if model not in (SPHERE, TWO_SPHERES):  # their meshes keep their poles
        assert np.abs(turned.tessellate(0.02).vertices - part.vertices).max() < 1e-3
    heights = heights_of(turned, 4, seed=6)
    cut = ebamcheck.slice(part, heights, backend="planecut")
    for k, z in enumerate(heights.tolist()):
        polygons = turned.section(z)
        length = sum(p.length for p in polygons)
        assert sum(p.area for p in polygons) == pytest.approx(turned.area(z), abs=2e-3 * length)
        # 20 times the tolerance: a plane nearly along a wall shows its chords stretched.
        assert difference(polygons, cut, k) <= 20 * 0.02 * length


@pytest.mark.in_turn(3)
@pytest.mark.parametrize(
    "model", [CUBE, PRISM, BRACKET, CONE, CYLINDER, TWO_SPHERES, PYRAMID], ids=lambda m: m.name
)
@pytest.mark.parametrize("direction", DIRECTIONS, ids=str)
def test_the_area_of_a_turned_model_integrates_to_its_volume(model, direction):
    turned = model.turned(direction)
    low, high = turned.bounds[:, 2]
    nodes, weights = np.polynomial.legendre.leggauss(8)
    edges = np.linspace(low, high, 21)
    total = 0.0
    for a, b in pairwise(edges):
        z = a + 0.5 * (nodes + 1.0) * (b - a)
        total += 0.5 * (b - a) * float(weights @ [turned.area(h) for h in z.tolist()])
    assert total == pytest.approx(model.volume, rel=1e-2)


def test_turned_sections_in_closed_form():
    diagonal = CUBE.turned((1.0, 1.0, 1.0))
    assert diagonal.area(math.sqrt(3) * 10.0) == pytest.approx(3 * math.sqrt(3) / 4 * 400.0)
    assert CYLINDER.turned((1.0, 0.0, 0.0)).area(7.0) == pytest.approx(60.0 * 2 * math.sqrt(625.0 - 49.0))
    slope = np.array([math.sin(0.3), 0.0, math.cos(0.3)])
    assert CYLINDER.turned(slope).area(30.0 * slope[2]) == pytest.approx(math.pi * 625.0 / math.cos(0.3))
    # A parabola: the plane is parallel to a side of the cone, half a base radius beyond the axis.
    side = np.array([50.0, 0.0, 25.0]) / math.hypot(50.0, 25.0)
    half_chord, depth = 25.0 * math.sqrt(0.75), math.hypot(50.0, 25.0) * 0.25
    height = float(side @ [-12.5, 0.0, 0.0])
    assert CONE.turned(side).area(height) == pytest.approx(4 / 3 * half_chord * depth, rel=1e-9)
    assert CONE.turned((0.0, 0.0, -1.0)).area(-10.0) == pytest.approx(CONE.area(10.0))


def test_turning_twice_is_turning_by_the_product():
    once = PRISM.turned((0.3, -0.5, 0.8))
    again = once.turned((0.1, 0.9, 0.2))
    assert again.volume == pytest.approx(PRISM.volume)
    z = float(again.bounds.mean(axis=0)[2])
    upright = CUBE.turned((1.0, 0.0, 0.0)).turned((-0.0, 0.0, 1.0))
    assert sum(p.area for p in again.section(z)) == pytest.approx(again.area(z), rel=1e-5)
    assert upright.area(5.0) == pytest.approx(400.0)


def test_a_direction_of_no_length_is_refused():
    for model in TURNABLE:
        with pytest.raises(SettingsError, match="direction"):
            model.turned((0.0, 0.0, 0.0))

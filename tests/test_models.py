"""Reference models: closed meshes that keep their tolerance, sections that are what they claim, and named cases."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
import shapely
import trimesh

import ebamcheck
from ebamcheck.errors import SettingsError
from ebamcheck.layers.heights import layer_heights
from ebamcheck.layers.stack import from_polygons
from ebamcheck_models import (
    BLADE,
    BRACKET,
    CASES,
    COMB,
    CONE,
    CUBE,
    CYLINDER,
    HELICAL_CHANNEL,
    IMPELLER,
    LADDER,
    LADDER_TOLERANCES_MM,
    MODELS,
    PRISM,
    PYRAMID,
    SPHERE,
    THIN_WALLS,
    TORUS,
    TWO_SPHERES,
    Model,
    TurnableModel,
)
from ebamcheck_models.__main__ import main
from ebamcheck_models.polyhedra import WIDTHS_MM, Polyhedron
from ebamcheck_models.walls import WalledModel

ALL = pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)


def heights_of(model, count, seed=0):
    """Heights all over the model, away from its steps by chance."""
    low, high = model.bounds[:, 2]
    return np.sort(low + (high - low) * np.random.default_rng(seed).uniform(0.001, 0.999, count))


def difference(polygons, layers, layer):
    return shapely.union_all(polygons).symmetric_difference(shapely.union_all(layers.polygons(layer))).area


# -- meshes ----------------------------------------------------------------------------------------


@pytest.mark.in_turn(2)
@ALL
@pytest.mark.parametrize("tolerance_mm", [2.0, 0.1])
def test_meshes_are_closed_and_of_the_designed_topology(model, tolerance_mm):
    part = model.tessellate(tolerance_mm)
    faces = part.faces.astype(np.int64)
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    forward, back = (edges @ [len(part.vertices), 1]), (edges @ [1, len(part.vertices)])
    # Every edge is run through as often one way as the other; once each where nothing touches.
    assert np.array_equal(np.sort(forward), np.sort(back))
    assert (len(np.unique(forward)) == len(forward)) == model.two_manifold
    assert len(np.unique(part.vertices, axis=0)) == len(part.vertices)
    assert np.array_equal(np.unique(faces), np.arange(len(part.vertices)))
    mesh = trimesh.Trimesh(part.vertices, part.faces, process=False)
    assert mesh.euler_number == model.euler_number
    assert len(trimesh.graph.connected_components(edges, nodes=np.arange(len(part.vertices)))) == model.shells
    corners = part.triangles
    doubled = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    assert doubled.min() > 0


@pytest.mark.in_turn(2, 1)
@ALL
def test_meshes_go_to_the_volume_that_is_claimed(model):
    for tolerance_mm in (1.0, 0.05):
        part = model.tessellate(tolerance_mm)
        corners = part.triangles - part.vertices.mean(axis=0)
        surface = (
            0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum()
        )
        volume = np.einsum("ij,ij->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6.0
        assert abs(volume - model.mesh_volume) <= tolerance_mm * surface + 1e-6 * model.volume


@pytest.mark.in_turn(2)
@ALL
def test_volume_is_the_integral_of_the_area(model):
    low, high = model.bounds[:, 2]
    if isinstance(model, Polyhedron):
        # Quadratic between the heights of corners, where two Gauss nodes give it exactly.
        edges = np.unique(model.corners[np.unique(model.facets), 2])
        middle, half = 0.5 * (edges[1:] + edges[:-1]), 0.5 * np.diff(edges)
        areas = [[model.area(m + h * s / math.sqrt(3)) for s in (-1, 1)] for m, h in zip(middle, half, strict=True)]
        assert half @ np.sum(areas, axis=1) == pytest.approx(model.volume, rel=1e-9)
    else:
        z = low + (high - low) * (np.arange(810) + 0.5) / 810
        integral = np.mean([model.area(h) for h in z.tolist()]) * (high - low)
        # A jump of the area lies anywhere in its cell of the midpoint rule.
        assert integral == pytest.approx(model.volume, rel=2e-3)


@pytest.mark.in_turn(2, 1)
@ALL
def test_sections_are_valid_have_the_claimed_area_and_end_at_the_top(model):
    for z in heights_of(model, 6, seed=1):
        polygons = model.section(z)
        assert all(p.is_valid for p in polygons)
        within = 2e-4 * sum(p.length for p in polygons) + 1e-9 * model.area(z)
        assert sum(p.area for p in polygons) == pytest.approx(model.area(z), abs=within)
    low, high = model.bounds[:, 2]
    for z in (low - 0.1, high, high + 0.1):
        assert model.section(float(z)) == []
        assert model.area(float(z)) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.in_turn(2)
@ALL
def test_sections_of_meshes_go_to_the_exact_section(model):
    heights = heights_of(model, 5, seed=4)
    exact = [model.section(z, 1e-4) for z in heights]
    worst = []
    for tolerance_mm in (0.5, 0.05):
        cut = ebamcheck.slice(model.tessellate(tolerance_mm), heights, backend="planecut")
        errors = [difference(e, cut, k) / sum(p.length for p in e) for k, e in enumerate(exact)]
        worst.append(max(errors))
        if model.two_manifold:
            assert np.array_equal(cut.ring_counts(), from_polygons(heights, exact).ring_counts())
        assert open_rings(cut) == 0
    # Steep walls show the tolerance itself; where a wall leans to the level the section moves farther.
    assert worst[1] <= 0.2
    assert worst[1] <= 0.3 * worst[0] + 2e-4


def open_rings(layers):
    return int(layers.open_counts().sum())


# -- closed forms ----------------------------------------------------------------------------------


def test_closed_forms():
    assert CONE.area(0.0) == pytest.approx(math.pi * 625.0)
    assert CONE.area(25.0) == pytest.approx(math.pi * 12.5**2)
    assert CONE.volume == pytest.approx(math.pi * 625.0 * 50.0 / 3.0)
    assert CYLINDER.volume == pytest.approx(math.pi * 625.0 * 60.0)
    assert PYRAMID.area(10.0) == pytest.approx(32.0**2)
    assert PYRAMID.volume == pytest.approx(1600.0 * 50.0 / 3.0)
    assert HELICAL_CHANNEL.area(33.3) == pytest.approx(6400.0 - (4 - math.pi) * 100.0 - math.pi * 64.0)


@pytest.mark.parametrize("level", [1, 2, 3])
def test_the_area_of_a_menger_sponge_is_a_product_over_the_digits_of_its_layer(level):
    sponge = MODELS[f"menger-{level}"]
    for layer in range(3**level):
        digits = [layer // 3**k % 3 for k in range(level)]
        # 4 of the 9 squares stay where the digit is 1, and 8 where it is 0 or 2.
        share = math.prod((4 if digit == 1 else 8) / 9 for digit in digits)
        assert sponge.area((layer + 0.5) * 27.0 / 3**level) == pytest.approx(share * 729.0)
    assert sponge.volume == pytest.approx(27.0**3 * (20 / 27) ** level)


def test_every_gap_of_the_comb_and_every_thin_wall_is_there():
    (plate,), (comb,) = COMB.section(2.0), COMB.section(10.0)
    teeth = comb.intersection(shapely.box(-1, 20, 60, 21))
    bounds = sorted(t.bounds for t in teeth.geoms)
    gaps = [b[0] - a[2] for a, b in pairwise(bounds)]
    assert gaps == pytest.approx(WIDTHS_MM, abs=4e-6)  # 32-bit steps at 40 mm
    assert plate.area - comb.area == pytest.approx(24.0 * sum(WIDTHS_MM), abs=1e-3)
    (frame,) = THIN_WALLS.section(5.0)
    walls = sorted(w.bounds for w in frame.intersection(shapely.box(-1, 14, 60, 15)).geoms)
    assert [w[2] - w[0] for w in walls] == pytest.approx(WIDTHS_MM, abs=4e-6)
    assert len(frame.interiors) == len(WIDTHS_MM) - 1


# -- named cases -----------------------------------------------------------------------------------


@pytest.mark.parametrize("model", CASES, ids=lambda m: m.name)
def test_a_named_case_cites_its_report_and_is_cut_right_at_every_layer(model):
    assert model.name.startswith("case-")
    assert "#" in model.summary or "touch" in model.summary
    part = model.tessellate(0.1)
    low, high = part.bounds[:, 2]
    # Mid-layer planes and planes through the layers' borders, faces and vertices among them.
    count = round((high - low) / 0.2)
    heights = low + 0.1 * np.arange(2 * count) if high - low < 50 else low + 0.2 * np.arange(1, count)
    cut = ebamcheck.slice(part, heights, backend="planecut")
    chosen = np.unique(np.linspace(0, len(heights) - 1, 40).astype(int))
    wanted = [model.area(z) for z in heights[chosen].tolist()]
    assert cut.areas()[chosen] == pytest.approx(wanted, rel=1e-9, abs=1e-4)
    assert open_rings(cut) == 0
    assert (cut.areas()[1:] > 0).all()


# -- the command -----------------------------------------------------------------------------------


def test_the_command_lists_every_model_with_its_summary(capsys):
    assert main(["--list"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == list(MODELS)
    for line, model in zip(lines, MODELS.values(), strict=True):
        assert line.endswith(f"  {model.summary}")


# -- plain models: one smooth body each ------------------------------------------------------------


PLAIN = [BLADE, BRACKET, CUBE, CYLINDER, HELICAL_CHANNEL, IMPELLER, PRISM, SPHERE, TORUS]
EACH_PLAIN = pytest.mark.parametrize("model", PLAIN, ids=lambda m: m.name)
WALLED = [m for m in PLAIN if isinstance(m, WalledModel)]
TOLERANCES_MM = (2.0, 0.3, 0.05)


# -- meshes ----------------------------------------------------------------------------------------


@EACH_PLAIN
def test_bounds_hold_the_mesh_and_touch_it(model):
    tolerance_mm = 0.05
    bounds = model.tessellate(tolerance_mm).bounds
    assert np.abs(bounds - model.bounds).max() <= tolerance_mm + 1e-3
    assert (bounds[0] >= model.bounds[0] - 2e-3).all()
    assert (bounds[1] <= model.bounds[1] + 2e-3).all()


@pytest.mark.in_turn(5)
@pytest.mark.parametrize("model", WALLED, ids=lambda m: m.name)
@pytest.mark.parametrize("tolerance_mm", TOLERANCES_MM)
def test_no_point_of_a_wall_facet_is_farther_from_the_surface_than_the_tolerance(model, tolerance_mm):
    # The distance within the level through a point is at least its distance from the surface.
    part = model.tessellate(tolerance_mm)
    corners = part.triangles
    steep = np.flatnonzero(np.ptp(corners[:, :, 2], axis=1) > 0)
    rng = np.random.default_rng(1)
    chosen = rng.choice(steep, 150)
    weights = rng.dirichlet([1.0, 1.0, 1.0], 150)
    weights[::3] = [0.5, 0.0, 0.5]  # the middle of the diagonal, where a twisted cell is farthest off
    for point in np.einsum("ij,ijk->ik", weights, corners[chosen]):
        rings = shapely.union_all([p.boundary for p in model.section(point[2], 0.01 * tolerance_mm)])
        assert rings.distance(shapely.Point(point[:2])) <= tolerance_mm


@EACH_PLAIN
def test_vertices_are_what_a_32_bit_file_keeps(model):
    vertices = model.tessellate(0.3).vertices
    assert np.array_equal(vertices, vertices.astype(np.float32))


@pytest.mark.parametrize("wrong", [0.0, -1.0, math.nan, math.inf, 1e-9, 2.1])
@EACH_PLAIN
def test_a_tolerance_that_no_mesh_can_keep_is_refused(model, wrong):
    with pytest.raises(SettingsError, match="tolerance"):
        model.tessellate(wrong)


# -- sections --------------------------------------------------------------------------------------


def test_closed_forms_of_plain_bodies():
    assert CUBE.volume == pytest.approx(8000.0, rel=1e-14)
    assert CYLINDER.area(10.0) == pytest.approx(math.pi * 625.0, rel=1e-14)
    straight = 160 * 100 - (4 - math.pi) * 18**2
    cut = math.pi * (15**2 + 8**2) + (40 * 15 + 15 * 45) + 0.5 * 40 * 50
    assert PRISM.area(5.0) == pytest.approx(straight - cut, rel=1e-13)
    assert SPHERE.area(0.0) == pytest.approx(math.pi * 900.0)
    assert TORUS.area(0.0) == pytest.approx(math.pi * (80.0**2 - 40.0**2))


# -- files and the command -------------------------------------------------------------------------


def test_the_command_writes_a_file_and_says_what(tmp_path, capsys):
    assert main(["blade", "--tolerance", "1", "-o", str(tmp_path / "b.stl")]) == 0
    facets = len(BLADE.tessellate(1.0).faces)
    assert f"{facets} facets" in capsys.readouterr().out
    assert (tmp_path / "b.stl").stat().st_size == 84 + 50 * facets


def test_the_command_refuses_what_makes_no_sense(tmp_path, capsys):
    assert main(["cube", "--tolerance", "0", "-o", str(tmp_path / "c.stl")]) == 2
    assert "tolerance 0.0 mm" in capsys.readouterr().err
    assert main(["cube", "-o", str(tmp_path / "no" / "c.stl")]) == 2
    with pytest.raises(SystemExit) as stopped:
        main(["teapot"])
    assert stopped.value.code == 2
    assert list(tmp_path.iterdir()) == []


@EACH_PLAIN
def test_every_model_keeps_the_protocol_and_its_name(model):
    assert isinstance(model, Model)
    assert MODELS[model.name] is model
    assert model.summary
    assert model.tessellate(2.0).name == model.name


# -- turned along any direction -------------------------------------------------------------------------------


TURNABLE = [m for m in MODELS.values() if isinstance(m, TurnableModel) and m.name != "menger-3"]
DIRECTIONS = [
    (1.0, 0.0, 0.0),
    (0.0, 0.0, -1.0),
    (0.3, -0.5, 0.8),
    (-0.7, 0.6, -0.2),
    (0.0, 1.0, 1e-3),
    (1e-4, 0.0, 1.0),
]


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
@pytest.mark.parametrize("model", [CUBE, PRISM, BRACKET, CONE, CYLINDER, TWO_SPHERES, PYRAMID], ids=lambda m: m.name)
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


def test_a_direction_of_no_length_is_refused():
    for model in TURNABLE:
        with pytest.raises(SettingsError, match="direction"):
            model.turned((0.0, 0.0, 0.0))


# -- the ladder of the paper ----------------------------------------------------------------------------------


def test_the_ladder_has_the_papers_layers_and_size():
    low, high = LADDER.bounds
    assert (high - low) == pytest.approx([245.0, 207.0, 897.6], rel=2e-3)
    assert len(layer_heights(LADDER.tessellate(1.0), 0.2)) == 4488
    assert LADDER_TOLERANCES_MM == (1.0, 0.8, 0.4, 0.08, 0.06, 0.04, 0.01, 0.006, 0.004, 0.002, 0.001)


@pytest.mark.slow
def test_the_top_of_the_ladder():
    part = LADDER.tessellate(0.001)
    assert 1_440_000 < len(part.faces) < 1_520_000
    assert np.array_equal(part.vertices, part.vertices.astype(np.float32))
    heights = layer_heights(part, 0.2)
    cut = ebamcheck.slice(part, heights, backend="planecut")
    assert open_rings(cut) == 0
    wanted = np.array([LADDER.area(z) for z in heights.tolist()])
    # A third of the deepest lack of a chord, all along the walls; lips lean and show more of it.
    assert np.abs(cut.areas() - wanted)[60:-60].max() <= 0.001 * 1400.0
    assert np.abs(cut.areas() - wanted).sum() * 0.2 <= 0.001 * 1400.0 * 897.6

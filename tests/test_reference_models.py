"""Reference models beyond the first six: closed forms, meshes and named cases."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
import shapely
import trimesh
from scipy import special

import ebamcheck
from ebamcheck.layers.heights import layer_heights
from ebamcheck.layers.stack import from_polygons
from ebamcheck_models import (
    BRACKET,
    CASES,
    COMB,
    CONE,
    CYLINDER,
    HELICAL_CHANNEL,
    IMPELLER,
    MODELS,
    PYRAMID,
    SPHERE,
    THIN_WALLS,
    TILTED_PLATE,
    TWO_SPHERES,
    walled_parts,
)
from ebamcheck_models.__main__ import main
from ebamcheck_models.polyhedra import WIDTHS_MM, Polyhedron
from ebamcheck_models.two_spheres import lens_area

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
            0.5
            * np.linalg.norm(
                np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
            ).sum()
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
        areas = [
            [model.area(m + h * s / math.sqrt(3)) for s in (-1, 1)] for m, h in zip(middle, half, strict=True)
        ]
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


@pytest.mark.parametrize("tolerance_mm", [2.0, 0.2, 0.02])
def test_no_point_of_a_cone_or_a_sphere_is_farther_than_the_tolerance(tolerance_mm):
    weights = np.random.default_rng(0).dirichlet([1.0, 1.0, 1.0], 30)
    points = np.einsum("wj,fjk->fwk", weights, CONE.tessellate(tolerance_mm).triangles).reshape(-1, 3)
    side = np.hypot(points[:, 0], points[:, 1]) - CONE.bottom_mm * (1.0 - points[:, 2] / CONE.height_mm)
    assert side.max() < 1e-5
    assert (np.minimum(-side, points[:, 2])).max() <= tolerance_mm
    points = np.einsum("wj,fjk->fwk", weights, TWO_SPHERES.tessellate(tolerance_mm).triangles).reshape(-1, 3)
    reach = np.linalg.norm(points[:, None] - TWO_SPHERES.centres, axis=2) - TWO_SPHERES.radii_mm
    assert np.abs(reach).min(axis=1).max() <= tolerance_mm


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


def test_the_impeller_has_the_area_that_bessel_functions_give():
    k = walled_parts.SHARPNESS
    for z in (8.0, 30.0, 77.0):
        hub, blade = float(walled_parts.hub_mm(z)), float(walled_parts.blade_mm(z))
        means = special.ive(0, k), special.ive(0, 2 * k)
        ring = hub**2 + 2 * hub * blade * means[0] + blade**2 * means[1]
        wanted = math.pi * (ring - walled_parts.BORE_RADIUS_MM**2)
        assert IMPELLER.area(z) == pytest.approx(wanted, rel=1e-10)


def test_the_lens_of_two_discs():
    assert lens_area(3.0, 1.0, 1.0) == 0.0
    assert lens_area(0.1, 1.0, 3.0) == pytest.approx(math.pi)
    assert lens_area(1.0, 1.0, 1.0) == pytest.approx(2 * math.pi / 3 - math.sqrt(3) / 2)
    # The centre of the smaller disc on the far side of the chord.
    one, other = shapely.Point(0, 0).buffer(5, 4096), shapely.Point(4.5, 0).buffer(2, 4096)
    assert lens_area(4.5, 5.0, 2.0) == pytest.approx(one.intersection(other).area, rel=1e-6)


def test_the_two_spheres_overlap_and_their_union_is_less_than_their_meshes():
    part = TWO_SPHERES.tessellate(0.05)
    assert part.signed_volume == pytest.approx(TWO_SPHERES.mesh_volume, rel=1e-2)
    assert part.volume == pytest.approx(TWO_SPHERES.volume, rel=1e-2)
    assert TWO_SPHERES.volume < 0.95 * TWO_SPHERES.mesh_volume
    # The area is smooth but where a sphere, or the lens, begins and ends: midpoints on a fine grid do.
    low, high = TWO_SPHERES.bounds[:, 2]
    z = low + (high - low) * (np.arange(4000) + 0.5) / 4000
    integral = np.mean([TWO_SPHERES.area(h) for h in z.tolist()]) * (high - low)
    assert integral == pytest.approx(TWO_SPHERES.volume, rel=1e-5)
    assert sum(SPHERE.volume * (r / 30.0) ** 3 for r in TWO_SPHERES.radii_mm) == pytest.approx(
        TWO_SPHERES.mesh_volume
    )


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


def test_planecut_keeps_every_gap_and_wall():
    for model in (COMB, THIN_WALLS, *(m for m in CASES if "prusa" in m.name)):
        low, high = model.bounds[:, 2]
        heights = low + (high - low) * np.array([0.1, 0.6, 0.95])
        cut = ebamcheck.slice(model.tessellate(1.0), heights, backend="planecut")
        assert cut.areas() == pytest.approx([model.area(z) for z in heights.tolist()], rel=1e-12)


def test_the_bracket_has_a_brace_as_thin_as_it_says():
    (region,) = BRACKET.section(10.0)
    hole = max((shapely.Polygon(r) for r in region.interiors), key=lambda p: p.area)
    assert hole.distance(region.exterior) == pytest.approx(0.8, abs=1e-3)
    assert region.buffer(-0.41).geom_type == "Polygon"
    assert len(region.buffer(-0.41).interiors) < len(region.interiors)


def test_the_tilted_plate_is_a_millimetre_thick():
    normal = np.array([0.35, -0.2, 0.5]) / np.linalg.norm([0.35, -0.2, 0.5])
    (region,) = TILTED_PLATE.section(0.0)
    width = region.minimum_rotated_rectangle
    sides = np.linalg.norm(np.diff(shapely.get_coordinates(width)[:3], axis=0), axis=1)
    assert sides.min() == pytest.approx(1.0 / math.hypot(normal[0], normal[1]), rel=1e-4)


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


def test_the_cube_that_cura_lost_a_layer_of():
    cube = MODELS["case-cura-1473"]
    part = cube.tessellate(1.0)
    for heights in (layer_heights(part, 0.2), [14.0, 14.2, 14.4]):
        assert ebamcheck.slice(part, heights, backend="planecut").areas() == pytest.approx(10_000.0)


def test_touching_cubes_are_two_rings_and_two_regions():
    touching = MODELS["case-touching-edge"]
    assert len(touching.section(5.0)) == 2
    cut = ebamcheck.slice(touching.tessellate(1.0), [5.0], backend="planecut")
    assert cut.areas() == pytest.approx([200.0])


# -- the command -----------------------------------------------------------------------------------


def test_the_command_lists_every_model_with_its_summary(capsys):
    assert main(["--list"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == list(MODELS)
    for line, model in zip(lines, MODELS.values(), strict=True):
        assert line.endswith(f"  {model.summary}")


def test_the_command_wants_a_name_or_the_list(capsys):
    with pytest.raises(SystemExit) as stopped:
        main([])
    assert stopped.value.code == 2
    assert "--list" in capsys.readouterr().err

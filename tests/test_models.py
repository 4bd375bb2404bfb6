"""Reference models: closed meshes that keep their tolerance, sections that are what they claim, and named cases."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
import shapely
import trimesh
from scipy import special

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
    MODELS,
    PRISM,
    PYRAMID,
    SPHERE,
    THIN_WALLS,
    TILTED_PLATE,
    TORUS,
    TWO_SPHERES,
    Model,
    write_stl,
)
from ebamcheck_models import impeller as impeller_shape
from ebamcheck_models.__main__ import main
from ebamcheck_models.narrow import WIDTHS_MM
from ebamcheck_models.outlines import Outline, arc, circle, rounded_rectangle
from ebamcheck_models.polyhedra import Polyhedron
from ebamcheck_models.two_spheres import lens_area
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
    k = impeller_shape.SHARPNESS
    for z in (8.0, 30.0, 77.0):
        hub, blade = float(impeller_shape.hub_mm(z)), float(impeller_shape.blade_mm(z))
        means = special.ive(0, k), special.ive(0, 2 * k)
        ring = hub**2 + 2 * hub * blade * means[0] + blade**2 * means[1]
        wanted = math.pi * (ring - impeller_shape.BORE_RADIUS_MM**2)
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


# -- plain models: one smooth body each ------------------------------------------------------------


PLAIN = [BLADE, BRACKET, CUBE, CYLINDER, HELICAL_CHANNEL, IMPELLER, PRISM, SPHERE, TORUS]
EACH_PLAIN = pytest.mark.parametrize("model", PLAIN, ids=lambda m: m.name)
WALLED = [m for m in PLAIN if isinstance(m, WalledModel)]
TOLERANCES_MM = (2.0, 0.3, 0.05)


# -- meshes ----------------------------------------------------------------------------------------


@EACH_PLAIN
@pytest.mark.parametrize("tolerance_mm", TOLERANCES_MM)
def test_one_body_of_the_designed_genus_without_slivers(model, tolerance_mm):
    part = model.tessellate(tolerance_mm)
    mesh = trimesh.Trimesh(part.vertices, part.faces, process=False)
    assert mesh.body_count == 1
    assert mesh.euler_number == model.euler_number
    longest = np.linalg.norm(part.triangles - np.roll(part.triangles, 1, axis=1), axis=2).max(axis=1)
    altitude = 2.0 * mesh.area_faces / longest
    assert altitude.min() > 0.05 * tolerance_mm
    assert part.volume > 0


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


@pytest.mark.parametrize("tolerance_mm", TOLERANCES_MM)
def test_no_point_of_a_sphere_or_torus_facet_is_farther_than_the_tolerance(tolerance_mm):
    weights = np.random.default_rng(0).dirichlet([1.0, 1.0, 1.0], 40)
    sphere = np.einsum("wj,fjk->fwk", weights, SPHERE.tessellate(tolerance_mm).triangles)
    assert np.abs(np.linalg.norm(sphere, axis=2) - SPHERE.radius_mm).max() <= tolerance_mm
    torus = np.einsum("wj,fjk->fwk", weights, TORUS.tessellate(tolerance_mm).triangles)
    tube = np.hypot(np.hypot(torus[..., 0], torus[..., 1]) - TORUS.radius_mm, torus[..., 2])
    assert np.abs(tube - TORUS.tube_mm).max() <= tolerance_mm


@EACH_PLAIN
def test_vertices_are_what_a_32_bit_file_keeps(model):
    vertices = model.tessellate(0.3).vertices
    assert np.array_equal(vertices, vertices.astype(np.float32))


@EACH_PLAIN
def test_same_tolerance_same_bytes(model, tmp_path):
    for name in ("a.stl", "b.stl"):
        write_stl(model.tessellate(0.3), tmp_path / name)
    data = (tmp_path / "a.stl").read_bytes()
    assert data == (tmp_path / "b.stl").read_bytes()
    assert len(data) == 84 + 50 * len(model.tessellate(0.3).faces)
    assert not data.startswith(b"solid")


def test_a_finer_tolerance_gives_more_facets_and_never_fewer():
    counts = [len(BLADE.tessellate(t).faces) for t in (1.0, 0.3, 0.1, 0.03)]
    assert counts == sorted(counts)
    # Facets of a doubly curved surface grow as one over the tolerance.
    assert 10 < counts[-1] / counts[0] < 100


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


def test_outline_areas_against_formulas():
    assert circle(3.0, -2.0, 7.0).area(0.0) == pytest.approx(49.0 * math.pi, rel=1e-14)
    ellipse = Outline((arc(1.0, 2.0, 5.0, 3.0, 0.0, 360.0),))
    assert ellipse.area(0.0) == pytest.approx(15.0 * math.pi, rel=1e-14)
    assert rounded_rectangle(5.0, 4.0, 1.0).area(0.0) == pytest.approx(80.0 - 4.0 + math.pi, rel=1e-14)


def test_a_section_at_a_step_is_that_just_above_it():
    at, above, below = BLADE.area(30.0), BLADE.area(30.0 + 1e-9), BLADE.area(30.0 - 1e-9)
    assert at == pytest.approx(above, rel=1e-9)
    assert at < 0.95 * below


# -- the demo part ---------------------------------------------------------------------------------


def test_the_blade_is_a_part_that_the_process_can_build():
    size = BLADE.bounds[1] - BLADE.bounds[0]
    assert 200.0 <= size.max() <= 400.0
    bead_mm = 6.0
    for z in np.arange(0.84, 320.0, 8.0):
        (region,) = BLADE.section(z, 0.01)
        assert region.is_valid
        holes = [shapely.Polygon(ring) for ring in region.interiors]
        assert len(holes) == 3
        outer = shapely.Polygon(region.exterior)
        walls = [hole.distance(outer.boundary) for hole in holes]
        webs = [a.distance(b) for a, b in pairwise(holes)]
        assert min(walls) >= bead_mm
        assert min(webs) >= 2.0 * bead_mm
        # Wide enough for a channel tool, and solid enough somewhere for a hexagon of two beads.
        assert min(math.sqrt(h.area / math.pi) for h in holes) >= 6.0
        assert region.buffer(-0.9 * bead_mm).area > 500.0


def test_the_blade_needs_no_support():
    """Every layer lies within the one below, spread by 34 degrees from the vertical."""
    step_mm = 2.0
    below = BLADE.section(0.0)[0]
    for z in np.arange(step_mm, 320.0, step_mm):
        section = BLADE.section(z)[0]
        held = below.buffer(step_mm * math.tan(math.radians(34.0)))
        assert section.difference(held).area < 1e-6
        below = section


def test_the_blade_changes_from_layer_to_layer_in_its_freeform_half():
    previous = BLADE.section(100.0)[0]
    for z in (150.0, 200.0, 250.0, 300.0):
        section = BLADE.section(z)[0]
        assert section.symmetric_difference(previous).area > 200.0
        previous = section


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

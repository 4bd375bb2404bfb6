"""Reference models: closed meshes that keep their tolerance, and sections that are what they claim."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
import shapely
import trimesh

import ebamcheck
from ebamcheck.errors import SettingsError
from ebamcheck.layers.stack import from_polygons
from ebamcheck_models import (
    BLADE,
    BRACKET,
    CUBE,
    CYLINDER,
    HELICAL_CHANNEL,
    IMPELLER,
    MODELS,
    PRISM,
    SPHERE,
    TORUS,
    Model,
    write_stl,
)
from ebamcheck_models.__main__ import main
from ebamcheck_models.model import SECTION_TOLERANCE_MM
from ebamcheck_models.outlines import Outline, arc, circle, rounded_rectangle
from ebamcheck_models.walls import WalledModel

# One smooth body each; test_reference_models.py holds every model to what is common to all.
PLAIN = [BLADE, BRACKET, CUBE, CYLINDER, HELICAL_CHANNEL, IMPELLER, PRISM, SPHERE, TORUS]
ALL = pytest.mark.parametrize("model", PLAIN, ids=lambda m: m.name)
WALLED = [m for m in PLAIN if isinstance(m, WalledModel)]
TOLERANCES_MM = (2.0, 0.3, 0.05)


def heights_of(model, count, seed=0):
    """Heights all over the model, away from its steps by chance."""
    low, high = model.bounds[:, 2]
    return np.sort(low + (high - low) * np.random.default_rng(seed).uniform(0.001, 0.999, count))


def edges_of(part):
    directed = np.concatenate([part.faces[:, [0, 1]], part.faces[:, [1, 2]], part.faces[:, [2, 0]]])
    return directed.astype(np.int64)


# -- meshes ----------------------------------------------------------------------------------------


@ALL
@pytest.mark.parametrize("tolerance_mm", TOLERANCES_MM)
def test_every_edge_has_one_facet_on_each_side(model, tolerance_mm):
    part = model.tessellate(tolerance_mm)
    edges = edges_of(part)
    key = edges[:, 0] * len(part.vertices) + edges[:, 1]
    reverse = edges[:, 1] * len(part.vertices) + edges[:, 0]
    assert len(np.unique(key)) == len(key)
    assert np.array_equal(np.sort(key), np.sort(reverse))
    assert len(np.unique(part.vertices, axis=0)) == len(part.vertices)
    assert np.array_equal(np.unique(part.faces), np.arange(len(part.vertices)))


@ALL
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


@ALL
def test_volume_of_the_mesh_is_that_of_the_solid_within_tolerance_times_surface(model):
    errors = []
    for tolerance_mm in TOLERANCES_MM:
        part = model.tessellate(tolerance_mm)
        surface = trimesh.Trimesh(part.vertices, part.faces, process=False).area
        errors.append(abs(part.volume - model.volume))
        assert errors[-1] <= tolerance_mm * surface + 1e-6 * model.volume
    assert errors[-1] <= 0.2 * errors[0] + 1e-6 * model.volume


@ALL
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


@ALL
def test_vertices_are_what_a_32_bit_file_keeps(model):
    vertices = model.tessellate(0.3).vertices
    assert np.array_equal(vertices, vertices.astype(np.float32))


@ALL
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
@ALL
def test_a_tolerance_that_no_mesh_can_keep_is_refused(model, wrong):
    with pytest.raises(SettingsError, match="tolerance"):
        model.tessellate(wrong)


# -- sections --------------------------------------------------------------------------------------


@ALL
def test_sections_are_valid_and_have_the_area_that_is_claimed(model):
    for z in heights_of(model, 25):
        polygons = model.section(z)
        assert all(p.is_valid for p in polygons)
        rounding = 1e-9 * model.area(z)
        within = SECTION_TOLERANCE_MM * sum(p.length for p in polygons) + rounding
        assert sum(p.area for p in polygons) == pytest.approx(model.area(z), abs=within)


@pytest.mark.in_turn(4)
@ALL
def test_volume_is_the_integral_of_the_area(model):
    low, high = model.bounds[:, 2]
    z = low + (high - low) * (np.arange(1500) + 0.5) / 1500
    midpoints = sum(model.area(h) for h in z.tolist()) * (high - low) / 1500
    assert midpoints == pytest.approx(model.volume, rel=1e-3)


def test_closed_forms():
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


@ALL
def test_nothing_lies_above_or_below(model):
    low, high = model.bounds[:, 2]
    for z in (low - 0.1, high, high + 0.1):
        assert model.section(float(z)) == []
        assert model.area(float(z)) == pytest.approx(0.0, abs=1e-9)


def test_a_section_at_a_step_is_that_just_above_it():
    at, above, below = BLADE.area(30.0), BLADE.area(30.0 + 1e-9), BLADE.area(30.0 - 1e-9)
    assert at == pytest.approx(above, rel=1e-9)
    assert at < 0.95 * below


@pytest.mark.parametrize("model", [BLADE, PRISM, SPHERE, TORUS], ids=lambda m: m.name)
def test_sections_of_ever_finer_meshes_go_to_the_exact_section(model):
    heights = heights_of(model, 12, seed=3)
    exact = from_polygons(heights, [model.section(z, 1e-4) for z in heights])
    depths = []
    for tolerance_mm in (1.0, 0.1):
        cut = ebamcheck.slice(model.tessellate(tolerance_mm), heights)
        assert np.array_equal(cut.ring_counts(), exact.ring_counts())
        regions = [shapely.union_all(cut.polygons(k)) for k in range(len(heights))]
        wanted = [shapely.union_all(exact.polygons(k)) for k in range(len(heights))]
        missing = [w.symmetric_difference(r).area / w.length for w, r in zip(wanted, regions, strict=True)]
        depths.append(max(missing))
        assert cut.areas() == pytest.approx([r.area for r in regions], rel=1e-9)
    assert depths[0] < 1.5
    assert depths[1] < 0.15 * max(depths[0], 0.1)


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


@ALL
def test_a_file_reads_back_as_the_same_mesh(model, tmp_path):
    part = model.tessellate(0.5)
    write_stl(part, tmp_path / "m.stl")
    again = ebamcheck.load(tmp_path / "m.stl")
    assert np.array_equal(again.triangles, part.triangles)
    assert len(again.vertices) == len(part.vertices)


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


@ALL
def test_every_model_keeps_the_protocol_and_its_name(model):
    assert isinstance(model, Model)
    assert MODELS[model.name] is model
    assert model.summary
    assert model.tessellate(2.0).name == model.name

"""The surface behind a mesh: its regions, exact forms where the vertices tell them, and whether vertices lie on it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from command_line import ebamcheck, write_stl

from benchmarks.chance_curves import Case, _over_a_cube, judge
from benchmarks.curve_parts import AXES_MM, CAD, RING_MM, TUBE_MM, _torus, heights_of, part_of
from benchmarks.curve_parts_meshes import (
    as_file,
    bored,
    decimated,
    irregular_convex,
    irregular_torus,
    noisy,
    quadric_decimated,
    split_edges,
    turned,
)
from benchmarks.curve_parts_solids import Bow, Triangles, extruded, frustum, lathe, regular_prism, wedge
from ebamcheck.curves import fit
from ebamcheck.curves.fitting import ungated
from ebamcheck.curves.gate import Slack, gated
from ebamcheck.curves.lifting import FLATTEST_SURFACE, Lifting
from ebamcheck.curves.oriented_contours import NO_PLANE
from ebamcheck.curves.sections import on_both, on_one
from ebamcheck.kernels import Floats
from ebamcheck.layers.stack import Layers
from ebamcheck.mesh.part import Part
from ebamcheck.settings.stages import CurveSettings
from ebamcheck.slicers.slicing import slice_part
from ebamcheck.surface.exact_forms import (
    CONE,
    CYLINDER,
    FLAT,
    KIND,
    NAMES,
    OWN,
    PLACE,
    QUADRIC,
    SIDE,
    SIZE,
    SPHERE,
    TORUS,
    signed_distance,
    signed_distances,
    told_forms,
)
from ebamcheck.surface.exact_surfaces import ExactSurfaces
from ebamcheck.surface.offsets import LARGEST_OFFSET
from ebamcheck.surface.part_surface import surface_of
from ebamcheck.surface.planes import coordinate_error_mm, plane_tolerance_mm
from ebamcheck.surface.regions import FREEFORM
from ebamcheck.surface.surfaces import surfaces

SETTINGS = CurveSettings()
BOX = frustum((35.0, 25.0), (35.0, 25.0), 20.0, 2.5)
BOSS = lathe(
    [
        *((0.0, 0.0), (28.0, 0.0), Bow(28.0, 1.5, 1.5, -90.0, 0.0), (29.5, 5.0), (20.0, 5.0)),
        *(Bow(20.0, 11.0, 6.0, 270.0, 180.0), (14.0, 38.0), (0.0, 38.0)),
    ]
)
"""Turned part: a cylinder that a fillet leads into a flange, with rounded rims."""


def on_ellipsoid(u: Floats) -> Floats:
    return np.asarray(u * AXES_MM)


def ellipsoid(points: int = 2000) -> Triangles:
    return irregular_convex(on_ellipsoid, points, 5)


def torus(points: int = 2000) -> Triangles:
    return irregular_torus(_torus, points, 1)


def placed(mesh: Triangles, seed: int = 0, kept: str = "float64") -> Part:
    return part_of(as_file(turned(mesh, seed), kept), "part")


def places_of(layers: Layers, points: Floats) -> Floats:
    """Points of layers with their heights, (P, 3)."""
    heights = np.repeat(np.repeat(layers.heights, np.diff(layers.layer_starts)), np.diff(layers.ring_starts))
    return np.column_stack([points, heights])


# -- regions ---------------------------------------------------------------------------------------------


def kinds_of(part: Part) -> dict[str, int]:
    found = surfaces(part, SETTINGS)
    return {kind: sum(s.kind == kind for s in found) for kind in {s.kind for s in found}}


@pytest.mark.parametrize(("seed", "kept"), [(0, "float64"), (11, "float64"), (12, "float32"), (0, "ascii4")])
def test_planes_and_cylinders_of_a_rounded_box_are_found(seed: int, kept: str) -> None:
    found = kinds_of(placed(BOX(0.02), seed, kept))
    assert (found["plane"], found["cylinder"]) == (6, 12)


def test_surfaces_hold_every_facet_once_and_their_area() -> None:
    part = placed(CAD["bracket"](0.05), 3, "float32")
    found = surfaces(part, SETTINGS)
    assert np.array_equal(np.sort(np.concatenate([s.facets for s in found])), np.arange(len(part.faces)))
    a, b, c = np.moveaxis(part.triangles, 1, 0)
    total = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()
    assert sum(s.area_mm2 for s in found) == pytest.approx(total)
    radii = sorted(float(s.figure.split()[1]) for s in found if s.kind == "cylinder")
    assert radii == pytest.approx([1.0, 1.0, 1.8, 1.8, 3.0, 3.0, 4.0, 6.0], abs=1e-4)


def test_a_frustum_is_a_cone_between_two_planes() -> None:
    found = surfaces(placed(lathe([(0.0, 0.0), (22.0, 0.0), (9.0, 35.0), (0.0, 35.0)])(0.05)), SETTINGS)
    assert sorted(s.kind for s in found) == ["cone", "plane", "plane"]
    cone = next(s for s in found if s.kind == "cone")
    assert cone.figure == f"half angle {np.degrees(np.arctan(13 / 35)):.4g} degrees"


@pytest.mark.parametrize("noise_mm", [0.02, 0.1])
def test_the_noise_of_a_freeform_patch_is_told(noise_mm: float) -> None:
    patch = max(surfaces(placed(noisy(torus(3000), noise_mm, 1)), SETTINGS), key=lambda s: len(s.facets))
    assert patch.kind == "freeform"
    assert 0.3 * noise_mm < float(patch.figure.split()[1]) < 3.0 * noise_mm


@pytest.mark.parametrize(("off_mm", "is_bar"), [(0.0, True), (1e-5, True), (0.01, False)])
def test_a_vertex_off_its_plane_by_more_than_the_rounding_is_seen(off_mm: float, is_bar: bool) -> None:
    bar = regular_prism(4, 40.0, 30.0)(1.0)
    assert (kinds_of(placed(split_edges(bar, 3, off_mm, 1))) == {"plane": 6}) is is_bar


def test_decimals_and_bits_tell_the_tolerance() -> None:
    mesh = turned(CAD["bracket"](0.05), 3)
    rounded = Triangles(np.round(mesh.vertices, 3), mesh.faces)
    assert coordinate_error_mm(placed(mesh, kept="ascii4")) == pytest.approx(5e-5)
    assert coordinate_error_mm(placed(rounded, kept="float32")) == pytest.approx(5e-4)
    assert coordinate_error_mm(placed(mesh, kept="float32")) < 1e-5
    assert plane_tolerance_mm(placed(mesh, kept="float32")) == pytest.approx(5e-5)


def test_points_of_planes_stay_and_say_so() -> None:
    part = placed(BOX(0.05), 11, "float32")
    cut = slice_part(part, part.bounds[0, 2] + np.array([8.0, 15.0, 22.0]))
    sides = Lifting(surface_of(part, SETTINGS)).lift(cut)
    inside = (sides.plane_before != NO_PLANE) & (sides.plane_after == sides.plane_before)
    assert inside.any()
    assert np.array_equal(sides.points[inside], cut.points[inside])
    moved = np.hypot(*(sides.points - cut.points).T)
    assert 0.01 < moved.max() <= 0.05 / FLATTEST_SURFACE  # the chord error of the mesh


def test_inspect_lists_and_draws_regions(tmp_path: Path) -> None:
    file, picture = tmp_path / "box.stl", tmp_path / "regions.svg"
    part = placed(BOX(0.05))
    write_stl(part, file)
    told = ebamcheck("inspect", file, "--regions", "--picture", picture, cwd=tmp_path)
    assert "cylinder       12 regions" in told.stdout
    assert "cylinder (12)" in picture.read_text(encoding="utf-8")
    listed = json.loads(ebamcheck("inspect", file, "--regions", "--json", cwd=tmp_path).stdout)["regions"]
    assert sum(r["facets"] for r in listed) == len(part.faces)
    refused = ebamcheck("inspect", file, "--picture", picture, cwd=tmp_path)
    assert refused.returncode == 2
    assert "give --regions" in refused.stderr


# -- exact forms -----------------------------------------------------------------------------------------


def form(kind: int, place: tuple[float, float, float], *own: float) -> Floats:
    row = np.zeros(SIZE)
    row[KIND], row[PLACE : PLACE + 3], row[SIDE] = kind, place, 1.0
    row[OWN : OWN + len(own)] = own
    return row


FORMS = {
    "sphere": form(SPHERE, (1.0, -2.0, 3.0), 5.0),
    "cylinder": form(CYLINDER, (1.0, 2.0, 0.0), 0.0, 0.6, 0.8, 4.0),
    "cone": form(CONE, (0.0, 1.0, -2.0), 0.6, 0.0, 0.8, np.cos(0.4), np.sin(0.4)),
    "torus": form(TORUS, (0.0, 0.0, 1.0), 0.8, 0.6, 0.0, 9.0, 2.5),
    "plane": form(FLAT, (0.0, 0.0, 1.0), 0.0, 0.6, 0.8),
    "quadric": form(QUADRIC, (2.0, 0.0, 0.0), *(AXES_MM**-2.0), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0),
}


@pytest.mark.parametrize("name", FORMS)
def test_distances_grow_along_their_gradient(name: str) -> None:
    row, step = FORMS[name], 1e-6
    for p in np.random.default_rng(1).uniform(-15.0, 15.0, (50, 3)):
        off, *gradient = signed_distance(row, *p)
        assert np.linalg.norm(gradient) == pytest.approx(1.0)
        if name == "quadric" and abs(off) > 1.0:
            continue  # to first order only
        ahead = signed_distance(row, *(p + step * np.array(gradient)))[0]
        assert (ahead - off) / step == pytest.approx(1.0, abs=0.15 if name == "quadric" else 1e-5)


@pytest.mark.parametrize("name", FORMS)
def test_a_section_is_met_in_its_layer(name: str) -> None:
    row = FORMS[name]
    rng = np.random.default_rng(3)
    met = 0
    for p in rng.uniform(-15.0, 15.0, (200, 3)) * (2.0 if name == "quadric" else 1.0):
        if abs(signed_distance(row, *p)[0]) > 0.3:
            continue
        (known,), ((x, y),) = on_one(row[None], p[None])
        met += known
        assert not known or abs(signed_distance(row, x, y, p[2])[0]) <= 1e-10
    assert met > 0


def test_two_sections_meet_in_a_common_place() -> None:
    cylinder, plane = (
        form(CYLINDER, (0.0, 0.0, 0.0), 0.0, 0.0, 1.0, 5.0),
        form(FLAT, (3.0, 0.0, 0.0), 1.0, 0.0, 0.0),
    )
    known, places = on_both(cylinder[None], plane[None], np.array([[2.98, 4.01, 7.0]]))
    assert known.all()
    assert places[0] == pytest.approx([3.0, 4.0])


# -- what vertices tell -------------------------------------------------------------------------------------


def found_in(part: Part) -> ExactSurfaces:
    return surface_of(part, SETTINGS).exact


def kinds_in(part: Part) -> list[str]:
    return sorted(NAMES[int(row[KIND])] for row in found_in(part).rows if row[KIND] != FLAT)


@pytest.mark.in_turn(5)
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("kept", ["float64", "float32", "ascii4"])
def test_an_ellipsoid_of_random_points_is_one_quadric(seed: int, kept: str) -> None:
    part = placed(ellipsoid(), seed, kept)
    assert kinds_in(part) == ["quadric"]
    assert (found_in(part).label >= 0).mean() > 0.99


@pytest.mark.parametrize("seed", range(2))
def test_a_torus_of_random_points_has_its_radii(seed: int) -> None:
    (row,) = (r for r in found_in(placed(torus(), seed, "float32")).rows if r[KIND] != FLAT)
    assert int(row[KIND]) == TORUS
    assert np.abs(row[OWN + 3 : OWN + 5]) == pytest.approx([RING_MM, TUBE_MM], abs=1e-4)


@pytest.mark.parametrize(("seed", "slivers"), [(0, 0), (12, 0), (12, 120)])
def test_a_rounded_box_is_planes_cylinders_and_spheres(seed: int, slivers: int) -> None:
    part = placed(split_edges(BOX(0.05), slivers, 1e-5, 1), seed, "float32")
    assert kinds_in(part) == ["cylinder"] * 12 + ["sphere"] * 8
    normals = surface_of(part, SETTINGS)
    assert (normals.exact.label[normals.kind != 1] >= 0).mean() > (0.99 if slivers else 0.9999)


def test_a_turned_part_is_cylinders_and_tori() -> None:
    assert kinds_in(placed(BOSS(0.05), 3)) == ["cylinder", "cylinder", "torus", "torus"]


def test_a_bore_through_facets_is_a_cylinder_though_its_seam_is_off_the_wall() -> None:
    pin = lathe([(0.0, -60.0), (5.0, -60.0), (5.0, 60.0), (0.0, 60.0)])
    wall = lathe([(0.0, 0.0), (20.0, 0.0), (20.0, 40.0), (0.0, 40.0)])
    lying = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    part = placed(bored(wall, pin, np.array([0.0, 0.0, 20.0]), lying)(0.05))
    radii = sorted(row[OWN + 3] for row in found_in(part).rows if row[KIND] == CYLINDER)
    assert radii == pytest.approx([5.0, 20.0], abs=1e-4)


def test_the_order_of_facets_changes_no_surface() -> None:
    part = placed(BOX(0.05), 11, "float32")
    order = np.random.default_rng(1).permutation(len(part.faces))
    both = part, Part(part.vertices, np.ascontiguousarray(np.roll(part.faces[order], 1, axis=1)))
    kinds = [e.rows[:, KIND][e.label] for e in map(found_in, both)]
    assert np.array_equal(kinds[0][order], kinds[1])
    one, other = (sorted((s.kind, len(s.facets), round(s.area_mm2, 6)) for s in surfaces(p, SETTINGS)) for p in both)
    assert one == other


# -- what they do not tell ----------------------------------------------------------------------------------


def test_two_rims_do_not_tell_what_lies_between() -> None:
    angle = np.arange(24) * np.pi / 12.0
    rims = [
        np.column_stack([9.0 * np.cos(angle + s), 9.0 * np.sin(angle + s), z + 0.0 * angle])
        for s, z in ((0.0, 0.0), (0.05, 12.0))
    ]
    points = np.concatenate(rims)
    assert list(told_forms(points, points, points / np.linalg.norm(points, axis=1)[:, None], 1e-4)) == []


@pytest.mark.parametrize("sides", [9, 24])
def test_a_polygon_is_no_cylinder(sides: int) -> None:
    assert kinds_in(placed(regular_prism(sides, 20.0, 30.0)(1.0))) == []


@pytest.mark.parametrize("noise_mm", [0.005, 0.05])
def test_noise_is_no_surface(noise_mm: float) -> None:
    for mesh in (ellipsoid(), torus()):
        assert kinds_in(placed(noisy(mesh, noise_mm, 1))) == []


def test_a_flat_whose_ends_lie_on_a_shaft_stays_flat() -> None:
    angle = np.arange(1, 72) * np.pi / 36.0  # every 5 degrees, but for a flat side of 30
    ring = 10.0 * np.column_stack([np.cos(angle), np.sin(angle)])
    mesh = extruded([ring[(angle < np.deg2rad(100.0)) | (angle > np.deg2rad(129.0))]], 30.0)
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    flat = (normals[:, 2] == 0.0) & (np.linalg.norm(normals, axis=1) > 100.0)
    assert flat.sum() == 2
    exact = found_in(placed(mesh, 2))
    curved = np.isin(exact.label, np.flatnonzero(exact.rows[:, KIND] != FLAT))
    assert curved.any()
    assert not curved[flat].any()


# -- contours -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(2))
def test_points_of_an_ellipsoid_lie_on_it(seed: int) -> None:
    part = placed(ellipsoid(1000), seed)
    cut = slice_part(part, heights_of(part, 5))
    lifting = Lifting(surface_of(part, SETTINGS))
    sides = lifting.lift(cut)
    row = next(r for r in lifting.surface.exact.rows if r[KIND] == QUADRIC)
    on = (sides.form_before >= 0) & (sides.form_after >= 0)
    assert on.mean() > 0.95
    lifted, cuts = (places_of(cut, points)[on] for points in (sides.points, cut.points))
    assert np.abs(signed_distances(row[None], lifted)[:, 0]).max() < 1e-9
    assert np.abs(signed_distances(row[None], cuts)[:, 0]).max() > 0.05


@pytest.mark.parametrize("seed", range(2))
def test_curves_of_a_scattered_ellipsoid_keep_to_it_within_their_tolerance(seed: int) -> None:
    part = placed(ellipsoid(1500), seed)
    (row,) = (r for r in found_in(part).rows if r[KIND] == QUADRIC)
    curves = fit(slice_part(part, heights_of(part, 8)[2:-2]), part=part, tolerance_mm=0.002)
    assert curves.evidence is not None
    assert curves.evidence.accepted.all()
    sampled = curves.sampled_rings(0.001)
    lifted = np.repeat(curves.evidence.method == 0, np.diff(sampled.ring_starts))
    assert lifted.mean() > 0.5
    heights = np.repeat(np.repeat(curves.heights, np.diff(curves.layer_starts)), np.diff(sampled.ring_starts))
    off = signed_distances(row[None], np.column_stack([sampled.points, heights])[lifted])
    slope = np.hypot(off[:, 1], off[:, 2])
    assert (np.abs(off[:, 0]) / slope)[slope > 0.3].max() < 0.003


def test_a_crease_beside_a_plane_is_a_section_of_both() -> None:
    part = placed(BOSS(0.1), 5)
    cut = slice_part(part, heights_of(part, 7))
    lifting = Lifting(surface_of(part, SETTINGS))
    sides = lifting.lift(cut)
    one_form = (sides.form_before >= 0) ^ (sides.form_after >= 0)
    sharp = ~sides.smooth & one_form & ~np.isnan(sides.before[:, 0])
    sharp &= (sides.before * sides.after).sum(axis=1) < np.cos(np.deg2rad(6.0))
    assert sharp.any()
    rows = lifting.surface.exact.rows[np.maximum(sides.form_before, sides.form_after)[sharp]]
    for row, place in zip(rows, places_of(cut, sides.points)[sharp], strict=True):
        assert abs(signed_distance(row, *place)[0]) < 1e-9


def test_a_surface_that_the_turns_of_the_mesh_do_not_bear_out_is_refused() -> None:
    part = placed(torus(3000), 1)
    cut = slice_part(part, heights_of(part, 4))
    surface = surface_of(part, SETTINGS)
    wrong = surface.exact.rows.copy()
    wrong[:, OWN + 4] += 5.0  # a tube thicker by 5 mm
    fallen = []
    for rows in (surface.exact.rows, wrong):
        lifting = Lifting(surface._replace(exact=surface.exact._replace(rows=rows)))
        made = ungated("bounded", cut, SETTINGS, lifting)
        curves = gated(made, cut, lifting.allowed(cut), Slack(0.022, 0.002))
        assert curves.evidence is not None
        fallen.append((curves.evidence.method > 0).mean())
    assert fallen[0] < 0.5
    assert fallen[1] == 1.0


# -- whether vertices lie on the surface --------------------------------------------------------------------


def grid(n: int) -> Triangles:
    return _over_a_cube(on_ellipsoid, n)


def collapsed() -> Triangles:
    """Collapses to the best place for planes leave vertices beyond the surface."""
    mesh = quadric_decimated(grid(12), 0.25)
    assert np.mean(np.linalg.norm(mesh.vertices / AXES_MM, axis=1) > 1.0) > 0.9
    return mesh


MESHES = {
    "rows of a tessellator": (lambda: grid(12), 1.0),
    "rows with vertices that split edges": (lambda: split_edges(grid(12), 120, 1e-5, 3), 1.0),
    "scattered points of a surface": (lambda: irregular_convex(on_ellipsoid, 300, 3), 1.0),
    "vertices that collapses left on the surface": (lambda: decimated(grid(16), 0.2), 1.0),
    "vertices beyond the surface": (collapsed, 0.5),
    "a solid after many collapses": (lambda: quadric_decimated(wedge(40.0, 30.0, 20.0, 4.0)(0.1), 0.25), 0.0),
    "a few vertices of a cone": (lambda: lathe([(0.0, 0.0), (20.0, 0.0), (0.0, 40.0)])(0.1), 1.0),
}
"""Meshes, and the share of its lift that a vertex of them gets."""


@pytest.mark.parametrize("name", MESHES)
def test_vertices_are_lifted_as_far_as_they_lie_on_the_surface(name: str) -> None:
    mesh, share = MESHES[name]
    surface = surface_of(placed(mesh()), SETTINGS)
    found = surface.offsets
    assert found.lift_share == share
    assert Lifting(surface).limits.share[FREEFORM] == share
    if "rows" in name:
        assert found.in_rows > 0.85
    if "scattered" in name:
        assert found.in_rows < 0.4
        assert found.offset < 0.05 < LARGEST_OFFSET
    if "beyond" in name:
        assert found.offset > LARGEST_OFFSET


def test_half_of_a_lift_is_nearer_where_vertices_stand_beyond_the_surface() -> None:
    truth = part_of(grid(60), "truth")
    verdict = judge(Case("ellipsoid by quadrics", "by quadrics", placed(collapsed()), truth, 2e-3))
    assert verdict.held, str(verdict)
    assert verdict.gain > 0.5, str(verdict)

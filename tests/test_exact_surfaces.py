"""Exact surfaces: found where the vertices tell them, nowhere else, and contours then lie on their sections."""

from __future__ import annotations

import numpy as np
import pytest
from curve_parts import (
    as_decimals,
    as_float32,
    extruded,
    noisy,
    polygon,
    rounded_box,
    scattered_torus,
    split_edges,
    turned,
)

from benchmarks.curve_parts_meshes import bored, irregular_convex
from benchmarks.curve_parts_solids import Bow, lathe
from ebamcheck.curves import fit
from ebamcheck.curves.fitting import ungated
from ebamcheck.curves.gate import Slack, gated
from ebamcheck.curves.lifting import Lifting
from ebamcheck.curves.sections import on_both, on_one
from ebamcheck.kernels import Floats
from ebamcheck.mesh.part import Part, from_arrays
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
from ebamcheck.surface.part_surface import surface_of

SETTINGS = CurveSettings()
AXES_MM = np.array([30.0, 20.0, 25.0])


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


def found_in(part: Part) -> ExactSurfaces:
    return surface_of(part, SETTINGS).exact


def kinds_in(part: Part) -> list[str]:
    return sorted(NAMES[int(row[KIND])] for row in found_in(part).rows if row[KIND] != FLAT)


def ellipsoid(points: int = 2000) -> Part:
    mesh = irregular_convex(lambda u: u * AXES_MM, points, 5)
    return from_arrays(mesh.vertices, mesh.faces)


def boss(chord_mm: float) -> Part:
    """Turned part: a cylinder that a fillet leads into a flange, with rounded rims."""
    profile = [(0.0, 0.0), (28.0, 0.0), Bow(28.0, 1.5, 1.5, -90.0, 0.0), (29.5, 5.0), (20.0, 5.0)]
    profile += [Bow(20.0, 11.0, 6.0, 270.0, 180.0), (14.0, 38.0), (0.0, 38.0)]
    mesh = lathe(profile)(chord_mm)
    return from_arrays(mesh.vertices, mesh.faces)


# -- forms ---------------------------------------------------------------------------------------------------


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


@pytest.mark.parametrize("name", ["sphere", "cylinder", "cone", "torus", "plane"])
def test_a_point_moved_by_its_distance_lies_on_the_surface(name: str) -> None:
    row = FORMS[name]
    for p in np.random.default_rng(2).uniform(-12.0, 12.0, (50, 3)):
        off, *gradient = signed_distance(row, *p)
        if name == "cone" and (p - row[PLACE : PLACE + 3]) @ row[OWN : OWN + 3] < 8.0:
            continue  # behind the tip the nearest place is the tip
        assert abs(signed_distance(row, *(p - off * np.array(gradient)))[0]) < 1e-9


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


@pytest.mark.in_turn(5)
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("kind", ["float64", "float32", "ascii"])
def test_an_ellipsoid_of_random_points_is_one_quadric(seed: int, kind: str) -> None:
    part = turned(ellipsoid(), seed)
    part = {"float64": part, "float32": as_float32(part), "ascii": as_decimals(part)}[kind]
    assert kinds_in(part) == ["quadric"]
    assert (found_in(part).label >= 0).mean() > 0.99


@pytest.mark.parametrize("seed", range(4))
def test_a_torus_of_random_points_has_its_radii(seed: int) -> None:
    exact = found_in(as_float32(turned(scattered_torus(2000), seed)))
    (row,) = (r for r in exact.rows if r[KIND] != FLAT)
    assert int(row[KIND]) == TORUS
    assert np.abs(row[OWN + 3 : OWN + 5]) == pytest.approx([30.0, 12.0], abs=1e-4)


@pytest.mark.parametrize("seed", range(3))
def test_a_rounded_box_is_planes_cylinders_and_spheres(seed: int) -> None:
    part = as_float32(turned(rounded_box([60, 40, 30], 2.5, 0.05), seed))
    assert kinds_in(part) == ["cylinder"] * 12 + ["sphere"] * 8
    normals = surface_of(part, SETTINGS)
    assert (normals.exact.label[normals.kind != 1] >= 0).all()


def test_slivers_are_of_the_surface_about_them() -> None:
    part = as_float32(turned(split_edges(rounded_box([60, 40, 30], 5.0, 0.05), 120, 1e-5), 2))
    assert kinds_in(part) == ["cylinder"] * 12 + ["sphere"] * 8
    normals = surface_of(part, SETTINGS)
    assert (normals.exact.label[normals.kind != 1] >= 0).mean() > 0.99


def test_a_turned_part_is_cylinders_and_tori() -> None:
    assert kinds_in(turned(boss(0.05), 3)) == ["cylinder", "cylinder", "torus", "torus"]


def test_a_bore_through_facets_is_a_cylinder_though_its_seam_is_off_the_wall() -> None:
    pin = lathe([(0.0, -60.0), (5.0, -60.0), (5.0, 60.0), (0.0, 60.0)])
    wall = lathe([(0.0, 0.0), (20.0, 0.0), (20.0, 40.0), (0.0, 40.0)])
    lying = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    mesh = bored(wall, pin, np.array([0.0, 0.0, 20.0]), lying)(0.05)
    part = from_arrays(mesh.vertices, mesh.faces)
    radii = sorted(row[OWN + 3] for row in found_in(part).rows if row[KIND] == CYLINDER)
    assert radii == pytest.approx([5.0, 20.0], abs=1e-4)


# -- what they do not tell ----------------------------------------------------------------------------------


def test_two_rims_do_not_tell_what_lies_between() -> None:
    angle = np.arange(24) * np.pi / 12.0
    rims = [
        np.column_stack([9.0 * np.cos(angle + s), 9.0 * np.sin(angle + s), z + 0.0 * angle])
        for s, z in ((0.0, 0.0), (0.05, 12.0))
    ]
    points = np.concatenate(rims)
    assert list(told_forms(points, points, points / np.linalg.norm(points, axis=1)[:, None], 1e-4)) == []


@pytest.mark.parametrize("sides", [9, 12, 16, 24])
def test_a_polygon_is_no_cylinder(sides: int) -> None:
    assert kinds_in(extruded([polygon(sides, 20.0)], 30.0)) == []


@pytest.mark.parametrize("noise_mm", [0.005, 0.05])
def test_noise_is_no_surface(noise_mm: float) -> None:
    for part in (ellipsoid(), scattered_torus(2000)):
        assert kinds_in(noisy(part, noise_mm)) == []


def test_a_flat_whose_ends_lie_on_a_shaft_stays_flat() -> None:
    angle = np.arange(1, 72) * np.pi / 36.0  # every 5 degrees, but for 35 degrees of a flat side
    ring = 10.0 * np.column_stack([np.cos(angle), np.sin(angle)])
    kept = (angle < np.deg2rad(100.0)) | (angle > np.deg2rad(129.0))
    part = turned(extruded([ring[kept]], 30.0), 2)
    exact = found_in(part)
    curved = np.isin(exact.label, np.flatnonzero(exact.rows[:, KIND] != FLAT))
    a, b, c = (part.vertices[part.faces[:, k]] for k in range(3))
    widest = np.sort(np.linalg.norm(np.cross(b - a, c - a), axis=1))
    flat = np.linalg.norm(np.cross(b - a, c - a), axis=1) >= 0.5 * 10.0 * np.deg2rad(25.0) * 30.0
    assert flat.any()
    assert widest[-1] > 0.0
    assert curved.any()
    assert not (curved & flat & ~np.isclose(np.abs(turned_axis(part, a, b, c)), 1.0)).any()


def turned_axis(part: Part, a: Floats, b: Floats, c: Floats) -> Floats:
    """Cosine between facets' normals and the axis of an extrusion, the direction of its longest edges."""
    edges = np.concatenate([b - a, c - b, a - c])
    lengths = np.linalg.norm(edges, axis=1)
    normals = np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    axis = edges[np.isclose(lengths, 30.0)][0] / 30.0
    return np.asarray(normals @ axis)


# -- contours -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(3))
def test_points_of_an_ellipsoid_lie_on_it(seed: int) -> None:
    part = turned(ellipsoid(1000), seed)
    low, high = part.bounds[:, 2]
    cut = slice_part(part, np.linspace(low, high, 7)[1:-1])
    lifting = Lifting(surface_of(part, SETTINGS))
    sides = lifting.lift(cut)
    heights = np.repeat(np.repeat(cut.heights, np.diff(cut.layer_starts)), np.diff(cut.ring_starts))
    row = next(r for r in lifting.surface.exact.rows if r[KIND] == QUADRIC)
    on = (sides.form_before >= 0) & (sides.form_after >= 0)
    assert on.mean() > 0.95
    assert (
        np.abs(signed_distances(row[None], np.column_stack([sides.points, heights])[on])[:, 0]).max() < 1e-9
    )
    assert np.abs(signed_distances(row[None], np.column_stack([cut.points, heights])[on])[:, 0]).max() > 0.05


@pytest.mark.parametrize("seed", range(5))
def test_curves_of_a_scattered_torus_keep_to_it_within_their_tolerance(seed: int) -> None:
    part = turned(scattered_torus(1500), seed)
    (row,) = (r for r in found_in(part).rows if r[KIND] == TORUS)
    low, high = part.bounds[:, 2]
    cut = slice_part(part, np.linspace(low, high, 8)[2:-2])
    curves = fit(cut, part=part, tolerance_mm=0.002)
    assert curves.evidence is not None
    assert curves.evidence.accepted.all()
    sampled = curves.sampled_rings(0.001)
    lifted = np.repeat(curves.evidence.method == 0, np.diff(sampled.ring_starts))
    assert lifted.mean() > 0.5
    heights = np.repeat(np.repeat(curves.heights, np.diff(curves.layer_starts)), np.diff(sampled.ring_starts))
    places = np.column_stack([sampled.points, heights])[lifted]
    slope = np.array([np.hypot(*signed_distance(row, *p)[1:3]) for p in places])
    assert (np.abs(signed_distances(row[None], places)[:, 0]) / slope)[slope > 0.3].max() < 0.003


def test_a_crease_beside_a_plane_is_a_section_of_both() -> None:
    part = turned(boss(0.1), 5)
    low, high = part.bounds[:, 2]
    cut = slice_part(part, np.linspace(low, high, 9)[1:-1])
    lifting = Lifting(surface_of(part, SETTINGS))
    sides = lifting.lift(cut)
    sharp = (
        ~sides.smooth & ((sides.form_before >= 0) ^ (sides.form_after >= 0)) & ~np.isnan(sides.before[:, 0])
    )
    sharp &= (sides.before * sides.after).sum(axis=1) < np.cos(np.deg2rad(6.0))
    assert sharp.any()
    heights = np.repeat(np.repeat(cut.heights, np.diff(cut.layer_starts)), np.diff(cut.ring_starts))
    for i in np.flatnonzero(sharp):
        form_number = max(sides.form_before[i], sides.form_after[i])
        assert (
            abs(signed_distance(lifting.surface.exact.rows[form_number], *sides.points[i], heights[i])[0])
            < 1e-9
        )


def test_the_order_of_facets_changes_no_surface() -> None:
    part = as_float32(turned(rounded_box([60, 40, 30], 2.5, 0.05), 1))
    order = np.random.default_rng(1).permutation(len(part.faces))
    shuffled = Part(part.vertices, np.ascontiguousarray(np.roll(part.faces[order], 1, axis=1)))
    one, other = found_in(part), found_in(shuffled)
    of_facet = [e.rows[:, KIND][e.label] for e in (one, other)]
    assert np.array_equal(of_facet[0][order], of_facet[1])


def test_a_surface_that_the_turns_of_the_mesh_do_not_bear_out_is_refused() -> None:
    part = turned(scattered_torus(3000), 1)
    low, high = part.bounds[:, 2]
    cut = slice_part(part, np.linspace(low, high, 6)[1:-1])
    surface = surface_of(part, SETTINGS)
    wrong = surface.exact.rows.copy()
    wrong[:, OWN + 4] += 5.0  # a tube thicker by 5 mm
    slack = Slack(0.022, 0.002)
    fallen = []
    for rows in (surface.exact.rows, wrong):
        lifting = Lifting(surface._replace(exact=surface.exact._replace(rows=rows)))
        curves = gated(ungated("bounded", cut, SETTINGS, lifting), cut, lifting.allowed(cut), slack)
        assert curves.evidence is not None
        fallen.append((curves.evidence.method > 0).mean())
    assert fallen[0] < 0.5
    assert fallen[1] == 1.0

"""Whether vertices lie on the surface that their mesh stands for is told from the mesh alone, and lifts follow that."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.chance_curves import Case, _over_a_cube, judge
from benchmarks.curve_parts import part_of
from benchmarks.curve_parts_meshes import decimated, irregular_convex, quadric_decimated, split_edges
from benchmarks.curve_parts_solids import Triangles, lathe, wedge
from ebamcheck.curves.lifting import Lifting
from ebamcheck.mesh.part import Part
from ebamcheck.settings.stages import CurveSettings
from ebamcheck.surface.offsets import LARGEST_OFFSET, Offsets
from ebamcheck.surface.part_surface import surface_of
from ebamcheck.surface.regions import FREEFORM

AXES_MM = np.array([30.0, 20.0, 25.0])


def on_ellipsoid(u: np.ndarray) -> np.ndarray:
    return u * AXES_MM


def grid(n: int) -> Triangles:
    return _over_a_cube(on_ellipsoid, n)


def offsets(mesh: Triangles) -> Offsets:
    return surface_of(part_of(mesh, "mesh"), CurveSettings()).offsets


def outside_mm(mesh: Triangles) -> np.ndarray:
    """How far vertices stand outside of the ellipsoid, nearly."""
    return 20.0 * (np.linalg.norm(mesh.vertices / AXES_MM, axis=1) - 1.0)


@pytest.fixture(scope="module")
def quadric() -> Triangles:
    return quadric_decimated(grid(12), 0.25)


def test_rows_of_a_tessellator_are_evidence() -> None:
    found = offsets(grid(12))
    assert found.in_rows > 0.95
    assert found.lift_share == 1.0


def test_vertices_that_split_edges_do_not_hide_the_rows() -> None:
    mesh = split_edges(grid(12), 120, 1e-5, 3)
    six = np.bincount(np.bincount(mesh.faces.reshape(-1)))[6] / len(mesh.vertices)
    found = offsets(mesh)
    assert six < 0.8 < 0.85 <= found.in_rows
    assert found.lift_share == 1.0


@pytest.mark.parametrize("points", [300, 1500])
def test_scattered_points_of_a_surface_are_known_to_lie_on_it(points: int) -> None:
    found = offsets(irregular_convex(on_ellipsoid, points, 3))
    assert found.in_rows < 0.4
    assert found.told >= 100
    assert found.offset < 0.05 < LARGEST_OFFSET
    assert found.lift_share == 1.0


def test_collapses_onto_vertices_that_are_left_leave_them_on_the_surface() -> None:
    mesh = decimated(grid(16), 0.2)
    assert np.abs(outside_mm(mesh)).max() < 1e-9
    assert offsets(mesh).lift_share == 1.0


def test_collapses_to_the_best_place_for_planes_leave_vertices_beyond_the_surface(quadric: Triangles) -> None:
    out = outside_mm(quadric)
    assert np.mean(out > 0.0) > 0.9  # what is to be found out
    found = offsets(quadric)
    assert found.offset > LARGEST_OFFSET
    assert found.lift_share == 0.5


def test_half_of_a_lift_is_nearer_where_vertices_stand_beyond_the_surface(quadric: Triangles) -> None:
    truth = part_of(grid(60), "truth")
    verdict = judge(Case("ellipsoid by quadrics", "by quadrics", part_of(quadric, "mesh"), truth, 2e-3))
    assert verdict.held, str(verdict)
    assert verdict.gain > 0.5, str(verdict)


def test_what_is_left_of_a_solid_after_many_collapses_is_not_lifted() -> None:
    mesh = quadric_decimated(wedge(40.0, 30.0, 20.0, 4.0)(0.1), 0.25)
    part = part_of(mesh, "wedge")
    normals = surface_of(part, CurveSettings())
    assert normals.offsets.lift_share == 0.0
    assert Lifting(normals).limits.share[FREEFORM] == 0.0


def test_few_vertices_are_not_asked() -> None:
    cone: Part = part_of(lathe([(0.0, 0.0), (20.0, 0.0), (0.0, 40.0)])(0.1), "cone")
    assert surface_of(cone, CurveSettings()).offsets.lift_share == 1.0


def test_a_plane_has_nothing_to_tell() -> None:
    box = wedge(40.0, 30.0, 20.0, 0.0)(0.1)
    assert offsets(box).inner == 0

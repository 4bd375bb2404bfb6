"""The manifold backend against rational arithmetic, closed forms and the corpus."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from parts import box, join, moved, sphere, tilted, torus, turn_z, welded
from section_oracle import simple_sections

import ebamcheck
from ebamcheck.errors import BackendFailed
from ebamcheck.mesh.part import from_arrays
from ebamcheck.testing.solids import prism
from ebamcheck_manifold import ManifoldCut, _boxes

SLICER = ManifoldCut()
SETTINGS = SLICER.Settings()

if not SLICER.probe().available:
    pytest.skip(SLICER.probe().why, allow_module_level=True)


def cut(part, heights, progress=None):
    with SLICER.prepare(part, SETTINGS) as prepared:
        return prepared.slice(np.atleast_1d(np.asarray(heights, float)), progress)


PLATE = shapely.box(0, 0, 30, 20).difference(shapely.Point(12, 9).buffer(5))

PARTS = {
    "box": box((0, 0, 0), (3, 4, 5)),
    "tilted box": tilted(box((0, 0, 0), (30, 7, 4))),
    "sphere": sphere(),
    "torus": torus(),
    "prism with hole": prism(PLATE, 0.0, 4.0),
    "tilted prism": tilted(prism(PLATE, 0.0, 4.0)),
}


def test_bottom_is_cut_and_top_is_not_to_the_last_bit():
    part = box((0, 0, 0.1), (2, 2, 0.3))
    bottom, top = part.bounds[:, 2]
    heights = [np.nextafter(bottom, -1), bottom, 0.2, np.nextafter(top, 0), top]
    assert cut(part, heights).areas().tolist() == [0.0, 4.0, 4.0, 4.0, 0.0]


@pytest.mark.parametrize("shift", [1e6, -1e6, 12345.678])
def test_half_open_rule_far_from_the_origin(shift):
    part = moved(join(box((0, 0, 0), (2, 2, 1)), box((5, 0, 0.5), (6, 1, 2))), shift=(shift, shift, shift))
    z = np.unique(part.vertices[:, 2])
    heights = np.unique(np.concatenate([z, np.nextafter(z, -np.inf), np.nextafter(z, np.inf)]))
    expected = [4.0 * (z[0] <= h < z[2]) + 1.0 * (z[1] <= h < z[3]) for h in heights]
    assert cut(part, heights).areas() == pytest.approx(expected, abs=1e-8)


BLOCK = box((0, 0, 0), (40, 30, 20))
CAVITY = box((15, 11, 7), (25, 19, 13)).reversed()
BODIES = {
    "doubled": (BLOCK, BLOCK),
    "three times": (BLOCK, BLOCK, BLOCK),
    "doubled around a cavity": (BLOCK, BLOCK, CAVITY),
    "doubled and overlapped": (BLOCK, BLOCK, box((20, 5, 0), (60, 25, 20))),
    "on two sides": (BLOCK, box((40, 0, 0), (80, 30, 20)), box((0, 30, 0), (40, 60, 20)), CAVITY),
    "four in a square": tuple(moved(BLOCK, shift=(x, y, 0)) for x in (0, 40) for y in (0, 30)),
}
"""Bodies with facets in common, the same way round or the other."""


@pytest.mark.parametrize("shift", [(0, 0, 0), (1258.5, 2871.5, 1527.5), (-3640.75, -1013.125, 9602.25)])
@pytest.mark.parametrize("degrees", [0.0, 90.0, 37.0])
@pytest.mark.parametrize("name", BODIES)
def test_bodies_that_share_facets_are_cut_whole_and_alike_everywhere(name, degrees, shift):
    """Facets at one angle around an edge, once paired one way and once the other, made manifold3d change the solid."""
    turned = [moved(body, turn_z(degrees)) for body in BODIES[name]]
    there = welded(join(*(moved(body, shift=shift) for body in turned)))
    heights = np.array([1.0, 9.0, 19.0])
    expected = cut(welded(join(*turned)), heights)
    layers = cut(there, heights + shift[2])
    exact = ebamcheck.slice(there, heights + shift[2], "planecut").areas()
    assert "doubtful_regions" not in layers.settings
    assert layers.areas() == pytest.approx(exact, abs=1e-4)
    assert layers.areas() == pytest.approx(expected.areas(), abs=1e-4)


def test_inside_out_is_empty_and_a_turned_inner_shell_is_a_cavity():
    inverted = box().reversed()
    layers = cut(inverted, [0.5, 1.5])
    assert layers.ring_counts().tolist() == [0, 0]
    cavity = join(box((0, 0, 0), (9, 9, 9)), box((2, 2, 2), (4, 4, 4)).reversed())
    assert cut(cavity, [3.0]).areas() == pytest.approx([77.0])
    assert cut(cavity, [3.0]).hole_counts().tolist() == [1]
    beside = join(box(), moved(box().reversed(), shift=(5, 0, 0)))
    assert cut(beside, [1.0]).areas() == pytest.approx([4.0])


def test_open_mesh_is_refused_in_one_line_that_says_why():
    whole = box()
    part = ebamcheck.mesh.part.from_arrays(whole.vertices, whole.faces[1:], "lidless")
    with pytest.raises(BackendFailed, match=r"'lidless'.*NotManifold.*3 edges") as caught:
        SLICER.prepare(part, SETTINGS)
    assert "\n" not in str(caught.value)


def test_facets_that_manifold3d_changes_are_declared_with_their_place():
    """A vertex in the middle of an edge, and a facet without area beside it: manifold3d mends that."""
    part = box((0, 0, 0), (4, 4, 4))
    (edge,) = [k for k, face in enumerate(part.faces.tolist()) if face == [0, 1, 5]]
    vertices = np.vstack([part.vertices, [(2, 0, 0)]])
    halves = [(0, 8, 5), (8, 1, 5), (0, 1, 8)]
    mended = from_arrays(vertices, np.vstack([np.delete(part.faces, edge, axis=0), halves]))
    both = join(mended, box((10, 0, 0), (14, 4, 4)))
    (region,) = cut(both, [1.0]).settings["doubtful_regions"]
    low, high = np.reshape(region["box_mm"], (2, 3))
    assert (low <= (2, 0, 0)).all()
    assert (high >= (2, 0, 0)).all()
    assert high[0] <= 4.0
    assert "changed" in region["why"]


@pytest.mark.parametrize("name", PARTS)
def test_nothing_is_declared_where_the_facets_are_those_given(name):
    assert "doubtful_regions" not in cut(moved(PARTS[name], shift=(1e3, -7.0, 0.1)), [0.1]).settings


@pytest.mark.parametrize("thickness_mm", [1e-6, 0.006, 0.5])
@pytest.mark.parametrize("lean", [0.0, 0.7])
def test_the_declared_bound_holds_for_a_turned_edge(thickness_mm, lean):
    """Two facets and the same four corners with the other diagonal: their sections are that far apart at most."""
    corners = np.array([(0, 0, 0), (10, 0, 0.3), (10, thickness_mm, 9), (0, 0, 9.5)], np.float64)
    corners[:, 1] += lean * corners[:, 2]
    given, held = corners[[[0, 1, 2], [0, 2, 3]]], corners[[[0, 1, 3], [1, 2, 3]]]
    (region,) = _boxes(np.concatenate([given, held]), np.arange(4) < 2)
    apart = 0.0
    for z in (2.0, 4.0, 6.0):
        ways = []
        for facets in (given, held):
            points = []
            for triangle in facets:
                for p, q in zip(triangle, np.roll(triangle, -1, axis=0), strict=True):
                    if (p[2] - z) * (q[2] - z) < 0:
                        points.append((p + (z - p[2]) / (q[2] - p[2]) * (q - p))[:2])
            ways.append(shapely.LineString(sorted(map(tuple, points))))
        apart = max(apart, shapely.hausdorff_distance(*ways))
    assert 0.0 < apart <= region["bound_mm"]
    assert region["bound_mm"] <= 8.0 * apart  # not idle


def test_facets_without_area_do_not_make_a_part_refused():
    whole = box()
    faces = np.concatenate([whole.faces, [(0, 0, 1), (3, 3, 3)]])
    part = ebamcheck.mesh.part.from_arrays(whole.vertices, faces)
    assert cut(part, [1.0]).areas().tolist() == [4.0]


@pytest.mark.corpus
def test_reference_areas_and_loops_of_the_corpus(corpus):
    compared = 0
    for file, rows in simple_sections(corpus).items():
        part = ebamcheck.load(corpus / file)
        try:
            layers = cut(part, [float(row["z"]) for row in rows])
        except BackendFailed:
            assert rows[0]["manifold3d_area"] == "", f"{file} was accepted when the reference was made"
            continue
        assert layers.areas() == pytest.approx([float(row["signed_area"]) for row in rows], rel=1e-6), file
        assert layers.ring_counts().tolist() == [int(row["n_loops"]) for row in rows], file
        compared += len(rows)
    assert compared > 100

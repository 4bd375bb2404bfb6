"""Causes of a difference, read off the mesh."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from comparison_stacks import SQUARE, box, judged

from ebamcheck.comparison.place_causes import MeshFlaws, Place, likely_cause
from ebamcheck.layers.stack import from_polygons, from_rings
from ebamcheck.mesh.part import from_arrays


def test_sections_for_causes_run_with_the_solid_on_their_left():
    segments = MeshFlaws(box()).section(2.0)
    x0, y0, x1, y1 = segments.T
    assert 0.5 * np.sum(x0 * y1 - x1 * y0) == pytest.approx(100.0)


def test_causes_read_off_the_mesh():
    part = box()
    assert MeshFlaws(part).edge_flaw(0.0, 0.0, 2.0, 1.0) == ""
    holed = from_arrays(part.vertices, np.delete(part.faces, [8, 9], axis=0))
    assert MeshFlaws(holed).edge_flaw(0.0, 0.5, 2.0, 1.0) == "open edge"
    fin = from_arrays(np.vstack([part.vertices, [(-5, -5, 2)]]), np.vstack([part.faces, [(0, 4, 8)]]))
    assert MeshFlaws(fin).edge_flaw(0.0, 0.1, 2.0, 1.0) == "non-manifold edge"
    turned = from_arrays(part.vertices, np.vstack([part.faces[:4], part.faces[4:6, ::-1], part.faces[6:]]))
    assert MeshFlaws(turned).edge_flaw(0.0, 0.1, 2.0, 1.0) == "inconsistent orientation"
    inner = box((2, 2, 1), (8, 8, 3))
    double = from_arrays(np.vstack([part.vertices, inner.vertices]), np.vstack([part.faces, inner.faces + 8]))
    assert MeshFlaws(double).winding_flaw(2.0, 5.0, 2.0, 1.0) == "overlapping shells"
    assert MeshFlaws(double).winding_flaw(0.5, 5.0, 2.0, 1.0) == ""
    assert MeshFlaws(part.reversed()).winding_flaw(0.5, 5.0, 2.0, 1.0) == "inconsistent orientation"


def test_a_feature_of_few_limits_is_thin():
    fin = shapely.box(10, 4.99, 15, 5.01)
    with_fin = from_polygons([2.0], [[shapely.box(0, 0, 10, 10).union(fin)]])
    without = from_rings([2.0], [[SQUARE]])
    result = judged({"a": with_fin, "b": without}, tolerance_mm=0.004, exact=("a",))
    assert [f.cause for f in result.findings] == ["thin feature"]


def together(*parts):
    offsets = np.cumsum([0] + [len(p.vertices) for p in parts])
    return from_arrays(
        np.vstack([p.vertices for p in parts]),
        np.vstack([p.faces + o for p, o in zip(parts, offsets[:-1], strict=True)]),
    )


def cause_at(part, x, y, declared=(), depth=0.5, limit=0.1):
    place = Place(x, y, 2.0, depth, limit, "generic", False)
    return likely_cause(MeshFlaws(part), place, declared)


def test_a_declared_doubt_is_the_cause_in_its_box_only():
    declared = [{}, {"doubtful_regions": [{"box_mm": [9, 4, 1, 10, 6, 3], "why": "an edge was turned"}]}]
    assert cause_at(box(), 10.05, 5.0, declared) == "an edge was turned"
    assert cause_at(box(), 10.15, 5.0, declared) == "unknown"
    walls = {name: from_rings([2.0], [[SQUARE * scale]]) for name, scale in (("a", 1.0), ("b", 1.1))}
    walls["b"] = walls["b"].labelled(
        settings={"doubtful_regions": [{"box_mm": [-9, -9, 0, 19, 19, 4], "why": "an edge was turned"}]}
    )
    assert [f.cause for f in judged(walls, exact=("a",)).findings] == ["an edge was turned"]


def test_shells_that_cross_or_touch_are_told_apart():
    assert cause_at(together(box(), box((9, 2, 0), (15, 8, 4))), 10.0, 2.1) == "overlapping shells"
    assert cause_at(together(box(), box((10, 0, 0), (15, 10, 4))), 10.0, 5.0) == "touching shells"
    assert cause_at(together(box(), box((10, 0, 0), (15, 10, 4))), 0.0, 5.0) == "unknown"


def test_a_body_through_itself_is_self_intersection():
    part = box()
    vertices = part.vertices.copy()
    vertices[[3, 7]] = [(5, -5, 0), (5, -5, 4)]  # one upright edge pulled through the opposite wall
    pulled = from_arrays(vertices, part.faces)
    assert cause_at(pulled, 5.0, -0.5) == "self-intersection"


@pytest.mark.parametrize(("width", "cause"), [(0.3, "thin"), (3.0, "unknown")])
def test_walls_and_gaps_by_their_width(width, cause):
    wall = box((0, 0, 0), (width, 10, 4))
    assert cause_at(wall, 0.1, 5.0) == ("thin feature" if cause == "thin" else cause)
    gap = together(box((-10, 0, 0), (0, 10, 4)), box((width, 0, 0), (width + 10, 10, 4)))
    assert cause_at(gap, 0.1, 5.0) == ("thin gap" if cause == "thin" else cause)


def test_a_nearly_level_face_magnifies_rounding():
    part = box()
    vertices = part.vertices.copy()
    vertices[4:, 2] = 2.0 + 1e-6 * (vertices[4:, 0] - 5.0)
    sloping = from_arrays(vertices, part.faces)
    assert cause_at(sloping, 5.0, 5.0) == "shallow slope"
    assert cause_at(part, 10.0, 5.0) == "unknown"


def test_unbalanced_pixels_count_only_where_the_mesh_is_open():
    part = box()
    holed = from_arrays(part.vertices, np.delete(part.faces, [8, 9], axis=0))
    assert cause_at(holed, 10.0, 5.0, [{"unbalanced_pixels": 3}, {}]) == "open surface"
    assert cause_at(part, 10.0, 5.0, [{"unbalanced_pixels": 3}, {}]) == "unknown"


def test_layers_that_do_not_close_are_no_dropped_ones():
    part = box()
    without_a_side = from_arrays(part.vertices, part.faces[:-2])
    rings = from_rings([1.0, 2.0, 3.0], [[SQUARE]] * 3)
    paths = from_rings([1.0, 2.0, 3.0], [[]] * 3, [[SQUARE]] * 3)
    result = judged({"a": rings, "b": rings, "c": paths}, without_a_side)
    assert {f.backend for f in result.findings} == {"c"}
    assert {f.cause for f in result.findings} <= {"open edge", "open path"}
    assert all(f.remedy.startswith("mend the mesh") for f in result.findings)

"""Tables of differences, layer classes, consensus and named outliers."""

from __future__ import annotations

import os
import pickle
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import shapely

from ebamcheck.comparison import compare, compare_all, layer_classes
from ebamcheck.comparison.causes import MeshFlaws, Place, likely_cause
from ebamcheck.comparison.consensus import agreement
from ebamcheck.comparison.pairwise import Pair, measure_block
from ebamcheck.comparison.topology import thin_counts
from ebamcheck.errors import SettingsError
from ebamcheck.layers.stack import from_polygons, from_rings
from ebamcheck.mesh.part import from_arrays
from ebamcheck.settings.slicing import ComparisonSettings

COLUMNS = [
    "layer", "height_mm", "class", "area_a_mm2", "area_b_mm2", "area_difference_mm2",
    "symmetric_difference_mm2", "iou", "hausdorff_ab_mm", "hausdorff_ba_mm", "hausdorff_mm", "p95_ab_mm",
    "p95_ba_mm", "depth_mm", "depth_x_mm", "depth_y_mm", "rings_a", "rings_b", "holes_a", "holes_b",
    "open_a", "open_b", "topology_agrees", "limit_mm", "agrees",
]  # fmt: skip

SQUARE = np.array([(0, 0), (10, 0), (10, 10), (0, 10)], float)
HEIGHTS = np.array([1.0, 2.0, 3.0])


def box(low=(0, 0, 0), high=(10, 10, 4)):
    """Box as a part: 8 vertices, 12 facets, outward."""
    x, y, z = zip(low, high, strict=True)
    corners = np.array([(x[i & 1], y[i >> 1 & 1], z[i >> 2]) for i in range(8)], float)
    faces = [
        (0, 2, 1), (1, 2, 3), (4, 5, 6), (5, 7, 6), (0, 1, 4), (1, 5, 4),
        (2, 6, 3), (3, 6, 7), (0, 4, 2), (2, 4, 6), (1, 3, 5), (3, 7, 5),
    ]  # fmt: skip
    return from_arrays(corners, faces)


def shifted(points, x_mm):
    return points + np.array([x_mm, 0.0])


def stack(*layers, heights=HEIGHTS, **labels):
    return from_polygons(heights, [[shapely.Polygon(r)] if r is not None else [] for r in layers], **labels)


def judged(stacks, part=None, heights_bound=0.0, rules=None, exact=(), bound=0.0, **settings):
    return compare_all(
        stacks,
        part or box(),
        dict.fromkeys(stacks, (bound, heights_bound)),
        {name: name in exact for name in stacks},
        rules or dict.fromkeys(stacks, "half-open"),
        ComparisonSettings(**settings),
    )


# -- the table of a pair -------------------------------------------------------------------------------


def test_table_of_a_pair():
    a = stack(SQUARE, SQUARE, None)
    b = stack(SQUARE, SQUARE + 1.0, None)
    rows = compare(a, b, part=box())
    assert list(rows.columns) == COLUMNS
    assert rows["agrees"].tolist() == [True, False, True]
    assert rows["iou"].tolist() == pytest.approx([1.0, 81 / 119, 1.0])
    assert rows["symmetric_difference_mm2"].tolist() == pytest.approx([0.0, 38.0, 0.0])
    assert rows["area_difference_mm2"].tolist() == pytest.approx([0.0, 0.0, 0.0])
    assert rows["hausdorff_mm"].tolist() == pytest.approx([0.0, np.sqrt(2), 0.0])
    assert rows["class"].tolist() == ["generic"] * 3
    assert compare(a, b)["class"].tolist() == ["unknown"] * 3


def test_place_of_the_depth_is_in_build_coordinates():
    far = SQUARE + 1e4
    hole = from_rings([1.0], [[far, shapely.Point(10006, 10003).buffer(1).exterior.coords[:-1]]])
    rows = compare(from_rings([1.0], [[far]]), hole)
    assert rows.loc[0, "depth_x_mm"] == pytest.approx(10006, abs=0.01)
    assert rows.loc[0, "depth_y_mm"] == pytest.approx(10003, abs=0.01)
    assert rows.loc[0, "depth_mm"] == pytest.approx(1.0, abs=0.01)


def test_bounds_add_up_to_the_limit():
    a, b = stack(SQUARE, SQUARE, SQUARE), stack(SQUARE, shifted(SQUARE, 0.05), shifted(SQUARE, 0.2))
    rows = compare(a, b, tolerance_mm=0.01, bound_a_mm=0.02, bound_b_mm=0.03, exact_a=True)
    assert rows["limit_mm"].tolist() == pytest.approx([0.06] * 3)
    assert rows["depth_mm"].tolist() == pytest.approx([0.0, 0.05, 0.2], abs=1e-6)
    assert rows["agrees"].tolist() == [True, True, False]
    assert compare(a, b, depth_from="nearer")["depth_mm"].tolist() == pytest.approx(
        [0.0, 0.025, 0.1], abs=2e-5
    )
    with pytest.raises(SettingsError, match="-1"):
        compare(a, b, bound_a_mm=-1)


def test_heights_and_parts_must_be_the_same():
    a = stack(SQUARE, SQUARE, SQUARE, part="aa")
    with pytest.raises(SettingsError, match=r"layer 1 is at z = 2.0 mm .* 2.5"):
        compare(a, stack(SQUARE, SQUARE, SQUARE, heights=[1.0, 2.5, 3.5]))
    with pytest.raises(SettingsError, match=r"3 layers.*2"):
        compare(a, stack(SQUARE, SQUARE, heights=[1.0, 2.0]))
    other = a.labelled(part="bb")
    with pytest.raises(SettingsError, match="check_part"):
        compare(a, other)
    assert compare(a, other, check_part=False)["agrees"].all()
    assert compare(a, a.labelled(part=""))["agrees"].all()


def test_no_layers_give_an_empty_table():
    empty = from_rings([], [])
    rows = compare(empty, empty)
    assert list(rows.columns) == COLUMNS
    assert len(rows) == 0


def test_blocks_and_threads_do_not_change_a_figure(monkeypatch):
    rng = np.random.default_rng(2)
    rings = [SQUARE + rng.normal(size=(4, 2)) for _ in range(150)]
    heights = np.arange(150.0)
    a = from_rings(heights, [[r] for r in rings])
    b = from_rings(heights, [[r + rng.normal(size=(4, 2)) * 0.1] for r in rings])
    tables = []
    for threads in ("1", "3"):
        monkeypatch.setenv("EBAMCHECK_THREADS", threads)
        tables.append(compare(a, b))
    assert tables[0].equals(tables[1])
    arguments = ([a.block(3, 9), b.block(3, 9)], [Pair(0, 1, 0.001, False, False)], (5.0, 5.0), 0, 6)
    assert np.array_equal(measure_block(*pickle.loads(pickle.dumps(arguments))), measure_block(*arguments))


# -- topology ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("width", "agrees"), [(0.08, True), (0.3, False)], ids=["thinner than twice the limit", "thicker"]
)
def test_a_neck_counts_only_where_it_is_thick(width, agrees):
    lobes = shapely.union_all([shapely.box(0, 0, 10, 10), shapely.box(12, 0, 22, 10)])
    joined = lobes.union(shapely.box(9, 5 - width / 2, 13, 5 + width / 2))
    rows = compare(from_polygons([0.0], [[lobes]]), from_polygons([0.0], [[joined]]), tolerance_mm=0.05)
    assert rows.loc[0, "rings_a"] == 2
    assert rows.loc[0, "rings_b"] == 1
    assert rows.loc[0, "topology_agrees"] == agrees
    assert rows.loc[0, "agrees"] == agrees


def test_ranges_of_counts_with_thin_features():
    plate = (
        shapely.box(0, 0, 10, 10).difference(shapely.box(2, 2, 2.05, 8)).difference(shapely.box(4, 4, 6, 6))
    )
    sliver = shapely.box(20, 0, 20.05, 10)
    outer, holes = thin_counts(shapely.union_all([plate, sliver]), 0.05)
    assert list(outer) == [1, 2]
    assert list(holes) == [1, 2]


def test_abutting_rings_are_one_region():
    halves = from_rings([0.0], [[SQUARE * [0.5, 1.0], shifted(SQUARE * [0.5, 1.0], 5.0)]])
    assert compare(halves, from_rings([0.0], [[SQUARE]]))["agrees"].all()


# -- classes -------------------------------------------------------------------------------------------


def test_layer_classes():
    roof = from_arrays(
        [(0, 0, 0), (10, 0, 0), (0, 10, 0), (3, 3, 5), (50, 50, 2)],
        [(0, 2, 1), (0, 1, 3), (1, 2, 3), (2, 0, 3)],
    )
    heights = [0.0, 1e-4, 2.0, 4.9999, 5.0, 6.0]
    assert layer_classes(roof, heights, 0.0).tolist() == [
        "face-on-plane", "generic", "generic", "generic", "vertex-on-plane", "generic",
    ]  # fmt: skip
    assert layer_classes(roof, heights, 1e-3).tolist() == [
        "face-on-plane", "face-on-plane", "generic", "vertex-on-plane", "vertex-on-plane", "generic",
    ]  # fmt: skip
    assert layer_classes(from_arrays(np.zeros((0, 3)), np.zeros((0, 3))), [1.0], 1.0).tolist() == ["generic"]


@pytest.mark.parametrize("seed", range(4))
def test_layer_classes_are_those_of_a_plain_search(seed):
    rng = np.random.default_rng(seed)
    part = from_arrays(np.round(rng.uniform(0, 9, (40, 3))), rng.integers(0, 40, (60, 3)))
    heights, margin = np.round(rng.uniform(-1, 10, 60), 1), float(rng.choice([0.0, 0.1, 0.6]))
    z = part.vertices[part.faces][:, :, 2]
    for height, found in zip(heights, layer_classes(part, heights, margin), strict=True):
        near = (z >= height - margin) & (z <= height + margin)
        expected = (
            "face-on-plane" if near.all(axis=1).any() else "vertex-on-plane" if near.any() else "generic"
        )
        assert found == expected


# -- consensus -----------------------------------------------------------------------------------------


def test_all_agree():
    good = stack(SQUARE, SQUARE, SQUARE)
    result = judged({"a": good, "b": good, "c": good})
    assert result.passed
    assert result.compared_layers == 3
    assert result.findings == []
    assert result.layers["verdict"].tolist() == ["agree"] * 3
    assert result.layers["consensus"].tolist() == ["a,b,c"] * 3
    assert list(result.pairs.columns) == ["a", "b", *COLUMNS, "gated", "evidence", "doubt_mm"]
    assert len(result.pairs) == 9


def test_one_outlier_is_named_with_place_and_limit():
    good, bad = stack(SQUARE, SQUARE, SQUARE), stack(SQUARE, SQUARE[[0, 1, 2]], SQUARE)
    result = judged({"a": good, "b": good, "c": bad}, exact=("a", "b"))
    assert not result.passed
    assert result.layers["verdict"].tolist() == ["agree", "outlier", "agree"]
    assert result.layers.loc[1, "consensus"] == "a,b"
    assert [(f.layer, f.backend, f.against, f.metric) for f in result.findings] == [
        (1, "c", "a", "depth"),
        (1, "c", "b", "depth"),
    ]
    finding = result.findings[0]
    assert finding.height_mm == 2.0
    assert finding.value == pytest.approx(5.0, abs=1e-4)  # the middle of the square that c halves
    assert finding.limit == 0.001
    assert finding.x_mm == pytest.approx(finding.value, abs=1e-3)
    assert finding.cause == "unknown"


def test_two_that_differ_are_undecided():
    result = judged({"a": stack(SQUARE, SQUARE, SQUARE), "b": stack(SQUARE, SQUARE * 2, SQUARE)})
    assert result.layers["verdict"].tolist() == ["agree", "undecided", "agree"]
    assert not result.passed
    assert [f.layer for f in result.findings] == [1]


@pytest.mark.parametrize(
    ("count", "gated", "agreeing", "expected"),
    [
        (3, "ab ac bc", "ab ac bc", ("abc", "agree")),
        (3, "ab ac bc", "ab", ("ab", "outlier")),
        (4, "ab ac ad bc bd cd", "ab cd", ("", "undecided")),
        (4, "ab ac ad bc bd cd", "ab ac bc", ("abc", "outlier")),
        (3, "ab ac bc", "ab bc", ("", "undecided")),
        (3, "ab", "ab", ("ab", "agree")),
        (3, "", "", ("", "not-compared")),
        (3, "ab bc", "ab bc", ("abc", "agree")),
        (2, "ab", "", ("", "undecided")),
    ],
)
def test_consensus_is_the_largest_consistent_set(count, gated, agreeing, expected):
    names = "abcd"[:count]
    couples = [(i, j) for i in range(count) for j in range(i + 1, count)]
    marks = [
        np.array([f"{names[i]}{names[j]}" in text.split() for i, j in couples]) for text in (gated, agreeing)
    ]
    members, verdict = agreement(count, couples, *marks)
    assert ("".join(names[i] for i in members), verdict) == expected


def test_layers_through_vertices_are_gated_between_half_open_slicers_only():
    heights = np.array([0.0, 2.0])
    good = stack(SQUARE, SQUARE, heights=heights)
    missing = stack(None, SQUARE, heights=heights)
    rules = {"a": "half-open", "b": "half-open", "c": "undefined"}
    result = judged({"a": good, "b": good, "c": missing}, rules=rules)
    assert result.passed
    assert result.layers["class"].tolist() == ["face-on-plane", "generic"]
    assert result.layers["consensus"].tolist() == ["a,b", "a,b,c"]
    strict = judged({"a": good, "b": good, "c": missing})
    assert [(f.backend, f.cause) for f in strict.findings] == [("c", "coplanar face")] * 2
    alone = judged({"a": good, "c": missing}, rules={"a": "half-open", "c": "undefined"})
    assert alone.layers["verdict"].tolist() == ["not-compared", "agree"]
    assert alone.compared_layers == 1


def test_the_height_bound_is_the_plane_margin():
    heights = np.array([1e-4, 2.0])
    good, missing = stack(SQUARE, SQUARE, heights=heights), stack(None, SQUARE, heights=heights)
    rules = {"a": "half-open", "c": "undefined"}
    near = judged({"a": good, "c": missing}, rules=rules, heights_bound=1e-3)
    assert near.layers["verdict"].tolist() == ["not-compared", "agree"]
    set_to_zero = judged({"a": good, "c": missing}, rules=rules, heights_bound=1e-3, plane_margin_mm=0.0)
    assert set_to_zero.layers["verdict"].tolist() == ["undecided", "agree"]


def test_empty_in_all_is_no_agreement_where_the_part_is():
    nothing = stack(None, None, None, heights=[1.0, 3.0, 7.0])
    result = judged({"a": nothing, "b": nothing}, part=box().reversed())
    assert result.layers["verdict"].tolist() == ["empty", "empty", "agree"]
    assert not result.passed
    assert result.compared_layers == 0
    assert [(f.backend, f.against, f.metric, f.cause) for f in result.findings] == [
        ("a,b", "part", "empty", "inconsistent orientation")
    ] * 2
    assert np.isfinite([result.findings[0].x_mm, result.findings[0].y_mm]).all()


def test_open_paths_alone_are_no_agreement():
    part = box()
    tube = from_arrays(part.vertices, part.faces[4:10])
    path = from_rings([2.0], [[]], [[[(0, 10), (0, 0), (10, 0), (10, 10)]]])
    result = judged({"a": path, "b": path}, part=tube)
    assert result.layers["verdict"].tolist() == ["empty"]
    assert result.pairs.loc[0, ["open_a", "open_b"]].tolist() == [1, 1]
    assert result.findings[0].cause in ("open path", "open edge")


def test_fewer_than_two_stacks_compare_nothing():
    for stacks in ({}, {"a": stack(SQUARE, SQUARE, SQUARE)}):
        result = judged(stacks)
        assert result.compared_layers == 0
        assert not result.passed
        assert len(result.layers) == 3 * len(stacks)


def test_progress_adds_up_to_the_layers():
    done = []
    good = stack(SQUARE, SQUARE, SQUARE)
    stacks = {"a": good, "b": good}
    compare_all(
        stacks, box(), dict.fromkeys(stacks, (0.0, 0.0)), dict.fromkeys(stacks, True),
        dict.fromkeys(stacks, "half-open"), progress=done.append,
    )  # fmt: skip
    assert sum(done) == 3


def test_blocks_and_threads_change_no_bit(monkeypatch):
    rng = np.random.default_rng(2)
    rings = [SQUARE + rng.normal(size=SQUARE.shape) * 0.1 for _ in range(40)]
    heights = np.linspace(0.1, 3.9, 40)
    a = from_rings(heights, [[r] for r in rings])
    b = from_rings(heights, [[r + rng.normal(size=r.shape) * 1e-3] for r in rings])
    c = from_rings(heights, [[np.round(r, 1)] for r in rings])
    stacks = {"a": a, "b": b, "c": c}
    results = []
    for threads, borders in (("1", None), ("2", [0, 40]), ("2", [0, 1, 17, 40]), ("1", list(range(41)))):
        monkeypatch.setenv("EBAMCHECK_THREADS", threads)
        results.append(
            compare_all(
                stacks, box(), dict.fromkeys(stacks, (0.05, 0.0)), dict.fromkeys(stacks, False),
                dict.fromkeys(stacks, "half-open"), borders=None if borders is None else np.array(borders),
            )
        )  # fmt: skip
    for other in results[1:]:
        pd.testing.assert_frame_equal(results[0].pairs, other.pairs, check_exact=True)
        pd.testing.assert_frame_equal(results[0].layers, other.layers, check_exact=True)
        assert results[0].findings == other.findings


# -- causes --------------------------------------------------------------------------------------------


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


# -- real parts ----------------------------------------------------------------------------------------


@pytest.mark.corpus
@pytest.mark.parametrize("name", ["menger3_22k.stl", "gears_7bodies_ascii.stl"])
def test_a_real_part_agrees_with_itself_and_not_with_a_shifted_self(name):
    corpus = os.environ.get("EBAMCHECK_CORPUS")
    if not corpus:
        pytest.skip("EBAMCHECK_CORPUS does not name the mesh corpus")
    trimesh = pytest.importorskip("trimesh")
    mesh = trimesh.load(Path(corpus) / "good" / name)
    part = from_arrays(mesh.vertices, mesh.faces)
    low, high = part.bounds[:, 2]
    heights = low + (high - low) * np.array([0.13, 0.31, 0.503, 0.77])
    flaws = MeshFlaws(part)
    regions = []
    for height in heights:
        lines = shapely.linestrings(flaws.section(height).reshape(-1, 2, 2).round(9))
        regions.append(shapely.build_area(shapely.geometrycollections(lines)))
    a = from_polygons(heights, [[r] for r in regions])
    b = from_polygons(heights, [[shapely.transform(r, lambda p: shifted(p, 0.25))] for r in regions])
    same = compare(a, a, exact_a=True, exact_b=True)
    assert same["agrees"].all()
    assert same["symmetric_difference_mm2"].max() == 0.0
    rows = compare(a, b, exact_a=True)
    assert not rows["agrees"].any()
    for k, region in enumerate(regions):
        moved = shapely.transform(region, lambda p: shifted(p, 0.25))
        expected = shapely.symmetric_difference(region, moved).area
        assert rows.loc[k, "symmetric_difference_mm2"] == pytest.approx(expected, rel=1e-8)
        assert rows.loc[k, "hausdorff_mm"] <= 0.25 + 1e-6

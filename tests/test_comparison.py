"""Consensus of several stacks, named outliers, and a real part."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import shapely
from comparison_stacks import COLUMNS, SQUARE, box, judged, shifted, stack

from ebamcheck.comparison import compare, compare_all
from ebamcheck.comparison.consensus import agreement
from ebamcheck.comparison.place_causes import MeshFlaws
from ebamcheck.layers.stack import from_polygons, from_rings
from ebamcheck.mesh.part import from_arrays

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
    members, verdict = agreement(couples, *marks)
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

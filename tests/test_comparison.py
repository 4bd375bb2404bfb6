"""Consensus of several stacks and named outliers, declared doubt, and agreement that means something."""

from __future__ import annotations

from itertools import combinations, product

import numpy as np
import pandas as pd
import pytest
import shapely
from comparison_stacks import COLUMNS, SQUARE, box, judged, stack
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from ebamcheck.comparison import compare_all
from ebamcheck.comparison.consensus import EvidenceRule, agreement, best_pair
from ebamcheck.comparison.doubt import doubted_layers
from ebamcheck.comparison.naming import worst_of
from ebamcheck.layers.stack import from_polygons, from_rings
from ebamcheck.pipeline.cross_check import evidence_records, evidence_rule, resting
from ebamcheck.pipeline.findings import doubt_findings
from ebamcheck.pipeline.gates import agreement_gate
from ebamcheck.settings.config import Config
from ebamcheck.settings.stages import ComparisonSettings
from ebamcheck.slicers.isolation import Outcome

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


def test_the_worst_finding_is_that_of_the_largest_excess():
    good, bad = stack(SQUARE, SQUARE, SQUARE), stack(SQUARE * 0.99, SQUARE[[0, 1, 2]], SQUARE)
    result = judged({"a": good, "b": good, "c": bad}, exact=("a", "b"))
    assert {f.layer for f in result.findings} == {0, 1}
    assert worst_of(result.findings).layer == 1


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
    marks = [np.array([f"{names[i]}{names[j]}" in text.split() for i, j in couples]) for text in (gated, agreeing)]
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


# -- declared doubt --------------------------------------------------------------------------------


BLOCK = box((0, 0, 0), (20, 10, 6))
BLOCK_HEIGHTS = np.array([1.0, 3.0, 5.0])
SECTION = shapely.box(0, 0, 20, 10)
BUMP = shapely.box(5, 9, 7, 10.006)


def compared(bumps, bound_mm=0.007, box_mm=(4, 8, 2, 8, 11, 4), most_mm=0.01):
    doubt = {"box_mm": list(box_mm), "why": "an edge was turned"} | ({"bound_mm": bound_mm} if bound_mm else {})
    stacks = {
        "exact": from_polygons(BLOCK_HEIGHTS, [[SECTION]] * 3),
        "doubts": from_polygons(
            BLOCK_HEIGHTS,
            [[shapely.union_all([SECTION, *b])] for b in bumps],
            settings={"doubtful_regions": [doubt]},
        ),
    }
    return compare_all(
        stacks, BLOCK, dict.fromkeys(stacks, (0.0, 0.0)), dict.fromkeys(stacks, True), dict.fromkeys(stacks, "half-open"),
        ComparisonSettings(doubt_mm=most_mm),
    )  # fmt: skip


def test_a_declared_place_agrees_and_is_counted_and_told():
    found = compared([[], [BUMP], []])
    assert found.passed
    ((_, _, layers, depth_mm, added_mm),) = doubted_layers(found.pairs)
    assert (layers, added_mm) == ([1], 0.007)
    assert depth_mm == pytest.approx(0.006, rel=0.02)
    (told,) = doubt_findings(found.pairs, Config())
    assert told.severity == "warning"
    assert "0.006 mm apart" in told.text


@pytest.mark.parametrize(
    ("what", "bumps", "options"),
    [
        ("no bound is declared", [[], [BUMP], []], {"bound_mm": None}),
        ("the bound is too small", [[], [BUMP], []], {"bound_mm": 0.004}),
        ("the bound is over the cap", [[], [BUMP], []], {"bound_mm": 0.02}),
        ("a doubt is forbidden", [[], [BUMP], []], {"most_mm": 0.0}),
        ("it lies on another layer", [[BUMP], [], []], {}),
        ("it differs beside, too", [[], [BUMP, shapely.box(15, 9, 17, 10.006)], []], {}),
        ("a body is lost beside", [[], [BUMP, shapely.box(30, 0, 33, 3)], []], {}),
        ("the bound is no number", [[], [BUMP], []], {"bound_mm": float("inf")}),
    ],
)
def test_a_doubt_changes_nothing_where(what, bumps, options):
    found = compared(bumps, **options)
    assert not found.passed, what
    assert not list(doubted_layers(found.pairs))
    assert found.findings


# -- evidence -------------------------------------------------------------------------------------------------


SMALL_SQUARE = np.array([(0.0, 0.0), (2.0, 0.0), (2.0, 2.0), (0.0, 2.0)])
SMALL_HEIGHTS = [0.5, 1.1, 1.7]
SMALL_BOX = box((0, 0, 0), (2, 2, 2))


def with_gate(stacks, bounds, rule):
    layers = {n: from_rings(SMALL_HEIGHTS, [[ring] for ring in rings]) for n, rings in stacks.items()}
    found = compare_all(
        layers, SMALL_BOX, {n: (bounds.get(n, 0.0), 0.0) for n in stacks},
        dict.fromkeys(stacks, True), dict.fromkeys(stacks, "half-open"), evidence=rule,
    )  # fmt: skip
    outcomes = {n: Outcome(n, file=SMALL_BOX) for n in stacks}
    return found, agreement_gate(found, outcomes, len(SMALL_HEIGHTS))


GOOD, BAD = [SMALL_SQUARE] * 3, [SMALL_SQUARE, SMALL_SQUARE, SMALL_SQUARE * 0.5]
RULE = EvidenceRule(largest_error_mm=0.1)


def test_a_vast_bound_agrees_with_everything_and_proves_nothing():
    found, gate = with_gate({"a": GOOD, "vast": BAD}, {"vast": 5.0}, EvidenceRule())
    assert (found.passed, gate.passed) == (True, True)  # without the rule
    found, gate = with_gate({"a": GOOD, "vast": BAD}, {"vast": 5.0}, RULE)
    assert (found.passed, found.compared_layers, gate.passed) == (False, 0, False)
    assert "vast is no evidence: its bound of 5 mm is over 0.1 mm" in gate.text
    assert found.layers["verdict"].tolist() == ["not-compared"] * 3
    for bound_mm, layers in ((0.09, 3), (0.11, 0)):
        found, _ = with_gate({"a": GOOD, "wide": GOOD}, {"wide": bound_mm}, RULE)
        assert found.compared_layers == layers


def test_two_others_are_enough_and_the_gate_names_them():
    found, gate = with_gate({"a": GOOD, "vast": BAD, "b": GOOD}, {"vast": 5.0}, RULE)
    assert (found.passed, gate.passed) == (True, True)
    assert found.layers["rests_on"].tolist() == ["a,b"] * 3
    assert "every one rests on a and b" in gate.text
    assert evidence_records(found) == [{"methods": ["a", "b"], "first_layer": 0, "last_layer": 2}]


def test_what_is_no_evidence_can_still_disagree():
    found, gate = with_gate({"a": GOOD, "loose": BAD, "b": GOOD}, {"loose": 0.2}, RULE)
    assert found.layers["verdict"].tolist() == ["agree", "agree", "outlier"]
    assert [f.backend for f in found.findings] == ["loose", "loose"]
    assert not gate.passed


def test_one_method_under_two_names_is_one():
    rule = EvidenceRule(kin=frozenset({frozenset(("a", "alias"))}))
    found, gate = with_gate({"a": GOOD, "alias": GOOD}, {}, rule)
    assert (found.compared_layers, gate.passed) == (0, False)
    assert "no two of which are independent evidence: a and alias are one method" in gate.text
    found, gate = with_gate({"a": GOOD, "alias": GOOD, "b": GOOD}, {"b": 0.01}, rule)
    assert gate.passed
    assert set(found.layers["rests_on"]) == {"a,b"}


def test_layers_rest_on_the_narrowest_agreement_there_is():
    found, _ = with_gate({"a": GOOD, "wide": GOOD, "b": BAD}, {"wide": 0.1, "b": 1e-6}, RULE)
    assert found.layers["rests_on"].tolist() == ["a,b", "a,b", "a,wide"]
    assert resting(found) == "evidence of a and b (2), a and wide (1)"


@given(st.integers(2, 5), st.data())
def test_law_of_evidence(count, data):
    """What is no evidence never makes an agreement; all of it counted is the consensus as it was."""
    couples = list(combinations(range(count), 2))
    draw = st.lists(st.booleans(), min_size=len(couples), max_size=len(couples)).map(np.array)
    gated, agrees, counts = (data.draw(draw) for _ in range(3))
    members, verdict = agreement(couples, gated, agrees, counts)
    assert agreement(couples, gated, agrees, np.ones_like(counts)) == agreement(couples, gated, agrees)
    pair = best_pair(members, count, gated & agrees & counts, np.arange(len(couples), dtype=float))
    if verdict == "agree":
        assert pair is not None
        assert set(pair) <= set(members)
        k = couples.index(pair)
        assert (gated & agrees & counts)[k]
    none = agreement(couples, gated, agrees, np.zeros_like(counts))
    assert none[1] in ("not-compared", "undecided")
    foes = {c for c, g, ok in zip(couples, gated, agrees, strict=True) if g and not ok}
    assert not foes & set(product(members, members))


def test_the_share_is_of_bead_and_layer():
    config = Config.model_validate({"comparison": {"evidence_share": 0.2}, "process": {"bead_width_mm": 5.0}})
    rule = evidence_rule(config, ["planecut", "manifold", "trimesh"])
    assert rule.largest_error_mm == pytest.approx(1.0)
    assert rule.largest_height_mm == pytest.approx(0.2 * config.layer_height_mm)
    assert rule.kin == frozenset()
    assert rule.without_weight({"a": (np.nan, 0.0), "b": (0.5, 9.0), "c": (1.0, 0.0)}).keys() == {"a", "b"}
    for share in (0.0, 0.6, np.inf):
        with pytest.raises(ValidationError):
            Config.model_validate({"comparison": {"evidence_share": share}})

"""Agreement that means something: two independent methods, both under a bound that leaves something to agree on."""

from __future__ import annotations

from itertools import combinations, product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from parts import box
from pydantic import ValidationError

from ebamcheck.comparison import compare_all
from ebamcheck.comparison.consensus import EvidenceRule, agreement, best_pair
from ebamcheck.layers.stack import from_rings
from ebamcheck.pipeline.cross_check import evidence_records, evidence_rule, resting
from ebamcheck.pipeline.gates import agreement_gate
from ebamcheck.settings.config import Config
from ebamcheck.slicers.isolation import Outcome

SQUARE = np.array([(0.0, 0.0), (2.0, 0.0), (2.0, 2.0), (0.0, 2.0)])
HEIGHTS = [0.5, 1.1, 1.7]
PART = box()


def judged(stacks, bounds, rule):
    layers = {n: from_rings(HEIGHTS, [[ring] for ring in rings]) for n, rings in stacks.items()}
    found = compare_all(
        layers, PART, {n: (bounds.get(n, 0.0), 0.0) for n in stacks},
        dict.fromkeys(stacks, True), dict.fromkeys(stacks, "half-open"), evidence=rule,
    )  # fmt: skip
    outcomes = {n: Outcome(n, file=PART) for n in stacks}
    return found, agreement_gate(found, outcomes, len(HEIGHTS))


GOOD, BAD = [SQUARE] * 3, [SQUARE, SQUARE, SQUARE * 0.5]
RULE = EvidenceRule(largest_error_mm=0.1)


def test_a_vast_bound_agrees_with_everything_and_proves_nothing():
    found, gate = judged({"a": GOOD, "vast": BAD}, {"vast": 5.0}, EvidenceRule())
    assert (found.passed, gate.passed) == (True, True)  # without the rule
    found, gate = judged({"a": GOOD, "vast": BAD}, {"vast": 5.0}, RULE)
    assert (found.passed, found.compared_layers, gate.passed) == (False, 0, False)
    assert "vast is no evidence: its bound of 5 mm is over 0.1 mm" in gate.text
    assert found.layers["verdict"].tolist() == ["not-compared"] * 3


def test_two_others_are_enough_and_the_gate_names_them():
    found, gate = judged({"a": GOOD, "vast": BAD, "b": GOOD}, {"vast": 5.0}, RULE)
    assert (found.passed, gate.passed) == (True, True)
    assert found.layers["rests_on"].tolist() == ["a,b"] * 3
    assert "every one rests on a and b" in gate.text
    assert evidence_records(found) == [{"methods": ["a", "b"], "first_layer": 0, "last_layer": 2}]


def test_what_is_no_evidence_can_still_disagree():
    found, gate = judged({"a": GOOD, "loose": BAD, "b": GOOD}, {"loose": 0.2}, RULE)
    assert found.layers["verdict"].tolist() == ["agree", "agree", "outlier"]
    assert [f.backend for f in found.findings] == ["loose", "loose"]
    assert not gate.passed


def test_one_method_under_two_names_is_one():
    rule = EvidenceRule(kin=frozenset({frozenset(("a", "alias"))}))
    found, gate = judged({"a": GOOD, "alias": GOOD}, {}, rule)
    assert (found.compared_layers, gate.passed) == (0, False)
    assert "no two of which are independent evidence: a and alias are one method" in gate.text
    found, gate = judged({"a": GOOD, "alias": GOOD, "b": GOOD}, {"b": 0.01}, rule)
    assert gate.passed
    assert set(found.layers["rests_on"]) == {"a,b"}


def test_layers_rest_on_the_narrowest_agreement_there_is():
    found, _ = judged({"a": GOOD, "wide": GOOD, "b": BAD}, {"wide": 0.1, "b": 1e-6}, RULE)
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

"""The table of reference parts: it sees where plan and text part, and a part that is built is told as built."""

from __future__ import annotations

import pandas as pd
import pytest

from benchmarks.acceptance import BACKENDS, DEFAULTS, PAIRS, REMEDIES, apart, rendered, row
from ebamcheck.plugins.registry import models
from ebamcheck.settings.config import Config

CONFIG = Config().changed(slicing={"backends": BACKENDS})


def sums(value: float) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Sums of three layers by plan and text, all of them alike."""
    ours = {name: [value, 2.0 * value, 0.0] for names in PAIRS.values() for name in names}
    text = {theirs: [len(names) * value, 2.0 * len(names) * value, 0.0] for theirs, names in PAIRS.items()}
    return pd.DataFrame(ours), pd.DataFrame(text)


def test_equal_sums_are_not_apart():
    assert apart(*sums(125.0)) == 0.0
    assert apart(*sums(0.0)) == 0.0


@pytest.mark.parametrize("column", PAIRS)
def test_whatever_one_layer_has_more_in_the_text_is_seen(column):
    plan, text = sums(125.0)
    text.loc[0, column] *= 1.1
    assert apart(plan, text) == pytest.approx(0.05)


@pytest.mark.slow
def test_a_cube_is_built_as_planned_and_told_so():
    found = row("cube", models(("cube",))["cube"], CONFIG, DEFAULTS)
    assert found["verdict"] == "VALIDATED"
    assert found["apart"] < 1e-6
    assert found["starts_plan"] == found["starts_text"] > 0
    assert found["over_sections"] == pytest.approx(1.0, abs=0.02)
    assert max(found["plan_k"], found["text_k"]) <= found["limit_k"]
    text = rendered(pd.DataFrame([found]))
    assert "| cube | defaults | 12 |" in text
    assert "met" in text
    assert "What shut the gates" not in text


@pytest.mark.slow
@pytest.mark.parametrize("part", ["bracket", "thin-walls", "two-spheres"])
def test_a_part_that_is_refused_is_built_with_its_remedy(part):
    model, remedy = models((part,))[part], REMEDIES[part]
    before = row(part, model, CONFIG, DEFAULTS)
    after = row(part, model, CONFIG.changed(**remedy.changes), str(remedy))
    assert (before["verdict"], after["verdict"]) == ("NOT VALIDATED", "VALIDATED")
    text = rendered(pd.DataFrame([before, after]))
    assert f"- {part}: `{before['gates'].split()[0]}`" in text
    assert f"- {part}: `{remedy}`: {remedy.why}." in text

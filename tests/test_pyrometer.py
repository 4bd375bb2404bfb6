"""A measured temperature of the surface: it corrects the heat of the next layer within limits, and the journal says why."""

from __future__ import annotations

import numpy as np
import pytest
from live_boxes import made_again

from ebamcheck.live.before import Before, check_warmth, corrected
from ebamcheck.live.building import Building
from ebamcheck.live.height_map import Refused, Warmth, warmth_of
from ebamcheck.live.making import Wanted
from ebamcheck.live.publishing import read_journal
from ebamcheck.settings.config import Config

SIZE = (30, 24, 5.2)


@pytest.fixture(scope="module")
def heat(maker, tmp_path_factory):
    """Heat of a part when its first layer was laid."""
    folder = tmp_path_factory.mktemp("first") / "p"
    made = maker.make(Wanted(0, 0.0, 1.7, "MAIN_K0001R1"), Before.cold(maker.config), folder)
    assert made.passed, made.why
    return made.after


@pytest.mark.in_turn(2)
@pytest.mark.parametrize("after_s", [0.0, 2.0, 30.0])
@pytest.mark.parametrize("off_k", [-120.0, -5.0, 0.0, 5.0, 120.0])
def test_the_corrected_model_reads_what_was_measured(heat, off_k, after_s):
    before, then = heat.surface_k, heat.rested(after_s)
    after, said = corrected(heat, Warmth(then.surface_k + off_k, after_s), Config())
    assert after.surface_k == pytest.approx(then.surface_k + off_k, abs=0.1)
    assert heat.surface_k == before
    assert (said.factor > 1.0) == (off_k > 0.0)
    assert f"{abs(off_k):.0f} K {'warmer' if off_k > 0.0 else 'colder'}" in said.why
    stored = [found.part.column.stored_j for found in (after, then)]
    assert (stored[0] - stored[1]) * off_k >= 0.0
    # What differs across the section, and the cold base, keep their place in it.
    assert np.allclose(after.part.field.state, said.factor * then.part.field.state)
    rise = [found.part.column.temperature_k - Config().process.ambient_temperature_k for found in (after, then)]
    assert np.allclose(rise[0], said.factor * rise[1], atol=0.1)


def refusal(judge, *given):
    """Why something is refused as a temperature; empty: it is used."""
    try:
        judge(*given)
    except Refused as refused:
        return f"{refused.code}: {refused}"
    return ""


def test_temperatures_out_of_limits_are_refused_with_the_limit(heat):
    config = Config()
    wide = config.changed(process={"pyrometer_limit_k": 1000.0})
    warm = heat.rested(20.0).surface_k
    assert refusal(check_warmth, heat, Warmth(warm, 20.0), config) == ""
    assert "process.pyrometer_limit_k" in refusal(check_warmth, heat, Warmth(warm + 151.0, 20.0), config)
    assert refusal(check_warmth, heat, Warmth(warm + 151.0, 20.0), wide) == ""
    for value in (-3.0, 20.0, 5000.0, 1e300):
        assert "give kelvins" in refusal(check_warmth, heat, Warmth(value, 20.0), wide)
    for after_s in (-1.0, 1e6):
        assert "after_s" in refusal(check_warmth, heat, Warmth(warm, after_s), wide)
    cold = Before.cold(config)
    assert "on which something was laid" in refusal(check_warmth, cold, Warmth(300.0, 0.0), config)


@pytest.mark.parametrize("value", ["hot", True, float("nan"), float("inf"), [300.0]])
def test_what_is_no_temperature_is_said(value):
    assert "give a finite number of kelvins" in refusal(warmth_of, {"surface_k": value, "after_s": 1.0})
    assert "give a finite number of seconds" in refusal(warmth_of, {"surface_k": 700.0, "after_s": value})
    assert "give a finite number of seconds" in refusal(warmth_of, {"surface_k": 700.0})


def test_a_reading_without_a_temperature_has_none():
    assert warmth_of({}) is None
    assert warmth_of({"surface_k": None}) is None
    assert warmth_of({"surface_k": 700, "after_s": 3}) == Warmth(700.0, 3.0)


def test_the_wait_follows_the_temperature_and_the_journal_says_why(maker, heat, tmp_path):
    waits, told = {}, {}
    for name, off_k in (("colder", -60.0), ("as worked out", None), ("warmer", 60.0)):
        building = Building(maker, tmp_path / name)
        try:
            first = building.start()
            height = {"event": "height", "done": 1, "height_mm": first["thickness_mm"]}
            warm = building.before.rested(8.0).surface_k
            assert building.height({**height, "surface_k": "hot", "after_s": 8.0})["code"] == "temperature"
            assert building.height({**height, "surface_k": warm + 400.0, "after_s": 8.0})["code"] == "temperature"
            read = {} if off_k is None else {"surface_k": warm + off_k, "after_s": 8.0}
            answer = building.height({**height, **read})
            assert answer["answer"] == "published", answer
            waits[name], told[name] = answer["wait_s"], answer
        finally:
            building.close()
    assert waits["colder"] < waits["as worked out"] < waits["warmer"]
    assert "temperature" not in told["as worked out"]
    entries = list(read_journal(tmp_path / "warmer" / "journal.jsonl"))
    assert "60 K warmer than worked out" in next(e["why_wait"] for e in entries if "why_wait" in e)
    assert [e["surface_k"] for e in entries if "surface_k" in e] == [
        pytest.approx(told["warmer"]["temperature"]["measured_k"])
    ]
    assert made_again(maker, tmp_path / "warmer", tmp_path / "again")

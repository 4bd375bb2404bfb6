"""A measured temperature of the surface: it corrects the heat of the next layer within limits, and the journal says why."""

from __future__ import annotations

import json
import shutil

import pytest
from command_line import FAST, ebamcheck, write_stl
from parts import box

from ebamcheck.live.building import Building
from ebamcheck.live.desk import answer_to
from ebamcheck.live.heat_so_far import HeatSoFar
from ebamcheck.live.journal import read_journal
from ebamcheck.live.loading import finished_run
from ebamcheck.live.making import LayerMaker, Wanted
from ebamcheck.live.publishing import LAYERS
from ebamcheck.live.pyrometer import ALIKE_K, corrected, fault_of_temperature, temperature_of
from ebamcheck.settings.config import Config

SIZE = (30, 24, 5.2)


@pytest.fixture(scope="module")
def maker(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pyrometer")
    write_stl(box(upper=SIZE), folder / "box.stl")
    done = ebamcheck("run", "box.stl", "-o", "box.run", "--backends", FAST, cwd=folder)
    assert done.returncode == 0, done.stderr
    found = finished_run(folder / "box.run")
    with LayerMaker(found.part, found.config, found.primary) as made:
        yield made


@pytest.fixture(scope="module")
def heat(maker, tmp_path_factory):
    """Heat of a part when its first layer was laid."""
    folder = tmp_path_factory.mktemp("first") / "p"
    made = maker.make(Wanted(0, 0.0, 1.7, "MAIN_K0001R1"), HeatSoFar.cold(maker.config), folder)
    assert made.passed, made.why
    return made.heat


@pytest.mark.parametrize("off_k", [-120.0, -40.0, -5.0, 5.0, 40.0, 120.0])
def test_the_corrected_model_reads_what_was_measured(heat, off_k):
    before = heat.surface_k
    after, said = corrected(heat, before + off_k)
    assert after.surface_k == pytest.approx(before + off_k, abs=0.1)
    assert heat.surface_k == before
    assert (said.rested_s > 0.0) == (off_k < 0.0)
    assert (said.added_j > 0.0) == (off_k > 0.0)
    assert ("colder" if off_k < 0 else "warmer") in said.told()["why"]
    stored = after.part.column.stored_j - heat.part.column.stored_j
    assert (stored > 0.0) == (off_k > 0.0)


def test_what_a_pyrometer_cannot_tell_corrects_nothing(heat):
    after, said = corrected(heat, heat.surface_k + 0.9 * ALIKE_K)
    assert after is heat
    assert said.rested_s == said.added_j == 0.0


def test_temperatures_out_of_limits_are_refused_with_the_limit(heat):
    config = Config()
    warm = heat.surface_k
    assert fault_of_temperature(heat, warm, config) == ""
    assert "process.pyrometer_limit_k" in fault_of_temperature(heat, warm + 151.0, config)
    wide = config.changed(process={"pyrometer_limit_k": 1000.0})
    assert fault_of_temperature(heat, warm + 151.0, wide) == ""
    for value in (-3.0, 20.0, 5000.0, 1e300):
        assert "give kelvins" in fault_of_temperature(heat, value, wide)
    assert "on which something was laid" in fault_of_temperature(HeatSoFar.cold(config), 300.0, config)


@pytest.mark.parametrize("value", ["hot", True, float("nan"), float("inf"), [300.0]])
def test_what_is_no_temperature_is_said(value):
    assert "is not a finite number of kelvins" in temperature_of({"surface_k": value})


def test_none_is_none():
    assert temperature_of({}) is None
    assert temperature_of({"surface_k": None}) is None
    assert temperature_of({"surface_k": 700}) == 700.0


def ask(building, **message):
    return answer_to(building, json.dumps(message).encode())


def test_the_wait_follows_the_temperature_and_the_journal_says_why(maker, heat, tmp_path):
    waits, told = {}, {}
    for name, off_k in (("colder", -60.0), ("as worked out", None), ("warmer", 60.0)):
        building = Building(maker, tmp_path / name)
        try:
            first = ask(building, event="start")
            height = {"event": "height", "done": 1, "height_mm": first["thickness_mm"]}
            warm = building.heat.surface_k
            assert ask(building, **height, surface_k="hot")["code"] == "temperature"
            assert ask(building, **height, surface_k=warm + 400.0)["code"] == "temperature"
            answer = ask(building, **height, **({} if off_k is None else {"surface_k": warm + off_k}))
            assert answer["answer"] == "published", answer
            waits[name], told[name] = answer["wait_s"] + answer["layer_s"], answer
        finally:
            building.close()
    assert waits["colder"] < waits["as worked out"] < waits["warmer"]
    assert "temperature" not in told["as worked out"]
    entries = list(read_journal(tmp_path / "warmer" / "journal.jsonl"))
    assert "60 K warmer than worked out" in next(e["why_wait"] for e in entries if "why_wait" in e)
    assert [e["surface_k"] for e in entries if "surface_k" in e] == [
        pytest.approx(told["warmer"]["temperature"]["measured_k"])
    ]
    # The journal makes the same bytes again.
    (tmp_path / "again").mkdir()
    shutil.copy(tmp_path / "warmer" / "journal.jsonl", tmp_path / "again")
    Building(maker, tmp_path / "again").close()
    name = told["warmer"]["name"]
    for path in (tmp_path / "warmer" / LAYERS / name).rglob("*"):
        if path.is_file():
            made = tmp_path / "again" / LAYERS / name / path.relative_to(tmp_path / "warmer" / LAYERS / name)
            assert made.read_bytes() == path.read_bytes()

"""Wire on the spool and life of the cathode: where either ends before the build does, it is found, on every control."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from live_boxes import maker_of, run_of_box
from parts import box
from program_text import CONTROLS, ProgramText, near
from report_runs import write_stl

from ebamcheck.checks.consumables import CATHODE, SPOOL, consumed
from ebamcheck.live import before
from ebamcheck.live.building import Building
from ebamcheck.live.making import LayerMaker
from ebamcheck.live.verifying import verify_build
from ebamcheck.pipeline.findings import consumable_findings
from ebamcheck.preflight.report import ready
from ebamcheck.program import program_summary, read_program
from ebamcheck.settings.config import Config

SINUMERIK = CONTROLS[0]


def used(text):
    """Wire, kg, and hours under beam of each layer, by the program's summary."""
    summary = program_summary(read_program(text.files.main, text.config), text.config)
    return summary["wire_kg"].to_numpy(), summary["deposit_s"].to_numpy() / 3600.0


@pytest.mark.parametrize("control", CONTROLS)
@pytest.mark.parametrize(("setting", "name"), [("spool_kg", SPOOL), ("cathode_h", CATHODE)])
def test_what_ends_before_the_program_is_found_in_its_layer(control, setting, name, tmp_path):
    amount = used(ProgramText(control, tmp_path / "p"))[setting == "cathode_h"]
    enough = ProgramText(control, tmp_path / "q", {setting: 1.001 * amount.sum()})
    assert name not in enough.failed_by_text()
    short = ProgramText(control, tmp_path / "r", {setting: amount[0] + 0.5 * amount[1]})
    found = short.failed_by_text()[name]
    assert found.value == pytest.approx(amount.sum(), rel=1e-3)
    # It ends in the motion by which half of the second layer is laid: all its beads have one feed and one wire.
    program = read_program(short.files.main, short.config)
    beads = np.flatnonzero(program.deposit & (program.layer == 1))
    here = [program.where(int(row)) for row in beads].index(found.where)
    laid = program.lengths[beads].cumsum() / program.lengths[beads].sum()
    assert laid[here - 1] - 1e-3 < 0.5 < laid[here] + 1e-3
    assert "it ends in layer 2" in found.text


def test_more_wire_in_one_bead_ends_the_spool(tmp_path):
    """The text itself is weighed, not what was planned."""
    total = used(ProgramText(SINUMERIK, tmp_path / "p"))[0].sum()
    text = ProgramText(SINUMERIK, tmp_path / "q", {"spool_kg": 1.05 * total})
    assert SPOOL not in text.failed_by_text()
    text.edit_all(r"(H3=)([\d.]+)", lambda m: f"{m[1]}{1.2 * float(m[2]):.6f}")
    assert SPOOL in text.failed_by_text()


@pytest.mark.parametrize("control", CONTROLS)
def test_stops_let_a_new_spool_be_put_on(control, tmp_path):
    amount = used(ProgramText(control, tmp_path / "p"))[0]
    holds = 1.2 * amount.max()
    without = ProgramText(control, tmp_path / "q", {"spool_kg": holds})
    assert "it ends in layer 2" in without.failed_by_text()[SPOOL].text
    stopping = ProgramText(control, tmp_path / "r", {"spool_kg": holds, "optional_stop": True})
    assert SPOOL not in stopping.failed_by_text()
    (found,) = consumable_findings(read_program(stopping.files.main, stopping.config), stopping.config)
    assert (found.severity, found.code) == ("warning", "consumable-change")
    assert "a new one before layer 2" in found.text
    least = ProgramText(control, tmp_path / "s", {"spool_kg": 0.9 * amount[0], "optional_stop": True})
    assert "it ends in layer 1" in least.failed_by_text()[SPOOL].text


def test_a_motion_without_a_feed_never_ends(tmp_path):
    text = ProgramText(SINUMERIK, tmp_path / "p", {"cathode_h": 1e6, "spool_kg": 1e6})
    program = read_program(text.files.main, text.config)
    assert [found.ends_in for found in consumed(program, text.config)] == [None, None]
    program.feed_mm_min[np.flatnonzero(program.beam)[3]] = 0.0
    assert [(found.ends_in, math.isinf(found.total)) for found in consumed(program, text.config)] == [(0, True)] * 2


def test_a_motion_without_a_feed_uses_up_nothing_where_neither_beam_nor_wire_is_on(tmp_path):
    text = ProgramText(SINUMERIK, tmp_path / "p", {"cathode_h": 1e6, "spool_kg": 1e6})
    program = read_program(text.files.main, text.config)
    row = np.flatnonzero(program.beam)[3]
    program.feed_mm_min[row], program.beam[row], program.wire[row] = 0.0, False, False
    assert [found.ends_in for found in consumed(program, text.config)] == [None, None]


def test_the_preflight_weighs_the_part(tmp_path):
    write_stl(box(upper=(40.0, 40.0, 40.0)), tmp_path / "cube.stl")
    part_kg = 40.0**3 * 1e-9 * 4430.0

    def level(**machine):
        checks = ready(tmp_path / "cube.stl", Config().changed(machine=machine)).preflight.checks
        return next((check.level for check in checks if check.name == SPOOL), None)

    assert level() is None
    assert level(spool_kg=1.01 * part_kg) == "pass"
    assert level(spool_kg=0.99 * part_kg) == "warning"
    assert level(spool_kg=0.99 * part_kg, optional_stop=True) == "pass"


@pytest.mark.parametrize("control", CONTROLS)
def test_the_place_is_a_motion_that_feeds(control, tmp_path):
    amount = used(ProgramText(control, tmp_path / "p"))[0]
    text = ProgramText(control, tmp_path / "q", {"spool_kg": 0.3 * amount[0]})
    found = text.failed_by_text()[SPOOL]
    program = read_program(text.files.main, text.config)
    assert any(near(found.where, program.where(int(row))) for row in np.flatnonzero(program.wire))


# -- builds layer by layer ------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """Folder with a run of a box of seven layers."""
    return run_of_box(tmp_path_factory, (30, 24, 12))


def three_layers(place, folder, **machine):
    """Answers of a build to its first three heights, with what the machine holds of a layer's own."""
    with maker_of(place) as found:
        config = found.config.changed(machine=machine)
        with LayerMaker(found.part, config, found.primary) as maker:
            building = Building(maker, folder)
            answers = [building.start()]
            for done in (1, 2):
                if answers[-1]["answer"] == "published":
                    answers.append(building.height({"done": done, "height_mm": 12.0 / 7.0 * done}))
            building.close()
    return answers


@pytest.fixture(scope="module")
def of_a_layer(place, tmp_path_factory):
    """Wire, kg, and hours under beam of the first layer, by its certificate."""
    folder = tmp_path_factory.mktemp("amounts") / "b"
    three_layers(place, folder, spool_kg=1e3, cathode_h=1e3)
    spent = [json.loads((folder / "layers" / f"MAIN_K000{k}R1" / "layer.json").read_text())["spent"] for k in (1, 2, 3)]
    for name in ("wire_kg", "beam_h"):
        assert [one[name] for one in spent] == pytest.approx([k * spent[0][name] for k in (1, 2, 3)], rel=0.1)
    return {"spool_kg": spent[0]["wire_kg"], "cathode_h": spent[0]["beam_h"]}


@pytest.mark.parametrize(("setting", "name"), [("spool_kg", SPOOL), ("cathode_h", CATHODE)])
def test_a_build_keeps_back_the_layer_in_which_it_would_end(setting, name, place, of_a_layer, tmp_path):
    holds = 2.5 * of_a_layer[setting]
    *before, last = three_layers(place, tmp_path / "b", **{setting: holds})
    assert [answer["answer"] for answer in before] == ["published"] * 2
    assert last["answer"] == "kept"
    assert name in last["reason"]
    assert "which the layers below took" in last["reason"]
    *_, last = three_layers(place, tmp_path / "c", **{setting: holds}, optional_stop=True)
    assert last["answer"] == "published"
    assert any("before this layer" in said for said in last["said"])
    assert all(layer.passed for layer in verify_build(tmp_path / "c", place / "box.stl"))


def test_verify_adds_up_what_a_build_took(place, of_a_layer, tmp_path, monkeypatch):
    """A server that takes every layer to begin with a full spool is found after the fact."""
    monkeypatch.setattr(before, "consumed", lambda nc, config, spent: consumed(nc, config), raising=True)
    answers = three_layers(place, tmp_path / "b", spool_kg=2.5 * of_a_layer["spool_kg"])
    assert [answer["answer"] for answer in answers] == ["published"] * 3
    found = verify_build(tmp_path / "b", place / "box.stl")
    assert [layer.passed for layer in found] == [True, True, False]
    assert SPOOL in found[-1].why

"""Wire on the spool and life of the cathode: where either ends before the build does, it is found, on every control."""

from __future__ import annotations

import math

import numpy as np
import pytest
from parts import box
from program_text import CONTROLS, ProgramText, near
from report_runs import write_stl

from ebamcheck.pipeline.noticed_in_program import of_consumables
from ebamcheck.preflight.report import ready
from ebamcheck.program import program_summary, read_program
from ebamcheck.program.checking.consumables import CATHODE, SPOOL, consumed
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
    (found,) = of_consumables(read_program(stopping.files.main, stopping.config), stopping.config)
    assert (found.severity, found.code) == ("warning", "consumable-change")
    assert "a new one before layer 2" in found.text
    least = ProgramText(control, tmp_path / "s", {"spool_kg": 0.9 * amount[0], "optional_stop": True})
    assert "it ends in layer 1" in least.failed_by_text()[SPOOL].text


def test_a_motion_without_a_feed_never_ends(tmp_path):
    text = ProgramText(SINUMERIK, tmp_path / "p", {"cathode_h": 1e6, "spool_kg": 1e6})
    program = read_program(text.files.main, text.config)
    assert [found.ends_in for found in consumed(program, text.config)] == [None, None]
    program.feed_mm_min[np.flatnonzero(program.beam)[3]] = 0.0
    assert [(found.ends_in, math.isinf(found.total)) for found in consumed(program, text.config)] == [
        (0, True)
    ] * 2


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

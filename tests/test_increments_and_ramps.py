"""Process values in the steps of the control, and ramps judged by the time they take: written, read back, and spoiled."""

from __future__ import annotations

import re
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st
from program_text import CONTROLS, ProgramText, near

from ebamcheck.errors import SettingsError
from ebamcheck.nc.conventions import to_increment
from ebamcheck.program import read_program, verify_file
from ebamcheck.settings.config import Config, validated

SINUMERIK, LINUXCNC, PLAIN = CONTROLS
STEPS = {
    "feed_increment_mm_min": 7.0,
    "power_increment_w": 25.0,
    "voltage_increment_kv": 0.5,
    "current_increment_ma": 0.3,
    "wire_increment_mm_s": 0.25,
}
VALUES = {
    SINUMERIK: {r"H1=": 0.5, r"H2=": 0.3, r"H3=": 0.25, r"F(?=\d{3})": 7.0},
    LINUXCNC: {r"M68 E0 Q": 0.5, r"M68 E1 Q": 0.3, r"M6[78] E2 Q": 0.25, r"\bF(?=\d{3})": 7.0},
    PLAIN: {r"(?<!P1 )\bS(?=\d)": 25.0, r"M42 P1 S": 0.25, r"\bF(?=\d{3})": 7.0},
}
RAMPS = {"ramp_up_mm": 4.0, "crater_fill_mm": 6.0, "ramp_power": 0.4, "ramp_steps": 4}


@given(st.floats(0.0, 1e4), st.floats(1e-3, 100.0))
def test_a_value_becomes_the_nearest_multiple_and_what_is_not_0_stays_so(value, step):
    found = to_increment(value, step)
    assert found / step == pytest.approx(round(found / step), abs=1e-6)
    assert abs(found - value) <= max(0.5 * step * (1.0 + 1e-9), step - value)
    assert (found == 0.0) == (value == 0.0)


@pytest.mark.parametrize("control", CONTROLS)
def test_a_program_holds_multiples_of_the_increments_and_passes(control, tmp_path):
    text = ProgramText(control, tmp_path / "p", STEPS, RAMPS)
    found = 0
    for lines in text.lines.values():
        for line in lines:
            for word, step in VALUES[control].items():
                for value in re.findall(rf"{word}([\d.]+)", line.split(";")[0]):
                    found += 1
                    assert float(value) / step == pytest.approx(round(float(value) / step), abs=1e-4), line
    assert found > 30
    fails = set(text.failed())
    plain = set(ProgramText(control, tmp_path / "q", None, RAMPS).failed())
    assert fails == plain
    assert "increments" not in fails


@pytest.mark.parametrize("control", CONTROLS)
def test_values_between_the_increments_of_a_profile_are_found(control, tmp_path):
    """The program of a finer control, for one that takes coarser steps."""
    text = ProgramText(control, tmp_path / "p", None, RAMPS)
    text.config = text.config.changed(machine=STEPS)
    found = text.failed()["increments"]
    file, line = found.where.split(":")
    block = (text.files.folder / file).read_text().split("\n")[int(line) - 1]
    assert any(re.search(word, block) for word in VALUES[control])
    assert found.value > 5


@pytest.mark.parametrize("control", CONTROLS)
def test_steps_that_are_one_to_the_control_are_not_set_twice(control, tmp_path):
    """Of four steps of power along a ramp, a coarse control has one or two: the value is written where it changes."""
    word = {SINUMERIK: r"H2=([\d.]+)", LINUXCNC: r"M67 E1 Q([\d.]+)", PLAIN: r"^S([\d.]+)"}[control]
    counts = []
    for step in (0.0, 60.0):
        coarse = {"current_increment_ma": step, "power_increment_w": 15.0 * step}
        text = ProgramText(control, tmp_path / f"{step:g}", coarse, RAMPS)
        name, begin = text.layer(2)
        inner = text.lines[name][text.find(name, word, nth=1, begin=begin) :]
        values = [m[1] for line in inner if (m := re.search(word, line))]
        assert all(a != b for a, b in pairwise(values[:8]))
        counts.append(len(values))
    assert counts[1] <= counts[0]
    assert control == PLAIN or counts[1] < counts[0]


# -- ramps ----------------------------------------------------------------------------------------------


def ramp_of(text, **process):
    """The check of the ramps of a program under other windows."""
    config = text.config.changed(process=process)
    checks = verify_file(text.files.main, config=config, curves=text.curves, plan=text.plan)
    return next(check for check in checks if check.name == "ramps in time")


@pytest.mark.parametrize("control", CONTROLS)
def test_ramps_take_their_length_over_the_feed(control, tmp_path):
    """4 mm and 6 mm at 10 mm/s are 0.4 s and 0.6 s; cuts lie at the ends of blocks that are near."""
    text = ProgramText(control, tmp_path / "p", None, RAMPS)
    found = ramp_of(text)
    assert found.passed
    times = [float(t) for t in re.findall(r"[\d.]*\d(?= \.\.| s)", found.text)]
    assert times == pytest.approx([0.4, 0.4, 0.6, 0.6], abs=0.003)
    assert ramp_of(text, ramp_up_window_s=(0.35, 0.45), crater_fill_window_s=(0.55, 0.65)).passed
    late = ramp_of(text, ramp_up_window_s=(0.1, 0.3))
    assert not late.passed
    assert "allowed are 0.1 .. 0.3 s" in late.text
    assert not ramp_of(text, ramp_up_window_s=(0.5, 1.0)).passed
    assert not ramp_of(text, crater_fill_window_s=(0.7, 1.0)).passed


@pytest.mark.parametrize("control", CONTROLS)
def test_a_slower_feed_along_a_ramp_is_found_by_its_time(control, tmp_path):
    text = ProgramText(control, tmp_path / "p", None, {**RAMPS, "ramp_up_window_s": (0.3, 0.5)})
    name, begin = text.layer(2)
    place = text.edit(name, r"\bF600\b", "F300", begin=begin)
    assert near(text.failed_by_text()["ramps in time"].where, place)


def test_without_ramps_the_beam_is_full_at_once(tmp_path):
    text = ProgramText(PLAIN, tmp_path / "p")
    assert "rises in 0 .. 0 s" in ramp_of(text).text
    assert not ramp_of(text, ramp_up_window_s=(0.2, 0.5)).passed


def test_a_window_is_given_in_order():
    with pytest.raises(SettingsError, match="lower one first"):
        validated({"process": {"ramp_up_window_s": [0.5, 0.2]}}, "here")
    assert Config().process.ramp_up_window_s is None


def test_the_values_read_back_are_those_that_are_written(tmp_path):
    text = ProgramText(SINUMERIK, tmp_path / "p", STEPS)
    nc = read_program(text.files.main, text.config)
    assert set(nc.feed_mm_min[nc.deposit]) == {602.0}

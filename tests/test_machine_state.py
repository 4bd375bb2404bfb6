"""The machine's state at every motion: what changes it where it must not is found, at its place, on every control."""

from __future__ import annotations

import re

import numpy as np
import pytest
from program_text import CONTROLS, ProgramText, near

from ebamcheck.nc.control import control
from ebamcheck.nc.words import group_of, wanted_words
from ebamcheck.program import read_program, verify_file

SINUMERIK, LINUXCNC, PLAIN = CONTROLS

STATE = ("modes", "smoothing", "readable", "order of events")
"""Checks that may find a word that changes the state."""

IN_A_BEAD = {
    SINUMERIK: (
        "G55", "G500", "G505", "G53", "G18", "G19", "G70", "G700", "G71", "G91", "G93", "G95", "G96",
        "G60", "G64", "G641", "G641 ADIS=5", "G643", "G644", "G645", "CTOL=0.5", "ADIS=0.01", "BRISK", "DRIVE", "FFWOF",
        "COMPCAD", "FLIN", "OVR=50", "TRANS X5", "ATRANS X5", "ROT RPL=5", "SCALE X2", "MIRROR X0", "G41", "D1", "T1",
        "M0", "M1", "M3 S100", "M8", "GOTOF ENDE", "REPEAT ANFANG", "IF R1==1", "POS[X]=5", "G4 F2", "G75 FP=1 X0", "CTOL=0.0001",
    ),
    LINUXCNC: (
        "G55", "G59.3", "G10 L2 P1 X5", "G92 X5", "G52 X5", "G18", "G20", "G91", "G90.1", "G93", "G95", "G61", "G61.1",
        "G64", "G64 P0.5", "G41 D1", "G43 H1", "G81", "M0", "M1", "M50 P0", "M3 S100", "M8", "T1 M6", "O100 CALL", "%",
        "G4 P2", "G28", "M60", "(py, x)", ";py, x", "( PyRun, x)", ";pyreload", "G64 P0.001",
    ),
    PLAIN: (
        "G55", "G92 X5", "G18", "G20", "G91", "G93", "G95", "G41", "G43", "M0", "M1", "M220 S50", "T1", "%", "G28",
        "G4 S2", "M98 P100",
    ),
}  # fmt: skip
"""Words that must not stand within a bead: modal words, frames, offsets, flow, other axes, waits."""


@pytest.mark.in_turn(3)
@pytest.mark.parametrize(("control", "word"), [(c, w) for c, words in IN_A_BEAD.items() for w in words])
def test_a_word_in_a_bead_that_changes_the_state_is_found(control, word, tmp_path):
    text = ProgramText(control, tmp_path / "p")
    place = text.insert(*text.in_bead(), word)
    found = text.failed_by_text()
    assert any(near(found[name].where, place) for name in STATE if name in found), found


@pytest.mark.parametrize("control", CONTROLS)
def test_an_honest_program_passes(control, tmp_path):
    assert ProgramText(control, tmp_path / "p").failed() == {}
    process = {"ramp_up_mm": 4.0, "crater_fill_mm": 3.0, "wire_retract_mm": 3.0, "layer_pause_s": 5.0}
    assert ProgramText(control, tmp_path / "q", process=process).failed() == {}


@pytest.mark.in_turn(3)
@pytest.mark.parametrize("control", CONTROLS)
def test_every_mode_is_established_by_the_main_program(control, tmp_path):
    for word in wanted_words(control, ProgramText(control, tmp_path / "p").config.machine).values():
        text = ProgramText(control, tmp_path / "p")
        pattern, begin = rf"(?<![\w.]){re.escape(word)}(?![\w.])( P[\d.]+)?", text.find(text.main, "G17")
        place = text.edit(text.main, pattern, "", begin=begin)
        found = text.failed_by_text()
        named = [found[n] for n in ("modes", "smoothing") if n in found]
        assert any(near(check.where, place) for check in named), (word, found)


@pytest.mark.in_turn(3)
@pytest.mark.parametrize("control", CONTROLS)
def test_every_block_of_the_safe_end_is_asked_for(control, tmp_path):
    text = ProgramText(control, tmp_path / "p")
    lines = text.lines[text.main]
    last = text.find(text.main, r"\bM(2|30)$")
    first = last - 1
    while re.search(r"G0 [XZ]|[MHS]\d+", lines[first - 1]) and "MAIN_L" not in lines[first - 1]:
        first -= 1
    kept = {re.sub(r"^N\d+ ", "", line) for line in lines[first:last]}
    assert len(kept) >= 6
    for i in range(first, last):
        text = ProgramText(control, tmp_path / "p")
        block = re.sub(r"^N\d+ ", "", text.lines[text.main].pop(i))
        found = text.failed_by_text()
        rises_anyway = block.startswith("G0 Z")  # the layer has risen already
        off_anyway = re.search(r"(beam|wire) off", block)  # the last bead has switched them off
        asked = "safe end" in found or "beam" in found or "wire" in found
        assert asked or rises_anyway or off_anyway, block


def test_the_retract_of_the_end_is_asked_for(tmp_path):
    text = ProgramText(SINUMERIK, tmp_path / "p")
    place = text.edit(text.main, r"G0 Z[\d.]+", "G0 Z3.1")
    assert near(text.failed_by_text()["safe end"].where, place)


@pytest.mark.parametrize("control", CONTROLS)
def test_a_beam_without_its_power_is_found(control, tmp_path):
    text = ProgramText(control, tmp_path / "p")
    zero = {SINUMERIK: "H2=0", LINUXCNC: "M68 E1 Q0", PLAIN: "M3 S0"}[control]
    place = text.edit_all(r"H2=120", zero) if control == SINUMERIK else text.edit_all(r"M68 E1 Q120|M3 S7200", zero)
    found = text.failed_by_text()["order of events"]
    assert "power" in found.text
    assert place.split(":")[0] in (found.where.split(":")[0], text.main)


@pytest.mark.parametrize("control", CONTROLS)
def test_a_first_way_without_one_axis_is_found(control, tmp_path):
    text = ProgramText(control, tmp_path / "p")
    name, begin = text.layer(1)
    place = text.edit(name, r"G0 X-?[\d.]+ ", "G0 ", begin=begin)
    found = text.failed_by_text()
    assert "readable" in found or any(near(check.where, place) for check in found.values())


@pytest.mark.parametrize("control", CONTROLS)
def test_a_beam_that_stands_is_found(control, tmp_path):
    text = ProgramText(control, tmp_path / "p")
    name, begin = text.layer(2)
    off = text.find(name, "; beam off", begin=begin)
    on = {SINUMERIK: "M60", LINUXCNC: "M64 P0", PLAIN: "M3 S7200"}[control]
    place = text.insert(name, off + 1, {SINUMERIK: "M61", LINUXCNC: "M65 P0", PLAIN: "M5"}[control])
    text.insert(name, off + 1, on)
    assert near(text.failed_by_text()["order of events"].where, place)


ENTRY = {
    SINUMERIK: ("G17 G710 G90 G94", "G40 D0", "TRAFOOF", "TRANS", "G54", "SOFT FFWON G642", "H2=120"),
    LINUXCNC: ("G40 G49 G80", "G54", "G64 P0.05", "G92.1", "M68 E1 Q120"),
    PLAIN: ("G40 G49 G80", "G92.1", "G54"),
}


@pytest.mark.in_turn(2)
@pytest.mark.parametrize(("control", "word"), [(c, w) for c, words in ENTRY.items() for w in words])
def test_a_layer_without_its_modes_is_found(control, word, tmp_path):
    text = ProgramText(control, tmp_path / "p")
    name, begin = text.layer(2)
    place = text.drop(name, rf"^(N\d+ )?{word}", begin=begin)
    assert near(text.failed_by_text()["modes"].where, place)


@pytest.mark.parametrize("control", CONTROLS)
def test_a_program_can_be_entered_at_a_layer(control, tmp_path):
    """The last layer by itself is what it is in the whole program: it takes nothing from the layers before it."""
    text = ProgramText(control, tmp_path / "p")
    whole = read_program(text.files.main, text.config)
    name, begin = text.layer(2)
    if control == SINUMERIK:
        alone = text.files.folder / name
    else:
        alone = text.files.folder / "ENTRY" / text.main
        alone.parent.mkdir()
        alone.write_text("\n".join(text.lines[name][begin:]))
    entered = read_program(alone, text.config)
    first = int(np.argmax(whole.layer == whole.layer.max()))
    count = int((entered.deposit).sum())
    assert count == int(whole.deposit[first:].sum()) > 10
    for column in ("feed_mm_min", "power_w", "wire_mm_s", "end"):
        a = getattr(whole, column)[first:][whole.deposit[first:]]
        b = getattr(entered, column)[entered.deposit]
        assert np.array_equal(a, b), column
    words = set(wanted_words(control, text.config.machine).values())
    assert words <= {n for n, row in zip(entered.events.name, entered.events.row, strict=True) if row == 0}


@pytest.mark.parametrize("control", CONTROLS)
def test_a_program_from_a_layer_on_has_its_blocks_as_they_were(control, tmp_path):
    from ebamcheck.errors import SettingsError
    from ebamcheck.writing.posts import begin_at_layer

    text = ProgramText(control, tmp_path / "p")
    whole = read_program(text.files.main, text.config)
    last = whole.layer == whole.layer.max()
    before = {name: (text.files.folder / name).read_text() for name in text.files.names}
    with pytest.raises(SettingsError, match="has layers 1 to 2"):
        begin_at_layer(text.files, 3)
    files = begin_at_layer(text.files, 2)
    nc = read_program(files.main, text.config)
    assert np.array_equal(nc.end[nc.deposit], whole.end[whole.deposit & last])
    assert np.array_equal(nc.end[-2:], whole.end[-2:])
    if control == SINUMERIK:
        assert files.names == ("MAIN.MPF", "MAIN_L0002.SPF")
        assert (files.folder / files.names[1]).read_text() == before[files.names[1]]
    checks = {c.name: c for c in verify_file(files.main, config=text.config, sha256=files.sha256)}
    for name in (
        "unchanged",
        "modes",
        "smoothing",
        "start state",
        "order of events",
        "safe end",
        "subprograms",
    ):
        assert checks[name].passed, checks[name]


@pytest.mark.parametrize("word", ["", "G64", "G641", "G644"])
def test_a_profile_whose_smoothing_keeps_no_tolerance_is_found(word, tmp_path):
    """CTOL stands in the program all the same, and the header says that the path keeps to it."""
    machine = {"smoothing": ("SOFT", "FFWON", *word.split())}
    found = ProgramText(SINUMERIK, tmp_path / "p", machine).failed()
    assert "no other word keeps the path within the tolerance" in found["smoothing"].text


@pytest.mark.parametrize("word", ["G60", "G642", "G643", "G645"])
def test_a_profile_whose_smoothing_keeps_its_tolerance_passes(word, tmp_path):
    machine = {"smoothing": ("SOFT", "FFWON", word)}
    assert "smoothing" not in ProgramText(SINUMERIK, tmp_path / "p", machine).failed()


def test_no_word_belongs_to_two_groups():
    for groups in (control(name).groups for name in CONTROLS):
        words = [word for group in groups for word in group.words]
        assert len(words) == len(set(words))


def test_the_words_of_a_group_are_named_when_they_are_refused(tmp_path):
    text = ProgramText(SINUMERIK, tmp_path / "p")
    text.insert(*text.in_bead(), "G18")
    assert "plane may not change" in text.failed_by_text()["readable"].text
    assert group_of(LINUXCNC, "G59.3").name == "work offset"


@pytest.mark.parametrize("control", CONTROLS)
def test_a_stop_that_the_operator_asks_for_is_written_and_read(control, tmp_path):
    text = ProgramText(control, tmp_path / "p", {"optional_stop": True})
    assert text.failed() == {}
    assert sum(bool(re.search(r"\bM1$", line)) for lines in text.lines.values() for line in lines) == 2


@pytest.mark.parametrize("control", CONTROLS)
def test_comments_behind_codes_can_be_left_out(control, tmp_path):
    text = ProgramText(control, tmp_path / "p", {"trailing_comments": False})
    assert text.failed() == {}
    assert not any("; beam on" in line for lines in text.lines.values() for line in lines)


def test_the_tool_is_parked_within_the_travel_and_over_clamps(tmp_path):
    clamp = {"outline_mm": ((150, 150), (160, 150), (160, 160)), "z_mm": (0.0, 80.0)}
    machine = {"park_mm": (-2000.0, 50.0)}
    text = ProgramText(SINUMERIK, tmp_path / "p", machine, {"keep_out": (clamp,)})
    found = read_program(text.files.main, text.config)
    assert found.end[-1].tolist() == [-1000.0, 50.0, 85.0]
    assert "safe end" not in text.failed()


@pytest.mark.parametrize("control", CONTROLS)
def test_the_feed_stands_before_a_comment(control, tmp_path):
    """A bead whose first vector rounds to nothing begins with a turn; the feed of its block is no part of the comment."""
    from dataclasses import replace

    from ebamcheck.program import write_program

    text = ProgramText(control, tmp_path / "p")
    vectors = text.plan.vectors.copy()
    first = vectors.index[vectors["island"] == 0][0]
    vectors.loc[first, ["x1", "y1"]] = vectors.loc[first, ["x0", "y0"]].to_numpy() + 1e-9
    # The end of the line that is gone lies where its neighbour begins a turn.
    plan = replace(text.plan, vectors=vectors)
    files = write_program(text.curves, plan, text.config, tmp_path / "q")
    nc = read_program(files.main, text.config)
    assert np.isfinite(nc.feed_mm_min[nc.deposit]).all()
    for name in files.names:
        for line in (files.folder / name).read_text().split("\n"):
            assert "F600" not in line.partition(";")[2]


@pytest.mark.parametrize("control", CONTROLS)
def test_of_a_program_that_leads_kilometres_away_nothing_else_is_judged(control, tmp_path):
    """To sample and simulate its path would take hours and all memory."""
    text = ProgramText(control, tmp_path / "p")
    # One of a hatch: behind it there is no arc, which would not fit.
    name, line = text.in_bead(nth=0)
    line = text.find(name, "; TURN", begin=line)
    place = text.edit(name, r"G1 X(-?\d+)\.(\d+)", r"G1 X\1\2", begin=line - 1)
    found = text.failed_by_text()
    assert set(found) == {"travel"}
    assert near(found["travel"].where, place, 0)
    assert "nothing else is judged" in found["travel"].text


NUMBERS = {SINUMERIK: ("H3=", "F"), LINUXCNC: ("M68 E2 Q", "F"), PLAIN: ("M42 P1 S", "F")}


@pytest.mark.parametrize("digits", ["9" * 400, "999999999", "0." + "0" * 20 + "1"])
@pytest.mark.parametrize("which", [0, 1])
@pytest.mark.parametrize("control", CONTROLS)
def test_a_number_that_no_control_takes_is_told_in_one_line(control, which, digits, tmp_path):
    text = ProgramText(control, tmp_path / "p")
    name, begin = text.layer(2)
    address = NUMBERS[control][which]
    place = text.edit(name, rf"{address}[\d.]+", f"{address}{digits}", begin=begin)
    found = text.failed_by_text()
    assert found
    assert all("\n" not in check.text for check in found.values())
    if float(digits) > 1.0:
        assert near(found["readable"].where, place, 1)


@pytest.mark.parametrize("control", CONTROLS)
def test_a_place_that_no_control_takes_is_refused_where_it_stands(control, tmp_path):
    for axis in "XYZ":
        text = ProgramText(control, tmp_path / "p")
        name, begin = text.layer(2)
        place = text.edit(name, rf"G0(.*){axis}[-\d.]+", rf"G0\g<1>{axis}-{'9' * 400}", begin=begin)
        assert near(text.failed_by_text()["readable"].where, place, 0)


def test_a_work_offset_that_goes_with_a_transformation_is_to_be_chosen_again(tmp_path):
    text = ProgramText(SINUMERIK, tmp_path / "p")
    name, begin = text.layer(2)
    off, offset = (text.find(name, word, begin=begin) for word in ("TRAFOOF", "G54"))
    place = text.swap(name, off, offset)
    found = text.failed_by_text()["modes"]
    assert near(found.where, place)
    assert "TRAFOOF takes G54 back" in found.text


def test_a_value_of_linuxcnc_that_stops_the_tool_along_a_bead_is_found(tmp_path):
    """M68 sets at once, and breaks blending: the tool stands under the beam. M67 comes with the motion behind it."""
    text = ProgramText(LINUXCNC, tmp_path / "p")
    name, line = text.in_bead()
    for code in ("M68 E2 Q33.5", "M68 E1 Q120", "M68 E0 Q60"):
        text = ProgramText(LINUXCNC, tmp_path / code)
        place = text.insert(name, line, code)
        found = text.failed_by_text()["order of events"]
        assert near(found.where, place, 0)
        assert "the tool stands for it under the beam" in found.text
    text = ProgramText(LINUXCNC, tmp_path / "q")
    text.insert(name, line, "M67 E1 Q120")
    assert "order of events" not in text.failed_by_text()


@pytest.mark.parametrize("ends", [{"beam_off": ["M68 E1 Q0", "M65 P0"]}, {"wire_stop": ["M68 E2 Q0", "M65 P1"]}])
def test_a_profile_may_set_a_value_to_nothing_before_it_switches_off(ends, tmp_path):
    assert not ProgramText(LINUXCNC, tmp_path / "p", machine=ends).failed_by_text()

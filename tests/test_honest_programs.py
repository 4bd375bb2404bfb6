"""Programs of small parts on every control: an honest one passes, whatever its comments say; metal in the air does not."""

from __future__ import annotations

import re

import numpy as np
import pytest
import shapely
from program_text import Text
from small_parts import POSTS, SHAPES, checks_of, made, written

from benchmarks.faults.judging import strip


@pytest.fixture(scope="module")
def parts():
    """Parts, planned once."""
    known = {}

    def part(shape):
        if shape not in known:
            known[shape] = made(shape)
        return known[shape]

    return part


NAMES = ("names and headers", "end of program", "block length", "blank", "size on the control", "header")
"""Checks of the text itself, in which comments count."""


def verdict(checks):
    """What every check says, but where."""
    return {n: (c.passed, c.value) for n, c in checks.items() if n not in NAMES}


@pytest.mark.in_turn(5)
@pytest.mark.parametrize("control", POSTS)
@pytest.mark.parametrize("shape", SHAPES)
def test_an_honest_program_passes_and_comments_change_nothing(parts, tmp_path, shape, control):
    part, before = parts(shape), {}
    main = written(part, control, tmp_path / "p")
    for planned in (True, False):
        checks = checks_of(main, part, control, planned)
        assert {n: (c.where, c.text) for n, c in checks.items() if not c.passed} == {}
        before[planned] = verdict(checks)
    # Every comment says another ring, island or layer now; then there is none.
    text = Text(main.parent)
    for lines in text.lines.values():
        lines[:] = [re.sub(r"^; (RING|ISLAND) \d+", "; RING 7", line) for line in lines]
    text.save()
    for change in (lambda folder: None, strip):
        change(main.parent)
        for planned in (True, False):
            assert verdict(checks_of(main, part, control, planned)) == before[planned]


@pytest.mark.parametrize("control", POSTS)
def test_ramps_and_overlaps_are_no_faults(parts, tmp_path, control):
    """Lines whose power changes along them, in wire that changes as well, stay one line."""
    process = {"ramp_up_mm": 4.0, "crater_fill_mm": 6.0, "overlap_mm": 4.0, "seam_shift_mm": 9.0}
    machine = {"curve_form": "arcs" if control == "linuxcnc" else "lines"}
    part = parts("block with a channel").by(process=process, machine=machine)
    main = written(part, control, tmp_path / "p")
    for planned in (True, False):
        checks = checks_of(main, part, control, planned)
        assert {n: (c.where, c.text) for n, c in checks.items() if not c.passed} == {}


def test_a_clamp_near_the_path_is_met_by_the_head(parts, tmp_path):
    clamp = {"name": "clamp", "outline_mm": ((-30, 5), (-12, 5), (-12, 25), (-30, 25)), "z_mm": (0.0, 30.0)}
    for above, passed in ((15.0, False), (29.0, True)):
        part = parts("cube").by(process={"keep_out": (clamp,)}, machine={"head_above_tip_mm": above})
        found = checks_of(written(part, "linuxcnc", tmp_path / f"p{above}"), part, "linuxcnc", False)["collision"]
        assert found.passed == passed, found.text
        if not passed:
            assert "the head goes" in found.text
            assert found.value == pytest.approx(30.0 - 15.0 - part.config.layer_height_mm, abs=0.01)


def test_a_zone_without_a_height_is_no_body(parts, tmp_path):
    zone = {"name": "probe", "outline_mm": ((-30, 5), (-12, 5), (-12, 25), (-30, 25))}
    part = parts("cube").by(process={"keep_out": (zone,)})
    checks = checks_of(written(part, "linuxcnc", tmp_path / "p"), part, "linuxcnc", False)
    assert all(check.passed for check in checks.values())


def test_the_worst_place_of_the_section_check_can_be_drawn(parts, tmp_path):
    part, control = parts("cube"), "plain-gcode"
    main = written(part, control, tmp_path / "p")
    text = Text(main.parent)
    third = text.find(main.name, "; LAYER: 3 ")
    text.edit(main.name, r"(?<=G1 X27\.)0(?=0+ Y27\.0+)", "8", begin=third)
    text.save()
    found = checks_of(main, part, control, False)["section"]
    assert not found.passed
    assert found.layer == 2
    assert np.hypot(found.x_mm - 27.8, found.y_mm - 27.0) < 1.0


# -- metal in the air ---------------------------------------------------------------------------------

BLOCK = shapely.box(0, 0, 30, 30)
ASIDE = shapely.box(60, 0, 84, 24)
AIR = {
    "a body that begins in the air": lambda k: BLOCK if k < 2 else shapely.union_all([BLOCK, ASIDE]),
    "a body over an empty layer": lambda k: BLOCK if k != 1 else shapely.Polygon(),
}
STANDS = {
    "a cap far beyond its stem": lambda k: BLOCK if k < 2 else BLOCK.buffer(14.0, join_style="mitre"),
    "a body that leans by less than its width": lambda k: shapely.box(20 * k, 0, 20 * k + 30, 30),
    "two bodies on the plate": lambda k: shapely.union_all([BLOCK, ASIDE]),
}


def support_of(tmp_path, monkeypatch, shape, control):
    monkeypatch.setitem(SHAPES, "now", shape)
    part = made("now")
    return checks_of(written(part, control, tmp_path / "p"), part, control, planned=False)["support"]


@pytest.mark.parametrize("control", POSTS)
@pytest.mark.parametrize("shape", AIR)
def test_metal_that_begins_in_the_air_is_found(tmp_path, monkeypatch, shape, control):
    found = support_of(tmp_path, monkeypatch, AIR[shape], control)
    assert not found.passed
    assert "begin in the air" in found.text
    assert found.value > 30.0


@pytest.mark.parametrize("shape", STANDS)
def test_what_hangs_on_metal_that_stands_is_not_in_the_air(tmp_path, monkeypatch, shape):
    assert support_of(tmp_path, monkeypatch, STANDS[shape], "linuxcnc").passed

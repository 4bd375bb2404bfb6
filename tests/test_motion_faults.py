"""Faults in motions: each is found where it is, against the plan and by text and part alone, on every control, comments or not."""

from __future__ import annotations

import re

import numpy as np
import pytest
from motion_faults import LAYERS, POSTS, SHAPES, checks_of, made, written


def at_bead(text, inserted):
    """Place of the first motion of an inserted bead."""
    name, line = inserted.split(":")
    lines = text.lines[name]
    return (
        f"{name}:{next(i for i in range(int(line) - 1, len(lines)) if re.search('G[1235] ', lines[i])) + 1}"
    )


@pytest.fixture(scope="module")
def parts():
    """Parts, planned once."""
    known = {}

    def part(shape):
        if shape not in known:
            known[shape] = made(shape)
        return known[shape]

    return part


def rise(text, k):
    """Pattern of a rise over a layer."""
    name, i = text.find(k, r"G0 Z")
    return re.escape(text.lines[name][i].split("G0 ")[1]) + "$"


def travel(text, k, nth=1):
    """File and index of the rise of a long travel within a layer: up, across, down."""
    name, a, b = text.layer(k)
    up = [
        i
        for i in range(a, b - 2)
        if "G0 Z" in text.lines[name][i]
        and "G0 X" in text.lines[name][i + 1]
        and "G0 Z" in text.lines[name][i + 2]
    ]
    return name, up[nth]


def low_rapid(text):
    name, i = travel(text, 3)
    text.lines[name][i] = re.sub(r"Z[\d.]+", "Z2.000000", text.lines[name][i])
    return f"{name}:{i + 1}"


def no_retracts(text):
    first = None
    for k in range(LAYERS):
        up = rise(text, k)
        name, a, b = text.layer(k)
        for i in reversed(range(a, b)):
            if re.search(up, text.lines[name][i]):
                del text.lines[name][i]
        first = first or f"{name}:{text.find(0, 'G0 X')[1] + 1}"
    return first


def all_axes_at_once(text):
    name, i = travel(text, 2)
    lines = text.lines[name]
    lines[i + 1] = f"{lines[i + 1]} {lines[i + 2].split('G0 ')[1]}"
    del lines[i + 2], lines[i]
    return f"{name}:{i + 1}"


def into_the_plate(text):
    name, i = text.find(0, r"G0 Z", nth=1)
    return text.insert(name, i, ["G0 Z0.500000"])


def bead_outside(text):
    name, i = text.find(1, r"beam off")
    return at_bead(text, text.insert(name, i + 1, ["; ISLAND 3", *text.bead((90, 5), (120, 5))]))


def bead_before_the_first_ring(text):
    name, i = text.find(1, r"beam on")
    while "G0 " not in text.lines[name][i]:  # the beam's current may come before it goes on
        i -= 1
    while "G0" in text.lines[name][i - 1] or ";" in text.lines[name][i - 1][:1]:
        i -= 1
    z = re.search(r"Z([\d.]+)", text.lines[name][text.find(1, r"G0 Z", nth=1)[1]])[1]
    up = text.lines[name][i].split("G0 ")[-1]
    blocks = ["G0 X5.000000 Y22.000000", f"G0 Z{z}", *text.bead((5, 22), (35, 22))[1:], f"G0 {up}"]
    return at_bead(text, text.insert(name, i + 1, blocks))


def chain_of_turns(text):
    name, i = text.find(1, r"; TURN")
    return text.insert(name, i + 1, ["G1 X95.000000 Y20.000000 ; TURN", "G1 X95.000000 Y24.000000 ; TURN"])


def hatch_line_far_out(text):
    name, i = text.find(2, r"; TURN", nth=2)
    lines = text.lines[name]
    assert "G1 X" in lines[i + 1]
    lines[i + 1] = re.sub(r"X(-?[\d.]+)", lambda m: f"X{float(m[1]) + 100:.6f}", lines[i + 1])
    return f"{name}:{i + 2}"


def extra_bead(text):
    name, i = text.find(1, r"beam off", nth=4)
    return at_bead(text, text.insert(name, i + 1, ["; ISLAND 5", *text.bead((35, 9), (35, 34))]))


def contour_twice(text):
    name, i = text.find(2, r"beam on")
    _, j = text.find(2, r"beam off")
    start = next(n for n in range(i, 0, -1) if "G0 X" in text.lines[name][n])
    again = [re.sub(r"^N\d+ ", "", line) for line in text.lines[name][start : j + 1] if "G0 Z" not in line]
    return at_bead(text, text.insert(name, j + 1, again))


def layers_swapped(text):
    if text.control == "sinumerik-840d-sl":
        lines = text.lines["MAIN.MPF"]
        i, j = (next(n for n, line in enumerate(lines) if line.endswith(f"MAIN_L000{k}")) for k in (2, 3))
        lines[i], lines[j] = lines[i].replace("L0002", "L0003"), lines[j].replace("L0003", "L0002")
        return f"MAIN.MPF:{i + 1}"
    (name, a, b), (_, _, c) = text.layer(1), text.layer(2)
    lines = text.lines[name]
    lines[a:c] = lines[b:c] + lines[a:b]
    return f"{name}:{text.find(1, 'G1|G2|G3|G5 ')[1] + 1}"


def layer_left_out(text):
    if text.control == "sinumerik-840d-sl":
        lines = text.lines["MAIN.MPF"]
        i = next(n for n, line in enumerate(lines) if line.endswith("MAIN_L0002"))
        del lines[i], text.lines["MAIN_L0002.SPF"]
        (text.folder / "MAIN_L0002.SPF").unlink()
        return f"MAIN.MPF:{i + 1}"
    name, a, b = text.layer(1)
    del text.lines[name][a:b]
    return first_bead(text, 1)


def first_bead(text, k):
    """Place of the first feed motion of a layer: after the modes that it sets and the rapids that lead to it."""
    name, i = text.find(k, "G0 X")
    lines = text.lines[name]
    found = next(n for n in range(i, len(lines)) if re.search(r"\b(G1|G5|G2|G3) ", lines[n]))
    return f"{name}:{found + 1}"


def contour_left_out(text):
    name, i = text.find(2, r"beam on", nth=1)
    _, j = text.find(2, r"beam off", nth=1)
    del text.lines[name][i : j + 1]
    return


def hatch_left_out(text):
    name, i = text.find(2, r"beam on", nth=3)
    _, j = text.find(2, r"beam off", nth=3)
    del text.lines[name][i : j + 1]
    return


def bead_cold(text):
    """Beam and wire stay off along a bead: what is left is a travel through the layer."""
    name, i = text.find(2, r"beam on", nth=3)
    del text.lines[name][i : i + 3]
    _, j = text.find(2, r"wire off", nth=3)
    del text.lines[name][j : j + 2]
    return


def bead_of_the_main_program(text):
    """A bead across the channel where no layer is called."""
    if text.control == "sinumerik-840d-sl":
        name = "MAIN.MPF"
        i = next(n for n, line in enumerate(text.lines[name]) if line.endswith("MAIN_L0004")) + 1
    else:
        (name,) = text.lines
        i = next(n for n, line in enumerate(text.lines[name]) if line == "M2")
    _, n = text.find(3, r"G0 Z", nth=1)
    z = re.search(r"Z([\d.]+)", text.lines[text.layer(3)[0]][n])[1]
    blocks = ["G0 X5.0 Y22.0", f"G0 Z{z}", *text.bead((5, 22), (35, 22))[1:], "G0 Z40.0"]
    return at_bead(text, text.insert(name, i, blocks))


FAULTS = {
    "rapid under metal": (low_rapid, {"collision"}, {"collision"}),
    "no retracts": (no_retracts, {"clearance"}, {"clearance"}),
    "all axes at once": (all_axes_at_once, {"clearance"}, {"clearance"}),
    "rapid into the plate": (into_the_plate, {"collision"}, {"collision"}),
    "bead 40 mm outside": (bead_outside, {"beads as planned", "beads inside"}, {"beads inside"}),
    "bead before the first ring": (bead_before_the_first_ring, {"beads as planned", "beads inside"}, {"beads inside"}),
    "bead of the main program": (bead_of_the_main_program, {"beads as planned", "beads inside"}, {"beads inside"}),
    "chain of turns": (chain_of_turns, {"hatch path", "beads inside"}, {"beads inside"}),
    "hatch line 100 mm out": (hatch_line_far_out, {"hatch path", "beads inside"}, {"beads inside"}),
    "extra bead in an island": (extra_bead, {"beads as planned"}, {"metal laid once"}),
    "contour laid twice": (contour_twice, {"beads as planned"}, {"metal laid once"}),
    "layers swapped": (layers_swapped, {"layer heights", "beads as planned"}, {"layer heights"}),
    "layer left out": (layer_left_out, {"layer heights", "beads as planned"}, {"layer heights"}),
    "contour left out": (contour_left_out, {"beads as planned", "section"}, {"section"}),
    "hatch left out": (hatch_left_out, {"beads as planned"}, {"gaps"}),
    "bead without beam and wire": (bead_cold, {"beads as planned", "clearance"}, {"gaps", "clearance"}),
}  # fmt: skip


CASES = [
    # Quick tests take every fourth fault, and the controls in turn; slow ones all of them.
    pytest.param(name, control, marks=() if i % (4 * len(POSTS)) == 4 * j else pytest.mark.slow)
    for i, name in enumerate(FAULTS)
    for j, control in enumerate(POSTS)
]


@pytest.mark.parametrize(("name", "control"), CASES)
def test_a_fault_is_found_where_it_is_with_comments_and_without(parts, tmp_path, name, control):
    plant, against_plan, alone = FAULTS[name]
    part = parts("block with a channel")
    text = written(part, control, tmp_path / "p")
    where = plant(text)
    text.save()
    commented = {}
    for planned, wanted in ((True, against_plan), (False, alone)):
        checks = checks_of(text, part, planned)
        commented[planned] = verdict(checks)
        found = {n: c for n, c in checks.items() if not c.passed}
        assert wanted <= found.keys(), (planned, {n: (c.where, c.text) for n, c in found.items()})
        if where is not None:
            assert any(near(c.where, where) for c in found.values()), (planned, where, found)
    text.strip()
    text.save()
    for planned, before in commented.items():
        assert verdict(checks_of(text, part, planned)) == before


def near(found, planted):
    """Whether a check names the place of a fault within three lines."""
    name, line = planted.split(":")
    other, _, at = found.partition(":")
    return other == name and abs(int(at or 0) - int(line)) <= 3


NAMES = ("names and headers", "end of program", "block length", "blank", "size on the control", "header")
"""Checks of the text itself, in which comments count."""


def verdict(checks):
    """What every check says, but where."""
    return {n: (c.passed, c.value) for n, c in checks.items() if n not in NAMES}


@pytest.mark.in_turn(5)
@pytest.mark.parametrize("control", POSTS)
@pytest.mark.parametrize("shape", SHAPES)
def test_an_honest_program_passes_and_comments_change_nothing(parts, tmp_path, shape, control):
    part = parts(shape)
    text = written(part, control, tmp_path / "p")
    before = {}
    for planned in (True, False):
        checks = checks_of(text, part, planned)
        assert {n: (c.where, c.text) for n, c in checks.items() if not c.passed} == {}
        before[planned] = verdict(checks)
    # Every comment says another ring, island or layer now; then there is none.
    for name, lines in text.lines.items():
        text.lines[name] = [re.sub(r"^; (RING|ISLAND) \d+", "; RING 7", line) for line in lines]
    text.save()
    for strip in (False, True):
        if strip:
            text.strip()
            text.save()
        for planned in (True, False):
            assert verdict(checks_of(text, part, planned)) == before[planned]


@pytest.mark.parametrize("control", POSTS)
def test_ramps_and_overlaps_are_no_faults(parts, tmp_path, control):
    """Lines whose power changes along them, in wire that changes as well, stay one line."""
    part = parts("block with a channel")
    process = {"ramp_up_mm": 4.0, "crater_fill_mm": 6.0, "overlap_mm": 4.0, "seam_shift_mm": 9.0}
    machine = {"curve_form": "arcs" if control == "linuxcnc" else "lines"}
    other = type(part)(
        part.config.changed(process=process, machine=machine), part.sections, part.plan, part.beads
    )
    text = written(other, control, tmp_path / "p")
    for planned in (True, False):
        failed = {n: (c.where, c.text) for n, c in checks_of(text, other, planned).items() if not c.passed}
        assert failed == {}


def test_a_clamp_near_the_path_is_met_by_the_head(parts, tmp_path):
    part = parts("cube")
    clamp = {"name": "clamp", "outline_mm": ((-30, 5), (-12, 5), (-12, 25), (-30, 25)), "z_mm": (0.0, 30.0)}
    for above, passed in ((15.0, False), (29.0, True)):
        config = part.config.changed(process={"keep_out": (clamp,)}, machine={"head_above_tip_mm": above})
        other = type(part)(config, part.sections, part.plan, part.beads)
        text = written(other, "linuxcnc", tmp_path / f"p{above}")
        found = checks_of(text, other, False)["collision"]
        assert found.passed == passed, found.text
        if not passed:
            assert "the head goes" in found.text
            assert found.value == pytest.approx(30.0 - 15.0 - part.config.layer_height_mm, abs=0.01)


def test_a_zone_without_a_height_is_no_body(parts, tmp_path):
    part = parts("cube")
    zone = {"name": "probe", "outline_mm": ((-30, 5), (-12, 5), (-12, 25), (-30, 25))}
    other = type(part)(
        part.config.changed(process={"keep_out": (zone,)}), part.sections, part.plan, part.beads
    )
    text = written(other, "linuxcnc", tmp_path / "p")
    assert all(c.passed for c in checks_of(text, other, False).values())


def test_a_layer_over_nothing_is_found(parts, tmp_path):
    part = parts("cube")
    text = written(part, "linuxcnc", tmp_path / "p")
    name, a, b = text.layer(1)
    del text.lines[name][a:b]
    text.save()
    found = checks_of(text, part, False)["support"]
    assert not found.passed
    assert near(found.where, first_bead(text, 1))


def test_the_worst_place_of_the_section_check_can_be_drawn(parts, tmp_path):
    part = parts("cube")
    text = written(part, "plain-gcode", tmp_path / "p")
    name, i = text.find(2, r"G1 X27\.0+ Y27\.0+")
    text.lines[name][i] = text.lines[name][i].replace("X27.0", "X27.8")
    text.save()
    found = checks_of(text, part, False)["section"]
    assert not found.passed
    assert found.layer == 2
    assert np.hypot(found.x_mm - 27.8, found.y_mm - 27.0) < 1.0

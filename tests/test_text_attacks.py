"""What a program's text shows without plan and comments: the form of the hatch, wire of single beads, windows."""

from __future__ import annotations

import re
import shutil

import numpy as np
import pytest
from slicers_here import slicers_here

from benchmarks.faults.subjects import SUBJECTS
from ebamcheck.checks.bead_checks import BACK, FINE, SKEW, UNEVEN, form_of
from ebamcheck.checks.interpass_checks import scheduled_shares
from ebamcheck.pipeline import run_job
from ebamcheck.record.run_folder import RunFolder
from ebamcheck.settings.config import Config
from ebamcheck.settings.process_window import outside_window
from ebamcheck.verification.gates_again import exchanged_layers
from ebamcheck.verification.verify import verify_against_part
from ebamcheck_models import write_stl

SPACING_MM = 4.32


# -- the form of a hatch ------------------------------------------------------------------------------


def form(points):
    """Form of one bead through points, and the line where it is not fine."""
    points = np.array(points, float)
    way = np.diff(points, axis=0)
    state, at = form_of(np.array([0, len(way)]), points[:-1].copy(), way, SPACING_MM)
    return int(state[0]), int(at[0])


def to_and_fro(lines=6, length=20.0, pitch=4.2):
    ends = [(0.0, length) if k % 2 == 0 else (length, 0.0) for k in range(lines)]
    return [(x, k * pitch) for k, pair in enumerate(ends) for x in pair]


@pytest.mark.parametrize("angle", [0.0, 0.4, 1.9])
def test_lines_to_and_fro_are_fine_in_any_direction(angle):
    c, s = np.cos(angle), np.sin(angle)
    points = np.array(to_and_fro()) @ np.array([[c, s], [-s, c]])
    assert form(points)[0] == FINE


def test_a_missing_motion_a_moved_end_and_an_exchange_are_found_where_they_are():
    points = to_and_fro()
    assert form([*points[:5], *points[6:]]) == (BACK, 5)
    assert form([*points[:4], *points[5:]]) == (BACK, 3)
    longer = to_and_fro(length=10.0)
    assert form([*longer[:4], *longer[5:]]) == (SKEW, 3)
    moved = [*points[:4], (points[4][0], points[4][1] + 3.0), *points[5:]]
    assert form(moved)[0] == SKEW
    swapped = [*points[:4], points[5], points[4], *points[6:]]
    assert form(swapped)[0] in (SKEW, BACK)
    assert form([(0, 0), (10, 0), (4, 0.5), (20, 0.5)]) == (BACK, 1)


def test_a_line_nearer_to_its_neighbour_than_the_others_is_found():
    points = [(x, y - 1.5 if y > 12.0 else y) for x, y in to_and_fro()]
    assert form(points)[0] == UNEVEN


TAIL = [(-1.5, -6.0), (-1.4, -5.4), (-0.3, -5.1), (1.0, -3.9), (1.7, -3.6), (0.6, -1.8)]
"""Short motions along a wall that lead to the first line."""


@pytest.mark.parametrize("turned", [False, True])
def test_a_bead_may_follow_a_wall_before_its_first_line_and_behind_its_last(turned):
    points = [*TAIL, *to_and_fro(lines=5), (20.4, 18.2), (19.6, 19.0)]
    assert form(points[::-1] if turned else points)[0] == FINE


@pytest.mark.parametrize("at", [0, 1, 10, 11])
def test_a_moved_end_of_the_first_or_last_line_is_found(at):
    points = to_and_fro()
    points[at] = (points[at][0], points[at][1] + 2.0)
    assert form(points)[0] == SKEW


@pytest.mark.parametrize("left", [slice(1, None), slice(None, -1)])
def test_a_turn_whose_line_is_missing_is_found(left):
    assert form(to_and_fro()[left])[0] == SKEW


def test_strands_along_a_nearly_straight_wall_are_fine():
    up, down = (
        [(0.0, 0.0), (0.007, 57.0), (0.0, 58.0), (0.005, 62.0)],
        [(3.3, 62.0), (3.31, 58.0), (3.29, 0.0)],
    )
    assert form([*up, *down])[0] == FINE
    around = [(-15.0, -8.0), (-11.0, -7.9), (-7.0, -7.0), (-3.5, -5.0), (-1.0, -2.0)]
    assert form([*around, *up, *down])[0] == FINE


def test_beads_along_walls_have_no_such_form():
    around = [(20 * np.cos(a), 20 * np.sin(a)) for a in np.linspace(0, 5, 40)]
    assert form(around)[0] == FINE
    assert form([(0, 0), (30, 0), (30, 12), (0, 12), (0, 0)])[0] == FINE
    corner = [(0, 0), (30, 0), (30, 30), (25.7, 30), (25.7, 4.3), (0, 4.3)]
    assert form(corner)[0] == FINE


# -- a run, and faults in it ---------------------------------------------------------------------------


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Runs of a small part, one for each control, with a program from layer 2 on."""
    folder = tmp_path_factory.mktemp("attacks")
    part = folder / "cube.stl"
    write_stl(SUBJECTS["cube"].model.tessellate(0.05), part)
    known = {}

    def run(control):
        if control not in known:
            config = SUBJECTS["cube"].config(control)
            with slicers_here():
                run_job(part, folder / control, config)
            known[control] = (folder / control, part, config)
        return known[control]

    return run


def spoiled(made, tmp_path, control, change, config=None):
    """Failed checks by name of a program by itself whose files, as texts by name, were changed."""
    run, part, own = made(control)
    folder = tmp_path / "program"
    shutil.copytree(run / "program", folder)
    texts = {p.name: p.read_text() for p in folder.iterdir()}
    for name, text in change(texts).items():
        (folder / name).write_bytes(text.encode("latin-1"))
    checks = verify_against_part(folder, part, config or own)
    return {c.name: c for c in checks if not c.passed}


def test_other_settings_than_those_of_the_program_are_told_and_no_fault(made, tmp_path):
    run, part, config = made("linuxcnc")
    other = config.changed(process={"mass_tolerance": 0.021})
    alone = tmp_path / "program"
    shutil.copytree(run / "program", alone)
    for folder, said in (
        (alone, "which ones, its text does not say"),
        (run / "program", "process.mass_tolerance is 0.021, not 0.02"),
    ):
        (header,) = [c for c in verify_against_part(folder, part, other) if c.name == "header"]
        assert header.passed
        assert "made with other settings" in header.text
        assert header.text.endswith(said)


def test_settings_that_the_header_contradicts_are_told_with_both_values(made, tmp_path):
    config = made("linuxcnc")[2].changed(process={"wire_diameter_mm": 1.3})
    found = spoiled(made, tmp_path, "linuxcnc", lambda texts: {}, config)["header"]
    assert "1.6 mm" in found.text
    assert "1.3 mm" in found.text


def beads(text):
    """Start and end of the text of each bead of a program of plain G-code."""
    return [m.span() for m in re.finditer(r"^M42 P1 S.*\nM8.*\n(?:.*\n)*?M9", text, re.MULTILINE)]


@pytest.mark.parametrize("factor", [0.7, 1.5])
@pytest.mark.parametrize("nth", [0, 1, *(pytest.param(n, marks=pytest.mark.slow) for n in (2, 3))])
def test_the_wire_of_one_bead_is_held_against_its_place(made, tmp_path, nth, factor):
    """Contour and hatch of two layers; the more of a place's metal is the bead's own, the more it is off."""
    starts = []

    def change(texts):
        name, text = next(iter(texts.items()))
        a, b = beads(text)[nth]
        starts.extend(text.count("\n", 0, at) + 1 for at in (a, b))
        scaled = re.sub(r"(?<=M42 P1 S)[\d.]+", lambda m: f"{factor * float(m[0]):.6f}", text[a:b])
        return {name: text[:a] + scaled + text[b:]}

    found = spoiled(made, tmp_path, "plain-gcode", change)["wire of beads"]
    assert starts[0] - 4 <= int(found.where.rpartition(":")[2]) <= starts[1]
    least = 1.0 / factor if factor < 1.0 else factor
    assert 0.3 * (least - 1.0) < found.value < 1.2 * (least - 1.0)


def test_a_way_may_name_one_axis_where_beads_do(made, tmp_path):
    def change(texts):
        each = {n: re.sub(r"^G1 (X\S+) (Y\S+)", r"G1 \1\nG1 \2", t, flags=re.M) for n, t in texts.items()}
        return {n: re.sub(r"^(G0 Z.*\nG0 X\S+) Y\S+", r"\1", t, count=1, flags=re.M) for n, t in each.items()}

    assert "words of motions" not in spoiled(made, tmp_path, "plain-gcode", change)


def test_a_way_to_a_bead_that_is_missing_is_found(made, tmp_path):
    def change(texts):
        name, text = next(iter(texts.items()))
        ways = list(re.finditer(r"^G0 X.*\n(?=G0 Z.*\n(?:M42|M3|S))", text, re.MULTILINE))
        return {name: text[: ways[2].start()] + text[ways[2].end() :]}

    found = spoiled(made, tmp_path, "plain-gcode", change)["words of motions"]
    assert "the way to it is missing" in found.text


# -- windows ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("window", "values"),
    [
        ("voltage_window_kv", (70.0, 150.0)),
        ("current_window_ma", (10.0, 60.0)),
        ("travel_window_mm_s", (12.0, 20.0)),
    ],
)
def test_each_value_is_held_against_its_own_window_before_slicing(window, values):
    found = list(outside_window(Config().changed(process={window: values})))
    assert [f.code for f in found] == ["process-limit"]
    assert window in found[0].text


@pytest.mark.parametrize(
    ("window", "values"),
    [
        ("voltage_window_kv", (70.0, 150.0)),
        ("current_window_ma", (10.0, 60.0)),
        ("travel_window_mm_s", (12.0, 20.0)),
        ("bead_section_mm2", (0.5, 3.0)),
        ("metal_energy_j_mm3", (10.0, 30.0)),
    ],
)
def test_a_program_is_held_against_each_window_from_its_text(made, tmp_path, window, values):
    config = made("linuxcnc")[2].changed(process={window: values})
    found = spoiled(made, tmp_path, "linuxcnc", lambda texts: {}, config)
    assert "process window" in found


def test_a_table_of_power_holds_without_a_plan():
    config = Config().changed(process={"power_schedule": ((0.0, 1.0), (10.0, 0.5))})
    heights = 3.0 + 0.5 * config.layer_height_mm + np.array([0.0, 5.0, 20.0])
    expected = np.interp(heights - heights[0] + 0.5 * config.layer_height_mm, [0.0, 10.0], [1.0, 0.5])
    assert scheduled_shares(heights, config) == pytest.approx(expected)
    assert scheduled_shares(heights, Config()) is None


# -- runs ---------------------------------------------------------------------------------------------------


def test_layers_of_one_slicer_in_the_file_of_another_are_found_on_a_plane_part(made, tmp_path):
    run, _, _ = made("linuxcnc")
    copy = tmp_path / "run"
    shutil.copytree(run, copy)
    folder = RunFolder(copy)
    record = folder.manifest()
    witness = record["program"]["witness"]
    fresh = folder.read_layers(witness)
    assert exchanged_layers(folder, record, fresh, witness) == ()
    shutil.copyfile(folder.layers_file(record["primary"]), folder.layers_file(witness))
    assert exchanged_layers(folder, record, fresh, witness) == (witness,)

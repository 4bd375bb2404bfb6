"""Starts and ends of beads: seams, overlap, ramps, retract; and the cuts that they are made of."""

from __future__ import annotations

import math

import numpy as np
import pytest
from nc_stack import make_curves, make_plan, stack
from planned_roles import as_planned

from ebamcheck.errors import SettingsError
from ebamcheck.pipeline import findings
from ebamcheck.program import read_program, verify_program, write_program
from ebamcheck.settings.config import Config
from ebamcheck.writing.segments import CIRCULAR, CUBIC, STRAIGHT, segment_lengths, segment_parts

WIDE = {"travel_min_mm": (-2000.0, -2000.0, 0.0), "travel_max_mm": (2000.0, 2000.0, 2000.0)}
ENDS = {
    "overlap_mm": 8.0,
    "seam_shift_mm": 21.3,
    "ramp_up_mm": 3.0,
    "crater_fill_mm": 5.0,
    "ramp_power": 0.4,
    "ramp_steps": 4,
    "wire_retract_mm": 1.5,
}


def made(tmp_path, process, **machine):
    """A small stack written and read back: settings, what it was made of, files and program."""
    config = Config().changed(process=process, machine={**WIDE, **machine})
    curves, plan = stack()
    files = write_program(curves, plan, config, tmp_path / "p")
    return config, curves, plan, files, as_planned(read_program(files.main, config), curves, plan, config)


def checks_of(config, curves, plan, nc):
    return {c.name: c for c in verify_program(nc, config=config, curves=curves, plan=plan)}


def own(checks):
    """The checks that bead ends can break; the rings of the stack cross themselves and its hatch covers nothing."""
    names = (
        "power", "overlap of contours", "wire retract", "parts of hatch lines", "contours close", "contour rings",
        "contour path", "islands", "hatch vectors", "beam", "wire", "spline blocks", "repeated blocks",
    )  # fmt: skip
    return {name: checks[name] for name in names if name in checks}


# -- cuts --------------------------------------------------------------------------------------------


def segments():
    """A line, a cubic and an arc."""
    h = math.sqrt(0.5)
    line = [(0, 0), (0, 0), (10, 0), (10, 0)]
    cubic = [(10, 0), (20, 0), (20, 20), (10, 20)]
    arc = [(10, 20), (10 - 10 * h, 10 + 10 * h), (10 - 10 * h, 10 + 10 * h), (0, 10)]
    return np.array([STRAIGHT, CUBIC, CIRCULAR], np.uint8), np.array([line, cubic, arc], float)


def test_lengths_of_segments():
    kind, points = segments()
    found = segment_lengths(kind, points)
    assert found[0] == 10.0
    assert found[2] == pytest.approx(5 * math.pi)
    u = np.linspace(0, 1, 200001)[:, None]
    p = points[1]
    curve = (1 - u) ** 3 * p[0] + 3 * (1 - u) ** 2 * u * p[1] + 3 * (1 - u) * u**2 * p[2] + u**3 * p[3]
    assert found[1] == pytest.approx(np.linalg.norm(np.diff(curve, axis=0), axis=1).sum(), rel=1e-8)


@pytest.mark.parametrize("shares", [(0.0, 1.0), (0.0, 0.3), (0.3, 0.31), (0.9, 1.0)])
def test_a_part_is_as_long_as_asked_and_cut_again_the_same(shares):
    kind, points = segments()
    lengths = segment_lengths(kind, points)
    low, high = (share * lengths for share in shares)
    part = segment_parts(kind, points, lengths, low, high)
    assert segment_lengths(kind, part) == pytest.approx(high - low, abs=1e-8)
    half = 0.5 * (low + high)
    first = segment_parts(kind, points, lengths, low, half)
    second = segment_parts(kind, part, high - low, half - low, high - low)
    assert first[:, 3] == pytest.approx(second[:, 0], abs=1e-7)
    if shares == (0.0, 1.0):
        assert (part[:, [0, 3]] == points[:, [0, 3]]).all()


# -- programs ----------------------------------------------------------------------------------------


def test_nothing_set_changes_nothing(tmp_path):
    *_, files, nc = made(tmp_path, {"ramp_power": 0.4})
    assert not nc.overlap.any()
    assert not nc.goes_on.any()
    assert "GOES ON" not in "".join(p.read_text() for p in files.folder.iterdir())


@pytest.mark.parametrize(
    ("machine", "bound_mm"),
    # Shapes are compared by chords that err by 2e-5 mm themselves; arcs and lines keep to their tolerance.
    [
        ({"curve_form": "poly"}, 3e-5),
        ({"curve_form": "bspline"}, 3e-5),
        ({"curve_form": "arcs"}, 0.011),
        ({"curve_form": "lines"}, 0.011),
        ({"control": "linuxcnc"}, 3e-5),
        ({"control": "plain-gcode"}, 0.011),
    ],
)
def test_every_form_drives_the_same_contours_and_passes(tmp_path, machine, bound_mm):
    config, curves, plan, _, nc = made(tmp_path, ENDS, **machine)
    found = own(checks_of(config, curves, plan, nc))
    assert {name: c.text for name, c in found.items() if not c.passed} == {}
    assert {"power", "overlap of contours", "wire retract", "parts of hatch lines"} <= found.keys()
    assert found["contour path"].value < bound_mm


def squares(tmp_path, process, layers=6, side=40.0, shift=(0.0, 0.0)):
    """A stack of equal squares, each layer displaced from the one below, written and read back."""
    heights = (np.arange(layers) + 0.5) * 1.5
    square = np.array([(0, 0), (side, 0), (side, side), (0, side), (0, 0)], float)
    rings = [[[(square + k * np.asarray(shift), None)]] for k in range(layers)]
    curves, plan = make_curves(heights, rings, [True] * layers), make_plan(heights, [])
    config = Config().changed(process=process)
    files = write_program(curves, plan, config, tmp_path / "p")
    return config, curves, plan, files, as_planned(read_program(files.main, config), curves, plan, config)


def starts_of(nc):
    rows = np.flatnonzero(nc.deposit)
    return nc.start[nc.beads.among(rows).first, :2]


def test_a_seam_moves_along_the_contour_from_layer_to_layer(tmp_path):
    config, curves, plan, _, nc = squares(tmp_path, {"seam_shift_mm": 25.0, "least_seam_distance_mm": 12.5})
    assert starts_of(nc) == pytest.approx(np.array([(0, 0), (25, 0), (40, 10), (40, 35), (20, 40), (0, 35)]))
    found = checks_of(config, curves, plan, nc)
    assert found["seams"].passed
    assert found["contour path"].passed


def test_a_seam_moves_whatever_the_start_of_the_curve(tmp_path):
    """Where each layer's curve starts further back by the shift, a shift along itself alone would stack the seams."""
    process = {"seam_shift_mm": 10.0, "least_seam_distance_mm": 5.0}
    config, curves, plan, _, nc = squares(tmp_path, process, shift=(-10.0, 0.0))
    assert checks_of(config, curves, plan, nc)["seams"].passed


def test_a_seam_of_a_ring_shorter_than_the_shift_lies_as_far_away_as_it_can(tmp_path):
    *_, nc = squares(tmp_path, {"seam_shift_mm": 25.0}, side=5.0)
    assert (np.hypot(*np.diff(starts_of(nc), axis=0).T) >= 5.0).all()


def test_an_overlap_is_laid_on_the_start(tmp_path):
    *_, nc = squares(tmp_path, {"seam_shift_mm": 25.0, "overlap_mm": 6.0})
    assert nc.lengths[nc.deposit].sum() == pytest.approx(6 * 166.0)
    assert nc.lengths[nc.overlap].sum() == pytest.approx(6 * 6.0)
    *_, small = made(tmp_path / "small", {"overlap_mm": 6.0})
    assert not small.overlap[small.ring % 3 == 2].any()  # open paths


def test_an_overlap_goes_once_around_at_most(tmp_path):
    *_, nc = made(tmp_path, {"overlap_mm": 1000.0})
    rows = np.flatnonzero(nc.deposit & (nc.ring == 1))
    assert nc.lengths[rows].sum() == pytest.approx(72.0)
    assert nc.contours(0.5).closed.sum() == 6


def test_the_beam_ramps_along_every_bead(tmp_path):
    config, *_, nc = made(tmp_path, {"ramp_up_mm": 3.0, "crater_fill_mm": 5.0, "ramp_power": 0.4})
    rows = np.flatnonzero(nc.deposit)
    bead = nc.beads.among(rows).bead
    share = nc.power_w[rows] / config.process.power_w
    for k in range(bead.max() + 1):
        mine = bead == k
        along = np.cumsum(nc.lengths[rows[mine]])
        power = share[mine]
        assert power[0] == pytest.approx(0.475, abs=1e-6)
        assert power[-1] == pytest.approx(0.475, abs=1e-6)
        assert set(np.round(power, 6)) == {0.475, 0.625, 0.775, 0.925, 1.0}
        full = power > 0.99
        assert along[full][-1] == pytest.approx(along[-1] - 5.0, abs=0.06)
        assert along[np.flatnonzero(full)[0] - 1] == pytest.approx(3.0, abs=0.06)


def test_ramps_shrink_on_short_beads(tmp_path):
    config, curves, plan, _, nc = made(tmp_path, {"ramp_up_mm": 30.0, "crater_fill_mm": 300.0})
    assert own(checks_of(config, curves, plan, nc))["power"].passed
    rows = np.flatnonzero(nc.deposit & (nc.ring == 1))
    up = nc.lengths[rows][np.diff(nc.power_w[rows], append=0.0) > 0].sum()
    assert 2.0 < up < 36.0 / 11.0 + 0.1


def test_heat_simulators_get_the_ramps(tmp_path):
    config = Config().changed(process={"ramp_up_mm": 3.0}, machine={"control": "3dthesis"})
    files = write_program(*stack(), config, tmp_path / "p")
    rows = np.loadtxt(files.folder / "Path.txt", skiprows=1)
    assert set(np.round(rows[rows[:, 0] == 0, 4], 4)) == {0.5625, 0.6875, 0.8125, 0.9375, 1.0}
    assert (rows[rows[:, 0] == 1, 4] == 0.0).all()


# -- faults ------------------------------------------------------------------------------------------


def changed(files, config, old, new, name="MAIN_L0002.SPF", count=1):
    """The program with a text replaced in one of its files."""
    path = files.folder / name
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, count))
    return read_program(files.main, config)


@pytest.mark.parametrize(
    ("old", "new", "name"),
    [
        ("H2=57", "H2=120", "power"),
        ("H4=1.5 ; wire drawn back, mm", "H4=1 ; wire drawn back, mm", "wire retract"),
        ("H4=1.5 ; wire drawn back, mm\n", "H2=120\n", "wire retract"),
        ("H4=1.5 ; wire drawn back, mm\n", "H4=1.5\nH4=1.5\n", "wire retract"),
        ("G0 X", "H4=1.5\nG0 X", "wire retract"),
    ],
)
def test_a_fault_at_the_end_of_a_bead_is_found(tmp_path, old, new, name):
    config, curves, plan, files, _ = made(tmp_path, ENDS)
    check = checks_of(config, curves, plan, changed(files, config, old, new))[name]
    assert not check.passed
    assert check.where.startswith("MAIN_L0002.SPF:")


def test_a_missing_overlap_is_found(tmp_path):
    config, curves, plan, _, nc = made(tmp_path, {"overlap_mm": 5.0})
    longer = config.changed(process={"overlap_mm": 8.0})
    check = checks_of(longer, curves, plan, nc)["overlap of contours"]
    assert not check.passed
    assert check.value == pytest.approx(3.0, abs=1e-4)
    assert checks_of(config, curves, plan, nc)["overlap of contours"].passed


def test_a_part_that_leaves_its_hatch_line_is_found(tmp_path):
    config, curves, plan, files, nc = made(tmp_path, {"ramp_up_mm": 3.0})
    row = int(np.flatnonzero(nc.goes_on)[0])
    x = nc.end[row - 1, 0]
    y = nc.end[row - 1, 1]
    name = nc.files[nc.file[row]].name
    moved = changed(files, config, f"X{x:.6f} Y{y:.6f}", f"X{x:.6f} Y{y + 0.1:.6f}", name)
    check = checks_of(config, curves, plan, moved)["parts of hatch lines"]
    assert not check.passed
    assert check.value == pytest.approx(0.1, abs=1e-5)


def test_splines_that_are_cut_need_polynomials():
    machine = {"curve_form": "bspline", "poly_licensed": False}
    with pytest.raises(SettingsError, match="poly_licensed"):
        Config().changed(machine=machine, process={"seam_shift_mm": 5.0})


def test_wire_that_is_drawn_back_is_left_to_the_feeder():
    config = Config().changed(process={"wire_retract_mm": 50.0})
    found = [f for f in findings.profile_findings(config) if f.code == "wire-drawn-back"]
    wire_mm3 = 50.0 * np.pi * 0.25 * config.process.wire_diameter_mm**2
    bead_mm2 = config.process.bead_width_mm * config.layer_height_mm
    assert [f.figure for f in found] == [pytest.approx(wire_mm3 / bead_mm2)]
    assert not [f for f in findings.profile_findings(Config()) if f.code == "wire-drawn-back"]

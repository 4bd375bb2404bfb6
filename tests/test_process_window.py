"""The process window: no layer, wire speed or line energy outside of the profile's limits, in settings or in text."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
import shapely
from command_line import ebamcheck, frame, write_stl
from hypothesis import given
from hypothesis import strategies as st
from nc_stack import stack
from prism_program import Made
from program_text import CONTROLS, ProgramText

from ebamcheck.checks.value_checks import window_check
from ebamcheck.errors import SettingsError
from ebamcheck.pipeline import check_job, run_job
from ebamcheck.program import read_program, verify_program, write_program
from ebamcheck.settings import process_window
from ebamcheck.settings.config import Config
from ebamcheck.settings.process_window import (
    allowed_layers_mm,
    checked_window,
    least_hole_mm,
    least_wall_mm,
    nominal_wire_speed_mm_s,
    outside_window,
    unusual_layers,
)


def layered(height_mm, **process):
    return Config().changed(layers={"layer_height_mm": height_mm}, process=process)


def settings_outside(config):
    return [(found.place, found.limit) for found in outside_window(config)]


# -- before anything is sliced ----------------------------------------------------------------------


def test_the_default_profile_is_within_its_window_at_every_height_that_it_allows():
    checked_window(Config())
    low, high = allowed_layers_mm(Config())
    assert low < Config().layer_height_mm < high
    for height_mm in (low, high):
        checked_window(layered(height_mm))
    assert settings_outside(layered(low * 0.999)) == [("layers.layer_height_mm", 0.5)]
    assert settings_outside(layered(high * 1.001)) == [("layers.layer_height_mm", 2.0)]


@pytest.mark.parametrize("height_mm", [0.1, 50.0])
@pytest.mark.parametrize("arguments", [("run",), ("post", "-o", "p"), ("scan", "--height", 6)])
def test_a_layer_height_beyond_the_window_is_refused_before_slicing(tmp_path, arguments, height_mm):
    write_stl(frame(), tmp_path / "frame.stl")
    name, *rest = arguments
    done = ebamcheck(name, "frame.stl", *rest, "--layer-height", height_mm, cwd=tmp_path)
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert line.startswith(f"ebamcheck: error: layers.layer_height_mm: {height_mm:g} mm is ")
    assert "(process.layer_over_bead): choose a layer height from 0.838 to 3.35 mm" in line
    assert [path.name for path in tmp_path.iterdir()] == ["frame.stl"]


def test_nothing_is_read_or_sliced_for_settings_outside_of_the_window(tmp_path):
    with pytest.raises(SettingsError, match=r"process\.layer_over_bead"):
        run_job(tmp_path / "missing.stl", tmp_path / "a.run", layered(50.0))


def test_a_check_cuts_layers_that_no_process_lays_and_says_so(tmp_path):
    path = write_stl(frame(), tmp_path / "frame.stl")
    fast = {"backends": ("planecut", "manifold")}
    found = check_job(path, tmp_path / "a.run", layered(6.0).changed(slicing=fast)).manifest["findings"]
    assert [(f["severity"], f["place"]) for f in found if f["code"] == "process-limit"] == [
        ("warning", "layers.layer_height_mm")
    ]


def test_each_listed_step_counts():
    listed = Config().changed(layers={"heights_mm": (1.0, 2.6, 4.2, 9.0, 10.6)})
    assert settings_outside(listed) == [("layers.heights_mm, layer 3", 2.0)]
    with pytest.raises(SettingsError, match=r"layers\.heights_mm, layer 3: 4\.8 mm is 2\.86 times"):
        checked_window(listed)
    checked_window(Config().changed(layers={"heights_mm": (5.0,)}))


@pytest.mark.parametrize(
    ("process", "height_mm", "named"),
    [
        ({"wire_speed_max_mm_s": 40.0}, 2.0, r"layers of 2 mm take 42\.97 mm/s of wire, over 40 mm/s"),
        ({"wire_speed_min_mm_s": 40.0}, 1.7, r"36\.53 mm/s of wire, under 40 mm/s \(process\.wire_speed_min"),
        ({"travel_speed_mm_s": 2.0}, None, r"give 3600 J/mm, over 3000 J/mm \(process\.line_energy_j_mm\)"),
        ({"current_ma": 20.0}, None, r"give 120 J/mm, under 150 J/mm \(process\.line_energy_j_mm\)"),
        ({"wire_speed_mm_s": 5.0}, None, r"process\.wire_speed_mm_s: layers of 0\.251\d* mm take 5\.4 mm/s"),
    ],
)
def test_every_limit_names_setting_value_and_limit(process, height_mm, named):
    with pytest.raises(SettingsError, match=named):
        checked_window(layered(height_mm, **process))


@given(
    width=st.floats(2.0, 13.0),
    speed=st.floats(2.0, 30.0),
    wire=st.floats(5.0, 150.0),
    diameter=st.floats(0.8, 3.2),
    height=st.floats(0.1, 10.0),
)
def test_allowed_heights_are_those_without_a_finding(width, speed, wire, diameter, height):
    config = layered(
        height,
        bead_width_mm=width,
        travel_speed_mm_s=speed,
        wire_speed_mm_s=wire,
        wire_diameter_mm=diameter,
        line_energy_j_mm=(1.0, 1e6),
    )
    low, high = allowed_layers_mm(config)
    if min(abs(height - low), abs(height - high)) > 1e-6 * height:
        assert (low < height < high) == (not list(outside_window(config)))


def test_wire_speed_is_that_of_the_mass_balance():
    # A metre of a bead of 4.32 x 2 mm is 8640 mm3, of a wire of 1.6 mm 4297 mm: in 100 s.
    assert nominal_wire_speed_mm_s(Config(), 2.0) == pytest.approx(8640.0 / (math.pi * 0.8**2) / 100.0)


def test_least_wall_and_hole_follow_the_bead_unless_they_are_set():
    config = Config()
    assert least_hole_mm(config) == 6.0
    assert least_wall_mm(config) == pytest.approx(6.0 * (1000.0 / 60.0) / 36.0)
    assert least_wall_mm(layered(0.5)) == 6.0  # the wire is at its least already
    fixed = Config().changed(process={"least_wall_mm": 4.0, "least_hole_mm": 9.0})
    assert (least_wall_mm(fixed), least_hole_mm(fixed)) == (4.0, 9.0)


@pytest.mark.parametrize(
    "process",
    [{"layer_over_bead": (2.0, 0.5)}, {"line_energy_j_mm": (9.0, 9.0)}, {"wire_speed_min_mm_s": 200.0}],
)
def test_limits_in_the_wrong_order_are_refused(process):
    with pytest.raises(SettingsError, match="give the lower one first"):
        Config().changed(process=process)


def test_layers_far_from_the_bead_are_told():
    bead = Config().process.bead_height_mm
    assert not list(unusual_layers(layered(1.2 * bead)))
    (found,) = unusual_layers(layered(1.5 * bead))
    assert (found.severity, found.code, found.limit) == ("note", "layer-over-bead", 1.25)
    assert not list(unusual_layers(layered(50.0)))  # that one is over the limit, and told as such
    low, high = process_window.USUAL_OVER_BEAD
    assert Config().process.layer_over_bead[0] < low < 1.0 < high < Config().process.layer_over_bead[1]


# -- from the text -----------------------------------------------------------------------------------


@pytest.fixture
def program(tmp_path):
    """A program of three layers, and how to look at it anew after a change of its text."""
    files = write_program(*stack(), Config(), tmp_path / "p")

    def looked(config=None, **changes):
        for name, (old, new) in changes.items():
            path = files.folder / f"{name}.SPF"
            text = path.read_text()
            assert old in text
            path.write_text(text.replace(old, new, 1))
        config = config or Config()
        nc = read_program(files.main, config)
        return next(c for c in verify_program(nc, config=config) if c.name == "process window"), files

    return looked


def test_a_program_of_the_default_profile_is_within_its_window(program):
    check, _ = program()
    assert check.passed, check
    assert "wire 16.67 .. 100 mm/s, line energy 150 .. 3000 J/mm, layers 0.5 .. 2 of a bead" in check.text


def line_of(files, check):
    name, line = check.where.split(":")
    return (files.folder / name).read_text().splitlines()[int(line) - 1]


@pytest.mark.parametrize(("wire", "told"), [("250.5", "250.5 mm/s of wire"), ("3.5", "3.5 mm/s of wire")])
def test_a_wire_speed_outside_of_the_window_is_named_with_its_place(program, wire, told):
    _, files = program()
    old = re.search(r"H3=([\d.]+)", (files.folder / "MAIN_L0002.SPF").read_text())[0]
    check, files = program(MAIN_L0002=(old, f"H3={wire}"))
    assert not check.passed
    assert told in check.text
    assert check.where.startswith("MAIN_L0002.SPF:")
    assert re.search(r"[XY]", line_of(files, check))


def test_a_feed_that_burns_is_named(program):
    check, _ = program(MAIN_L0003=("F600", "F100"))
    assert not check.passed
    assert "4320 J/mm of line energy, allowed are 150 .. 3000" in check.text
    assert check.where.startswith("MAIN_L0003.SPF:")


def test_a_layer_over_the_bead_is_named(tmp_path):
    config = Config()
    files = write_program(*stack(layer_height=4.0), config, tmp_path / "p")
    check = next(
        c for c in verify_program(read_program(files.main, config), config=config) if c.name == "process window"
    )
    assert not check.passed
    assert re.match(r"2\.387 of a bead's height a layer, allowed are 0\.5 \.\. 2 \(and 2 more\)", check.text)
    assert check.where.startswith("MAIN_L0001.SPF:")


def test_ramps_of_the_beam_are_judged_by_their_bead(tmp_path):
    """A ramp begins under the least line energy; the bead that it belongs to does not."""
    config = Config().changed(process={"ramp_up_mm": 6.0, "ramp_power": 0.1, "ramp_steps": 8})
    files = write_program(*stack(), config, tmp_path / "p")
    nc = read_program(files.main, config)
    assert np.nanmin(nc.power_w[nc.deposit]) < 150.0 * 10.0
    check = next(c for c in verify_program(nc, config=config) if c.name == "process window")
    assert check.passed, check


@pytest.mark.parametrize("control", CONTROLS)
@pytest.mark.parametrize("end", ["ramp_up_mm", "crater_fill_mm"])
def test_wire_that_runs_on_while_the_beam_no_longer_melts_it_is_found(control, end, tmp_path):
    """The bead has the power; the end of its ramp has a hundredth of it, and all of the wire."""
    ramp = {end: 10.0, "ramp_power": 0.001, "ramp_steps": 10}
    found = ProgramText(control, tmp_path / "p", process=ramp).failed()
    assert "J/mm3 of the wire along a ramp, allowed are 10 .. 600" in found["process window"].text
    assert "process window" not in ProgramText(control, tmp_path / "q", process={end: 10.0}).failed()


@pytest.mark.parametrize("bead_mm", [3.9, 4.1, 5.3])
def test_beads_at_the_least_wire_keep_it_when_their_width_is_rounded(tmp_path, bead_mm):
    """Widths are printed with four decimals: one at the limit of the wire may not be rounded beyond it."""
    tip = shapely.Polygon([(0, 0), (80, 0), (80, 20)])
    config = Config().changed(
        process={"bead_width_mm": bead_mm, "current_ma": 120.0 * (bead_mm / 6.0) ** 2, "interpass": "off"},
        layers={"layer_height_mm": 1.676},
        scan={"order": "raster"},
    )
    made = Made(tmp_path, tip, config, layers=1)
    program = made.read()
    assert program.wire_mm_s[program.deposit].min() == pytest.approx(1000.0 / 60.0, rel=1e-4)
    assert window_check(program, config).passed


@pytest.mark.parametrize("limits", [{"line_energy_j_mm": (150.0, 3000.0)}, {"current_window_ma": (30.0, 400.0)}])
def test_power_goes_down_no_further_than_the_window_allows(tmp_path, limits):
    """Aluminium melts with less power than the window lets a bead have: the plan waits for the rest."""
    config = Config().changed(
        material={"name": "Al 2319"}, process={"interpass": "both", **limits}, scan={"order": "raster"}
    )
    program = Made(tmp_path, shapely.box(0, 0, 30, 30), config, layers=4).read()
    power_w = program.power_w[program.deposit]
    assert power_w.min() < 0.5 * config.process.power_w
    assert window_check(program, config).passed

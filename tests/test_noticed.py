"""What is noticed of parts, profiles, plans and programs beside the gates."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import strategies as st
from nc_stack import make_curves, make_plan
from parts import box, moved

from ebamcheck.checks.interpass_checks import INTERPASS
from ebamcheck.checks.process_checks import seam_turns
from ebamcheck.heat.medium import entry_limit_k
from ebamcheck.mesh.inspection import inspect
from ebamcheck.pipeline import findings
from ebamcheck.preflight.room import of_bodies, suspicions
from ebamcheck.program import read_program, write_program
from ebamcheck.result import CODES, SEVERITIES, Check
from ebamcheck.settings.config import Config

ROOT = Path(__file__).resolve().parent.parent
FAST = {"backends": ("planecut", "manifold")}

figures = st.none() | st.floats(allow_nan=False)
texts = st.text(st.characters(exclude_categories=["Cs"]), max_size=30)
any_finding = st.builds(
    Check.finding, st.sampled_from(SEVERITIES), st.sampled_from(sorted(CODES)), texts, texts, figures, figures, texts, texts
)  # fmt: skip


# -- what is noticed ---------------------------------------------------------------------------------


def of_part(found, config):
    return [*of_bodies(found), *suspicions(found, config)]


def codes_of_part(part, **sections):
    return [f.code for f in of_part(inspect(part), Config().changed(**sections))]


def test_sizes_that_no_unit_explains_are_told():
    assert codes_of_part(box((0, 0, 0), (100, 60, 40))) == []
    assert codes_of_part(box((0, 0, 0), (4, 2.36, 1.57))) == ["part-under-beads"]
    assert codes_of_part(box((0, 0, 0), (76.2, 50.8, 25.4))) == ["part-round-in-inches"]
    assert codes_of_part(box((0, 0, 0), (79.375, 50.8, 26.9875))) == ["part-round-in-inches"]
    assert codes_of_part(box((0, 0, 0), (127, 254, 381))) == []  # round in both
    assert codes_of_part(box((0, 0, 0), (100, 2400, 40))) == ["part-beyond-travel"]
    assert codes_of_part(box((0, 0, 0), (17.9, 5, 5))) == ["part-under-beads"]
    assert codes_of_part(box((0, 0, 0), (17.9, 5, 5)), process={"bead_width_mm": 5.0}) == []


def test_the_axis_that_is_too_short_is_named():
    (found,) = of_part(inspect(moved(box((0, 0, 0), (100, 60, 1600)), shift=(9, 9, 9))), Config())
    assert (found.place, found.figure, found.limit) == ("machine.travel_max_mm Z", 1600.0, 1500.0)


@pytest.mark.parametrize("control", ["sinumerik-840d-sl", "linuxcnc", "plain-gcode"])
def test_placeholders_of_every_control_are_named_until_they_are_set(control):
    config = Config().changed(machine={"control": control}, process={"interpass": "off"})
    names = findings.placeholder_codes(config)
    assert {"beam_on", "beam_off", "wire_start", "wire_stop"} <= set(names)
    assert "set_power" not in names
    assert "wire_retract" not in names
    assert "set_power" in findings.placeholder_codes(config.changed(process={"interpass": "power"}))
    ramped = config.changed(process={"ramp_up_mm": 4.0, "wire_retract_mm": 3.0})
    assert {"set_power", "wire_retract"} <= set(findings.placeholder_codes(ramped))
    own = config.changed(machine=dict.fromkeys(names, ("M70",)))
    own = own.changed(machine={"set_beam": ("S{current_ma}",)})
    assert findings.placeholder_codes(own) == []
    assert not list(findings.profile_findings(own))
    one = own.changed(machine={"wire_stop": Config().machine.wire_stop})
    (found,) = findings.profile_findings(one)
    assert (found.place, found.figure) == ("machine.wire_stop", 1.0)


@pytest.mark.parametrize(("rise_k", "figure"), [(1000.0, None), (2000.0, 2293.15), (9000.0, 3533.0)])
def test_no_temperature_over_the_boiling_point_is_a_figure(rise_k, figure):
    plan = replace(make_plan([0.75, 2.25], []), metrics=pd.DataFrame({"entry_max_k": [np.nan, rise_k]}))
    found = list(findings.heat_findings(plan, Config()))
    assert [(f.figure, f.place) for f in found] == [(figure, "layer 2, cut at z = 2.250 mm, Z 3.000 mm")] * (
        figure is not None
    )
    assert all(("over the boiling point" in f.text) == (figure == 3533.0) for f in found)
    assert all(f.text.startswith("1 of 2 layers") for f in found)


def test_waits_and_power_are_told_with_their_figures():
    summary = pd.DataFrame(
        {"pause_s": [1800.0, 0.0], "deposit_s": [3000.0, 600.0], "travel_s": [900.0, 900.0]}
    )
    plan = replace(make_plan([0.75, 2.25], []), metrics=pd.DataFrame({"power_share": [1.0, 0.4]}))
    wait, power = findings.interpass_findings(summary, plan, Config())
    assert wait.text == "the program waits 0.5 of 2 hours for the part to cool"
    assert (power.figure, power.limit, power.place) == (
        2880.0,
        7200.0,
        "layer 2, cut at z = 2.250 mm, Z 3.000 mm",
    )
    full = replace(plan, metrics=pd.DataFrame({"power_share": [1.0, 1.0]}))
    assert not list(findings.interpass_findings(summary.assign(pause_s=0.0), full, Config()))


@pytest.mark.parametrize(
    ("process", "figure", "remedy"),
    [
        ({}, 903.15, "no wait is long enough"),
        ({"base": "insulated"}, 903.15, "cool the table"),
        ({"interpass": "power"}, 903.15, "wait as well"),
        ({"interpass_at": "layer"}, 880.0, "no wait is long enough"),
        ({"interpass": "off"}, None, ""),
        ({"interpass": "off", "interpass_limit_k": 700.0}, 903.15, "wait and lower the power"),
    ],
)
def test_a_limit_that_the_plan_does_not_keep_is_a_fault(process, figure, remedy):
    config = Config().changed(process=process)
    metrics = pd.DataFrame({"entry_max_k": [np.nan, 610.0], "enter_k": [300.0, 880.0]})
    plan = replace(make_plan([0.75, 2.25], []), metrics=metrics)
    found = list(findings.limit_findings([], plan, config))
    assert [(f.severity, f.code, f.place) for f in found] == [
        ("fault", "interpass-limit", "layer 2, cut at z = 2.250 mm, Z 3.000 mm")
    ] * (figure is not None)
    for fault in found:
        assert (fault.figure, fault.limit) == (pytest.approx(figure), entry_limit_k(config))
        assert remedy in fault.remedy
        assert "in 1 of 2 layers" in fault.text


def test_a_limit_that_the_text_alone_does_not_keep_is_a_fault():
    metrics = pd.DataFrame({"entry_max_k": [500.0, 570.0]})
    plan = replace(make_plan([0.75, 2.25], []), metrics=metrics)
    hot = Check(INTERPASS, False, 1139.3, 873.0, "K", "MAIN_L0024.SPF:13", "surface at 1139 K")
    (fault,) = findings.limit_findings([hot], plan, Config())
    assert (fault.place, fault.figure, fault.limit) == ("MAIN_L0024.SPF:13", 1139.3, 873.0)
    assert not list(findings.limit_findings([replace(hot, passed=True)], plan, Config()))


SQUARE = np.array([(0, 0), (40, 0), (40, 40), (0, 40), (0, 0)], float)
BESIDE = np.array([(20, 0), (40, 0), (40, 40), (0, 40), (0, 0), (20, 0)], float)
OPEN = np.array([(60, 0), (80, 0), (80, 40)], float)


def test_seams_at_corners_are_found_with_their_place(tmp_path):
    config, heights = Config(), [0.75, 2.25]
    curves = make_curves(
        heights, [[[(BESIDE, None)]], [[(SQUARE + 5, None)], [(OPEN, None)]]], [True, True, False]
    )
    nc = read_program(write_program(curves, make_plan(heights, []), config, tmp_path / "p").main, config)
    row, turn_deg = seam_turns(nc)
    assert turn_deg == pytest.approx([0.0, 90.0], abs=1e-6)
    (found,) = findings.seam_findings(nc, np.array(heights), config)
    assert found.place == "layer 2, cut at z = 2.250 mm, Z 3.000 mm, (5.000, 5.000)"
    assert found.text.startswith("1 of 2 closed contours")
    assert nc.layer[row].tolist() == [0, 1]


def test_a_round_contour_has_no_corner(tmp_path):
    angle = np.linspace(0.0, 2.0 * np.pi, 65)
    ring = 20.0 * np.column_stack([np.cos(angle), np.sin(angle)])
    ring[-1] = ring[0]
    curves = make_curves([0.75], [[[(ring, None)]]], [True])
    nc = read_program(write_program(curves, make_plan([0.75], []), Config(), tmp_path / "p").main, Config())
    assert seam_turns(nc)[1] == pytest.approx([360.0 / 64.0], abs=1e-3)
    assert not list(findings.seam_findings(nc, np.array([0.75]), Config()))

"""Findings: one list in run.json, from which terminal, report, JUnit, certificate and banner are rendered, and nothing else."""

from __future__ import annotations

import ast
import json
import re
import shutil
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pytest
from command_line import frame, write_stl
from finished_runs import THICK_FAST, plate_of_two_layers
from hypothesis import given
from hypothesis import strategies as st
from nc_stack import make_curves, make_plan
from parts import box, moved

from ebamcheck.checks.interpass_checks import INTERPASS
from ebamcheck.checks.process_checks import seam_turns
from ebamcheck.checks.rules import REMEDIES
from ebamcheck.commands.summaries import run_summary
from ebamcheck.errors import ExitCode
from ebamcheck.heat.medium import entry_limit_k
from ebamcheck.json_values import plain, write_json
from ebamcheck.mesh.inspection import inspect
from ebamcheck.pipeline import findings, run_job
from ebamcheck.pipeline.findings import failed_checks
from ebamcheck.preflight.room import of_bodies, suspicions
from ebamcheck.program import read_program, write_program
from ebamcheck.record.certificate import (
    APPROVAL,
    CODES_OF_THE_MAKER,
    DRY_RUN,
    PROVED,
    certificate,
    seal,
    statement,
    write_certificate,
)
from ebamcheck.record.certificate_checks import run_certificate_checks
from ebamcheck.record.run_folder import RunFolder
from ebamcheck.result import (
    CODES,
    SEVERITIES,
    Check,
    Place,
    finding_of_record,
    finding_records,
    has_fault,
    ordered,
)
from ebamcheck.settings.config import Config
from ebamcheck_reports import html, junit

ROOT = Path(__file__).resolve().parent.parent

figures = st.none() | st.floats(allow_nan=False)
texts = st.text(st.characters(exclude_categories=["Cs"]), max_size=30)
any_finding = st.builds(
    Check.finding, st.sampled_from(SEVERITIES), st.sampled_from(sorted(CODES)), texts, texts, figures, figures, texts, texts
)  # fmt: skip


# -- the list ----------------------------------------------------------------------------------------


@given(st.lists(any_finding))
def test_findings_come_back_from_json(found):
    stored = json.loads(json.dumps(plain(finding_records(found)), allow_nan=False))
    assert repr([finding_of_record(record) for record in stored]) == repr(ordered(found))


@given(st.lists(any_finding))
def test_the_gravest_come_first_and_none_comes_twice(found):
    keys = [(SEVERITIES.index(f.severity), f.code) for f in ordered(found)]
    assert keys == sorted(keys)
    assert sorted(map(repr, ordered(found))) == sorted(set(map(repr, found)))
    assert has_fault(found) == any(f.severity == "fault" for f in found)


def test_a_code_or_severity_that_stands_in_no_table_is_refused():
    with pytest.raises(ValueError, match="stands in no table"):
        Check.finding("note", "no-such-code", "?")
    with pytest.raises(ValueError, match="severity 'grave'"):
        Check.finding("grave", "metal-excess", "?")


@given(st.text("ABC_09.:", min_size=1), st.integers(1, 10**9))
def test_a_line_of_a_file_is_read_back_as_it_is_told(file, line):
    place = Place.of_line(str(Place(file, line)))
    assert (place.file, place.line, place.layer, place.is_point) == (file, line, None, False)


@pytest.mark.parametrize("where", ["", "run.json", "MAIN.MPF:", "machine.travel_max_mm Z", "C:x"])
def test_what_names_no_line_is_told_as_it_was_given(where):
    assert (str(Place.of_line(where)), Place.of_line(where).line) == (where, 0)


def test_every_code_is_used_and_in_the_table_of_findings():
    said = {
        node.value
        for path in (ROOT / "ebamcheck").rglob("*.py")
        if path.name != "result.py"
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    }
    assert set(CODES) <= said
    table = (ROOT / "docs" / "limits.md").read_text(encoding="utf-8").partition("## Findings")[2]
    rows = dict(re.findall(r"^\| `([a-z-]+)` \| (.+) \|$", table, re.MULTILINE))
    assert {code: rows.get(code) for code in CODES} == dict(CODES)


# -- what is shown -----------------------------------------------------------------------------------

PLANTED = [
    Check.finding("note", "interpass-wait", "pauses of <b> 7.5 s", "process.layer_pause_s", 7.5, None, "s"),
    Check.finding("warning", "metal-excess", "12 % & more", "layer 3, z = 4.500 mm, (1.000, 2.000)", 1.12, 1.1, "of it", "mill"),
    Check.finding("fault", "wall-under-bead", "a wall of 0.8 mm", "layer 0, z = 0.500 mm", 0.8, 2.8, "mm", "thicken the wall"),
]  # fmt: skip


@pytest.fixture
def copy(tmp_path_factory, tmp_path):
    """A finished run of a plate with a hole, to be altered."""
    shutil.copytree(plate_of_two_layers(tmp_path_factory), tmp_path / "copy.run")
    return RunFolder(tmp_path / "copy.run")


def altered(run, **parts):
    write_json({**run.manifest(), **parts}, run.path / "run.json")


def rendered(run):
    """Every rendering as plain text: terminal, first screen and certificate of the report, JUnit, certificate."""
    write_certificate(run)
    html.write(run)
    junit.write(run)
    page = (run.path / "report.html").read_text(encoding="utf-8")
    tree = ElementTree.fromstring(page.removeprefix("<!DOCTYPE html>\n"))
    parts = {s.get("id"): " ".join("".join(s.itertext()).split()) for s in tree.iter("section")}
    cases = ElementTree.parse(run.path / "junit.xml").getroot().iter()
    return {
        "terminal": run_summary(run.manifest()),
        "first screen": parts["summary"] + parts["verdict"],
        "report's certificate": parts["certificate"],
        "junit": "\n".join(str(text) for node in cases for text in (node.text, *node.attrib.values())),
        "certificate": json.dumps(json.loads((run.path / "certificate.json").read_text()), ensure_ascii=False),
    }


def test_every_rendering_shows_every_finding(copy):
    own = [finding_of_record(record) for record in copy.manifest()["findings"]]
    assert {"placeholder-codes", "seam-at-corner"} <= {found.code for found in own}
    altered(copy, findings=finding_records([*own, *PLANTED]))
    for name, text in rendered(copy).items():
        for found in [*own, *PLANTED]:
            for said in (found.severity, found.code, found.text, str(found.place), found.remedy):
                assert said in text, (name, found.code, said)


def test_every_rendering_says_what_is_proved_and_what_is_left(copy):
    said = statement(copy.manifest())
    assert said.proved == tuple(PROVED[gate["name"]] for gate in copy.manifest()["gates"])
    assert (said.left[1], *said.left[3:]) == (CODES_OF_THE_MAKER, DRY_RUN, APPROVAL)
    assert re.fullmatch(r"\S+ kg of wire on the spool and a cathode for \S+ h of beam", said.left[2])
    assert re.fullmatch(r"a look at \d+ warnings", said.left[0])
    for name, text in rendered(copy).items():
        # What is left to a person stands once in the report, where it is signed.
        for clause in (*said.proved, *(() if name == "report's certificate" else said.left)):
            assert clause in text, (name, clause)
        if name == "first screen":
            assert text.count(said.left[0]) == 1


def test_every_check_of_a_program_has_a_remedy_of_its_own(copy):
    names = {check["name"] for check in copy.manifest()["program"]["checks"]}
    assert len(names) > 50
    assert names - set(REMEDIES) == set()


def test_a_failed_check_is_a_finding_with_its_remedy():
    """Those of the metal have findings of their own; without these, a program that is not validated might have no fault."""
    check = Check(
        "overhang", False, 80.0, 74.0, "deg", "MAIN_L0003.SPF:9", "too far", place="layer 3", remedy="turn it"
    )
    others = [replace(check, passed=True), Check("surface", False, 9, 3, "mm", "", "")]
    (found,) = failed_checks([check, *others])
    assert (found.severity, found.code, found.text) == ("fault", "check-failed", "overhang: too far")
    assert (found.place, found.remedy) == ("MAIN_L0003.SPF:9, layer 3", "turn it")


def test_what_is_left_follows_from_gates_and_findings(copy):
    manifest = copy.manifest()
    gates = [{**g, "passed": g["name"] not in ("fit", "program")} for g in manifest["gates"]]
    shut = statement({**manifest, "exit_code": 1, "gates": gates, "findings": []})
    assert shut.left == ("to open the gates fit, program",)
    assert len(shut.proved) == len(gates) - 2
    assert shut.parts()[0] == ("Not proved", (PROVED["fit"], PROVED["program"]))
    other = {**gates[0], "name": "of a plugin", "text": "all is blue"}
    assert statement({**manifest, "gates": [other]}).proved == ("all is blue",)
    own_codes = [f for f in manifest["findings"] if f["code"] != "placeholder-codes"]
    assert CODES_OF_THE_MAKER not in statement({**manifest, "findings": own_codes}).left
    faulty = statement({**manifest, "exit_code": 1, "findings": finding_records(PLANTED)})
    assert faulty.left == ("a look at 1 fault, 1 warning",)
    assert statement({**manifest, "job": "check", "program": None, "findings": []}).left == ()


def test_junit_fails_for_a_fault_alone(copy):
    altered(copy, findings=finding_records(PLANTED))
    junit.write(copy)
    cases = ElementTree.parse(copy.path / "junit.xml").getroot().iter("testcase")
    found = [(c.get("name").split()[0], c[0].tag) for c in cases if c.get("classname") == "ebamcheck.finding"]
    assert found == [
        ("wall-under-bead", "failure"),
        ("metal-excess", "skipped"),
        ("interpass-wait", "system-out"),
    ]


def test_the_seal_breaks_where_a_finding_is_taken_out(copy):
    def failed():
        return [check.name for check in run_certificate_checks(copy, copy.manifest()) if not check.passed]

    altered(copy, findings=finding_records(PLANTED))
    path = write_certificate(copy)
    assert failed() == []
    whole = json.loads(path.read_text())
    for k in range(len(PLANTED)):
        less = {**whole, "findings": whole["findings"][:k] + whole["findings"][k + 1 :]}
        write_json(less, path)
        assert failed() == ["certificate seal", "certificate"]
        # Sealed anew it is no longer what the record says.
        write_json({**less, "seal": seal(less)}, path)
        assert failed() == ["certificate"]


def test_a_run_of_a_version_without_findings_is_shown_and_its_certificate_holds(copy):
    manifest = copy.manifest()
    del manifest["findings"]
    write_json(manifest, copy.path / "run.json")
    assert "findings" not in certificate(manifest)
    assert "cannot be shown" not in rendered(copy)["first screen"]
    write_certificate(copy)  # the page was written after the first one
    assert all(check.passed for check in run_certificate_checks(copy, copy.manifest()))


def test_nothing_with_a_fault_is_validated(tmp_path, monkeypatch):
    """A fault shuts a run whose gates all pass."""
    monkeypatch.setattr(findings, "profile_findings", lambda _: [PLANTED[2]])
    result = run_job(write_stl(frame(), tmp_path / "frame.stl"), tmp_path / "a.run", THICK_FAST)
    assert all(gate.passed for gate in result.gates)
    assert result.exit_code is ExitCode.OUT_OF_TOLERANCE
    assert result.manifest["program"]["validated"] is False
    assert "; NOT VALIDATED" in (result.folder.program_folder / "MAIN.MPF").read_text()
    page = (result.folder.path / "report.html").read_text()
    assert "✘ NOT VALIDATED" in page
    assert "a wall of 0.8 mm" in page.partition('id="part"')[0]


@pytest.mark.parametrize(
    ("value_deg", "passed", "set_deg", "told"),
    [(44.0, True, None, 0), (46.0, True, None, 1), (46.0, True, 60.0, 0), (80.0, False, None, 0)],
)
def test_a_steep_overhang_is_warned_of_where_no_angle_is_set(value_deg, passed, set_deg, told):
    check = Check("overhang", passed, value_deg, 74.0, "deg", "MAIN.MPF:7", "layers reach out")
    config = Config().changed(process={"largest_overhang_deg": set_deg})
    found = list(findings.overhang_findings([check, replace(check, name="support")], config))
    assert [(one.severity, one.code) for one in found] == [("warning", "steep-overhang")] * told


# -- of parts, profiles, plans and programs ------------------------------------------------------------


def of_part(found, config):
    return [*of_bodies(found), *suspicions(found, config)]


def codes_of_part(part, **sections):
    return [f.code for f in of_part(inspect(part), Config().changed(**sections))]


@pytest.mark.parametrize(
    ("size", "code"),
    [
        ((100, 60, 40), ""),
        ((4, 2.36, 1.57), "part-under-beads"),
        ((76.2, 50.8, 25.4), "part-round-in-inches"),
        ((79.375, 50.8, 26.9875), "part-round-in-inches"),
        ((127, 254, 381), ""),  # round in both
        ((100, 2400, 40), "part-beyond-travel"),
        ((17.9, 5, 5), "part-under-beads"),
    ],
)
def test_sizes_that_no_unit_explains_are_told(size, code):
    assert codes_of_part(box((0, 0, 0), size)) == [code] * bool(code)
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
    summary = pd.DataFrame({"pause_s": [1800.0, 0.0], "deposit_s": [3000.0, 600.0], "travel_s": [900.0, 900.0]})
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
ROUND = 20.0 * np.column_stack([f(np.linspace(0.0, 2.0 * np.pi, 65)) for f in (np.cos, np.sin)]).round(9)


def test_seams_at_corners_are_found_with_their_place(tmp_path):
    heights = [0.75, 2.25]
    curves = make_curves(
        heights, [[[(BESIDE, None)], [(ROUND - 50, None)]], [[(SQUARE + 5, None)], [(OPEN, None)]]], [True, True, True, False]
    )  # fmt: skip
    config = Config()
    nc = read_program(write_program(curves, make_plan(heights, []), config, tmp_path / "p").main, config)
    row, turn_deg = seam_turns(nc)
    assert turn_deg == pytest.approx([0.0, 360.0 / 64.0, 90.0], abs=1e-3)
    (found,) = findings.seam_findings(nc, np.array(heights), config)
    assert found.place == "layer 2, cut at z = 2.250 mm, Z 3.000 mm, (5.000, 5.000)"
    assert found.text.startswith("1 of 3 closed contours")
    assert nc.layer[row].tolist() == [0, 0, 1]


# -- a program whose layers end beside the top of the part: no gate sees it, since all hold the metal against its own layers ---


def height_findings(part_mm, heights, **sections):
    return list(findings.height_findings(part_mm, np.array(heights), Config().changed(**sections)))


def test_a_plate_thinner_than_its_only_layer_is_told():
    (found,) = height_findings(1.0, [0.5])
    assert (found.severity, found.code) == ("warning", "height-off-part")
    assert found.text == "the only layer ends at Z 1.676 mm, and the part is 1.000 mm high"
    assert (found.figure, found.limit) == pytest.approx((0.6755, 0.02), abs=1e-4)
    for listed, setting in (([0.4], "heights_mm"), ([], "layer_height_mm")):
        (found,) = height_findings(0.8, [0.4], layers={"heights_mm": listed})
        assert (found.severity, found.place) == ("fault", f"layers.{setting}")
        assert setting in found.remedy


@pytest.mark.parametrize(
    ("part_mm", "severity"),
    [(22.0, "fault"), (21.2, "fault"), (20.9, "warning"), (20.6, "warning"), (20.38, ""), (20.0, ""), (19.62, ""),
     (19.2, "warning"), (18.8, "fault"), (18.0, "fault")],
)  # fmt: skip
def test_layers_that_are_missing_or_too_many_are_a_fault(part_mm, severity):
    """Ten layers of 2 mm: no heights but listed ones leave off half a layer, or go on as far above the part."""
    found = height_findings(part_mm, 1.0 + 2.0 * np.arange(10), layers={"layer_height_mm": 2.0})
    assert [one.severity for one in found] == [severity] * bool(severity)
    assert not height_findings(part_mm, [0.8], layers={"base_mm": 10.0})  # on what stands

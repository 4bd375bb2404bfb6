"""Findings: one list in run.json, from which terminal, report, JUnit, certificate and banner are rendered, and nothing else."""

from __future__ import annotations

import ast
import json
import re
import shutil
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import pytest
from command_line import WIDE, frame, write_stl
from hypothesis import given
from hypothesis import strategies as st
from slicers_here import slicers_here

from ebamcheck.checks.rules import REMEDIES
from ebamcheck.commands.summaries import run_summary
from ebamcheck.errors import ExitCode
from ebamcheck.json_values import plain, write_json
from ebamcheck.pipeline import findings, run_job
from ebamcheck.pipeline.findings import METAL, failed_checks
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
from ebamcheck_reports import html, junit, summary

ROOT = Path(__file__).resolve().parent.parent
FAST = {"backends": ("planecut", "manifold")}

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


def test_every_code_is_kebab_case_explained_and_used():
    assert all(re.fullmatch(r"[a-z]+(-[a-z]+)+", code) for code in CODES)
    assert all(re.fullmatch(r"[A-Z].{20,}\.", meaning) for meaning in CODES.values())
    assert list(CODES) == sorted(CODES)
    said = {
        node.value
        for path in (ROOT / "ebamcheck").rglob("*.py")
        if path.name != "result.py"
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    }
    assert set(CODES) <= said


def test_every_code_is_in_the_table_of_findings():
    table = (ROOT / "docs" / "limits.md").read_text(encoding="utf-8").partition("## Findings")[2]
    rows = dict(re.findall(r"^\| `([a-z-]+)` \| (.+) \|$", table, re.MULTILINE))
    assert {code: rows.get(code) for code in CODES} == dict(CODES)


def test_nothing_that_is_shown_says_that_a_program_may_be_used():
    """Nothing proves that: the control has not run it."""
    told = re.compile(
        r"may be used|can be used on|safe to (run|use)|ready (to use|for production)|fit for use",
        re.IGNORECASE,
    )
    places = [*(ROOT / "ebamcheck").rglob("*.py"), *(ROOT / "reports" / "ebamcheck_reports").rglob("*.py")]
    assert [(p.name, told.search(p.read_text())[0]) for p in places if told.search(p.read_text())] == []


# -- what is shown -----------------------------------------------------------------------------------

PLANTED = [
    Check.finding("note", "interpass-wait", "pauses of <b> 7.5 s", "process.layer_pause_s", 7.5, None, "s"),
    Check.finding("warning", "metal-excess", "12 % & more", "layer 3, z = 4.500 mm, (1.000, 2.000)", 1.12, 1.1, "of it", "mill"),
    Check.finding("fault", "wall-under-bead", "a wall of 0.8 mm", "layer 0, z = 0.500 mm", 0.8, 2.8, "mm", "thicken the wall"),
]  # fmt: skip


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A finished run of a plate with a hole."""
    folder = tmp_path_factory.mktemp("made")
    path = write_stl(frame(), folder / "frame.stl")
    thick = {"layer_height_mm": 6.0}
    with slicers_here():
        return run_job(path, folder / "frame.run", Config().changed(layers=thick, slicing=FAST, process=WIDE))


@pytest.fixture
def copy(made, tmp_path):
    shutil.copytree(made.folder.path, tmp_path / "copy.run")
    return RunFolder(tmp_path / "copy.run")


def rendered(run):
    """Every rendering as plain text: terminal, first screen and certificate of the report, JUnit, certificate, table."""
    write_certificate(run)
    html.write(run)
    junit.write(run)
    summary.write(run)
    page = (run.path / "report.html").read_text(encoding="utf-8")
    tree = ElementTree.fromstring(page.removeprefix("<!DOCTYPE html>\n"))
    parts = {s.get("id"): " ".join("".join(s.itertext()).split()) for s in tree.iter("section")}
    cases = ElementTree.parse(run.path / "junit.xml").getroot()
    told = [
        [*case.attrib.values(), *(v for c in case for v in (c.text, *c.attrib.values()))]
        for case in cases.iter()
    ]
    paper = json.loads((run.path / "certificate.json").read_text())
    return {
        "terminal": run_summary(run.manifest()),
        "first screen": parts["summary"] + parts["verdict"],
        "report's certificate": parts["certificate"],
        "junit": "\n".join(str(value) for case in told for value in case),
        "certificate": json.dumps(paper, ensure_ascii=False),
    }


def test_a_run_holds_its_findings(made):
    found = made.manifest["findings"]
    assert made.exit_code is ExitCode.PASS
    assert {"placeholder-codes", "seam-at-corner"} <= {f["code"] for f in found}
    assert found == finding_records(finding_of_record(f) for f in found)
    assert made.folder.manifest()["findings"] == plain(found)


def test_every_rendering_shows_every_finding(made, copy):
    manifest = copy.manifest()
    write_json(
        {**manifest, "findings": finding_records([*map(finding_of_record, manifest["findings"]), *PLANTED])},
        copy.path / "run.json",
    )
    shown = rendered(copy)
    for name, text in shown.items():
        for found in map(finding_of_record, copy.manifest()["findings"]):
            for said in (found.severity, found.code, found.text, found.place, found.remedy):
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
    (found,) = failed_checks(
        [
            check,
            Check("overhang", True, 1.0, 74.0, "deg", "", "fine"),
            Check("surface", False, 9, 3, "mm", "", ""),
        ]
    )
    assert (found.severity, found.code, found.text) == ("fault", "check-failed", "overhang: too far")
    assert (found.place, found.remedy) == ("MAIN_L0003.SPF:9, layer 3", "turn it")


def test_shut_gates_are_left_to_be_opened(copy):
    """Also where no finding is a fault: what is left is more than a look at warnings."""
    gates = [{**g, "passed": g["name"] not in ("fit", "program")} for g in copy.manifest()["gates"]]
    shut = statement({**copy.manifest(), "exit_code": 1, "gates": gates, "findings": []})
    assert shut.left == ("to open the gates fit, program",)


def test_a_gate_that_is_shut_proves_nothing(copy):
    manifest = copy.manifest()
    gates = [{**g, "passed": g["name"] != "fit"} for g in manifest["gates"]]
    said = statement({**manifest, "gates": gates})
    assert PROVED["fit"] not in said.proved
    assert len(said.proved) == len(gates) - 1
    assert said.parts()[0] == ("Not proved", (PROVED["fit"],))
    other = {**gates[0], "name": "of a plugin", "text": "all is blue"}
    assert statement({**manifest, "gates": [other]}).proved == ("all is blue",)


def test_own_codes_leave_no_codes_to_set(copy):
    manifest = copy.manifest()
    kept = [f for f in manifest["findings"] if f["code"] != "placeholder-codes"]
    assert CODES_OF_THE_MAKER not in statement({**manifest, "findings": kept}).left


def test_of_what_is_not_validated_no_next_step_is_said(copy):
    manifest = copy.manifest()
    shut = statement({**manifest, "exit_code": 1, "findings": finding_records(PLANTED)})
    assert shut.left == ("a look at 1 fault, 1 warning",)
    check = statement({**manifest, "job": "check", "program": None, "findings": []})
    assert check.left == ()


def test_junit_fails_for_a_fault_alone(copy):
    write_json({**copy.manifest(), "findings": finding_records(PLANTED)}, copy.path / "run.json")
    junit.write(copy)
    cases = ElementTree.parse(copy.path / "junit.xml").getroot().iter("testcase")
    found = {
        c.get("name").split()[0]: [n.tag for n in c]
        for c in cases
        if c.get("classname") == "ebamcheck.finding"
    }
    assert found == {
        "wall-under-bead": ["failure"],
        "metal-excess": ["skipped"],
        "interpass-wait": ["system-out"],
    }


def test_the_seal_breaks_where_a_finding_is_taken_out(copy):
    write_json({**copy.manifest(), "findings": finding_records(PLANTED)}, copy.path / "run.json")
    path = write_certificate(copy)
    assert all(check.passed for check in run_certificate_checks(copy, copy.manifest()))
    whole = json.loads(path.read_text())
    for k in range(len(PLANTED)):
        less = {**whole, "findings": whole["findings"][:k] + whole["findings"][k + 1 :]}
        write_json(less, path)
        failed = [check.name for check in run_certificate_checks(copy, copy.manifest()) if not check.passed]
        assert failed == ["certificate seal", "certificate"]
        # Sealed anew it is no longer what the record says.
        write_json({**less, "seal": seal(less)}, path)
        failed = [check.name for check in run_certificate_checks(copy, copy.manifest()) if not check.passed]
        assert failed == ["certificate"]


def test_a_run_of_a_version_without_findings_is_shown_and_its_certificate_holds(copy):
    manifest = copy.manifest()
    del manifest["findings"]
    write_json(manifest, copy.path / "run.json")
    assert "findings" not in certificate(manifest)
    assert "cannot be shown" not in rendered(copy)["first screen"]
    write_certificate(copy)
    assert all(check.passed for check in run_certificate_checks(copy, copy.manifest()))


def test_nothing_with_a_fault_is_validated(tmp_path, monkeypatch):
    """A fault shuts a run whose gates all pass."""
    monkeypatch.setattr(findings, "profile_findings", lambda _: [PLANTED[2]])
    path = write_stl(frame(), tmp_path / "frame.stl")
    config = Config().changed(layers={"layer_height_mm": 6.0}, slicing=FAST, process=WIDE)
    result = run_job(path, tmp_path / "a.run", config)
    assert all(gate.passed for gate in result.gates)
    assert result.exit_code is ExitCode.OUT_OF_TOLERANCE
    assert result.manifest["program"]["validated"] is False
    assert "; NOT VALIDATED" in (result.folder.program_folder / "MAIN.MPF").read_text()
    page = (result.folder.path / "report.html").read_text()
    assert "✘ NOT VALIDATED" in page
    assert "a wall of 0.8 mm" in page.partition('id="part"')[0]
    assert "nothing failed" not in page


def test_sections_off_an_open_mesh_are_no_mistake_of_the_program():
    """An open mesh has sections that differ from it, too: the mesh is to be mended before anything is reported."""
    for remedy in (REMEDIES["sections of the mesh"], METAL["sections of the mesh"][1]):
        assert remedy.startswith("mend the mesh")


@pytest.mark.parametrize(
    ("value_deg", "passed", "set_deg", "told"),
    [(44.0, True, None, 0), (46.0, True, None, 1), (46.0, True, 60.0, 0), (80.0, False, None, 0)],
)
def test_a_steep_overhang_is_warned_of_where_no_angle_is_set(value_deg, passed, set_deg, told):
    check = Check("overhang", passed, value_deg, 74.0, "deg", "MAIN.MPF:7", "layers reach out")
    config = Config().changed(process={"largest_overhang_deg": set_deg})
    found = list(findings.overhang_findings([check, replace(check, name="support")], config))
    assert [(one.severity, one.code) for one in found] == [("warning", "steep-overhang")] * told

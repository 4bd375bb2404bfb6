"""Every limit has a planted case just inside and one just outside; a limit, or a check, without its two cases fails here."""

from __future__ import annotations

import ast
from collections import Counter
from dataclasses import replace
from pathlib import Path

import limits_of_heat
import limits_of_metal
import limits_of_parts
import limits_of_path
import limits_of_tables
import limits_of_text
import numpy as np
import pytest
from finished_runs import certified_plate
from limit_cases import cube
from limits_of_faults import FAULTY
from limits_of_heat import preheated
from planted_faults import FAULTS

import ebamcheck
from ebamcheck.checks import value_checks
from ebamcheck.checks.matching import matched
from ebamcheck.checks.rules import REMEDIES, RULES, checks_on, names_of, of_gate
from ebamcheck.checks.subject import Subject
from ebamcheck.plugins import registry
from ebamcheck.program import Check, verify_program
from ebamcheck.record.run_folder import RunFolder
from ebamcheck.verification.verify import verify_run
from ebamcheck.writing.bead_ends import planned_path

CASES = (
    *limits_of_text.CASES,
    *limits_of_path.CASES,
    *limits_of_metal.CASES,
    *limits_of_heat.CASES,
    *limits_of_parts.CASES,
    *limits_of_tables.CASES,
)

# Checks with a sound and a faulty case in tests of their own
ELSEWHERE = {
    # How a table turns, and that it is taken back: test_tilt_table.py.
    "table turns", "frame taken back",
    # Scans of a plate that heat more, or less, than the model says: test_preheat_made_wrong.py.
    "preheat balance",
    # Hashes, signatures and records, equal or not: test_certificate.py, test_forgeries.py.
    "settings unchanged", "file unchanged", "part unchanged", "certificate", "certificate seal", "signature", "record", "verdict", "handshake",
    "program", "worked out again", "part sound", "mounting",
}  # fmt: skip

# Constants of rooms of checks that need no two cases, by the reason
NO_LIMITS = {
    "how finely something is looked at": """
        bead_checks.MARGIN bead_checks.CRUMB narrow_features.CRUMB subject.BEAD_STEP_MM clearance.PLACES metal.STEP_SHARE
        bead_checks.CHORD_MM bead_checks.AT_ONCE heat_again.PLATE_CELLS heat_again.STEPS heat_again.SINGLE_LAYERS heat_again.MOST_CELLS
        heat_again.HOTTEST_K heat_again.SUMMED clearance.STEP_MM section_check.STEP_MM process_checks.OUTLINE_STEP_MM
        process_checks.INNER_STEP_MM process_checks.FIRST_ASKED process_checks.QUARTER_ROUND path_checks.SAMPLES path_checks.CHORD_SHARE
        path_checks.FLAT_ARC preheating.AT_ONCE_S preheating.MOST_PASSES process_checks.DIRECTIONS
        process_checks.KEEP_OUT_STEP_MM section_check.STEP_MM path_checks.DEGREE
        clearance.CELLS_PER_BEAD clearance.MOST_CELLS interpass_checks.OUTLINE_STEP_MM interpass_checks.LONGEST_WAIT_S interpass_checks.LEAST_SHARE
        table.STEP_DEG interpass_checks.LONGEST_S
        metal_rules.SPANS metal.AT_ONCE metal_rules.LEAST_BEADS bead_end_checks.REACH_BEADS
        narrow_features.NO_WIDTH_MM narrow_features.LYING narrow_features.STEPS narrow_features.ON_SIDE
        mesh_checks.LINES_PER_BEAD mesh_checks.MOST_LINES mesh_checks.OFF_GRID mesh_checks.AT_ONCE part_file.AT_ONCE
        mesh_checks.LEAST_MM2 mesh_checks.MOST_SPANS mesh_checks.FINEST
        mesh_checks.CUTS_OF_A_LAYER mesh_checks.CUTS_AT_ONCE stages.SAMPLING_MM table.STEP_MM
        table.MOST_PLACES""",
    "units, forms of files, and how much of something is told": """
        consumables.KG_MM3 consumables.HOUR_S consumables.TOLD_LAYERS
        text_checks.TOLD text_checks.LETTERS text_checks.MEGABYTE heat_again.RADIATION_W_MM2K4
        metal.NO_ZONES bead_checks.FINE bead_checks.SKEW bead_checks.UNEVEN bead_checks.BACK
        matching.APART_MM form.CERTIFICATE_FORMAT value_checks.TOLD
        findings.LACKING part_file.UNIT_MM part_file.HEAD part_file.FACET part_file.FACET_TEXT reports.TIME_S
        reports.MEMORY_MB reports.LARGEST_REPORT_BYTES reports.MOST_FILES form.FORMAT_VERSION form.PRINTED
        run_folder.AT_FDCWD run_folder.RENAME_EXCHANGE signing.SIGNATURE_FORMAT signing.FINGERPRINT_DIGITS tables_again.SHOWN
        certificate.GIT_TIMEOUT_S table.FAR_MM""",
    "which of several things is compared with which: each way of it is judged by a limit of its own": """
        bead_checks.PARALLEL_RAD bead_checks.TO_AND_FRO bead_checks.WIDEST_SPACINGS bead_checks.GENTLE bead_checks.MANY
        subject.CONTOUR_SHARE preheating.ROUND_SHARE preheating.SLIVER_MM preheating.ALONG_MM
        checks.SAME_AREA slabs.LEAST_REACH table.LEAST_MM2
        table.SAME_MM interpass_checks.PERCENT value_checks.WIDER""",
    "what keeps a quotient from a divisor of nothing": "metal.LEAST_OWN",
    "what a warning or a text tells, and no check": """
        value_checks.MOST_SLACK findings.STEEP_DEG findings.ROUNDING_MM findings.MOST_NARROW
        narrow_features.LONG narrow_features.TAPERS""",
}

# Settings that other gates, or other checks, rest on
NOT_JUDGED_HERE = {
    "comparison.tolerance_mm", "comparison.evidence_share", "comparison.doubt_mm",  # of slicers: test_comparison.py
    "curves.largest_lift_mm", "curves.largest_bulge_mm",  # of curves: test_curve_evidence.py
    "process.melting_efficiency", "process.dilution",  # data of the process: test_interpass.py
}  # fmt: skip


@pytest.mark.parametrize("case", CASES, ids=str)
def test_a_figure_inside_of_its_limit_passes_and_one_outside_fails(case):
    inside, outside = case.verdict(case.inside), case.verdict(case.outside)
    assert inside.name == outside.name == case.check
    assert inside.passed, inside.text
    assert not outside.passed, outside.text


@pytest.mark.parametrize("name", FAULTY)
def test_what_is_right_or_wrong_passes_where_it_is_right_and_fails_where_it_is_wrong(name):
    plant, needs = FAULTY[name]
    faulty = plant()
    sound = preheated() if name.startswith("preheat") else cube()
    needs_of_sound = tuple(need for need in needs if need in ("curves", "plan", "layers", "beads"))
    assert all(check.passed for check in sound.checks(*needs_of_sound).values() if check.name == name)
    assert not faulty.checks(*needs)[name].passed


# -- no limit and no check is left out -----------------------------------------------------------------


def planted_checks():
    return {case.check for case in CASES} | set(FAULTY) | {check for _, check in FAULTS.values()} | ELSEWHERE


def test_every_check_that_has_a_remedy_is_planted():
    assert set(REMEDIES) - planted_checks() == set(), (
        "give each a row in limits_of_*.py, or a fault in limits_of_faults.py"
    )


@pytest.mark.slow
def test_every_check_that_a_sound_run_reports_is_planted(tmp_path_factory):
    run, part = certified_plate(tmp_path_factory)
    names = {check["name"] for check in RunFolder(run).manifest()["program"]["checks"]}
    names |= {check.name for check in verify_run(run, part)}
    assert {name for name in names - planted_checks() if not name.startswith("gate ")} == set()


def constants(folder):
    """Names of the constants of modules that hold a number, as ``module.NAME``."""
    for path in sorted((Path(ebamcheck.__file__).parent / folder).glob("*.py")):
        for node in ast.parse(path.read_text()).body:
            target = node.targets[0] if isinstance(node, ast.Assign) else getattr(node, "target", None)
            value = getattr(node, "value", None)
            if target is None or value is None:
                continue
            numbers = [
                x.value for x in ast.walk(value) if isinstance(x, ast.Constant) and type(x.value) in (int, float)
            ]
            for name in target.elts if isinstance(target, ast.Tuple) else [target]:
                if isinstance(name, ast.Name) and name.id.isupper() and not name.id.startswith("_") and numbers:
                    yield f"{path.stem}.{name.id}"


def test_every_constant_of_the_checks_has_its_two_cases_or_is_no_limit():
    known = {name for room in ("checks", "pipeline", "record", "verification") for name in constants(room)}
    listed = {name for names in NO_LIMITS.values() for name in names.split()}
    cased = {name for case in CASES for name in case.limits}
    assert known - listed - cased == set(), "give each a row in limits_of_*.py, or tell in NO_LIMITS why it is none"
    assert listed - known == set(), "no constant of that name"
    assert listed & cased == set(), "is a limit"


def test_every_setting_that_makes_a_check_looser_has_its_two_cases():
    limits = {
        *value_checks.WIDER_IF_GREATER,
        *value_checks.WIDER_IF_LESS,
        *value_checks.WINDOWS,
        *value_checks.OF_PREHEATING,
    }
    cased = {name for case in CASES for name in case.limits}
    assert limits - cased - NOT_JUDGED_HERE == set()


def test_the_checks_of_plugins_are_among_those_of_a_program(monkeypatch):
    check = Check("mine", False, 12.0, 10.0, "motions", "MAIN.MPF", "12 motions")
    monkeypatch.setattr(registry, "names", lambda group: ["mine"] if group == registry.CHECKS else [])
    monkeypatch.setattr(registry, "plugin", lambda group, name: lambda program, config: check)
    assert not cube().checks()["mine"].passed


# -- the table of rules ----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def known():
    made = cube()
    curves, plan, layers = (made.known[name] for name in ("curves", "plan", "layers"))
    nc, match = matched(made.nc, planned_path(curves, plan, made.config))
    asked = frozenset({"beads", "heat", "metal"})
    return Subject(nc, made.config, curves=curves, plan=plan, match=match, layers=layers, asked=asked)


def test_no_check_has_two_rows():
    assert [name for name, count in Counter(n for rule in RULES for n in rule.checks).items() if count > 1] == []


def test_a_row_makes_the_checks_that_it_names_in_their_order(known):
    for rule in RULES:
        if rule.applies(known):
            made = [check.name for check in rule.make(known)]
            assert made == [name for name in rule.checks if name in made]


@pytest.mark.parametrize("need", sorted({need for rule in RULES for need in rule.needs} - {"part", "heights"}))
def test_what_is_not_known_is_not_checked(known, need):
    less = replace(known, asked=known.asked - {need}) if need in known.asked else replace(known, **{need: None})
    without = {name for rule in RULES if need in rule.needs for name in rule.checks}
    assert without & {check.name for check in checks_on(known)}
    assert not without & {check.name for check in checks_on(less)}


def test_checks_of_a_program_are_those_of_the_table_in_its_order(known):
    made = cube()
    found = [check.name for check in checks_on(known)]
    order = [name for rule in RULES for name in rule.checks]
    assert found == sorted(found, key=order.index)
    same = verify_program(made.nc, config=made.config, beads=True, heat=True, metal=True, **made.known)
    assert [check.name for check in same] == found


def test_every_check_shuts_one_gate(known):
    found = checks_on(known)
    by_gate = [of_gate(found, gate) for gate in ("deposit", "heat", "program")]
    assert sorted(check.name for some in by_gate for check in some) == sorted(check.name for check in found)
    assert {check.name for check in by_gate[1]} <= set(names_of("heat"))
    assert [check.name for check in checks_on(known, "deposit")] == [check.name for check in by_gate[0]]


def test_a_subject_takes_roles_from_the_plan_else_from_sections(known):
    alone = replace(known, curves=None, plan=None, match=None)
    assert np.array_equal(known.nc.ring >= 0, alone.nc.ring >= 0)
    assert alone.path is None
    assert alone.shares.tolist() == [1.0] * 4

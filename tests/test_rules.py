"""The table of rules: every check has one row, and a row makes the checks that it names, of a subject that knows what it needs."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from limit_cases import cube

from ebamcheck.checks.matching import matched
from ebamcheck.checks.rules import RULES, checks_on, names_of, of_gate
from ebamcheck.checks.subject import Subject
from ebamcheck.program import verify_program
from ebamcheck.writing.bead_ends import planned_path


@pytest.fixture(scope="module")
def known():
    made = cube()
    curves, plan, layers = (made.known[name] for name in ("curves", "plan", "layers"))
    nc, match = matched(made.nc, planned_path(curves, plan, made.config))
    asked = frozenset({"beads", "heat", "metal"})
    return Subject(nc, made.config, curves=curves, plan=plan, match=match, layers=layers, asked=asked)


def test_no_check_has_two_rows():
    assert [
        name for name, count in Counter(n for rule in RULES for n in rule.checks).items() if count > 1
    ] == []


def test_a_row_makes_the_checks_that_it_names_in_their_order(known):
    for rule in RULES:
        if rule.applies(known):
            made = [check.name for check in rule.make(known)]
            assert made == [name for name in rule.checks if name in made]


@pytest.mark.parametrize(
    "need", sorted({need for rule in RULES for need in rule.needs} - {"part", "heights"})
)
def test_what_is_not_known_is_not_checked(known, need):
    if need in known.asked:
        less = replace(known, asked=known.asked - {need})
    else:
        less = replace(known, **{need: None})
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

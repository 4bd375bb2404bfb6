"""The harness of faults: its tools by laws, and a few dozen faults, found or on a list that may only get shorter."""

from __future__ import annotations

import re

import numpy as np
import pytest
from slicers_here import slicers_here

from benchmarks.faults import tables
from benchmarks.faults.__main__ import PART, QUICK, SEED, quick_results
from benchmarks.faults.judging import NEAR_LINES, Said, failures, is_right, judged_run, judged_text, verdict
from benchmarks.faults.kinds import KINDS, Ground, NotHereError, Place
from benchmarks.faults.planting import Planter, Result, Results, faults
from benchmarks.faults.program_text import (
    NUMBER,
    about,
    code_of,
    moved,
    numbered,
    turn,
    without_comments,
    word,
)
from benchmarks.faults.subjects import CONTROLS, SUBJECTS, Workshop
from ebamcheck.errors import InputError
from ebamcheck.program import Check, read_program


@pytest.fixture(scope="module")
def workshop(tmp_path_factory):
    with slicers_here():
        yield Workshop(tmp_path_factory.mktemp("faults"))


# -- the list of faults --------------------------------------------------------------------------------


def test_there_are_enough_faults_of_enough_kinds_for_every_control():
    names = [fault.name for fault in faults()]
    assert len(names) == len(set(names)) >= 300
    for control in CONTROLS:
        kinds = {f.kind.name for f in faults("", (control,))}
        assert len(kinds) >= 40
    assert set(QUICK) <= set(names)


def test_every_kind_that_a_text_cannot_show_says_why():
    for kind in KINDS.values():
        assert kind.changes in tables.CHANGES
        assert kind.unseen == "" or len(kind.unseen.split()) > 3


# -- faults --------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def found(workshop):
    """Results of the quick faults by name, worked out as they are asked for."""
    known: dict[str, Result] = {}

    def result(name: str) -> Result:
        if name not in known:
            known.update({r.name: r for r in quick_results(workshop, SEED, (name,))})
        return known[name]

    return result


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=pytest.mark.slow if i % 8 else ()) for i, n in enumerate(QUICK)]
)
def test_a_planted_fault_is_found_by_the_check_that_is_meant_for_it(name, found):
    result = found(name)
    assert not result.run_missed
    assert not result.text_missed
    assert set(QUICK[name].split(", ")) <= {*result.run_checks, *result.text_checks}


@pytest.mark.parametrize(
    ("part", "control"),
    [
        *((PART, control) for control in CONTROLS),
        ("bored", CONTROLS[1]),
    ],
)
def test_a_sound_program_raises_no_alarm_with_or_without_comments(part, control, workshop):
    made = workshop.finished(SUBJECTS[part], control)
    ground = Ground(made.text(), made.subject, made.config, np.random.default_rng(0))
    assert judged_run(ground, made, workshop.folder) == []
    assert judged_text(ground, made, workshop.folder, keep_comments=True) == []
    assert judged_text(ground, made, workshop.folder, keep_comments=False) == []


@pytest.mark.parametrize("control", CONTROLS)
def test_the_same_seed_plants_the_same_fault(control, workshop):
    fault = next(f for f in faults("island shifted", (control,)))
    texts = [Planter(workshop, seed, (PART,)).planted(fault)[0].text.files for seed in (1, 1, 2)]
    assert texts[0] == texts[1]
    assert texts[0] != texts[2]


@pytest.mark.parametrize("control", CONTROLS)
def test_beads_of_the_text_are_those_that_the_product_reads(control, workshop):
    made = workshop.finished(SUBJECTS[PART], control)
    program = read_program(made.run / "program", made.config)
    places = {program.where(int(row)) for row in np.flatnonzero(program.deposit)}
    beads = made.text().beads()
    assert {f"{b.file}:{i + 1}" for b in beads for i in b.motions} == places
    first = program.where(int(np.flatnonzero(program.deposit)[0]))
    assert first == f"{beads[0].file}:{beads[0].first + 1}"


# -- tools ---------------------------------------------------------------------------------------------


def test_text_without_comments_says_the_same_and_keeps_its_lines():
    text = "%_N_A_MPF\n;$PATH=/X\n; VALIDATED\nN10 G1 X1 ; TURN\nN20 M30\n"
    bare = without_comments(text)
    assert bare == "%_N_A_MPF\n;$PATH=/X\n\nN10 G1 X1\nN20 M30\n"
    assert without_comments("; A\nG0 X1 (way) ; B\r\nM2\n") == "\nG0 X1 \r\nM2\n"


def test_blocks_are_numbered_by_tens():
    lines = ["%_N_A_SPF", "; A", "N7 G0 X1", "G0 X2", "!N5 G0 X3", ""]
    assert numbered(lines) == ["%_N_A_SPF", "; A", "N10 G0 X1", "N20 G0 X2", "N5 G0 X3", ""]


@pytest.mark.parametrize(
    "code",
    [
        "G1 X3.000000 Y-2.000000 F600",
        "G3 X0.000000 Y5.000000 I-5.000000 J0.000000",
        "G5 I1.000000 J0.500000 P-0.250000 Q0.125000 X3.000000 Y4.000000",
        "POLY PO[X]=(3.000000,0.500000,-0.250000) PO[Y]=(4.000000,1.000000,0.125000) PL=1",
    ],
)
def test_a_turn_and_a_mirror_and_their_inverses_leave_a_block_as_it_was(code):
    mirror = np.diag([-1.0, 1.0])
    back = moved(moved(code, mirror, (4.0, 0.0)), mirror, (4.0, 0.0))
    assert back == code
    there = moved(code, turn(90.0), about(turn(90.0), (1.0, 1.0)))
    assert moved(there, turn(-90.0), about(turn(-90.0), (1.0, 1.0))).replace("-0.000000", "0.000000") == code
    assert there != code
    assert moved(code, mirror)[:2] == {"G3": "G2"}.get(code[:2], code[:2])


def test_a_turn_carries_ends_and_vectors_along():
    there = moved("G3 X0.000000 Y5.000000 I-5.000000 J0.000000", turn(90.0))
    assert [round(word(there, a), 6) for a in "XYIJ"] == [-5.0, 0.0, 0.0, -5.0]
    assert re.search(rf"X{NUMBER}", code_of("N10 " + there))


def test_places_are_right_within_three_lines_in_their_file():
    places = [Place("A.SPF", 10, 12)]
    for line, right in ((10 - NEAR_LINES, True), (12 + NEAR_LINES, True), (6, False), (16, False)):
        assert is_right(Said("beam", f"A.SPF:{line}", ""), places) is right
    assert not is_right(Said("beam", "B.SPF:11", ""), places)
    assert not is_right(Said("beam", "", ""), places)
    assert is_right(Said("gate fit", "run.json", ""), [Place("run.json", 1, 1)])


def test_what_fails_for_a_sound_program_finds_no_fault_and_neither_does_a_crash():
    said = [Said("coverage", "A:1", "")]
    assert not verdict(said, frozenset({"coverage"}), [Place("A", 1, 1)]).found
    assert verdict(said, frozenset(), [Place("A", 1, 1)]).by == ("coverage",)

    def crash() -> list[Check]:
        raise ZeroDivisionError("planted")

    def refuse() -> list[Check]:
        raise InputError("MAIN.MPF:7:3: no such word")

    assert not verdict(failures(crash), frozenset(), []).found
    refused = failures(refuse)
    assert verdict(refused, frozenset(), [Place("MAIN.MPF", 5, 5)]).by == ("refused",)


def some_result(**changes: object) -> Result:
    values = {
        "name": "a/linuxcnc", "kind": "a", "changes": "metal", "control": "linuxcnc", "part": "cube", "variant": "",
        "what": "something", "where": "MAIN.ngc:7", "unseen": "", "run_found": True, "run_by": ("beam",),
    }  # fmt: skip
    return Result(**{**values, **changes})  # type: ignore[arg-type]


def test_tables_name_what_is_missed_and_count_the_rest():
    results = [
        some_result(),
        some_result(name="b/linuxcnc", kind="b", unseen="an order that changes no metal"),
    ]
    text = tables.as_markdown(results, [("cube", ""), ("prism", "text: beam (A:1)")], 13, 3)
    assert "2 faults of 2 kinds" in text
    assert "(2 of 3 were judged)" in text
    assert "1 of 2 raise a false alarm" in text
    assert "| metal | all | 2 | 2 of 2 | 2 of 2 | 0 of 1 | - |" in text
    assert "## Missed by text and part: 1\n\n- `a/linuxcnc` (cube, MAIN.ngc:7): something" in text
    assert "- b: an order that changes no metal." in text
    assert tables.as_csv(results).count("\n") == 3


def test_results_are_kept_and_what_is_known_is_not_judged_again(tmp_path):
    def not_here():
        raise NotHereError

    wanted = some_result(run_checks=("beam", "wire"))
    assert Results(tmp_path).of("a/linuxcnc", lambda: wanted) == wanted
    assert Results(tmp_path).of("a/linuxcnc", not_here) == wanted
    assert Results(tmp_path).of("b/linuxcnc", not_here) is None
    assert Results(tmp_path).of("b/linuxcnc", lambda: wanted) is None

"""Forms of a block that an 840D takes and that change nothing: one table of them, each tried; and their neighbours that do."""

from __future__ import annotations

import re
import shutil

import numpy as np
import pytest
from finished_runs import certified_plate

from ebamcheck.errors import InputError
from ebamcheck.program import read_program
from ebamcheck.record.run_folder import RunFolder
from ebamcheck.settings.config import validated
from ebamcheck.verification.verify import verify_against_part

LINE = r"^N(\d+)0 (G1 X(\S+) Y(\S+))$"
CALL = r"^N(\d+)0 (MAIN_L0002)$"

HARMLESS = {
    "a mode said again": (LINE, r"N\g<1>0 G90 \2"),
    "a mode said again by itself": (LINE, r"N\g<1>0 G90\nN\g<1>1 \2"),
    "two modes said again": (LINE, r"N\g<1>0 G17 G90\nN\g<1>1 \2"),
    "a mode said again between layers": (CALL, r"N\g<1>0 G90\nN\g<1>1 \2"),
    "the motion with a zero": (LINE, r"N\g<1>0 G01 X\3 Y\4"),
    "a code with a zero": (r"\bM60\b", "M060"),
    "one pass": (CALL, r"N\g<1>0 \2 P1"),
    "one pass with an equals sign": (CALL, r"N\g<1>0 \2 P=01"),
    "a message": (LINE, r'N\g<1>0 MSG("now")\nN\g<1>1 \2'),
    "a message with a semicolon": (LINE, r'N\g<1>0 MSG("A;B")\nN\g<1>1 \2'),
    "a message and a comment": (LINE, r'N\g<1>0 MSG("(1): a;b") ; c\nN\g<1>1 \2'),
    "a message that may be skipped": (LINE, r'/N\g<1>0 MSG("A")\nN\g<1>1 \2'),
    "a comment that may be skipped": (LINE, r"/N\g<1>0 ; nothing\nN\g<1>1 \2"),
    "no blanks": (LINE, r"N\g<1>0G1X\3Y\4"),
    "more blanks": (LINE, r"N\g<1>0   G1  X\3   Y\4 "),
    "tabs": (LINE, "N\\g<1>0\tG1\tX\\3\tY\\4"),
    "equals signs": (LINE, r"N\g<1>0 G1 X=\3 Y = \4"),
    "small letters": (LINE, r"n\g<1>0 g1 x\3 y\4"),
    "a plus sign": (r"^(N\d+ G1 X)(\d\S*)", r"\1+\2"),
    "a comment": (LINE, r"N\g<1>0 \2 ; along the wall"),
    "an empty block": (LINE, r"N\g<1>0\nN\g<1>1 \2"),
    "an empty line": (LINE, r"\nN\g<1>0 \2"),
    "no number": (LINE, r"\2"),
    "a number with zeros": (LINE, r"N000\g<1>0 \2"),
    "a main block": (LINE, r":\g<1>0 \2"),
}

JUDGED = {
    "a motion that may be skipped": (LINE, r"/N\g<1>0 \2", "order of events", "at the panel"),
    "a motion of another level": (LINE, r"/3 N\g<1>0 \2", "order of events", "at the panel"),
    "a call that may be skipped": (CALL, r"/N\g<1>0 \2", "order of events", "at the panel"),
    "two passes": (CALL, r"N\g<1>0 \2 P2", "readable", "is run once"),
    "no pass": (CALL, r"N\g<1>0 \2 P0", "readable", "is run once"),
    "another mode": (LINE, r"N\g<1>0 G91 \2", "readable", "G91"),
    "a message without its end": (LINE, r'N\g<1>0 MSG("A;B)\nN\g<1>1 \2', "readable", "unknown word"),
    "a message and a motion": (LINE, r'N\g<1>0 MSG("A") \2', "readable", "unknown word"),
    "another code": (r"\bM60\b", "M0600", "readable", "unknown word"),
    "a number and a letter in one": (LINE, r"N\g<1>0=5 \2", "readable", "unknown word"),
    "a word that runs into a number": (LINE, r"N\g<1>0 SOFTX\3", "readable", "unknown word"),
    "lines that end otherwise": (r"\n", "\r\n", "line ends", "LF alone"),
}  # fmt: skip


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    run, part = certified_plate(tmp_path_factory)
    return run, part, validated(RunFolder(run).manifest()["settings"], "run.json")


def spoiled(made, tmp_path, *edits):
    """Folder of the program with edits, each of the first place that it fits in a file of its own."""
    folder = shutil.copytree(made[0] / "program", tmp_path / "program")
    for pattern, by in edits:
        for file in sorted(folder.iterdir()):
            text, count = re.subn(pattern, by, file.read_text(), count=0 if pattern == r"\n" else 1, flags=re.MULTILINE)
            file.write_bytes(text.encode("ascii"))
            if count and pattern != r"\n":
                break
        assert count
    return folder


def columns(nc):
    return np.column_stack([nc.layer, nc.kind, nc.beam, nc.wire, nc.end, nc.feed_mm_min, nc.power_w])


@pytest.mark.parametrize("what", HARMLESS)
def test_a_harmless_form_is_read_as_what_it_is(made, tmp_path, what):
    config = made[2]
    read = read_program(spoiled(made, tmp_path, HARMLESS[what]), config)
    np.testing.assert_array_equal(columns(read), columns(read_program(made[0] / "program", config)))


@pytest.mark.in_turn(4)
@pytest.mark.parametrize("what", HARMLESS)
def test_a_harmless_form_raises_no_alarm(made, tmp_path, what):
    checks = verify_against_part(spoiled(made, tmp_path, HARMLESS[what]), made[1], made[2])
    assert [(c.name, c.text) for c in checks if not c.passed] == []


@pytest.mark.in_turn(2)
@pytest.mark.parametrize("what", JUDGED)
def test_a_form_that_changes_something_is_a_fault(made, tmp_path, what):
    pattern, by, name, said = JUDGED[what]
    checks = verify_against_part(spoiled(made, tmp_path, (pattern, by)), made[1], made[2])
    (found,) = [c for c in checks if not c.passed]
    assert found.name == name
    assert said in found.text


def test_a_layer_that_sets_one_mode_of_all_is_no_beginning_of_a_layer(made, tmp_path):
    """Words said again are no first blocks, and first blocks cut down to one word are no words said again."""
    folder = spoiled(made, tmp_path)
    (file,) = folder.glob("*_L0002.SPF")
    lines = file.read_text().split("\n")
    first = next(k for k, line in enumerate(lines) if "G17" in line)
    file.write_text("\n".join([*lines[:first], "N10 G90", *lines[first + 7 :]]))
    checks = verify_against_part(folder, made[1], made[2])
    assert "modes" in [c.name for c in checks if not c.passed]


def test_a_word_of_two_numbers_is_refused(made, tmp_path):
    with pytest.raises(InputError, match="unknown word"):
        read_program(spoiled(made, tmp_path, (LINE, r"N\g<1>0 G1 X1.2.3 Y4")), made[2])

"""Process values one by one, and what a program says of itself: on every control, by the text alone and against the plan."""

from __future__ import annotations

import re

import pytest
from program_text import CONTROLS, ProgramText, near

from ebamcheck.checks.text_checks import Truth
from ebamcheck.program import mark_validated, verify_file
from ebamcheck.settings.files import differences

SINUMERIK, LINUXCNC, PLAIN = CONTROLS


@pytest.mark.parametrize("control", CONTROLS)
def test_the_feed_of_one_bead_is_found(control, tmp_path):
    text = ProgramText(control, tmp_path / "p")
    name, begin = text.layer(2)
    place = text.edit(name, r"\bF600\b", "F590", nth=3, begin=begin)
    assert near(text.failed_by_text()["process values"].where, place)


@pytest.mark.parametrize("control", CONTROLS)
def test_a_value_over_those_of_the_process_is_found_where_it_is_set(control, tmp_path):
    text = ProgramText(control, tmp_path / "p")
    name, begin = text.layer(2)
    pattern, over = {
        SINUMERIK: (r"H2=120", "H2=121"),
        LINUXCNC: (r"M68 E1 Q120", "M68 E1 Q121"),
        PLAIN: (r"M3 S7200", "M3 S7300"),
    }[control]
    place = text.edit(name, pattern, over, begin=begin)
    assert near(text.failed_by_text()["process values"].where, place)


@pytest.mark.parametrize("control", CONTROLS)
def test_wire_drawn_back_that_the_process_does_not_ask_for_is_found(control, tmp_path):
    text = ProgramText(control, tmp_path / "p")
    name, begin = text.layer(2)
    off = text.find(name, "; wire off", begin=begin)
    block = {SINUMERIK: "H4=500", LINUXCNC: "M68 E3 Q500", PLAIN: "M42 P2 S500"}[control]
    place = text.insert(name, off + 1, block)
    assert near(text.failed_by_text()["process values"].where, place)


LIES = {
    "LAYERS": (r"; LAYERS: 2", "; LAYERS: 3"),
    "MACHINE": (r"; MACHINE: wire", "; MACHINE: another"),
    "BEAM": (r"; BEAM: 7200 W", "; BEAM: 7300 W"),
    "WIRE": (r"; WIRE: Ti-6Al-4V", "; WIRE: 316L"),
    "layer 2": (r"; LAYER: 2 OF 2", "; LAYER: 1 OF 2"),
    "CONTROL": (r"; CONTROL: .*", "; CONTROL: another"),
    "CURVES": (r"; CURVES: .*", "; CURVES: lines, within 1 mm"),
    "COORDINATES": (r"; COORDINATES: .*", "; COORDINATES: X Y of the machine, inches"),
}


@pytest.mark.in_turn(2)
@pytest.mark.parametrize("control", CONTROLS)
@pytest.mark.parametrize("name", LIES)
def test_a_header_that_is_not_true_is_found(control, name, tmp_path):
    text = ProgramText(control, tmp_path / "p")
    place = text.edit_all(*LIES[name])
    found = text.failed_by_text()
    assert near(found["header"].where, place)


@pytest.mark.parametrize("control", CONTROLS)
@pytest.mark.parametrize(("pattern", "lie"), [(r"CUT AT [\d.]+", "CUT AT 77.000000"), (r" Z [\d.]+$", " Z 99.000000")])
def test_a_layer_at_another_height_than_it_says_is_found(control, pattern, lie, tmp_path):
    text = ProgramText(control, tmp_path / "p")
    name, begin = text.layer(2)
    place = text.edit(name, rf"(?<=LAYER: 2 OF 2)(.*){pattern}", rf"\1{lie}", begin=begin)
    assert text.failed()["header"].where == place


def test_a_file_without_a_status_is_found(tmp_path):
    text = ProgramText(SINUMERIK, tmp_path / "p")
    place = text.edit("MAIN_L0002.SPF", "; NOT VALIDATED", "; RELEASED")
    assert near(text.failed_by_text()["status"].where, place)


@pytest.mark.parametrize("control", CONTROLS)
def test_the_hash_of_another_part_is_found(control, tmp_path):
    text = ProgramText(control, tmp_path / "p")
    begin = text.find(text.main, "; LAYERS: ")
    text.lines[text.main].insert(begin, f"; PART SHA-256: {'ab' * 32}")
    assert "header" not in text.failed_by_text(truth=Truth(part_sha256="ab" * 32))
    found = text.failed_by_text(truth=Truth(part_sha256="cd" * 32))["header"]
    assert found.where == f"{text.main}:{begin + 1}"


@pytest.mark.parametrize("control", CONTROLS)
def test_the_hash_of_other_settings_is_found(control, tmp_path):
    text = ProgramText(control, tmp_path / "p")
    found = text.failed_by_text(truth=Truth(settings_sha256="cd" * 32))["header"]
    assert "SETTINGS SHA-256" in found.text


@pytest.mark.parametrize("control", CONTROLS)
def test_other_settings_that_are_given_are_told_and_no_fault(control, tmp_path):
    text = ProgramText(control, tmp_path / "p")
    other = text.config.changed(scan={"seed": 4})
    truth = Truth(given_sha256="cd" * 32, differences=tuple(differences(other, text.config)))
    assert "header" not in text.failed_by_text(truth=truth)
    checks = verify_file(text.files.main, config=text.config, truth=truth)
    (header,) = [check for check in checks if check.name == "header"]
    assert "not cdcdcdcdcdcd" in header.text
    assert header.text.endswith("scan.seed is 4, not 0")


@pytest.mark.parametrize("control", CONTROLS)
def test_a_line_that_differs_from_the_settings_is_told_with_both_values(control, tmp_path):
    text = ProgramText(control, tmp_path / "p")
    text.edit_all(*LIES["BEAM"])
    found = text.failed_by_text(truth=Truth(given_sha256="cd" * 32))["header"]
    assert "says BEAM: 7300 W (60 kV, 120 mA), by the settings it is 7200 W (60 kV, 120 mA)" in found.text


@pytest.mark.parametrize("control", CONTROLS)
def test_a_status_that_is_not_the_one_recorded_is_found(control, tmp_path):
    text = ProgramText(control, tmp_path / "p")
    assert "status" not in text.failed_by_text(truth=Truth(validated=False))
    found = text.failed_by_text(truth=Truth(validated=True))["status"]
    assert "says NOT VALIDATED, the program is VALIDATED" in found.text


def test_one_file_of_another_status_is_found(tmp_path):
    text = ProgramText(SINUMERIK, tmp_path / "p")
    place = text.edit("MAIN_L0002.SPF", "; NOT VALIDATED", "; VALIDATED")
    assert text.failed_by_text()["status"].where == place


@pytest.mark.parametrize("control", CONTROLS)
def test_nothing_rests_on_comments_of_the_header(control, tmp_path):
    """Without its comments, a program is judged by its blocks alone."""
    text = ProgramText(control, tmp_path / "p")
    for name, lines in text.lines.items():
        kept = [line for line in lines if not line.startswith(";") or line.startswith(";$PATH")]
        text.lines[name] = [re.sub(r"\s*;(?!\$).*", "", line) for line in kept]
    found = text.failed_by_text()
    assert not {
        "header",
        "status",
        "modes",
        "start state",
        "safe end",
        "order of events",
        "process values",
    } & set(found)


def test_the_size_of_a_program_has_a_limit(tmp_path):
    text = ProgramText(SINUMERIK, tmp_path / "p", {"program_limit_mb": 1e-3})
    assert "size on the control" in text.failed()
    roomy = ProgramText(SINUMERIK, tmp_path / "q", {"program_limit_mb": 1.0})
    assert "size on the control" not in roomy.failed()


def test_the_size_is_that_of_the_validated_program(tmp_path):
    text = ProgramText(SINUMERIK, tmp_path / "p")

    def size():
        checks = verify_file(text.files.main, config=text.config)
        return next(check.value for check in checks if check.name == "size on the control")

    before = size()
    mark_validated(text.files)
    assert size() == before
    assert size() == sum((text.files.folder / name).stat().st_size for name in text.files.names) / 1e6

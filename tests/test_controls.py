"""Controls as plugins: the kit on every one of the house, and a stranger's beside them."""

import re
from typing import ClassVar

import pytest
from nc_stack import stack

from ebamcheck.controls import fanuc
from ebamcheck.errors import InputError, SettingsError
from ebamcheck.nc.control import control, controls, simulators
from ebamcheck.program import read_program, verify_file, write_program
from ebamcheck.settings.config import Config
from ebamcheck.testing import ControlSuite


class TestSinumerik(ControlSuite):
    control = "sinumerik-840d-sl"


@pytest.mark.slow
class TestSinumerikBspline(ControlSuite):
    control = "sinumerik-840d-sl"
    machine: ClassVar = {"curve_form": "bspline"}


@pytest.mark.slow
class TestLinuxcnc(ControlSuite):
    control = "linuxcnc"


@pytest.mark.slow
class TestPlainGcode(ControlSuite):
    control = "plain-gcode"


@pytest.mark.slow
class TestFanuc(ControlSuite):
    control = "fanuc"


@pytest.mark.parametrize("name", simulators())
def test_a_simulator_is_a_control_that_is_not_read(name):
    assert not control(name).is_read
    assert callable(control(name).load("writer"))


def test_an_unknown_control_is_refused_with_the_names_there_are():
    with pytest.raises(SettingsError, match="linuxcnc"):
        control("heidenhain")


def test_every_control_is_registered_under_its_own_name():
    assert all(found.name == name for name, found in controls().items())


@pytest.fixture
def program(tmp_path):
    config = Config().changed(machine={"control": "fanuc", "program_name": "O0042"})
    return write_program(*stack(count=2), config, tmp_path / "p"), config


def test_a_fanuc_program_has_its_number_parentheses_and_decimal_points(program):
    lines = program[0].main.read_text().splitlines()
    assert lines[0] == lines[-1] == "%"
    assert lines[1] == "O0042 (O0042)"
    assert lines[2] == "(NOT VALIDATED)"
    assert not any(";" in line for line in lines)
    for line in lines:
        code = re.sub(r"\([^)]*\)", "", line)
        values = re.findall(r"[XYZIJRAF](-?[\d.]+)", code)
        assert all("." in value for value in values), line


@pytest.mark.parametrize(
    "text",
    [
        "G1 X5. Y5. ; G0 Z-5.",
        "G5.1 Q1",
        "G1.0 X5. Y5.",
        "G92.1 X1.0 Y0 Z0",
        "G92.1 X0",
        "G68 X0. Y0. R5.",
        "G51 X2.",
        "M98 P100",
        "#1=5",
    ],
)
def test_what_would_change_a_fanuc_unseen_is_refused(program, text):
    files, config = program
    lines = files.main.read_text().splitlines()
    at = next(i for i, line in enumerate(lines) if line.startswith("G1 X"))
    files.main.write_text("\n".join([*lines[:at], text, *lines[at:]]) + "\n")
    with pytest.raises(InputError, match=rf":{at + 1}:"):
        read_program(files.main, config)


@pytest.mark.parametrize("address", list("XYZFA"))
def test_a_number_that_lost_its_point_is_refused(program, address):
    """It may be thousandths on the control, and the reader would take it for millimetres."""
    files, config = program
    text = files.main.read_text()
    pointed = next(m for m in re.finditer(rf" {address}(-?[1-9]\d*)\.\d+", text) if float(m[1]))
    files.main.write_text(text[: pointed.start()] + f" {address}{pointed[1]}" + text[pointed.end() :])
    with pytest.raises(InputError, match=f"{address}{pointed[1]} has no decimal point"):
        read_program(files.main, config)


def test_a_fanuc_number_of_a_program_behind_blocks_is_refused(program):
    """What stands before it would be a program of its own, without an end."""
    files, config = program
    lines = files.main.read_text().splitlines()
    at = next(i for i, line in enumerate(lines) if line.startswith("G1 X"))
    files.main.write_text("\n".join([lines[0], *lines[2:at], lines[1], *lines[at:]]) + "\n")
    with pytest.raises(InputError, match=rf":{at}:1: unknown word 'O0042'"):
        read_program(files.main, config)


def test_small_letters_of_a_fanuc_program_are_refused(program):
    files, config = program
    files.main.write_text(files.main.read_text().replace("G1 X", "g1 X", 1))
    with pytest.raises(InputError, match="'g': this control takes capitals alone"):
        read_program(files.main, config)


def test_fanuc_comments_say_what_the_header_means(program):
    files, config = program
    nc = read_program(files.main, config)
    assert nc.header["CONTROL"] == fanuc.CONTROL.title
    assert nc.dialect == "fanuc"


def test_a_program_for_another_control_than_that_of_the_settings_is_found(program):
    files, config = program
    for name, sound in (("fanuc", True), ("linuxcnc", False), (Config().machine.control, True)):
        settings = config.changed(machine={"control": name})
        checks = {c.name: c for c in verify_file(files.main, config=settings)}
        assert ("is read as one of fanuc" not in checks["header"].text) == sound, name

"""What plugins of checks and materials leave out is said, not guessed."""

from types import SimpleNamespace

import pytest

from ebamcheck.checks import rules
from ebamcheck.checks.subject import Subject
from ebamcheck.errors import SettingsError
from ebamcheck.program import Check
from ebamcheck.settings import materials as material
from ebamcheck.settings.config import Config
from ebamcheck.settings.materials import INCONEL_718

PROGRAM = SimpleNamespace(files=[SimpleNamespace(name="MAIN.MPF")])


def checks_of(function, monkeypatch):
    monkeypatch.setattr(rules.registry, "names", lambda group: ["mine"])
    monkeypatch.setattr(rules.registry, "plugin", lambda group, name: function)
    return rules._plugged(Subject(PROGRAM, Config()))


def test_a_check_that_says_nothing_is_told_by_its_figures(monkeypatch):
    check = Check("length", False, 12.0, 10.0, "motions", "MAIN.MPF", "")
    (found,) = checks_of(lambda program, config: check, monkeypatch)
    assert found.text == "12 motions, the limit is 10"


def test_a_check_that_raises_is_a_fault_of_its_plugin(monkeypatch):
    (found,) = checks_of(lambda program, config: 1 / 0, monkeypatch)
    assert not found.passed
    assert "ZeroDivisionError" in found.text
    assert "plugin" in found.remedy


def with_preset(table, monkeypatch):
    monkeypatch.setattr(material, "preset", lambda name: table)
    return Config().changed(material={"name": "Inconel 625"})


def test_a_preset_that_lacks_data_is_refused(monkeypatch):
    """The defaults of the section are those of titanium, which no other material has."""
    with pytest.raises(SettingsError, match=r"preset 'Inconel 625' lacks .*solidus_k.*: set them, or complete"):
        with_preset({"density_kg_m3": 8440.0}, monkeypatch)


def test_a_complete_preset_is_taken(monkeypatch):
    found = with_preset({**INCONEL_718, "density_kg_m3": 8440.0}, monkeypatch)
    assert found.material.density_kg_m3 == 8440.0

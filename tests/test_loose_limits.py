"""Limits of the gates that a run has widened are told, in the run and when it is verified."""

from __future__ import annotations

import shutil

import pytest
from command_line import write_stl
from parts import box

from benchmarks.faults.judging import reseal
from benchmarks.faults.subjects import SUBJECTS
from ebamcheck.checks.value_checks import WIDER_IF_GREATER, WIDER_IF_LESS, WINDOWS, loose_limits
from ebamcheck.pipeline import findings, run_job
from ebamcheck.record.run_folder import RunFolder
from ebamcheck.settings.config import Config
from ebamcheck.verification.verify import verify_run


def changed(name, factor):
    section, key = name.split(".")
    return Config().changed(**{section: {key: factor * getattr(getattr(Config(), section), key)}})


@pytest.mark.parametrize("name", WIDER_IF_GREATER + WIDER_IF_LESS)
def test_a_wider_limit_is_told_with_both_values_and_a_narrower_one_is_not(name):
    wider, narrower = (1.2, 0.8) if name in WIDER_IF_GREATER else (0.8, 1.01)
    (found,) = loose_limits(changed(name, wider))
    assert found.severity == "warning"
    assert name in found.text
    assert "default" in found.text
    assert list(loose_limits(changed(name, narrower))) == []


def test_limits_that_follow_from_others_are_held_against_these():
    assert list(loose_limits(Config())) == []
    assert list(loose_limits(Config().changed(process={"bead_width_mm": 8.0}))) == []
    for process in (
        {"surface_tolerance_mm": 4.0},
        {"interpass_limit_k": 1000.0},
        {"interpass_at": "layer"},
    ):
        (found,) = loose_limits(Config().changed(process=process))
        assert next(iter(process)) in found.text


@pytest.mark.parametrize("name", WINDOWS)
def test_a_window_that_is_wider_on_either_side_is_told_and_a_narrower_one_is_not(name):
    section, key = name.split(".")
    low, high = getattr(getattr(Config(), section), key)
    for window in ((0.5 * low, high), (low, 1.5 * high)):
        (found,) = loose_limits(Config().changed(**{section: {key: window}}))
        assert f"{name} {window[0]:g} .. {window[1]:g} (default {low:g} .. {high:g})" in found.text
    assert list(loose_limits(Config().changed(**{section: {key: (1.1 * low, 0.9 * high)}}))) == []


def test_increments_that_hide_power_are_told():
    """Half a step of 40 mA is 17 % of the power, and a layer that lacks so much passes."""
    (found,) = loose_limits(Config().changed(machine={"current_increment_ma": 40.0}))
    assert "machine.current_increment_ma 40 (the power may be 16.7 % off for it)" in found.text
    assert list(loose_limits(Config().changed(machine={"current_increment_ma": 1.0}))) == []


def test_limits_of_a_preheating_are_told_where_there_is_one():
    preheat = {"over_k": 400.0, "defocus": 1.0}
    assert list(loose_limits(Config().changed(preheat=preheat))) == []
    (found,) = loose_limits(Config().changed(preheat={"when": "plate", **preheat}))
    assert "preheat.over_k 400 (default 50)" in found.text


def test_data_of_a_known_material_that_are_not_its_own_are_told():
    """A beam of 60 W melts a wire that is said to be liquid at 310 K."""
    data = {"liquidus_k": 310.0, "solidus_k": 300.0, "conductivity_by_temperature": ((1.0, 9.0), (9.0, 9.0))}
    (found,) = loose_limits(Config().changed(material=data))
    assert (found.severity, found.code) == ("warning", "material-data")
    assert (
        "not those of Ti-6Al-4V: material.conductivity_by_temperature, material.solidus_k 300 (usual 1877)"
        in found.text
    )
    assert list(loose_limits(Config().changed(material={"name": "inconel 718"}))) == []
    own = {**Config().material.model_dump(), **data, "name": "solder"}
    assert list(loose_limits(Config().changed(material=own))) == []


def test_a_table_that_the_program_does_not_command_is_told():
    axis = {"name": "A", "axis": (1.0, 0.0, 0.0), "point_mm": (0.0, 0.0, -50.0)}
    turned = Config().changed(machine={"rotary": (axis,)})
    (found,) = (f for f in findings.profile_findings(turned) if f.code == "table-as-it-stands")
    assert (found.severity, found.place) == ("warning", "machine.rotary")
    assert "does not command A:" in found.text
    assert not [f for f in findings.profile_findings(Config()) if f.code == "table-as-it-stands"]


def test_a_run_tells_it_and_a_record_that_leaves_it_out_is_found(tmp_path):
    part = write_stl(box((0, 0, 0), (24, 24, 5)), tmp_path / "cube.stl")
    config = SUBJECTS["cube"].config("plain-gcode", process={"mass_tolerance": 0.5})
    result = run_job(part, tmp_path / "run", config)
    assert "process.mass_tolerance 0.5 (default 0.02)" in "".join(
        f["text"] for f in result.manifest["findings"] if f["code"] == "limit-widened"
    )
    copy = tmp_path / "copy"
    shutil.copytree(tmp_path / "run", copy)
    record = RunFolder(copy).manifest()
    record["findings"] = [f for f in record["findings"] if f["code"] != "limit-widened"]
    RunFolder(copy).write_manifest(record)
    reseal(copy, "MAIN.gcode")
    assert "limit-widened is left out" in next(
        c.text for c in verify_run(copy, part) if c.name == "record" and not c.passed
    )

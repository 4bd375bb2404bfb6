"""Mistakes in the code that makes programs, planted one by one: each leaves a program that agrees with its own plan, and a gate shuts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapely
from prism_program import CONFIG, Made

from ebamcheck.checks import heat_again, text_checks
from ebamcheck.checks.heat_again import (
    BeadHeat,
    FollowedHeat,
    entries_k,
    highest_entry_k,
    melting_power_w,
)
from ebamcheck.checks.interpass_checks import (
    AGAIN,
    INTERPASS,
    heat_checks,
    text_beads,
    text_bed_k,
    text_shapes,
)
from ebamcheck.checks.value_checks import MELTING, window_check
from ebamcheck.heat import interpass, medium
from ebamcheck.heat.balance import HeatColumn, LayerShape
from ebamcheck.metal import target
from ebamcheck.nc import files, inputs
from ebamcheck.nc.roles import by_height
from ebamcheck.pipeline.gates import heat_gate
from ebamcheck.program import verify_program
from ebamcheck.settings import process, process_window
from ebamcheck.settings.config import Config
from ebamcheck.writing import tracks, wire

FRAME = shapely.box(0, 0, 60, 40).difference(shapely.box(24, 14, 38, 26))


# -- metal -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("factor", [0.8, 1.2])
def test_a_wrong_section_of_the_wire_is_found(factor, monkeypatch, tmp_path):
    right = process_window.wire_area_mm2
    monkeypatch.setattr(process_window, "wire_area_mm2", lambda config: factor * right(config))
    assert "metal" in Made(tmp_path, FRAME).failed()


def test_cells_with_too_little_of_the_section_are_found(monkeypatch, tmp_path):
    right = target.cell_shares
    monkeypatch.setattr(target, "cell_shares", lambda *given: 0.965 * right(*given))
    assert "metal" in Made(tmp_path, FRAME).failed()


def test_an_allowance_that_is_left_out_is_found(monkeypatch, tmp_path):
    config, right = CONFIG.changed(process={"machining_allowance_mm": 2.0}), wire.metal_region
    assert not Made(tmp_path / "sound", FRAME, config).failed()
    half = config.changed(process={"machining_allowance_mm": 1.0})
    monkeypatch.setattr(wire, "metal_region", lambda section, _: right(section, half))
    assert "metal" in Made(tmp_path / "wrong", FRAME, config).failed()


@pytest.mark.parametrize("factor", [0.3, 2.5])
def test_layers_far_from_the_height_of_a_bead_are_found(factor, monkeypatch, tmp_path):
    right = process.bead_height_mm
    monkeypatch.setattr(process, "bead_height_mm", lambda *given: factor * right(*given))
    config = CONFIG.changed(process={"wire_speed_min_mm_s": 0.1, "wire_speed_max_mm_s": 1000.0})
    assert config.process.bead_height_mm == pytest.approx(factor * 1.6755, rel=1e-4)
    check = window_check(by_height((made := Made(tmp_path, FRAME, config, layers=2)).read(), made.z), config)
    assert "of a bead's height a layer" in check.text


# -- heat --------------------------------------------------------------------------------------------

WARM = CONFIG.changed(process={"interpass": "both"})


def heat_of(made):
    nc = by_height(made.read(), made.z)
    return {check.name: check for check in heat_checks(nc, made.config, list(made.plan.sections))}


def test_a_sound_program_passes_both_balances(tmp_path):
    checks = heat_of(Made(tmp_path, FRAME, WARM))
    assert all(checks[name].passed for name in (INTERPASS, MELTING, AGAIN))


@pytest.mark.parametrize("share", [0.5, 0.7])
def test_heat_that_is_lost_in_the_model_is_found(share, monkeypatch, tmp_path):
    drive = HeatColumn.drive

    def drive_less(self, beads, *given):
        return drive(self, (*beads[:2], share * beads[2]), *given)

    monkeypatch.setattr(HeatColumn, "drive", drive_less)
    made = Made(tmp_path, FRAME, WARM)
    checks = heat_of(made)
    assert checks[INTERPASS].passed
    assert not checks[AGAIN].passed
    gate = heat_gate(checks.values(), made.plan.metrics, made.config)
    assert not gate.passed
    assert "second balance" in gate.text


def test_layers_that_the_model_takes_for_wider_are_found(monkeypatch, tmp_path):
    right = LayerShape.of

    def wider(section, thickness_mm):
        shape = right(section, thickness_mm)
        return replace(shape, area_mm2=2.0 * shape.area_mm2)

    monkeypatch.setattr(LayerShape, "of", wider)
    assert not heat_of(Made(tmp_path, FRAME, WARM))[AGAIN].passed


def test_a_limit_that_the_plan_takes_too_high_is_found(monkeypatch, tmp_path):
    right = medium.entry_limit_k
    monkeypatch.setattr(interpass, "entry_limit_k", lambda config: right(config) + 300.0)
    assert not heat_of(Made(tmp_path, FRAME, WARM))[INTERPASS].passed


def test_a_power_that_does_not_melt_the_wire_is_found(monkeypatch, tmp_path):
    right = medium.least_power_share
    monkeypatch.setattr(interpass, "least_power_share", lambda *given: 0.6 * right(*given))
    assert not heat_of(Made(tmp_path, FRAME, WARM))[MELTING].passed


SETTINGS = (
    {},
    {"process": {"interpass": "off"}},
    {"process": {"interpass_limit_k": 500.0}},
    {"process": {"interpass_limit_k": 5000.0}},
    {"process": {"interpass": "off", "interpass_limit_k": 700.0}},
    {"process": {"dilution": 0.0, "current_ma": 20.0}},
    {"material": {"name": "Inconel 718"}},
    {"material": {"interpass_limit_k": 5000.0}},
)


@pytest.mark.parametrize("changes", SETTINGS)
def test_limits_of_plan_and_gate_are_the_same(changes):
    config = Config().changed(**changes)
    assert highest_entry_k(config) == medium.entry_limit_k(config)
    for thickness_mm in (0.5, 1.6755, 3.0):
        share = melting_power_w(config, thickness_mm) / config.process.power_w
        assert share == pytest.approx(medium.least_power_share(config, thickness_mm), rel=1e-3)


HEAT_PARTS = {
    "frame": [FRAME] * 6,
    "tower": [shapely.box(0, 0, 18, 14)] * 24,
    "cone": [shapely.Point(0, 0).buffer(28 - 2 * k) for k in range(9)],
    "spread": [shapely.Point(0, 0).buffer(14 + 2 * k) for k in range(6)],
}


@pytest.mark.in_turn(3)
@pytest.mark.parametrize("base", ["cooled", "insulated"])
@pytest.mark.parametrize("name", HEAT_PARTS)
def test_both_balances_find_the_same_temperatures(name, base, tmp_path):
    config = WARM.changed(process={"base": base})
    sections = HEAT_PARTS[name]
    made = Made(tmp_path, sections, config, layers=len(sections))
    nc = by_height(made.read(), made.z)
    beads, shapes = text_beads(nc, config), text_shapes(nc, config, sections)
    column_k, _ = text_bed_k(beads, config, shapes)
    heat = BeadHeat(
        beads.layer,
        beads.move_s + beads.wait_s,
        beads.time_s,
        beads.energy_j * config.material.absorptivity,
    )
    again_k = entries_k(heat, sections, np.array([shape.thickness_mm for shape in shapes]), config)
    # Half of what the gate lets two balances differ by.
    assert again_k == pytest.approx(column_k, abs=0.05 * (873.0 - 293.0))


@pytest.mark.in_turn(5)
@pytest.mark.parametrize("limit_k", [423.0, 873.0])
@pytest.mark.parametrize("material", ["Ti-6Al-4V", "Al 2319", "316L"])
def test_sound_plans_pass_the_second_balance(material, limit_k, tmp_path):
    """On a cooled plate a slim column on a wide foot, and slabs on a slim column, cool the fastest from the heat of a bead."""
    config = WARM.changed(material={"name": material}, process={"base": "cooled", "interpass_limit_k": limit_k})
    column, foot = shapely.box(-6, -6, 6, 6), shapely.box(-40, -40, 40, 40)
    slab = shapely.box(-20, -20, 20, 20)
    for name, sections in (("foot", [foot] * 3 + [column] * 8), ("slab", [column] * 6 + [slab] * 4)):
        checks = heat_of(Made(tmp_path / name, sections, config, layers=len(sections)))
        assert checks[AGAIN].passed, checks[AGAIN].text


def test_cells_that_are_joined_on_the_way_down_change_nothing(monkeypatch):
    count = 200
    layer = np.repeat(np.arange(count), 4)
    off_s = np.where(np.arange(layer.size) % 4 == 0, 40.0, 2.0)
    times = heat_again.BeadHeat(layer, off_s, np.full(layer.size, 6.0), np.full(layer.size, 1e4))
    sections = [shapely.box(0, 0, 40 + 15 * np.sin(k / 9), 30) for k in range(count)]
    joined_k = heat_again.entries_k(times, sections, np.full(count, 1.6755), Config())
    monkeypatch.setattr(heat_again, "MOST_CELLS", 10**6)
    single_k = heat_again.entries_k(times, sections, np.full(count, 1.6755), Config())
    assert joined_k == pytest.approx(single_k, abs=1.0)


def test_layers_followed_one_by_one_are_those_followed_at_once():
    sections = [shapely.box(0, 0, 60, 60)] * 3 + [shapely.box(0, 0, 0, 0)] + [shapely.box(20, 20, 40, 40)] * 150
    count, beads = len(sections), 4
    off_s = np.tile([90.0, 2.0, 2.0, 2.0], count)
    heat = BeadHeat(np.repeat(np.arange(count), beads), off_s, np.full(off_s.size, 6.0), np.full(off_s.size, 1e4))
    at_once_k = entries_k(heat, sections, np.full(count, 1.6), Config())
    stands, one_by_one = FollowedHeat(Config()), []
    for k, section in enumerate(sections):
        rows = slice(k * beads, (k + 1) * beads)
        own = BeadHeat(np.zeros(beads, np.int64), off_s[rows], heat.time_s[rows], heat.heat_j[rows])
        bed_k, after = stands.with_layer(own, section, 1.6)
        # What stands is as it was: another try of the layer begins on the same heat.
        assert (stands.with_layer(own, section, 1.6)[0] == bed_k).all()
        stands = after
        one_by_one.append(bed_k)
    assert (np.concatenate(one_by_one) == at_once_k).all()


def test_after_a_time_without_end_no_temperature_is_known():
    config, section = Config(), shapely.box(0, 0, 20, 20)
    times_s, heat_j = np.array([5.0, np.inf, 5.0, 5.0]), np.array([1e4, np.nan, 1e4, 1e4])
    heat = BeadHeat(np.array([0, 0, 1, 1]), np.zeros(4), times_s, heat_j)
    found = entries_k(heat, [section, section], np.array([1.6, 1.6]), config)
    assert np.isfinite(found).tolist() == [True, True, False, False]


# -- what is taken of the plan -----------------------------------------------------------------------


def against_plan(made):
    nc = made.read()
    found = verify_program(nc, config=made.config, curves=made.beads, plan=made.plan, layers=made.layers)
    return {check.name for check in found if not check.passed}


def test_a_line_that_the_writer_does_not_take_is_found(monkeypatch, tmp_path):
    assert "hatch vectors" not in against_plan(Made(tmp_path / "sound", FRAME))
    right = tracks.hatch_columns
    monkeypatch.setattr(tracks, "hatch_columns", lambda plan: tuple(column[:-1] for column in right(plan)))
    assert "hatch vectors" in against_plan(Made(tmp_path / "wrong", FRAME))


def test_a_power_that_the_writer_does_not_take_from_the_plan_is_found(monkeypatch, tmp_path):
    assert "power" not in against_plan(Made(tmp_path / "sound", FRAME, WARM))
    right = inputs.Interpass
    monkeypatch.setattr(
        inputs, "Interpass", lambda **given: right(**{**given, "power_share": 0.8 * given["power_share"]})
    )
    assert "power" in against_plan(Made(tmp_path / "wrong", FRAME, WARM))


# -- after the checks --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "spoil",
    [
        lambda data, name: data[:-40],
        lambda data, name: data + b"G1 X0 Y0\n",
        lambda data, name: data.replace(b" F600", b" F900", 1) if "L0002" in name else data,
        lambda data, name: data.replace(b"VALIDATED", b"NOT VALIDATED", 1) if "L0002" in name else data,
        lambda data, name: data.replace(b"; VALIDATED\n", b"", 1),
    ],
)
def test_what_changes_when_a_program_is_marked_is_found(spoil, monkeypatch, tmp_path):
    right = files.mark_validated
    made = Made(tmp_path, FRAME, layers=2)

    def mark(given):
        found = right(given)
        for name in found.names:
            path = found.folder / name
            path.write_bytes(spoil(path.read_bytes(), name))
        return found

    monkeypatch.setattr(text_checks, "mark_validated", mark)
    checked = {name: (made.files.folder / name).read_bytes() for name in made.files.names}
    with pytest.raises(RuntimeError, match="more than its status"):
        text_checks.marked_validated(made.files)
    assert all((made.files.folder / name).read_bytes() == data for name, data in checked.items())


@pytest.mark.parametrize("control", ["sinumerik-840d-sl", "linuxcnc", "plain-gcode", "fanuc"])
def test_a_sound_program_of_any_control_is_marked(control, tmp_path):
    made = Made(tmp_path, FRAME, CONFIG.changed(machine={"control": control}), layers=2)
    assert text_checks.marked_validated(made.files).validated

"""Waits and power: no bead is entered above the limit; plan, text and balance agree; planted faults shut the gate."""

from __future__ import annotations

import re
import shutil

import numpy as np
import pytest
import shapely
from planned_roles import as_planned

from ebamcheck.checks.interpass_checks import (
    INTERPASS,
    OVER_RANGE,
    layer_shares,
    sections_of,
    text_beads,
    text_bed_k,
    text_shapes,
)
from ebamcheck.checks.value_checks import MELTING
from ebamcheck.controls.gcode.writing import write_linuxcnc, write_plain_gcode
from ebamcheck.controls.sinumerik.writing import write_program
from ebamcheck.errors import SettingsError
from ebamcheck.heat.balance import HeatColumn
from ebamcheck.heat.interpass import shortest_wait_s
from ebamcheck.heat.medium import (
    enthalpy_tables,
    entry_limit_k,
    least_power_share,
    melting_heat_j_kg,
    scheduled_share,
)
from ebamcheck.layers.stack import from_polygons
from ebamcheck.nc.inputs import interpass_of
from ebamcheck.pipeline.gates import heat_gate
from ebamcheck.pipeline.stages import bead_paths, plan_program
from ebamcheck.program import program_summary, read_program, verify_program
from ebamcheck.scan import ScanPlan, plan_stack
from ebamcheck.settings.config import Config

POSTS = {"sinumerik-840d-sl": write_program, "linuxcnc": write_linuxcnc, "plain-gcode": write_plain_gcode}
LAYERS = 14
WIDE = {"travel_min_mm": (-2000.0, -2000.0, 0.0), "travel_max_mm": (2000.0, 2000.0, 2000.0)}
CONFIG = Config().changed(scan={"annealing_steps": 100}, machine=WIDE)


def tube(config=CONFIG, count=LAYERS):
    """Layers of a block with a channel."""
    section = shapely.box(0, 0, 44, 40).difference(shapely.Point(20, 20).buffer(6, 32))
    heights = (np.arange(count) + 0.5) * config.layer_height_mm
    return from_polygons(heights, [[section]] * count)


def planned(**process):
    config = CONFIG.changed(process=process)
    return config, plan_program(tube(config), config)


@pytest.fixture(scope="module")
def plans():
    """The block planned in every way."""
    return {name: planned(interpass=name) for name in ("dwell", "power", "both", "off")}


def entries_k(config, plan):
    return plan.metrics["entry_max_k"].to_numpy() + config.process.ambient_temperature_k


# -- limits ------------------------------------------------------------------------------------------


def test_the_least_power_is_an_energy_balance_of_the_pool():
    process, material = CONFIG.process, CONFIG.material
    points = np.array(material.heat_capacity_by_temperature)
    grid = np.linspace(process.ambient_temperature_k, material.liquidus_k, 200_001)
    middle = 0.5 * (grid[1:] + grid[:-1])
    sensible = (np.interp(middle, points[:, 0], points[:, 1]) * np.diff(grid)).sum()
    heat = sensible + material.latent_heat_j_kg
    assert melting_heat_j_kg(CONFIG) == pytest.approx(heat, rel=2e-3)
    metal_kg_s = 1e-9 * material.density_kg_m3 * 10.0 * process.hatch_spacing_mm * CONFIG.layer_height_mm
    power_w = 2.0 * metal_kg_s * heat / 0.37 / material.absorptivity
    assert least_power_share(CONFIG) == pytest.approx(power_w / process.power_w, rel=2e-3)
    assert least_power_share(CONFIG, 2.0) == pytest.approx(2.0 / CONFIG.layer_height_mm * least_power_share(CONFIG))
    # Too little for the pool, enough for the wire; then too little for that.
    assert least_power_share(CONFIG, 6.0) == 1.0
    assert least_power_share(CONFIG, 50.0) > 5.0
    assert enthalpy_tables(CONFIG).temperature_k[0] == process.ambient_temperature_k


def test_the_limit_is_that_of_the_process_the_material_or_the_solidus():
    material = CONFIG.material
    assert entry_limit_k(CONFIG) == material.interpass_limit_k < 0.5 * material.solidus_k
    assert entry_limit_k(CONFIG.changed(process={"interpass_limit_k": 700.0})) == 700.0
    off = CONFIG.changed(process={"interpass": "off"})
    assert entry_limit_k(off) == material.solidus_k
    assert entry_limit_k(off.changed(process={"interpass_limit_k": 700.0})) == 700.0


def test_no_setting_lifts_the_limit_over_the_solidus():
    for changes in ({"process": {"interpass_limit_k": 5000.0}}, {"material": {"interpass_limit_k": 5000.0}}):
        assert entry_limit_k(CONFIG.changed(**changes)) == CONFIG.material.solidus_k


def test_a_schedule_is_a_table_of_heights():
    table = CONFIG.changed(process={"power_schedule": [[0, 1], [20, 0.5]]})
    assert [scheduled_share(table, z) for z in (0.0, 10.0, 90.0)] == [1.0, 0.75, 0.5]
    assert scheduled_share(CONFIG, 3.0) is None
    with pytest.raises(SettingsError, match="rising order"):
        CONFIG.changed(process={"power_schedule": [[20, 1], [0, 0.5]]})


def test_the_shortest_wait_is_a_whole_second():
    assert shortest_wait_s(lambda w: 900.0 - w, 873.0) == 27.0
    assert shortest_wait_s(lambda w: 900.0 - 0.99 * w, 873.0) == 28.0
    assert shortest_wait_s(lambda w: 800.0, 873.0) == 0.0
    assert shortest_wait_s(lambda w: 900.0, 873.0) == 0.0


# -- the plan ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["dwell", "both"])
def test_no_bead_is_entered_above_the_limit(plans, name):
    config, plan = plans[name]
    limit_k = config.material.interpass_limit_k
    assert (entries_k(config, plan) <= limit_k).all()
    assert (plan.metrics["enter_k"] <= limit_k).all()
    # Without measures it melts away: the waits are not there for nothing.
    hot_config, hot = plans["off"]
    assert entries_k(hot_config, hot).max() > limit_k + 500.0
    assert plan.metrics["wait_s"][0] == 0.0
    # Some bead is entered near the limit in every layer that is waited for: none waits too long.
    waited = plan.metrics["wait_s"] + plan.metrics["ring_wait_s"] > 0
    assert waited.any()
    assert (entries_k(config, plan)[waited] > limit_k - 15.0).all()


def test_power_tapers_from_the_cold_base_to_the_least(plans):
    config = CONFIG.changed(process={"base_plate_mm": 12.0})
    heights = (np.arange(4) + 0.5) * config.layer_height_mm
    plan = plan_stack(from_polygons(heights, [[shapely.box(0, 0, 110, 80)]] * 4), config)
    share = plan.metrics["power_share"].to_numpy()
    least = least_power_share(config)
    assert 1.0 >= share[0] > share[-1] >= least
    assert least <= plans["both"][1].metrics["power_share"].min() < least + 0.01
    assert (plans["dwell"][1].metrics["power_share"] == 1.0).all()
    assert (plans["off"][1].metrics[["wait_s", "ring_wait_s"]].to_numpy(float) == 0.0).all()


def test_power_first_and_then_waits_is_faster_than_waits_alone(plans):
    waits = {
        name: plan.metrics["wait_s"].sum() + plan.island_wait_s.sum() + plan.metrics["ring_wait_s"].sum()
        for name, (_, plan) in plans.items()
    }
    assert waits["power"] == waits["off"] == 0.0
    assert 0.0 < waits["both"] < 0.6 * waits["dwell"]
    # Less power alone is not enough here.
    assert entries_k(*plans["power"]).max() > CONFIG.material.interpass_limit_k


def test_the_limit_may_hold_for_layers_alone(plans):
    config, plan = planned(interpass_at="layer")
    limit_k = config.material.interpass_limit_k
    assert (plan.metrics["enter_k"] <= limit_k).all()
    assert (plan.island_wait_s == 0.0).all()
    assert entries_k(config, plan).max() > limit_k
    assert plan.metrics["time_s"].notna().all()


@pytest.mark.slow
def test_a_table_of_power_is_kept_and_waited_for():
    config, plan = planned(power_schedule=[[0, 0.9], [10, 0.6]])
    heights = plan.heights
    share = plan.metrics["power_share"].to_numpy()
    assert share == pytest.approx(np.interp(heights, [0, 10], [0.9, 0.6]))
    assert (entries_k(config, plan) <= config.material.interpass_limit_k).all()


@pytest.mark.slow
def test_power_goes_down_no_further_than_the_process_window_allows():
    for window in ({"line_energy_j_mm": (500.0, 3000.0)}, {"current_window_ma": (83.0, 1000.0)}):
        config, plan = planned(**window)
        assert least_power_share(config) < 0.6
        assert plan.metrics["power_share"].min() == 0.7
        assert entries_k(config, plan).max() <= entry_limit_k(config) + 0.1


def test_a_geometric_order_is_driven_too():
    config = CONFIG.changed(scan={"order": "raster"})
    plan = plan_stack(tube(config, 8), config)
    assert (entries_k(config, plan) <= config.material.interpass_limit_k).all()
    assert plan.metrics["power_share"].min() < 1.0


def test_waits_live_in_the_file_of_the_plan(plans, tmp_path):
    _, plan = plans["both"]
    plan.to_parquet(tmp_path / "scan.parquet")
    back = ScanPlan.from_parquet(tmp_path / "scan.parquet")
    assert back.island_wait_s.tolist() == plan.island_wait_s.tolist()
    assert back.inner_wait_s.tolist() == plan.inner_wait_s.tolist()
    assert back.inner_wait_s.any()
    assert back.metrics["wait_s"].tolist() == plan.metrics["wait_s"].tolist()
    assert len(interpass_of(back, CONFIG).island_wait_s) == len(plan.islands)


# -- the program -------------------------------------------------------------------------------------


def written(config, plan, folder, control="sinumerik-840d-sl"):
    config = config.changed(machine={"control": control, "curve_form": "lines"})
    beads = bead_paths(tube(config), plan, config)
    return config, beads, POSTS[control](beads, plan, config, folder)


def judged(config, files, plan=None, curves=None):
    nc = as_planned(read_program(files.main, config), curves, plan, config)
    layers = tube(config)
    checks = verify_program(nc, config=config, plan=plan, curves=curves, layers=layers, heat=True)
    return nc, {check.name: check for check in checks}


@pytest.mark.parametrize("control", POSTS)
def test_waits_and_power_are_written_and_read_back(plans, tmp_path, control):
    config, plan = plans["both"]
    config, curves, files = written(config, plan, tmp_path / "p", control)
    nc, checks = judged(config, files, plan, curves)
    for name in ("layer pause", "power", INTERPASS, MELTING):
        assert checks[name].passed, checks[name].text
    assert layer_shares(nc, config) == pytest.approx(plan.metrics["power_share"].to_numpy(), abs=1e-6)
    rings = 2
    waits = plan.metrics["wait_s"].sum() + (rings - 1) * plan.metrics["ring_wait_s"].sum()
    waits += plan.island_wait_s.sum() + plan.inner_wait_s[plan.further_beads()].sum()
    assert program_summary(nc, config)["pause_s"].sum() == pytest.approx(waits)
    assert (text_beads(nc, config).wait_s[text_beads(nc, config).inner] > 0.0).any()
    alone = judged(config, files)[1]
    assert all(alone[name].passed for name in ("layer pause", "power", INTERPASS, MELTING))


def test_the_text_is_as_warm_as_the_plan(plans, tmp_path):
    config, plan = plans["both"]
    config, curves, files = written(config, plan, tmp_path / "p")
    nc = as_planned(read_program(files.main, config), curves, plan, config)
    beads = text_beads(nc, config)
    shapes = text_shapes(nc, config, sections_of(tube(config)))
    bed_k, leave_k = text_bed_k(beads, config, shapes)
    ambient_k = config.process.ambient_temperature_k
    # Times of beads and moves are those of the plan; only the way to the first contour of a layer is not known to it.
    planned_k = plan.metrics["leave_k"].to_numpy()
    assert leave_k - ambient_k == pytest.approx(planned_k - ambient_k, rel=0.01)
    assert bed_k[beads.enters_layer] == pytest.approx(plan.metrics["enter_k"].to_numpy(), rel=0.02)


FAULTS = {
    "waits deleted": (r"^N\d+ G4 F.*\n", "", INTERPASS),
    "power doubled": (r"H2=(\d+(?:\.\d+)?)", lambda m: f"H2={2 * float(m[1]):g}", INTERPASS),
    "power halved": (r"H2=(\d+(?:\.\d+)?)", lambda m: f"H2={0.5 * float(m[1]):g}", MELTING),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_planted_faults_shut_the_heat_gate(plans, tmp_path, fault):
    config, plan = plans["both"]
    config, curves, files = written(config, plan, tmp_path / "p")
    _, checks = judged(config, files, plan, curves)
    assert heat_gate(checks.values(), plan.metrics, config).passed
    pattern, by, found = FAULTS[fault]
    changed = 0
    for path in files.folder.iterdir():
        text, count = re.subn(pattern, by, path.read_text(), flags=re.MULTILINE)
        path.write_text(text)
        changed += count
    assert changed > 10
    # From the text alone, without the plan.
    _, checks = judged(config, files)
    assert not checks[found].passed
    assert not heat_gate(checks.values(), plan.metrics, config).passed
    _, checks = judged(config, files, plan, curves)
    assert not checks["layer pause" if fault == "waits deleted" else "power"].passed


def test_a_lower_limit_shuts_the_gate(plans, tmp_path):
    config, plan = plans["both"]
    config, curves, files = written(config, plan, tmp_path / "p")
    low = config.changed(process={"interpass_limit_k": 800.0})
    _, checks = judged(low, files, plan, curves)
    gate = heat_gate(checks.values(), plan.metrics, low)
    assert not gate.passed
    assert gate.limit == 800.0
    assert "over 800 K" in gate.text
    # What the plan alone finds shuts it as well.
    warm = plan.metrics.assign(entry_max_k=plan.metrics["entry_max_k"] + 30.0)
    assert not heat_gate(judged(config, files)[1].values(), warm, config).passed
    # Nor is a layer with beads of which the plan knows no temperature taken for a cool one.
    unknown = plan.metrics.assign(entry_max_k=plan.metrics["entry_max_k"].mask(plan.metrics.index == 1))
    gate = heat_gate(judged(config, files)[1].values(), unknown, config)
    assert not gate.passed
    assert "no temperature for layer 2" in gate.text
    assert not heat_gate([], plan.metrics, config).passed


@pytest.mark.slow
def test_a_part_that_melts_shuts_the_gate_without_any_measure(tmp_path):
    hot = {"interpass": "off", "current_ma": 240.0}
    config, plan = planned(**hot)
    config, curves, files = written(config, plan, tmp_path / "p")
    _, checks = judged(config, files, plan, curves)
    gate = heat_gate(checks.values(), plan.metrics, config)
    assert not gate.passed
    assert gate.limit == config.material.solidus_k
    assert gate.figure <= config.material.boiling_k


def test_no_figure_is_over_the_boiling_point(plans, tmp_path):
    config, plan = plans["off"]
    config, curves, files = written(config, plan, tmp_path / "p")
    assert plan.metrics["leave_k"].max() <= config.material.boiling_k
    metrics = plan.metrics.assign(entry_max_k=5000.0)
    gate = heat_gate(judged(config, files, plan, curves)[1].values(), metrics, config)
    assert gate.figure == config.material.boiling_k
    assert OVER_RANGE in gate.text
    assert not gate.passed


def test_a_wait_within_a_bead_or_after_the_last_one_is_found(plans, tmp_path):
    config, plan = plans["off"]
    config, curves, files = written(config, plan, tmp_path / "p", "plain-gcode")
    lines = files.main.read_text().splitlines(keepends=True)
    shutil.copy(files.main, tmp_path / "kept")
    at = next(n for n, line in enumerate(lines) if line.startswith("G1") and lines[n + 1].startswith("G1"))
    for where, what in ((at + 1, "within a bead"), (len(lines) - 1, "after the last bead")):
        files.main.write_text("".join([*lines[:where], "G4 S7\n", *lines[where:]]))
        check = judged(config, files, plan, curves)[1]["layer pause"]
        assert not check.passed
        assert what in check.text


def test_an_empty_layer_is_no_obstacle():
    box = shapely.box(0, 0, 30, 30)
    heights = (np.arange(3) + 0.5) * CONFIG.layer_height_mm
    plan = plan_stack(from_polygons(heights, [[box], [], [box]]), CONFIG)
    assert plan.metrics["power_share"].isna().tolist() == [False, True, False]
    assert HeatColumn(CONFIG).surface_k == CONFIG.process.ambient_temperature_k

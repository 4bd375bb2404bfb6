"""Every bead has the power that melts its own wire, no wait leaves the metal too cold, and the text alone tells both."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
import shapely
from prism_program import CONFIG, Made

from ebamcheck.checks.heat_again import MODELS_K, highest_entry_k, melting_power_w
from ebamcheck.checks.interpass_checks import (
    AGAIN,
    COLD,
    INTERPASS,
    WARM_SHARE,
    TextBeads,
    heat_checks,
    layer_shares,
    least_entries_k,
    text_beads,
    text_bed_k,
    text_shapes,
)
from ebamcheck.checks.value_checks import MELTING, melting_check, spread_mm
from ebamcheck.controls.gcode.writing import write_plain_gcode
from ebamcheck.controls.sinumerik.writing import write_program
from ebamcheck.heat.medium import entry_limit_k
from ebamcheck.layers.stack import from_polygons
from ebamcheck.nc.inputs import interpass_of
from ebamcheck.nc.roles import by_height
from ebamcheck.pipeline.gates import heat_gate
from ebamcheck.pipeline.stages import bead_paths, contour_curves, plan_program, power_by_wire
from ebamcheck.program import read_program, verify_program
from ebamcheck.scan.islands.regions import contour_region
from ebamcheck.scan.plan.stacking import stack_plans
from ebamcheck.scan.plan.whole_part import Stack, ordered_layers
from ebamcheck.settings.config import Config

WARM = CONFIG.changed(process={"interpass": "both"})
HOLED = shapely.box(0, 0, 44, 40).difference(shapely.Point(20, 20).buffer(6, 32))
WALL = shapely.box(0, 0, 60, 9.5)
AMBIENT_K = WARM.process.ambient_temperature_k


def read(made):
    return by_height(made.read(), made.z)


def heat_of(made, nc=None, config=None):
    nc = read(made) if nc is None else nc
    return {c.name: c for c in heat_checks(nc, config or made.config, list(made.plan.sections))}


def judged(made, planned=False):
    plan = {"plan": made.plan, "curves": made.beads} if planned else {}
    checks = verify_program(made.read(), config=made.config, layers=made.layers, heat=True, **plan)
    return {c.name: c for c in checks}


@pytest.fixture(scope="module")
def holed(tmp_path_factory):
    """A holed block whose contours lay up to 1.6 spacings, on a part warm enough for the least power."""
    return Made(tmp_path_factory.mktemp("holed"), HOLED, WARM, layers=6)


# -- power of each bead --------------------------------------------------------------------------------


def needed_j_mm3(config):
    """Energy over the wire that melts it and as much of the layers below, from the cold."""
    material, process = config.material, config.process
    points = np.array(material.heat_capacity_by_temperature)
    grid = np.linspace(process.ambient_temperature_k, material.liquidus_k, 100_001)
    middle = 0.5 * (grid[1:] + grid[:-1])
    j_kg = (np.interp(middle, *points.T) * np.diff(grid)).sum() + material.latent_heat_j_kg
    melts = process.melting_efficiency * material.absorptivity * (1.0 - process.dilution)
    return 1e-9 * material.density_kg_m3 * j_kg / melts


@pytest.mark.parametrize("section", [HOLED, WALL], ids=["block", "wall"])
def test_every_bead_has_the_power_that_melts_its_wire(section, tmp_path):
    made = Made(tmp_path, section, WARM, layers=5)
    nc, process = read(made), WARM.process
    rows = np.flatnonzero(nc.deposit)
    j_mm3 = nc.power_w[rows] / (nc.wire_mm_s[rows] * np.pi * process.wire_diameter_mm**2 / 4)
    needed = needed_j_mm3(WARM)
    assert 37.0 < needed < 39.5
    assert j_mm3.min() >= needed * (1.0 - 2e-3)
    # Where the layer has the least power, wider beads have just what they need, and others that of the layer.
    assert j_mm3.min() < needed * (1.0 + 2e-3)
    shares = layer_shares(nc, WARM)[nc.layer[rows]]
    assert (nc.power_w[rows] / process.power_w > shares * 1.05).any()
    checks = heat_of(made)
    assert all(check.passed for check in checks.values()), checks


def test_the_heat_of_the_plan_is_that_of_its_beads(holed):
    nc = read(holed)
    shapes = text_shapes(nc, WARM, list(holed.plan.sections))
    _, leave_k = text_bed_k(text_beads(nc, WARM), WARM, shapes)
    assert leave_k - AMBIENT_K == pytest.approx(holed.plan.metrics["leave_k"].to_numpy() - AMBIENT_K, rel=2e-3)
    assert layer_shares(nc, WARM) == pytest.approx(holed.plan.metrics["power_share"].to_numpy(), abs=1e-6)


@pytest.mark.parametrize(("factor", "sound"), [(1.2, True), (1.0 / 1.2, False)])
def test_power_wire_and_feed_of_each_bead_are_judged(holed, factor, sound):
    nc = read(holed)
    flat = np.zeros(int(nc.deposit.sum()), np.bool_)
    worst = melting_check(nc, WARM, flat).value
    power_w = nc.power_w * factor / worst
    assert melting_check(replace(nc, power_w=power_w), WARM, flat).passed is sound
    # One motion alone, by its wire and by its feed.
    warm = replace(nc, power_w=nc.power_w * 1.5 / worst)
    row = int(np.flatnonzero(nc.deposit)[7])
    need = warm.power_w[row] / float(melting_power_w(WARM, spread_mm(nc, np.array([row]), WARM))[0])
    wire, feed = nc.wire_mm_s.copy(), nc.feed_mm_min.copy()
    wire[row] *= need / factor
    assert melting_check(replace(warm, wire_mm_s=wire), WARM, flat).passed is sound
    feed[row] *= 2.0
    assert melting_check(replace(warm, feed_mm_min=feed), WARM, flat).passed


# -- waits -----------------------------------------------------------------------------------------------


def longer(made, layer, by_s):
    """Lengthen a wait in the middle of a layer."""

    def change(lines):
        at = [n for n, line in enumerate(lines) if re.search(r"G4 F[\d.]+", line)]
        n = at[len(at) // 2]
        lines[n] = re.sub(r"G4 F([\d.]+)", lambda m: f"G4 F{float(m[1]) + by_s:g}", lines[n])

    made.edit(f"MAIN_L{layer:04d}.SPF", change)


@pytest.mark.parametrize("seconds", [600.0, 1800.0])
def test_a_wait_of_minutes_too_many_is_found_by_text_and_part(seconds, tmp_path):
    made = Made(tmp_path, HOLED, WARM, layers=6)
    assert all(check.passed for check in heat_of(made).values())
    longer(made, 4, seconds)
    checks = judged(made)
    assert not checks[COLD].passed
    assert "layer 4" in checks[COLD].text
    assert checks["layer pause"].passed
    gate = heat_gate(checks.values(), made.plan.metrics, WARM)
    assert not gate.passed
    assert gate.text.startswith(checks[COLD].text)


@pytest.mark.parametrize("factor", [1.2, 1.0 / 1.2])
def test_waits_are_those_of_the_plan_neither_shorter_nor_longer(factor, tmp_path):
    made = Made(tmp_path, HOLED, WARM, layers=4)
    assert judged(made, planned=True)["layer pause"].passed
    waits = interpass_of(made.plan, WARM).island_wait_s
    longer(made, 3, (factor - 1.0) * float(waits[waits > 0.0].max()))
    assert not judged(made, planned=True)["layer pause"].passed


@pytest.fixture
def least_k(holed):
    """Least entry temperature of a bead that is waited for after one that was entered at a temperature."""
    every = text_beads(read(holed), WARM)
    columns = ("ring", "island", "row", "move_s", "time_s", "energy_j", "peak_w")
    two = {name: getattr(every, name)[:2] for name in columns}

    def found(config, before_k, wait_s, enters_layer=False, scanned=False):
        beads = TextBeads(
            layer=np.array([0, int(enters_layer)]), wait_s=np.array([0.0, wait_s]), stray=(),
            scans={1: None} if scanned else {}, **two,
        )  # fmt: skip
        return float(least_entries_k(beads, np.array([before_k, 300.0]), config)[1])

    return found


def test_the_least_temperature_after_a_wait(least_k):
    limit_k = highest_entry_k(WARM)
    rise_k = limit_k - AMBIENT_K
    assert least_k(WARM, limit_k, 5.0) == pytest.approx(AMBIENT_K + WARM_SHARE * rise_k)
    assert least_k(WARM, 2.0 * limit_k, 5.0) == least_k(WARM, limit_k, 5.0)
    # Metal that was not warm need not stay so, and by what two models differ any wait may cool.
    assert least_k(WARM, AMBIENT_K + 300.0, 5.0) == pytest.approx(AMBIENT_K + WARM_SHARE * 300.0)
    assert least_k(WARM, AMBIENT_K + 100.0, 5.0) == pytest.approx(AMBIENT_K + 100.0 - MODELS_K)
    assert least_k(WARM, limit_k, 0.0) == -np.inf


def test_waits_that_the_settings_ask_for_and_preheating_are_sound(least_k):
    paused = WARM.changed(process={"layer_pause_s": 100.0})
    limit_k = highest_entry_k(WARM)
    assert least_k(paused, limit_k, 100.0, enters_layer=True) == -np.inf
    assert least_k(paused, limit_k, 120.0, enters_layer=True) > 600.0
    assert least_k(paused, limit_k, 100.0) > 600.0
    assert least_k(WARM, limit_k, 50.0, enters_layer=True) > 600.0
    assert least_k(WARM, limit_k, 50.0, enters_layer=True, scanned=True) == -np.inf


@pytest.mark.parametrize(("factor", "sound"), [(1.2, True), (1.0 / 1.2, False)])
def test_a_least_entry_temperature_holds_for_every_bead(holed, factor, sound):
    # The first bead is laid on the cold plate: 293 K.
    config = WARM.changed(process={"least_entry_temperature_k": AMBIENT_K / factor})
    check = heat_of(holed, config=config)[COLD]
    assert check.passed is sound
    assert check.limit == pytest.approx(AMBIENT_K / factor)
    at_layer = config.changed(process={"interpass_at": "layer"})
    assert heat_of(holed, config=at_layer)[COLD].passed is sound


SOUND = {
    "wide at a low limit": (shapely.box(0, 0, 110, 80), {"interpass_limit_k": 423.0}),
    "waits alone": (shapely.box(0, 0, 110, 80), {"interpass": "dwell"}),
    "insulated frame": (
        shapely.box(0, 0, 100, 60).difference(shapely.box(12, 12, 88, 48)),
        {"base": "insulated"},
    ),
    "pauses": (HOLED, {"layer_pause_s": 400.0}),
    "two pieces": (shapely.union_all([shapely.box(0, 0, 50, 50), shapely.box(80, 0, 94, 14)]), {}),
}


@pytest.mark.parametrize("name", SOUND)
def test_no_plan_is_refused_for_its_waits_or_its_power(name, tmp_path):
    section, process = SOUND[name]
    made = Made(tmp_path, section, WARM.changed(process=process), layers=4)
    checks = heat_of(made)
    assert all(checks[n].passed for n in (INTERPASS, MELTING, AGAIN, COLD)), [c.text for c in checks.values()]
    assert judged(made)["power"].passed


# -- power of layers of several parts, judged from the text alone -------------------------------------------


def tube(x, outer, inner):
    return shapely.Point(x, 0).buffer(outer, 32).difference(shapely.Point(x, 0).buffer(inner, 32))


PARTS = [tube(0, 30, 15), tube(160, 60, 38), tube(300, 60, 38)]


def power_check(parts, folder, count=2, **settings):
    machine = {"control": "plain-gcode", "curve_form": "lines"}
    config = Config().changed(scan={"annealing_steps": 100}, machine=machine, **settings)
    layers = from_polygons((np.arange(count) + 0.5) * config.layer_height_mm, [parts] * count)
    plan = plan_program(layers, config)
    files = write_plain_gcode(bead_paths(layers, plan, config), plan, config, folder)
    checks = verify_program(read_program(files.main, config), config=config, layers=layers, heat=True)
    return plan, next(check for check in checks if check.name == "power")


@pytest.mark.parametrize("parts", [PARTS, PARTS[:1]], ids=["three", "one"])
def test_power_that_is_taken_back_for_one_of_the_parts_is_no_fault(parts, tmp_path):
    plan, check = power_check(parts, tmp_path / "p")
    assert (plan.metrics["power_share"] < 1.0).all()
    assert check.passed, check.text


def test_under_a_low_limit_a_place_may_be_as_hot_as_it_while_the_section_is_cool(tmp_path):
    # Aluminium: 130 K over the chamber, of which the section as a whole has half.
    bores = shapely.MultiPoint([(20, 20), (60, 20), (40, 60)]).buffer(8, 16)
    plate = shapely.box(0, 0, 80, 80).difference(bores)
    plan, check = power_check([plate], tmp_path / "p", 6, material={"name": "Al 2319"})
    assert (plan.metrics["power_share"] < 0.5).all()
    assert check.passed, check.text


# -- plan and text find the same temperatures where beads are entered, on parts whose upper layers shrink to nothing --


BRIEF = Config().changed(scan={"annealing_steps": 100})
INSTANT = {"rapid_mm_s": 1e6}
"""Moves that take no time: then nothing of plan and text differs."""

LAYERS = 10
ROUNDING_K = 0.1
"""Times and power of a text are rounded to its decimals."""

WAYS_K = 12.0
"""What a surface near the limit cools down in the second that the longest way over these parts takes."""


def disc(radius):
    return shapely.Point(3, 2).buffer(max(radius, 0.0), 64)


def round_at(share):
    """Half width of a circle at a share of its height."""
    return float(np.sqrt(1.0 - (2.0 * share - 1.0) ** 2))


SHAPES = {
    "torus": lambda s: disc(40 + 8 * round_at(s)).difference(disc(40 - 8 * round_at(s))),
    "sphere": lambda s: disc(19 * round_at(s)),
    "cone": lambda s: disc(26 * (1 - s)),
    "ellipsoid": lambda s: shapely.affinity.scale(disc(17 * float(np.sqrt(1 - s**2))), 2.0, 1.0),
    # Thin in the middle of its height: heat under the layers of contours alone goes on to those above.
    "waist": lambda s: disc(22.0 if abs(s - 0.5) > 0.15 else 5.0),
    "tube": lambda s: disc(30).difference(disc(22)),
}


def planned_and_written(shape, config, folder):
    """A part planned and written: the plan, its mean temperatures at every entry, and the program."""
    heights = (np.arange(LAYERS) + 0.5) * config.layer_height_mm
    layers = from_polygons(heights, [[shape((k + 0.5) / LAYERS)] for k in range(LAYERS)])
    order, seed = config.scan.order, config.scan.seed
    stack = Stack([layers.section(k) for k in range(LAYERS)], heights, range(LAYERS))
    contours = [contour_region(section, config) for section in stack.sections]
    beads = contour_curves(layers, contours, config)
    power_of = power_by_wire(stack.sections, beads, config)
    done = list(ordered_layers(stack, config, order, seed, carry=True, power_of=power_of))
    plan = stack_plans(list(done), config, order, seed)
    files = write_program(bead_paths(layers, plan, config), plan, config, folder)
    return plan, np.concatenate([layer.heat.mean_k for layer in done]), read_program(files.main, config)


def entries_of_text(nc, config, plan):
    beads = text_beads(nc, config)
    return beads, *text_bed_k(beads, config, text_shapes(nc, config, list(plan.sections)))


@pytest.mark.in_turn(2)
@pytest.mark.parametrize("name", SHAPES)
def test_plan_and_text_enter_every_bead_at_the_same_temperature(name, tmp_path):
    config = BRIEF.changed(machine=INSTANT)
    plan, planned_k, nc = planned_and_written(SHAPES[name], config, tmp_path / "p")
    beads, text_k, leave_k = entries_of_text(nc, config, plan)
    assert planned_k == pytest.approx(text_k, abs=ROUNDING_K)
    known = leave_k < config.material.boiling_k
    assert plan.metrics["leave_k"][known].to_numpy() == pytest.approx(leave_k[known], abs=ROUNDING_K)
    assert set(beads.layer) == set(range(LAYERS))


@pytest.mark.in_turn(2)
@pytest.mark.parametrize("name", SHAPES)
def test_no_bead_is_entered_warmer_than_planned_and_every_layer_has_a_figure(name, tmp_path):
    plan, planned_k, nc = planned_and_written(SHAPES[name], BRIEF, tmp_path / "p")
    beads, text_k, _ = entries_of_text(nc, BRIEF, plan)
    # Ways to contours are planned by the shortest ones: the text comes later, never sooner.
    assert (text_k < planned_k + ROUNDING_K).all()
    assert (text_k > planned_k - WAYS_K).all()
    # Contours and islands alike are held to the limit: none without a figure, none over it.
    entry_k = plan.metrics["entry_max_k"].to_numpy() + BRIEF.process.ambient_temperature_k
    assert (entry_k <= entry_limit_k(BRIEF)).all()
    assert np.isfinite(plan.metrics["enter_k"]).all()
    hottest_k = np.array([planned_k[beads.layer == k].max() for k in range(LAYERS)])
    assert (hottest_k <= entry_k + 1e-6).all()
    checks = {check.name: check for check in heat_checks(nc, BRIEF, list(plan.sections))}
    assert checks[INTERPASS].passed, checks[INTERPASS].text

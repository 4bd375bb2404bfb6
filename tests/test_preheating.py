"""Preheating: laws of its heat and of its lines, a run whose scan reaches the target, and what would wreck part or machine."""

import json
import math
import shutil

import numpy as np
import pytest
import shapely
from command_line import FAST, ebamcheck, write_stl
from hypothesis import given, settings
from hypothesis import strategies as st
from parts import box
from planted_faults import drop, edit
from program_text import Text
from slicers_here import runs_cut_here as runs_cut_here

from ebamcheck.errors import SettingsError
from ebamcheck.heat import Medium
from ebamcheck.heat.preheating import SIGMAS, BeamWay, SurfaceHeat, bare_plate, pass_lines, spot_peak_k
from ebamcheck.json_values import sha256_of_json
from ebamcheck.nc.templates import usable_templates
from ebamcheck.settings.config import Config, load_config
from ebamcheck.verification.verify import verify

MACHINE = {"set_focus": ["H5={defocus} ; focus"]}
PLATE = """[machine]
set_focus = ["H5={defocus} ; focus"]
[preheat]
when = "plate"
defocus = 20.0
current_ma = 10
"""
SCAN, MAIN = "MAIN_P0001.SPF", "MAIN.MPF"


def config_of(process=None, machine=None, **preheat):
    given = {"when": "plate", "defocus": 20.0, "current_ma": 10.0, **preheat}
    return Config().changed(preheat=given, machine=MACHINE | (machine or {}), process=process or {})


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """Folder with a run of a box on a plate that is preheated."""
    folder = tmp_path_factory.mktemp("preheat")
    write_stl(box(upper=(36, 30, 6.7)), folder / "box.stl")
    (folder / "plate.toml").write_text(PLATE)
    done = ebamcheck("run", "box.stl", "-o", "box.run", "--backends", FAST, "-c", "plate.toml", cwd=folder)
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


# -- laws --------------------------------------------------------------------------------------------


@settings(deadline=None, max_examples=40)
@given(
    st.floats(20.0, 120.0), st.floats(15.0, 90.0), st.floats(2.0, 25.0), st.integers(0, 5),
    st.sampled_from(["lines", "crossed"]), st.booleans(),
)  # fmt: skip
def test_lines_stay_within_the_region_and_leave_nothing_of_it_bare(width, height, spacing, number, pattern, hole):
    config = config_of(pattern=pattern, spacing_mm=spacing)
    region = shapely.box(0, 0, width, height)
    if hole:
        region = region.difference(shapely.Point(0.4 * width, 0.5 * height).buffer(0.2 * min(width, height)))
    first, on = pass_lines(region, config, number)
    second, _ = pass_lines(region, config, number + (2 if pattern == "crossed" else 1))
    near = region.buffer(1e-3)
    for line in first:
        assert near.covers(shapely.LineString([line[:2], line[2:]]))
    for k in np.flatnonzero(on):
        assert near.covers(shapely.LineString([first[k - 1, 2:], first[k, :2]]))
    # A pass and the one that lies half a spacing aside come within half a spacing of every place, but for the rounding of rows.
    lines = shapely.MultiLineString([[line[:2], line[2:]] for line in np.concatenate([first, second])])
    rows = max(spacing, min(width, height)) if min(width, height) < spacing else spacing
    assert region.difference(lines.buffer(0.8 * rows)).area < 1e-6 * region.area


def test_heat_is_neither_won_nor_lost_and_the_places_average_to_the_column():
    config = config_of()
    body = shapely.box(0, 0, 80, 60)
    heat = SurfaceHeat(bare_plate(body, config), body, body, 25.0, config)
    lines, _ = pass_lines(body, config, 0)
    time_s = np.hypot(*(lines[:, 2:] - lines[:, :2]).T) / 40.0
    heat.simulate(BeamWay(lines[:, :2], lines[:, 2:], time_s, np.full(len(lines), 900.0)))
    heat.rest(20.0)
    column = heat.column
    assert column.absorbed_j == pytest.approx(900.0 * time_s.sum() * config.material.absorptivity)
    assert column.stored_j + column.base_j + column.radiated_j == pytest.approx(column.absorbed_j, rel=1e-6)
    assert heat.read().mean_k == pytest.approx(column.surface_k, abs=0.5)


def test_an_even_source_comes_to_the_steady_state_of_a_plate_on_a_cooled_table():
    """By hand: what is put in flows through the plate, q = k (T - Ta) / L, less what radiates."""
    data = {
        "heat_capacity_by_temperature": ((293.15, 540.0), (3533.0, 540.0)),
        "conductivity_by_temperature": ((293.15, 12.0), (3533.0, 12.0)),
    }
    config = config_of().changed(material={**data, "conductivity_w_mk": 12.0, "emissivity": 1e-6})
    body = shapely.box(0, 0, 80, 60)
    column = bare_plate(body, config)
    for _ in range(400):
        column.advance(10.0, 10.0 * 300.0 * config.material.absorptivity)
    flux = 300.0 * config.material.absorptivity / (80 * 60)
    # The uppermost cell is read at its middle, and takes the heat over its height.
    through_mm = 25.0 - 0.5 * 2.5
    wanted = config.process.ambient_temperature_k + flux * through_mm / 12e-3
    assert column.surface_k == pytest.approx(wanted, rel=0.01)


def test_the_peak_under_a_spot_has_its_two_limits():
    """At rest it is P / (2 sqrt(2 pi) k sigma), by hand; fast it falls with the root of the speed."""
    config = config_of(spot_mm=20.0)
    medium, sigma = Medium.of(config), 20.0 / SIGMAS
    taken = 500.0 * config.material.absorptivity
    standing = taken / (2.0 * math.sqrt(2.0 * math.pi) * medium.conductivity_w_mmk * sigma)
    assert spot_peak_k(500.0, 0.001, config) == pytest.approx(standing, rel=0.05)
    fast, faster = spot_peak_k(500.0, 200.0, config), spot_peak_k(500.0, 800.0, config)
    assert fast / faster == pytest.approx(2.0, rel=0.05)


# -- a run -------------------------------------------------------------------------------------------


def preheat_checks(checks):
    return {check.name: check for check in checks if check.name.startswith("preheat")}


def test_a_run_preheats_its_plate_by_a_subprogram_and_verifies(place):
    record = json.loads((place / "box.run" / "run.json").read_text())
    names = [file["name"] for file in record["program"]["files"]]
    assert SCAN in names
    main = (place / "box.run" / "program" / MAIN).read_text()
    calls = [line.split()[1] for line in main.split("\n") if " MAIN_" in line]
    assert calls[:2] == ["MAIN_P0001", "MAIN_L0001"]
    scan = (place / "box.run" / "program" / SCAN).read_text()
    assert "M62" not in scan  # no wire
    assert scan.index("H5=20") < scan.index("M60") < scan.rindex("M61") < scan.index("H5=0 ")
    checks = verify(place / "box.run")
    assert all(check.passed for check in checks), [c.in_words() for c in checks if not c.passed]
    found = preheat_checks(checks)
    target = Config().preheat.target_k
    assert target <= found["preheat temperature"].value <= target + Config().preheat.over_k
    assert found["preheat melting"].value < Config().material.solidus_k
    # The program alone, against part and settings, as anybody can check it.
    alone = verify(place / "box.run" / "program", place / "box.stl")
    assert all(check.passed for check in alone), [c.in_words() for c in alone if not c.passed]
    assert set(preheat_checks(alone)) == set(found)


def test_layers_begin_on_the_warm_plate_in_plan_and_text(place):
    warm = json.loads((place / "box.run" / "run.json").read_text())
    done = ebamcheck("run", "box.stl", "-o", "cold.run", "--backends", FAST, cwd=place)
    assert done.returncode == 0, done.stderr
    cold = json.loads((place / "cold.run" / "run.json").read_text())
    enter = [
        np.genfromtxt(place / run / "scan.csv", delimiter=",", names=True)["enter_k"][0]
        for run in ("box.run", "cold.run")
    ]
    assert enter[0] - enter[1] > 100.0

    def text_of(run):
        return next(c for c in run["program"]["checks"] if c["name"] == "interpass temperature")["value"]

    assert text_of(warm) <= 873.0
    assert text_of(cold) <= 873.0
    assert "preheat_passes" not in (place / "cold.run" / "scan.csv").read_text()
    # Off, nothing of it is in the program, nor in the hash of its settings.
    assert not [f for f in cold["program"]["files"] if "_P0" in f["name"]]
    assert "preheat" not in cold["settings"]
    assert cold["settings_sha256"] == sha256_of_json(cold["settings"])


def test_the_report_shows_it(place):
    html = (place / "box.run" / "report.html").read_text()
    assert "<h3>Preheating</h3>" in html
    assert "1 subprogram, before layer 1" in html
    assert "MAIN_P0001.SPF: the beam preheats" in html


# -- what would wreck part or machine and still run ---------------------------------------------------


def each(*plants):
    def plant(text):
        for one in plants:
            one(text)

    return plant


def passes_doubled(text):
    first, last = text.find(SCAN, "; PASS 1$"), text.find(SCAN, "H2=120")
    text.lines[SCAN][last:last] = text.lines[SCAN][first:last]


def last_pass_without(begin, end):
    def plant(text):
        first, last = text.find(SCAN, "; PASS 9$"), text.find(SCAN, "H2=120")
        del text.lines[SCAN][first + begin : last - end]

    return plant


def hot_spot(text):
    first = text.find(SCAN, r"G1 X-10.000000 Y5.000000")
    again = [f"N{171 + k} G1 X{-10.0 if k % 2 else 0.0:.6f} Y5.000000" for k in range(8)]
    text.lines[SCAN][first + 1 : first + 1] = again


ON, OFF = "M60 ; beam on", "M61 ; beam off"
FAULTS = {
    "the wire runs while it preheats": (
        each(edit(SCAN, ON, f"{ON}\nN171 H3=33 ; wire speed, mm/s\nN172 M62 ; wire on"), edit(SCAN, OFF, f"M63 ; wire off\nN271 {OFF}", 1)),
        "preheat state",
    ),
    "the power of melting": (edit(SCAN, r"H2=10 ", "H2=120 "), "preheat state"),
    "twice the voltage": (edit(SCAN, r"H1=60 ", "H1=120 "), "preheat state"),
    "the beam in focus": (drop(SCAN, r"H5=20 "), "preheat state"),
    "half out of focus": (edit(SCAN, r"H5=20 ", "H5=10 "), "preheat state"),
    "the focus is not taken back": (drop(SCAN, r"H5=0 "), "preheat state"),
    "a bead out of focus": (edit("MAIN_L0002.SPF", ON, f"H5=20 ; focus\nN151 {ON}"), "preheat state"),
    "the beam beside the plate": (edit(SCAN, r"G1 X46.000000 Y-5.000000", "G1 X246.000000 Y-5.000000"), "preheat path"),
    "the tool at the plate": (edit(SCAN, r"G0 Z20.000000", "G0 Z0.500000"), "preheat path"),
    "ten times too slow": (edit(SCAN, r"F3000", "F300"), "preheat path"),
    "twice the passes": (passes_doubled, "preheat count"),
    "a pass less": (last_pass_without(0, 0), "preheat count"),
    "half a pass": (last_pass_without(4, 1), "preheat count"),
    "never called": (drop(MAIN, "MAIN_P0001"), "preheat calls"),
    "called twice": (edit(MAIN, "MAIN_P0001", "MAIN_P0001\nN131 MAIN_P0001"), "preheat calls"),
    "called after its layer": (each(drop(MAIN, "MAIN_P0001"), edit(MAIN, "MAIN_L0001", "MAIN_L0001\nN141 MAIN_P0001")), "preheat calls"),
    "the beam is left on": (drop(SCAN, OFF, -1), "preheat state"),
    "the beam is on in a rapid": (each(drop(SCAN, OFF, 1), drop(SCAN, ON, 1)), "preheat state"),
    "the beam stands": (edit(SCAN, OFF, f"G4 F20\nN265 {OFF}", 1), "preheat state"),
    "a wait in which all cools": (edit(SCAN, "G4 F30", "G4 F3000"), "preheat temperature"),
    "a place that is scanned again and again": (hot_spot, "preheat count"),
    "the wire is switched on in place of off": (edit(SCAN, "M63 ; wire off", "M62 ; wire off"), "preheat state"),
}  # fmt: skip


@pytest.mark.in_turn(2)
@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_in_preheating_is_found_from_the_text(name, place, tmp_path):
    plant, wanted = FAULTS[name]
    shutil.copytree(place / "box.run" / "program", tmp_path / "program")
    text = Text(tmp_path / "program")
    plant(text)
    text.save()
    checks = verify(tmp_path / "program", place / "box.stl", load_config(place / "plate.toml"))
    failed = {check.name: check for check in checks if not check.passed}
    assert wanted in failed, [check.in_words() for check in failed.values()]
    assert failed[wanted].where
    # Against the recorded run it does not pass either.
    run = tmp_path / "box.run"
    shutil.copytree(place / "box.run", run)
    shutil.rmtree(run / "program")
    shutil.copytree(tmp_path / "program", run / "program")
    assert not all(check.passed for check in verify(run, place / "box.stl"))


def test_what_misses_the_target_shuts_the_gate_with_place_value_and_setting(place):
    (place / "miss.toml").write_text(PLATE.replace('"plate"', '"plate"\nmost_passes = 3'))
    done = ebamcheck("run", "box.stl", "-o", "miss.run", "--backends", FAST, "-c", "miss.toml", cwd=place)
    assert done.returncode == 1
    assert "preheat temperature at MAIN_P0001.SPF:" in done.stdout
    assert "preheat.target_k is 450 K" in done.stdout
    assert "preheat.most_passes" in done.stdout
    assert "NOT VALIDATED" in (place / "miss.run" / "program" / MAIN).read_text()


@pytest.mark.slow
def test_layers_that_are_colder_than_the_target_are_scanned_too(tmp_path):
    write_stl(box(upper=(150, 150, 5)), tmp_path / "box.stl")
    (tmp_path / "layers.toml").write_text(
        PLATE.replace('"plate"', '"layers"').replace("= 10", "= 150")
        + "target_k = 645\nover_k = 100\nspot_mm = 40\nspacing_mm = 20\nsoak_s = 10\nevenness_k = 400\n"
        + "[process]\ncurrent_ma = 60\n"
    )
    done = ebamcheck("run", "box.stl", "-o", "box.run", "--backends", FAST, "-c", "layers.toml", cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    program = tmp_path / "box.run" / "program"
    scans = sorted(path.name for path in program.glob("*_P*.SPF"))
    assert scans == ["MAIN_P0001.SPF", "MAIN_P0002.SPF", "MAIN_P0003.SPF"]
    calls = [line.split()[1] for line in (program / MAIN).read_text().split("\n") if " MAIN_" in line]
    assert calls == [f"MAIN_{what}{k:04d}" for k in (1, 2, 3) for what in "PL"]
    assert all(check.passed for check in verify(program, tmp_path / "box.stl"))
    # The scan of the second layer left out: it would begin too cold.
    text = Text(program)
    text.drop(MAIN, "MAIN_P0002")
    del text.lines["MAIN_P0002.SPF"]
    text.save()
    failed = {check.name: check for check in verify(program, tmp_path / "box.stl") if not check.passed}
    assert "preheat temperature" in failed
    assert "layer 2 begins on" in failed["preheat temperature"].text


@pytest.mark.parametrize(
    ("process", "machine", "preheat", "said"),
    [
        ({}, {"set_focus": ()}, {}, "machine.set_focus is empty"),
        ({}, {}, {"defocus": 0.0}, "preheat.defocus is 0"),
        ({}, {}, {"current_ma": 260.0}, "over process.current_max_ma"),
        ({}, {}, {"speed_mm_s": 80.0}, "feed_max_mm_s"),
        ({}, {"control": "linuxcnc"}, {}, "has programs of one file"),
        ({}, {}, {"target_k": 860.0}, "over 873 K"),
        ({"layer_pause_s": 5.0}, {}, {"when": "layers"}, "process.layer_pause_s"),
    ],
)  # fmt: skip
def test_preheating_that_cannot_be_is_refused_with_its_setting(process, machine, preheat, said):
    config = config_of(process, machine, **preheat)
    with pytest.raises(SettingsError, match=said):
        usable_templates(config, config.machine.control)


@pytest.mark.parametrize("command", ["run", "post"])
def test_programs_that_begin_at_a_layer_do_not_preheat(place, command):
    done = ebamcheck(command, "box.stl", "-o", "no.run", "--from-layer", "2", "-c", "plate.toml", cwd=place)
    assert done.returncode == 2
    assert "--from-layer 2: preheat.when" in done.stderr
    assert not (place / "no.run").exists()


def test_a_focus_template_sets_the_focus_and_nothing_else():
    for wrong in (["H2={current_ma}"], ["M60"], ["H9=5"], ["H5={defocus} M60"]):
        config = Config().changed(machine={"set_focus": wrong})
        with pytest.raises(SettingsError, match="set_focus"):
            usable_templates(config, config.machine.control)
    config = Config().changed(machine={"layer_begin": ["H5={defocus}"], **MACHINE})
    with pytest.raises(SettingsError, match="layer_begin"):
        usable_templates(config, config.machine.control)

"""The metal of programs: right on parts of any shape, and planted faults that shut the gate."""

import json
import re
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
import shapely
from command_line import FAST, ebamcheck, write_stl
from parts import box
from prism_program import CONFIG, Made

from ebamcheck.checks.matching import matched
from ebamcheck.checks.metal import _Cells, deposit
from ebamcheck.checks.metal_rules import DEPOSIT_CHECKS, _Metal, _outside, deposit_checks
from ebamcheck.checks.narrow_features import narrow_bead
from ebamcheck.checks.value_checks import wire_check
from ebamcheck.layers.stack import from_polygons
from ebamcheck.metal import target_of
from ebamcheck.nc.control import control as control_named
from ebamcheck.pipeline.findings import metal_findings
from ebamcheck.pipeline.gates import deposit_gate
from ebamcheck.program import Check, program_summary, read_program
from ebamcheck.settings.config import Config
from ebamcheck.settings.process_window import checked_window, nominal_wire_speed_mm_s
from ebamcheck.writing.bead_ends import planned_path
from ebamcheck.writing.events import COLUMNS, event_totals, process_events

DISC = shapely.Point(3, -8).buffer(45, 64)
PARTS = {
    "square": shapely.box(0, 0, 80, 80),
    "ring": DISC.difference(shapely.Point(0, -5).buffer(14, 32)),
    "frame": shapely.box(0, 0, 90, 60).difference(shapely.box(14, 14, 76, 46)),
    "frame of walls under three beads": shapely.box(0, 0, 110, 70).difference(shapely.box(14, 14, 96, 56)),
    "wedge": shapely.Polygon([(0, 0), (120, 0), (120, 14), (0, 40)]),
    "wall of two beads": shapely.box(0, 0, 100, 11),
    "wall of one bead": shapely.box(0, 0, 100, 6),
    "far away": shapely.affinity.translate(shapely.box(0, 0, 50, 40), 700, -650),
    "two": shapely.MultiPolygon([shapely.box(0, 0, 40, 40), shapely.box(60, 0, 100, 25)]),
    "hub in a ring": shapely.MultiPolygon(
        [shapely.box(0, 0, 70, 70).difference(shapely.box(11, 11, 59, 59)), shapely.box(16, 16, 54, 54)]
    ),
}


@pytest.mark.parametrize("name", PARTS)
def test_the_metal_of_a_program_is_that_of_the_part(name, tmp_path):
    made = Made(tmp_path, PARTS[name])
    checks = made.checks()
    assert tuple(checks) == DEPOSIT_CHECKS
    assert [check for check in checks.values() if not check.passed] == []
    assert deposit_gate(checks.values(), made.config).passed
    # The mass by the summary of the text is the mass by the field.
    kg = program_summary(made.read(), made.config)["wire_kg"].sum()
    part = PARTS[name].area * made.z[-1] * made.config.material.density_kg_m3 * 1e-9
    assert kg == pytest.approx(part, rel=0.02)


@pytest.mark.parametrize("name", PARTS)
def test_plan_and_program_are_one_process(name, tmp_path):
    config = CONFIG.changed(process={"interpass": "both", "layer_pause_s": 20.0, "overlap_mm": 3.0})
    made = Made(tmp_path, PARTS[name], config, layers=3)
    path = planned_path(made.beads, made.plan, config)
    events = process_events(path, made.plan, config)
    assert list(events.columns) == list(COLUMNS)
    nc, _ = matched(made.read(), path)
    plan, text = event_totals(events, 3, config), program_summary(nc, config)
    for ours, theirs in {"contour_mm": "contour_mm", "travel_mm": "travel_mm", "wire_mm": "wire_mm"}.items():
        assert plan[ours].to_numpy() == pytest.approx(text[theirs].to_numpy(), rel=1e-5, abs=1e-3)
    hatch = plan[["hatch_mm", "turn_mm", "wall_mm", "gap_mm"]].sum(axis=1)
    assert hatch.to_numpy() == pytest.approx(text["hatch_mm"].to_numpy(), rel=1e-6, abs=1e-4)
    assert plan["deposit_s"].to_numpy() == pytest.approx(text["deposit_s"].to_numpy(), rel=1e-6)
    # Waits are of the layer that they come before, or within which they are.
    assert plan["wait_s"].to_numpy() == pytest.approx(text["pause_s"].to_numpy(), abs=1e-6)
    assert plan["wait_s"][1:].min() >= 20.0
    assert plan["starts"].sum() == sum(event == "wire_start" for event in nc.events.name)
    assert wire_check(nc, config, path).passed
    # The plan's own rows count the same lines and turns.
    metrics = made.plan.metrics
    assert (metrics["hatch_length_mm"] + metrics["turn_length_mm"]).to_numpy() == pytest.approx(
        hatch.to_numpy(), rel=1e-5
    )


@pytest.fixture
def square(tmp_path):
    return Made(tmp_path, shapely.box(0, 0, 80, 60).difference(shapely.box(40, 20, 60, 40)), layers=6)


LAYER = "MAIN_L0003.SPF"


def test_the_square_is_sound(square):
    assert square.failed() == set()


def wire_times(factor):
    """Edit of a file: all of its wire speeds, multiplied."""

    def change(lines):
        lines[:] = [re.sub(r"H3=([\d.]+)", lambda m: f"H3={factor * float(m[1]):.6f}", line) for line in lines]

    return change


def test_too_much_wire_is_found(square):
    square.edit(LAYER, wire_times(1.05))
    assert square.checks()["metal of layers"].where.startswith(LAYER)
    assert "metal of layers" in square.failed()
    for k in (1, 2, 4, 5, 6):
        square.edit(f"MAIN_L{k:04d}.SPF", wire_times(1.05))
    assert {"metal", "metal of layers"} <= square.failed()
    assert not deposit_gate(square.checks().values(), square.config).passed


def test_a_bead_beside_the_part_is_found_whatever_a_comment_says(square):
    def astray(lines):
        i = next(n for n, line in enumerate(lines) if "M62" in line)
        # Before the first ring is named, in a chain of turns, 40 mm beside the part and back.
        x, y = re.search(r"G0 X(\S+) Y(\S+)", "\n".join(lines[:i])).groups()
        lines[i + 1 : i + 1] = [f"N1 G1 X{float(x):.3f} Y-40.000 F600 ; TURN", f"N2 G1 X{x} Y{y} ; TURN"]

    square.edit(LAYER, astray)
    failed = square.failed()
    assert "reach of metal" in failed
    # Cells end two beads beside the part: what lies beyond counts as outside, too.
    assert square.checks()["reach of metal"].value > 11.0


def test_a_sum_that_rounding_puts_under_0_is_no_metal_beside_the_part():
    solid = pd.DataFrame({"layer": [0], "z_mm": [1.5], "outside_mm3": [-1e-13], "laid_mm3": [100.0]})
    built = SimpleNamespace(outside_mm3=-1e-13, laid_mm3=100.0)
    program = SimpleNamespace(files=[SimpleNamespace(name="MAIN.MPF")])
    found = SimpleNamespace(first_row=[-1])
    check = _outside(_Metal(program, found, Config(), solid, built, alone=False))
    assert check.passed
    assert check.text.startswith("0.00 % of the metal lies beside the part, most 0.00 % of a layer")
    assert str(check.value) == "0.0"


def feed_halved(lines):
    lines[:] = [line.replace("F600", "F300") for line in lines]


def contour_laid_twice(lines):
    i = next(n for n, line in enumerate(lines) if line.startswith("; RING"))
    j = next(n for n, line in enumerate(lines) if "M61" in line)
    lines[j + 1 : j + 1] = [re.sub(r"^N\d+ ", "", line) for line in lines[i : j + 1]]


def half_of_the_islands_left_out(lines):
    islands = [n for n, line in enumerate(lines) if line.startswith("; ISLAND")]
    del lines[islands[1] : islands[len(islands) // 2]]


@pytest.mark.parametrize("spoil", [feed_halved, contour_laid_twice, half_of_the_islands_left_out])
def test_too_much_or_too_little_metal_in_a_layer_is_found(square, spoil):
    square.edit(LAYER, spoil)
    assert "metal of layers" in square.failed()


def test_wire_moved_from_one_end_to_the_other_tilts_the_surface(square):
    """Every layer lays the metal of the part in all, and too little of it on the left."""

    def moved(lines):
        x = 0.0
        for i, line in enumerate(lines):
            found = re.search(r"X(-?[\d.]+)", line)
            x = float(found[1]) if found else x
            factor = 0.55 + 0.9 * x / 80.0
            lines[i] = re.sub(r"H3=([\d.]+)", lambda m, f=factor: f"H3={f * float(m[1]):.6f}", line)

    sound = square.checks()["surface"].value
    for k in range(1, 7):
        square.edit(f"MAIN_L{k:04d}.SPF", moved)
    assert square.checks()["surface"].value > 3.0 > 2.0 * sound


def test_a_hole_that_closes_is_found(square):
    """The same program against a part that has a hole where beads lie."""
    holed = square.layers.polygons(0)[0].difference(shapely.Point(20, 30).buffer(2.5))
    layers = from_polygons(square.layers.heights, [[holed]] * len(square.layers))
    assert {"reach of metal", "holes"} <= square.failed(layers)
    checks = square.checks(layers)
    assert "narrower than the bead" in checks["reach of metal"].text
    assert checks["holes"].value == len(layers)
    found = {finding.code: finding for finding in metal_findings(checks.values())}
    assert {"hole-closed", "bead-out-of-section"} <= set(found)
    assert found["hole-closed"].severity == "fault"
    assert "(20.0, 30.0)" in found["hole-closed"].text
    assert found["hole-closed"].remedy


def test_what_stands_in_a_hole_does_not_close_it(tmp_path):
    """Metal reaches beside the hub of a ring, and most of the ring's hole is hub: the gap between them is open."""
    made = Made(tmp_path, PARTS["hub in a ring"], layers=2)
    thinner = made.layers.polygons(0)[0].union(made.layers.polygons(0)[1]).buffer(-1.2)
    checks = made.checks(from_polygons(made.layers.heights, [list(thinner.geoms)] * 2))
    assert checks["reach of metal"].value > 0.0
    assert checks["holes"].passed


def test_the_width_of_a_hole_is_that_of_its_widest_place(square):
    """Of a slot it is the way across: by that a bead is chosen which leaves it open."""
    slotted = square.layers.polygons(0)[0].difference(shapely.box(4, 8, 76, 10.5))
    layers = from_polygons(square.layers.heights, [[slotted]] * len(square.layers))
    assert "first one 2.5 mm wide" in square.checks(layers)["holes"].text


@pytest.mark.parametrize(("factor", "code"), [(1.2, "metal-excess"), (0.8, "metal-missing")])
def test_findings_tell_too_much_metal_from_too_little(square, factor, code):
    square.edit(LAYER, wire_times(factor))
    assert code in {finding.code for finding in metal_findings(square.checks().values())}


@pytest.mark.parametrize(("factor", "code"), [(1.03, "metal-excess"), (0.97, "metal-missing")])
def test_the_mass_of_a_small_part_tells_too_much_from_too_little(tmp_path, factor, code):
    """Four grams in kilograms with three decimals are the same on both sides."""
    small = Made(tmp_path, shapely.box(0, 0, 20, 20), layers=2)
    small.config = small.config.changed(material={"density_kg_m3": 1000.0})
    for k in (1, 2):
        small.edit(f"MAIN_L{k:04d}.SPF", wire_times(factor))
    whole = small.checks()["metal"]
    assert not whole.passed
    laid, wanted = (float(kg) for kg in re.findall(r"([\d.]+) kg", whole.text))
    assert abs(laid / wanted - 1.0) == pytest.approx(whole.value, abs=1e-3)
    assert [finding.code for finding in metal_findings([whole])] == [code]


@pytest.mark.parametrize(
    ("name", "text", "code"),
    [
        ("metal", "9.700 kg of metal for 9.937 kg of part", "metal-missing"),
        ("metal", "10.300 kg of metal for 9.937 kg of part", "metal-excess"),
        (
            "height inside",
            "metal is 0.940 layers high on average, furthest off 1.080: layer 1",
            "metal-missing",
        ),
        (
            "height inside",
            "metal is 1.060 layers high on average, furthest off 0.900: layer 1",
            "metal-excess",
        ),
    ],
)
def test_findings_of_the_whole_metal_go_by_its_sign(name, text, code):
    check = Check(name, False, 0.05, 0.02, "of the part", "", text)
    assert [finding.code for finding in metal_findings([check])] == [code]


def test_metal_where_the_part_has_none_is_outside(square):
    empty = [[] if k == 2 else square.layers.polygons(k) for k in range(len(square.layers))]
    layers = from_polygons(square.layers.heights, empty)
    assert "metal outside" in square.failed(layers)


@pytest.mark.parametrize("thickness", [0.3, 2.0, 3.0])
def test_walls_under_a_bead_shut_the_gate(thickness, tmp_path):
    made = Made(tmp_path, shapely.box(0, 0, 80, thickness), layers=2)
    checks = made.checks()
    assert not checks["metal outside"].passed
    gate = deposit_gate(checks.values(), made.config)
    assert not gate.passed
    assert "beside the part" in gate.text or "metal" in gate.text


@pytest.mark.parametrize(("thickness", "said"), [(4.0, "set process.bead_width_mm 4.0"), (1.0, "the thinnest wall")])
def test_a_wall_under_a_bead_is_named_with_what_would_lay_it(thickness, said, tmp_path):
    made = Made(tmp_path, shapely.box(0, 0, 80, thickness), layers=2)
    check = made.checks()["metal outside"]
    assert not check.passed
    assert f"is {thickness:.1f} mm thick" in check.text
    assert said in check.text


def test_a_narrower_bead_lays_the_wall_that_the_finding_says_it_does(tmp_path):
    """The bead of 4 mm that a wall of 4 mm asks for: its power by its line energy, at the same travel speed."""
    wall = shapely.box(0, 0, 200, 4.0)
    bead = narrow_bead(4.0, CONFIG.layer_height_mm, CONFIG)
    assert bead.least_mm < 4.0
    narrow = CONFIG.changed(
        process={"bead_width_mm": 4.0, "current_ma": bead.current_ma},
        layers={"layer_height_mm": CONFIG.layer_height_mm},
    )
    checked_window(narrow)
    made = Made(tmp_path, wall, narrow, layers=3)
    assert made.failed() == set()
    nc = made.read()
    on = nc.deposit & nc.wire
    wire_mm_s = np.average(nc.wire_mm_s[on], weights=nc.lengths[on])
    assert wire_mm_s == pytest.approx(bead.wire_mm_s, rel=0.06)


@pytest.mark.parametrize("thickness", [6.5, 7.0, 7.5, 8.5])
def test_walls_a_little_wider_than_a_bead_have_their_metal(thickness, tmp_path):
    """Two beads along one such wall lie so near to each other that their pools overlap in its middle."""
    made = Made(tmp_path, shapely.box(0, 0, 80, thickness), layers=4)
    assert made.failed() == set()


def test_an_allowance_for_machining_makes_room_for_a_thin_wall(tmp_path):
    config = CONFIG.changed(process={"machining_allowance_mm": 2.0})
    made = Made(tmp_path, shapely.box(0, 0, 80, 4.0), config, layers=3)
    assert made.failed() == set()


def test_limits_are_those_of_the_user(square):
    strict = square.config.changed(process={"surface_tolerance_mm": 0.01, "mass_tolerance": 1e-6})
    nc = square.read()
    found = deposit(nc, square.layers, square.z, strict)
    failed = {c.name for c in deposit_checks(nc, found, strict) if not c.passed}
    assert {"surface", "metal"} <= failed


def test_no_check_no_gate():
    assert not deposit_gate([], CONFIG).passed


@pytest.mark.parametrize("control", ["linuxcnc", "plain-gcode"])
def test_other_controls_lay_the_same_metal(control, tmp_path):

    config = CONFIG.changed(machine={"control": control})
    made = Made(tmp_path, PARTS["ring"], layers=2)
    files = control_named(control).load("writer")(made.beads, made.plan, config, tmp_path / control)
    nc = read_program(files.main, config)
    found = deposit(nc, made.layers, made.z, config)
    theirs = deposit(made.read(), made.layers, made.z, made.config)
    assert found.layers["laid_mm3"].to_numpy() == pytest.approx(theirs.layers["laid_mm3"].to_numpy(), rel=1e-4)
    assert [c for c in deposit_checks(nc, found, config) if not c.passed] == []
    assert wire_check(nc, config, planned_path(made.beads, made.plan, config)).passed


def test_the_field_of_a_layer_is_that_of_its_figures(square):
    found = deposit(square.read(), square.layers, square.z, square.config, keep={3})
    assert set(found.fields) == {3, found.worst}
    field, figures = found.fields[3], found.layers.iloc[3]
    assert field.laid_mm.sum() * field.target.step_mm**2 == pytest.approx(figures["laid_mm3"], rel=1e-6)
    assert field.over_mm.max() == pytest.approx(figures["high_mm"])


@pytest.mark.slow
def test_beads_that_are_all_at_the_most_wire_of_the_feeder_leave_metal_out_and_that_is_said(tmp_path):
    """Nobody makes up for the rim of such layers: beads of nominal wire alone leave it a sixth short."""
    write_stl(box((0, 0, 0), (20, 20, 5)), tmp_path / "low.stl")
    nominal = nominal_wire_speed_mm_s(Config(), Config().layer_height_mm)
    (tmp_path / "c.toml").write_text(f"process.wire_speed_max_mm_s = {nominal + 1e-6}\n")
    done = ebamcheck("run", "low.stl", "-c", "c.toml", "--backends", FAST, "-o", "r", cwd=tmp_path)
    assert done.returncode == 1
    record = json.loads((tmp_path / "r/run.json").read_text())
    found = [finding for finding in record["findings"] if finding["severity"] == "fault"]
    assert {finding["code"] for finding in found} == {"metal-missing"}
    assert any("process.wire_speed_max_mm_s" in finding["remedy"] for finding in found)


def test_metal_is_read_where_it_was_spread():
    """Reading a field at places is the transpose of spreading values over cells; what lies beside the grid takes no part."""
    target = target_of(shapely.box(0, 0, 30, 20), 1.0, 3.0)
    rng = np.random.default_rng(3)
    places, values = rng.uniform(-8.0, 38.0, (400, 2)), rng.uniform(size=400)
    field, cells = rng.uniform(size=target.share.shape), _Cells(target, places)
    assert (cells.spread(values) * field).sum() == pytest.approx((cells.read(field) * values).sum())
    within = ((places > [-2.5, -2.5]) & (places < [32.5, 22.5])).all(axis=1)
    assert cells.spread(values * within).sum() == pytest.approx((values * within).sum())

"""What a process engineer asks of a path: directions, places to keep out of, seams, overhangs, beads, allowance, pauses."""

from __future__ import annotations

import math

import numpy as np
import pytest
from nc_stack import hatch, make_curves, make_plan, stack

from ebamcheck.checks.process_checks import outside_sectors
from ebamcheck.curves import fit
from ebamcheck.errors import SettingsError
from ebamcheck.layers.stack import from_polygons, from_rings
from ebamcheck.program import program_summary, read_program, verify_file, verify_program, write_program
from ebamcheck.scan.islands.regions import layer_regions
from ebamcheck.settings.config import Config

SQUARE = np.array([(0, 0), (40, 0), (40, 40), (0, 40), (0, 0)], float)


def checks_of(tmp_path, rings, process=None, islands=(), layers=None, height=1.5, beads=False):
    """Checks by name of a program of one polyline ring a layer."""
    heights = (np.arange(len(rings)) + 0.5) * height
    config = Config().changed(process=process or {})
    curves = make_curves(heights, [[[(ring, None)]] for ring in rings], [True] * len(rings))
    files = write_program(curves, make_plan(heights, list(islands)), config, tmp_path / "p")
    nc = read_program(files.main, config)
    sections = from_rings(heights, layers) if layers else None
    return {c.name: c for c in verify_program(nc, config=config, layers=sections, heights=heights, beads=beads)}, files


def line_of(check, files):
    name, line = check.where.split(":")
    return (files.folder / name).read_text().split("\n")[int(line) - 1]


# -- directions --------------------------------------------------------------------------------------


def test_degrees_outside_of_sectors():
    found = outside_sectors(np.array([0.0, 90.0, 200.0, -10.0, 359.0]), ((350.0, 20.0), (80.0, 100.0)))
    assert found.tolist() == [0.0, 0.0, 100.0, 0.0, 0.0]
    assert outside_sectors(np.array([123.0]), ((0.0, 360.0),)).tolist() == [0.0]


def test_a_travel_out_of_the_feeders_sector_is_named(tmp_path):
    found, files = checks_of(tmp_path, [SQUARE], {"travel_sectors_deg": ((-95.0, 95.0),)})
    check = found["travel sectors"]
    assert not check.passed
    assert check.value == pytest.approx(85.0)
    assert "X0.0" in line_of(check, files)
    everywhere, _ = checks_of(tmp_path, [SQUARE], {"travel_sectors_deg": ((-10.0, 280.0),)})
    assert everywhere["travel sectors"].passed


# -- places ------------------------------------------------------------------------------------------

CLAMP = {"name": "left clamp", "outline_mm": ((-20, 10), (-4, 10), (-4, 30), (-20, 30)), "z_mm": (0.0, 5.0)}


def test_a_bead_near_a_clamp_is_named(tmp_path):
    found, _ = checks_of(tmp_path, [SQUARE], {"keep_out": (CLAMP,)})
    assert found["keep-out zones"].passed
    moved = {**CLAMP, "outline_mm": tuple((x + 2, y) for x, y in CLAMP["outline_mm"])}
    found, files = checks_of(tmp_path, [SQUARE], {"keep_out": (moved,)})
    check = found["keep-out zones"]
    assert check.value == pytest.approx(1.0)
    assert "left clamp" in check.text
    assert check.where.startswith("MAIN_L0001.SPF:")
    assert "Y0.0" in line_of(check, files)


def test_a_clamp_is_in_the_way_up_to_its_height_only(tmp_path):
    low = {**CLAMP, "outline_mm": ((-4, 10), (4, 10), (4, 30), (-4, 30)), "z_mm": (0.0, 1.0)}
    assert checks_of(tmp_path, [SQUARE], {"keep_out": (low,)})[0]["keep-out zones"].passed


# -- seams and overhangs -----------------------------------------------------------------------------


def test_seams_on_top_of_each_other_are_named(tmp_path):
    stacked, _ = checks_of(tmp_path, [SQUARE, SQUARE], {"least_seam_distance_mm": 5.0})
    assert not stacked["seams"].passed
    assert stacked["seams"].where.startswith("MAIN_L0002.SPF:")
    turned = np.vstack([SQUARE[1:], SQUARE[1]])
    apart, _ = checks_of(tmp_path, [SQUARE, turned], {"least_seam_distance_mm": 5.0})
    assert apart["seams"].passed
    assert apart["seams"].value == pytest.approx(40.0)


def area_of(check):
    return float(check.text.split(", ")[1].split(" mm2")[0])


@pytest.mark.parametrize("reach", [0.5, 1.5, 4.0])
def test_the_angle_of_an_overhang(tmp_path, reach):
    wider = SQUARE + np.where(SQUARE > 20, reach, 0.0) * (1, 0)
    found, _ = checks_of(tmp_path, [SQUARE, wider], {"largest_overhang_deg": 45.0})
    angle = math.degrees(math.atan2(reach, 1.5))
    assert found["overhang"].value == pytest.approx(angle, abs=1e-6)
    assert found["overhang"].passed == (angle <= 45.0 + 1e-9)
    if angle > 46:
        assert area_of(found["overhang"]) == pytest.approx((reach - 1.5) * 46, rel=1e-5)
        assert found["overhang"].where.startswith("MAIN_L0002.SPF:")


@pytest.mark.parametrize("limit_deg", [None, 80.0, 89.0])
@pytest.mark.parametrize(("reach", "area"), [(5.9, 0.0), (6.1, 0.1 * 46), (20.0, 14 * 46 - 8 * 34)])
def test_no_angle_lets_metal_begin_on_nothing(tmp_path, limit_deg, reach, area):
    """A cantilever that begins within one layer hangs in the air beyond the width of a bead, whatever slopes may do."""
    wider = SQUARE + np.where(SQUARE > 20, reach, 0.0) * (1, 0)
    process = {"bead_width_mm": 6.0, "largest_overhang_deg": limit_deg}
    found = checks_of(tmp_path, [SQUARE, wider], process)[0]["overhang"]
    assert found.value == pytest.approx(math.degrees(math.atan2(reach, 1.5)), abs=1e-6)
    assert found.limit == pytest.approx(math.degrees(math.atan2(6.0, 1.5)), abs=1e-6)
    assert found.passed == (reach < 6.0)
    assert ("farther than a bead is wide" in found.text) == (reach > 6.0)
    if reach > 6.0:
        assert area_of(found) == pytest.approx(area, rel=1e-5)
        assert found.where.startswith("MAIN_L0002.SPF:")


def rings_of_stack(tmp_path, rings, islands=(), process=None):
    """Check `overhang` of layers of several polyline rings each."""
    heights = (np.arange(len(rings)) + 0.5) * 1.5
    config = Config().changed(process={"bead_width_mm": 6.0, **(process or {})})
    curves = make_curves(heights, [[[(r, None)] for r in layer] for layer in rings], [True] * sum(map(len, rings)))
    files = write_program(curves, make_plan(heights, list(islands)), config, tmp_path / "p")
    nc = read_program(files.main, config)
    return {c.name: c for c in verify_program(nc, config=config, heights=heights)}["overhang"]


def box(x0, y0, x1, y1):
    return np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1), (x0, y0)], float)


@pytest.mark.parametrize("span", [11.9, 12.1, 36.0])
def test_a_roof_over_a_hole_reaches_out_by_half_of_its_span(tmp_path, span):
    """Beads around the hole run half a bead's width beside it; those of the roof are hatch over it."""
    hole = box(-span / 2 - 3, -span / 2 - 3, span / 2 + 3, span / 2 + 3)[::-1]
    side = span / 2 + 9
    lines = [(-side, y, side, y) for y in np.linspace(-side, side, 20)[1:-1]]
    outer = box(-side, -side, side, side)
    found = rings_of_stack(tmp_path, [[outer, hole], [outer]], [(1, lines)])
    assert found.value == pytest.approx(math.degrees(math.atan2(span / 2, 1.5)), abs=0.02) or span < 12.0
    assert found.passed == (span < 12.0)
    assert found.passed or found.where.startswith("MAIN_L0002.SPF:")


@pytest.mark.parametrize("gap", [11.9, 12.1, 60.0])
def test_a_bead_between_two_posts_reaches_out_by_half_of_its_span(tmp_path, gap):
    """The beam is one bead wide, so that it has no contour; posts end half a bead's width beside their contours."""
    posts = [box(-30 - gap / 2, -3, -gap / 2 - 3, 3), box(gap / 2 + 3, -3, 30 + gap / 2, 3)]
    beam = [(-30.0 - gap / 2, 0.0, 30.0 + gap / 2, 0.0)]
    found = rings_of_stack(tmp_path, [posts, []], [(1, beam)])
    assert found.passed == (gap < 12.0)
    if not found.passed:
        assert found.value == pytest.approx(math.degrees(math.atan2(gap / 2, 1.5)), abs=0.05)
        assert found.where.startswith("MAIN_L0002.SPF:")


def test_a_bead_that_runs_round_between_two_contours_hides_no_hole(tmp_path):
    rings = [circle(40.0), circle(37.5), circle(33.0)[::-1]]
    found = rings_of_stack(tmp_path, [rings, rings])
    assert found.passed
    assert found.value == pytest.approx(0.0, abs=0.01)


def circle(radius):
    turn = np.linspace(0.0, 2.0 * np.pi, 97)
    return radius * np.column_stack([np.cos(turn), np.sin(turn)])


# -- beads -------------------------------------------------------------------------------------------


def filled(tmp_path, lines):
    """A square of a contour bead and hatch lines, checked against its section."""
    section = SQUARE[:-1] + np.where(SQUARE[:-1] > 20, 3.0, -3.0)
    return checks_of(tmp_path, [SQUARE], islands=[(0, lines)], layers=[[section]], beads=True)


def lines():
    return hatch(3.0, 3.2, 9, 34.0)


def test_a_filled_square_has_no_gap(tmp_path):
    found, _ = filled(tmp_path, lines())
    assert all(found[name].passed for name in ("hatch spacing", "lines laid once", "coverage", "repeated blocks"))
    assert "no gap" in found["coverage"].text


def test_a_missing_line_is_named_by_the_one_after_it(tmp_path):
    some = lines()
    del some[4]
    found, files = filled(tmp_path, some)
    assert not found["hatch spacing"].passed
    assert found["hatch spacing"].value == pytest.approx(2 * 4.32)
    assert "Y24.8" in line_of(found["hatch spacing"], files)
    assert "1 gaps" in found["coverage"].text


def test_lines_of_islands_that_lie_beside_each_other_have_none_between_them(tmp_path):
    # One after the other in the text and parallel, 8.64 mm apart across, but the one ends where the other has yet to begin.
    left, right = [(4.0, 10.0, 10.0, 10.0)], [(24.0, 18.64, 34.0, 18.64)]
    found, _ = filled(tmp_path, left + right)
    assert found["hatch spacing"].passed
    assert not found["coverage"].passed
    over, _ = filled(tmp_path, [(10.0, 10.0, 26.0, 10.0), *right])
    assert not over["hatch spacing"].passed


def test_a_line_laid_twice_is_named(tmp_path):
    some = lines()
    found, files = filled(tmp_path, [*some, some[2]])
    assert not found["lines laid once"].passed
    assert "Y11.84" in line_of(found["lines laid once"], files)


def test_a_bare_half_fails_the_coverage_with_its_place(tmp_path):
    found, _ = filled(tmp_path, lines()[:4])
    check = found["coverage"]
    assert not check.passed
    assert check.value < 0.8
    assert check.where.startswith("MAIN_L0001.SPF:")
    assert "mm2 at (" in check.text


# -- rapids whose axes arrive one after the other --------------------------------------------------


CORNER = {"name": "corner", "outline_mm": ((70, 0), (100, 0), (100, 30), (70, 30)), "z_mm": (0.0, 80.0)}
"""28 mm beside the straight way from (0, 0) to (100, 100), and on that of axes that arrive one after the other."""


def rapid_checks(tmp_path, control, way, clamp=CORNER):
    suffix = {"fanuc": "cnc", "linuxcnc": "ngc"}[control]
    path = tmp_path / f"WAY.{suffix}"
    path.write_text("\n".join(["G17 G21 G90 G94", "G0 Z90.0", "G0 X0.0 Y0.0", "G0 Z60.0", *way, "M30", ""]))
    config = Config().changed(machine={"control": control}, process={"keep_out": (clamp,)})
    return {c.name: c for c in verify_file(path, config=config)}


BESIDE = ("keep-out zones", "collision", "clearance")


def test_a_rapid_of_a_fanuc_may_lead_anywhere_within_its_box(tmp_path):
    """Each of its axes goes at its own speed, so that its way is a dog-leg."""
    there, back = "G0 X100.0 Y100.0", "G0 X0.0 Y0.0"
    found = rapid_checks(tmp_path, "fanuc", [there, back])
    for name in BESIDE:
        assert not found[name].passed, name
        assert found[name].where in ("WAY.cnc:5", "WAY.cnc:6")
    assert found["collision"].value == pytest.approx(20.0)
    assert found["clearance"].value == pytest.approx(25.0)
    straight = rapid_checks(tmp_path, "linuxcnc", [there, back])
    assert all(straight[name].passed for name in BESIDE)


def test_rapids_of_one_axis_lead_straight_on_a_fanuc(tmp_path):
    found = rapid_checks(tmp_path, "fanuc", ["G0 Y100.0", "G0 X100.0", "G0 X0.0", "G0 Y0.0"])
    assert all(found[name].passed for name in BESIDE)


def test_a_rapid_of_a_fanuc_over_a_clamp_needs_no_box(tmp_path):
    low = {**CORNER, "z_mm": (0.0, 55.0)}
    found = rapid_checks(tmp_path, "fanuc", ["G0 X100.0 Y100.0", "G0 X0.0 Y0.0"], low)
    assert all(found[name].passed for name in BESIDE)


# -- allowance and pauses --------------------------------------------------------------------------------


HEIGHTS = np.array([0.75, 2.25])


def program_of(tmp_path, config):
    """Program of the contour beads of a square block, and its sections."""
    sections = from_rings(HEIGHTS, [[SQUARE[:-1]]] * 2)
    beads = [layer_regions(sections.polygons(k)[0], config).contour for k in range(2)]
    curves = fit(from_polygons(HEIGHTS, [[bead] for bead in beads]), config.curves.method, config.curves)
    files = write_program(curves, make_plan(HEIGHTS, []), config, tmp_path / "p")
    return read_program(files.main, config), sections


def section_of(nc, sections, config):
    checks = verify_program(nc, config=config, layers=sections)
    return next(check for check in checks if check.name == "section")


@pytest.mark.parametrize("allowance", [0.0, 0.8, 3.0])
def test_the_allowance_moves_the_bead_outwards(tmp_path, allowance):
    config = Config().changed(process={"machining_allowance_mm": allowance})
    nc, sections = program_of(tmp_path, config)
    ends = nc.end[nc.deposit, :2]
    assert np.allclose([ends.min(axis=0), ends.max(axis=0)], [[3 - allowance] * 2, [37 + allowance] * 2])
    assert section_of(nc, sections, config).passed


def test_a_program_without_the_allowance_asked_for_is_named(tmp_path):
    nc, sections = program_of(tmp_path, Config())
    check = section_of(nc, sections, Config().changed(process={"machining_allowance_mm": 0.8}))
    assert not check.passed
    assert check.value == pytest.approx(0.8, abs=0.35)  # up to 0.8 times the root of 2 at a corner
    assert check.where.startswith("MAIN_L000")


# -- pauses ------------------------------------------------------------------------------------------

CONTROLS = {"sinumerik-840d-sl": "G4 F30 ", "linuxcnc": "G4 P30 ", "plain-gcode": "G4 S30 "}
WIDE = {"travel_min_mm": (-2000.0, -2000.0, 0.0), "travel_max_mm": (2000.0, 2000.0, 2000.0)}


def paused(tmp_path, control, seconds=30.0):
    """A stack of three layers written with a wait between them: settings and files."""
    config = Config().changed(
        process={"layer_pause_s": seconds, "interpass": "off"},
        machine={**WIDE, "control": control, "curve_form": "lines"},
    )
    return config, write_program(*stack(), config, tmp_path / "p")


def pause_check(files, config):
    nc = read_program(files.main, config)
    return next(c for c in verify_program(nc, config=config) if c.name == "layer pause"), nc


@pytest.mark.in_turn(3)
@pytest.mark.parametrize("control", CONTROLS)
def test_a_program_waits_between_its_layers_and_after_none_else(tmp_path, control):
    config, files = paused(tmp_path, control)
    text = "".join(path.read_text() for path in sorted(files.folder.iterdir()))
    assert text.count(CONTROLS[control]) == 2
    check, nc = pause_check(files, config)
    assert check.passed, check.text
    assert program_summary(nc, config)["pause_s"].tolist() == [0.0, 30.0, 30.0]
    short = config.changed(process={"layer_pause_s": 20.0})
    assert not pause_check(files, short)[0].passed
    assert "waits 30 s before layer 2 in place of 20 s" in pause_check(files, short)[0].text


@pytest.mark.parametrize("control", CONTROLS)
def test_without_a_pause_there_is_no_word_of_it(tmp_path, control):
    config, files = paused(tmp_path, control, seconds=0.0)
    assert not any("G4 " in path.read_text() for path in files.folder.iterdir())
    assert pause_check(files, config)[0].passed


@pytest.mark.parametrize("control", CONTROLS)
@pytest.mark.parametrize("fault", ["lost", "longer", "in the layer"])
def test_a_wrong_pause_is_found(tmp_path, control, fault):
    config, files = paused(tmp_path, control)
    word = CONTROLS[control].strip()
    path = next(path for path in sorted(files.folder.iterdir()) if word in path.read_text())
    lines = path.read_text().splitlines(keepends=True)
    at = next(n for n, line in enumerate(lines) if word in line)
    if fault == "longer":
        lines[at] = lines[at].replace("30", "300")
    else:
        line = lines.pop(at)
        if fault == "in the layer":
            lines.insert(at - 8, line)
    path.write_text("".join(lines))
    check, _ = pause_check(files, config)
    assert not check.passed
    assert {"lost": "waits 0 s", "longer": "waits 300 s", "in the layer": "of layer 1 in place of 0 s"}[
        fault
    ] in check.text


def test_a_simulator_waits_too(tmp_path):
    times = []
    for seconds in (0.0, 30.0):
        _, files = paused(tmp_path / str(seconds), "3dthesis", seconds)
        rows = [line.split() for line in files.main.read_text().splitlines()]
        spots = [row for row in rows if len(row) == 6 and row[0] == "1"]
        times.append([float(row[5]) for row in spots])
    longer = np.subtract(times[1], times[0])
    assert np.isclose(longer, 30.0).sum() == 2
    assert np.isclose(longer, 0.0).sum() == len(longer) - 2


@pytest.mark.parametrize(
    "blocks", [(), ("G4 F30",), ("M1 ; wait {layer_pause_s}",), ("H9={layer_pause_s}", "G4 F{layer_pause_s}")]
)
def test_a_wait_that_cannot_be_read_back_is_refused(blocks):
    with pytest.raises(SettingsError, match="in one block, once"):
        Config().changed(machine={"layer_pause": blocks})

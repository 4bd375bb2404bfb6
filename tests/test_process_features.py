"""What a process engineer sets for the contour bead, and where it shows in the program's text."""

from __future__ import annotations

import numpy as np
import pytest
from nc_stack import make_plan, stack

from ebamcheck.curves import fit
from ebamcheck.errors import SettingsError
from ebamcheck.layers.stack import from_polygons, from_rings
from ebamcheck.program import program_summary, read_program, verify_program, write_program
from ebamcheck.scan.islands.regions import layer_regions
from ebamcheck.settings.config import Config

SQUARE = np.array([(0, 0), (40, 0), (40, 40), (0, 40)], float)
HEIGHTS = np.array([0.75, 2.25])


def program_of(tmp_path, config):
    """Program of the contour beads of a square block, and its sections."""
    sections = from_rings(HEIGHTS, [[SQUARE]] * 2)
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

"""What a process engineer sets for the contour bead, and where it shows in the program's text."""

from __future__ import annotations

import numpy as np
import pytest
from nc_stack import make_plan

from ebamcheck.config import Config
from ebamcheck.curves import fit
from ebamcheck.layers import from_polygons, from_rings
from ebamcheck.program import read_program, verify_program, write_program
from ebamcheck.scan.regions import layer_regions

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

"""The wire of single beads, by text and sections alone, on sections that taper: what their rims lack heaps up inside of them."""

from dataclasses import replace

import numpy as np
import pytest
import shapely
from prism_program import Made

from ebamcheck.program.checking.bead_wire import NAME, bead_wire_check
from ebamcheck.program.reading.roles import beads_of, by_height, by_section

LAYERS = 22


@pytest.fixture(scope="module")
def tapered(tmp_path_factory):
    """A square that gets narrower from 44 to 14 mm, and its program as one reads it who knows the sections alone."""
    sides = np.linspace(44.0, 14.0, LAYERS) / 2.0
    made = Made(tmp_path_factory.mktemp("tapered"), [shapely.box(-s, -s, s, s) for s in sides], layers=LAYERS)
    nc = by_height(made.read(), made.z)
    return made, by_section(nc, made.layers, made.z, made.config.contour_offset_mm, 0.75)


def checked(made, nc):
    check = bead_wire_check(nc, made.config, made.z, made.layers)
    assert check.name == NAME
    return check


def test_a_sound_program_of_a_taper_passes_on_a_surface_that_heaps_up(tapered):
    made, nc = tapered
    surface = made.checks()["surface"]
    assert surface.passed
    assert "too high" in surface.text
    assert surface.value > 1.0
    assert checked(made, nc).passed


@pytest.mark.parametrize("factor", [0.5, 1.6])
@pytest.mark.parametrize("layer", [1, LAYERS // 2, LAYERS - 2])
def test_a_bead_of_other_wire_is_found_on_it(tapered, layer, factor):
    made, nc = tapered
    beads = beads_of(nc)
    length = np.bincount(beads.bead, nc.lengths[beads.rows], minlength=beads.first.size)
    mine = np.flatnonzero((nc.layer[beads.first] == layer) & (nc.ring[beads.first] < 0))
    longest = mine[np.argmax(length[mine])]
    wire = nc.wire_mm_s.copy()
    wire[beads.rows[beads.bead == longest]] *= factor
    found = checked(made, replace(nc, wire_mm_s=wire))
    assert not found.passed
    assert found.layer == layer

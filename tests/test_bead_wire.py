"""The wire of single beads, by text and sections alone, on sections that taper: what their rims lack heaps up inside of them."""

from dataclasses import replace

import numpy as np
import pytest
import shapely
from prism_program import Made

from ebamcheck.checks.metal import deposit
from ebamcheck.checks.metal_rules import WIRE_OF_BEADS, bead_wire_check, most_off
from ebamcheck.nc.roles import by_height, by_section

LAYERS = 22


@pytest.fixture(scope="module")
def tapered(tmp_path_factory):
    """A square that gets narrower from 44 to 14 mm, and its program as one reads it who knows the sections alone."""
    sides = np.linspace(44.0, 14.0, LAYERS) / 2.0
    made = Made(tmp_path_factory.mktemp("tapered"), [shapely.box(-s, -s, s, s) for s in sides], layers=LAYERS)
    nc = by_height(made.read(), made.z)
    return made, by_section(nc, made.layers, made.z, made.config.contour_offset_mm, 0.75)


def checked(made, nc):
    check = bead_wire_check(nc, deposit(nc, made.layers, made.z, made.config, asked=True), made.config)
    assert check.name == WIRE_OF_BEADS
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
    beads = nc.beads
    length = np.bincount(beads.bead, nc.lengths[beads.rows], minlength=beads.first.size)
    mine = np.flatnonzero((nc.layer[beads.first] == layer) & (nc.ring[beads.first] < 0))
    longest = mine[np.argmax(length[mine])]
    wire = nc.wire_mm_s.copy()
    wire[beads.rows[beads.bead == longest]] *= factor
    found = checked(made, replace(nc, wire_mm_s=wire))
    assert not found.passed
    assert found.layer == layer


# -- webs and fins on a plate ---------------------------------------------------------------------------------

THICKNESSES = np.arange(3.0, 30.1, 0.5)
QUICK = (3.0, 6.0, 6.5, 7.0, 7.5, 10.5, 19.0)


def webs(thickness_mm, count=1, plate_layers=3, web_layers=14):
    """Sections of so many webs on a plate, one of each layer."""
    pitch = thickness_mm + 15.0
    width = 30.0 + count * pitch
    plate = shapely.box(0.0, 0.0, 60.0, width)
    each = [shapely.box(0.0, y, 60.0, y + thickness_mm) for y in 22.5 + pitch * np.arange(count)]
    return [plate] * plate_layers + [shapely.union_all(each)] * web_layers


def read(made):
    return by_section(
        by_height(made.read(), made.z), made.layers, made.z, made.config.contour_offset_mm, 0.75
    )


@pytest.mark.parametrize("count", [1, 3])
@pytest.mark.parametrize(
    "thickness_mm",
    [pytest.param(t, marks=() if t in QUICK else pytest.mark.slow) for t in THICKNESSES.tolist()],
)
def test_wire_is_refused_only_where_the_metal_field_refuses_the_web_too(tmp_path, thickness_mm, count):
    """The verdict of a plate does not change with the webs on it, nor to and fro with their thickness."""
    sections = webs(thickness_mm, count)
    made = Made(tmp_path, sections, layers=len(sections))
    assert checked(made, read(made)).passed or made.failed()


@pytest.fixture(scope="module")
def plate(tmp_path_factory):
    made = Made(tmp_path_factory.mktemp("plate"), shapely.box(0.0, 0.0, 100.0, 60.0), layers=3)
    return made, read(made)


def contour_of(nc, layer):
    beads = nc.beads
    k = int(np.flatnonzero((nc.layer[beads.first] == layer) & (nc.ring[beads.first] >= 0))[0])
    return beads.rows[beads.bead == k]


def scaled(nc, rows, factor):
    wire = nc.wire_mm_s.copy()
    wire[rows] *= factor
    return replace(nc, wire_mm_s=wire)


@pytest.mark.parametrize(("share", "passes"), [(1.0 / 1.2, True), (1.2, False)])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_the_wire_of_a_whole_contour_has_a_limit(plate, share, passes, sign):
    """What it has too much of, beyond what its place asks for, is held against the limit of its length."""
    made, nc = plate
    rows = contour_of(nc, 1)
    limit = float(most_off(np.array([nc.lengths[rows].sum()]), made.config.process.bead_width_mm)[0])
    exact = checked(made, scaled(nc, rows, 1.0 + sign * 2.0 * limit)).value - 2.0 * limit
    found = checked(made, scaled(nc, rows, 1.0 + sign * (share * limit - exact)))
    assert found.passed == passes


@pytest.mark.parametrize("factor", [0.75, 1.25])
def test_a_quarter_over_eighteen_millimetres_of_a_contour_is_found(plate, factor):
    made, nc = plate
    rows = contour_of(nc, 1)
    along = np.cumsum(nc.lengths[rows])
    first = int(np.searchsorted(along, 10.0)) + 1
    last = int(np.searchsorted(along, along[first - 1] + 18.0))
    found = checked(made, scaled(nc, rows[first : last + 1], factor))
    assert not found.passed
    assert found.layer == 1

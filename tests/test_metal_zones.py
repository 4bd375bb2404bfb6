"""Every layer and every zone of the metal: what would spoil a part shuts the gate, however right the means are."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from prism_program import CONFIG, Made

from ebamcheck.checks.metal import NO_ZONES, ZONES, deposit, zone_figures, zone_limit, zone_off
from ebamcheck.checks.metal_rules import WIRE_OF_BEADS, bead_wire_check, most_off
from ebamcheck.kernels import Floats
from ebamcheck.layers.stack import from_polygons
from ebamcheck.metal import Surface, levelled, reachable, target_of
from ebamcheck.nc.roles import by_height, by_section

BLOCK = shapely.box(0, 0, 150, 130)
NOTCH = shapely.box(132, 112, 150, 130)
"""Three beads by three, 1.7 % of the block: less than its mass may be off by."""
POCKET = shapely.box(60, 50, 78, 68)
PROCESS = CONFIG.process


def stack(made, sections):
    return from_polygons(made.layers.heights, [[section] for section in sections])


@pytest.fixture(scope="module")
def notched(tmp_path_factory):
    """A program that leaves a corner bare."""
    return Made(tmp_path_factory.mktemp("notched"), BLOCK.difference(NOTCH), layers=3)


def test_a_corner_that_stays_bare_is_found(notched):
    assert notched.failed() == set()
    checks = notched.checks(stack(notched, [BLOCK] * 3))
    assert checks["metal"].passed
    assert checks["metal of layers"].passed
    assert not checks["height of zones"].passed
    place = re.search(r"at \((.*), (.*)\)", checks["height of zones"].text)
    assert NOTCH.distance(shapely.Point(float(place[1]), float(place[2]))) < 3.0
    # The surface sinks there by a layer a layer, and the pool is three millimetres deep.
    assert not checks["surface"].passed
    assert "too low" in checks["surface"].text


def test_a_corner_that_one_layer_leaves_bare_is_found(notched):
    sections = [BLOCK.difference(NOTCH)] * 2 + [BLOCK]
    checks = notched.checks(stack(notched, sections))
    assert {name for name, check in checks.items() if not check.passed} == {"height of zones"}
    assert checks["height of zones"].where.startswith("MAIN_L0003.SPF")


def test_a_pocket_that_stays_bare_is_found(tmp_path):
    made = Made(tmp_path, BLOCK.difference(POCKET), layers=2)
    failed = made.failed(stack(made, [BLOCK] * 2))
    assert "height of zones" in failed
    assert not failed & {"metal", "metal of layers"}


def thinned(made, name, share):
    """Lay the hatch of a layer with a share of its wire, and its contours with what that leaves."""

    def change(lines, hatch, contour):
        of_contour = False
        for i, line in enumerate(lines):
            of_contour = line.startswith("; RING") or (of_contour and not line.startswith("; ISLAND"))
            factor = contour if of_contour else hatch
            lines[i] = re.sub(r"H3=([\d.]+)", lambda m, f=factor: f"H3={f * float(m[1]):.6f}", line)

    def laid():
        return float(deposit(made.read(), made.layers, made.z, made.config).layers["laid_mm3"].iloc[1])

    whole = laid()
    made.edit(name, lambda lines: change(lines, share, 1.0))
    missing = whole - laid()
    of_contours = whole - missing / (1.0 - share)
    made.edit(name, lambda lines: change(lines, 1.0, 1.0 + missing / of_contours))
    assert laid() == pytest.approx(whole, rel=1e-4)


def test_one_layer_of_thin_hatch_is_found_though_its_mass_is_right(tmp_path):
    """85 % of the wire in every hatch line of one layer, and the rest in its contours."""
    made = Made(tmp_path, shapely.box(0, 0, 80, 60), layers=5)
    assert made.failed() == set()
    thinned(made, "MAIN_L0002.SPF", 0.85)
    checks = made.checks()
    assert checks["metal"].passed
    assert checks["metal of layers"].passed
    assert checks["height inside"].passed
    assert not checks["height of layers"].passed
    assert checks["height of layers"].where.startswith("MAIN_L0002.SPF")


def test_a_hole_that_closes_over_three_layers_is_found(tmp_path):
    """The program closes a hole of 20 mm by steps; the part keeps it open."""
    holes = [shapely.Point(40, 30).buffer(r, 32) for r in (10.0, 10.0, 8.0, 6.0, 4.0)]
    plate = shapely.box(0, 0, 80, 60)
    made = Made(tmp_path, [plate.difference(hole) for hole in holes], layers=5)
    checks = made.checks(stack(made, [plate.difference(holes[0])] * 5))
    assert not checks["reach of metal"].passed
    assert checks["reach of metal"].value > 5.0
    assert not checks["holes"].passed


# -- zones -------------------------------------------------------------------------------------------


def figures(share, laid, before=0.0, thickness=1.5):
    inside = share >= 0.5
    target = target_of(shapely.box(0, 0, *(np.array(share.shape[::-1]) - 2.0)), 1.0, 1.0)
    deep = np.zeros_like(inside)
    deep[7:-7, 7:-7] = inside[7:-7, 7:-7]
    parts = deep, inside & ~deep
    return zone_figures(target, laid, np.full_like(laid, before), parts, thickness, PROCESS)


SHARE: Floats = np.pad(np.ones((60, 80)), 1)


def test_an_even_layer_is_as_high_as_it_is_to_be_everywhere():
    found = figures(SHARE, 1.5 * SHARE)
    assert set(found) == set(NO_ZONES)
    for zone in ZONES:
        assert found[f"{zone}_settled"] == pytest.approx(1.0)
        assert found[f"{zone}_owed"] == pytest.approx(1.0)


def test_the_worst_window_lies_where_metal_is_missing():
    laid = 1.5 * SHARE
    laid[40:52, 20:32] = 0.0
    found = figures(SHARE, laid)
    assert abs(found["zone_x_mm"] - 25.0) < 6.0
    assert abs(found["zone_y_mm"] - 45.0) < 6.0
    assert found["zone_settled"] < 1.0 - float(zone_limit(0.03, found["zone_mm2"], PROCESS))


def test_metal_that_fills_what_was_left_is_not_wrong():
    low = figures(SHARE, 1.8 * SHARE, before=-0.3)
    high = figures(SHARE, 1.8 * SHARE, before=0.3)
    assert zone_off(low["inside_settled"], low["inside_owed"]) == pytest.approx(0.0)
    assert zone_off(high["inside_settled"], high["inside_owed"]) == pytest.approx(0.2)


@given(st.floats(36.0, 1e5), st.floats(1.01, 10.0))
def test_larger_zones_have_tighter_limits(area, factor):
    small, large = zone_limit(0.03, [area, factor * area], PROCESS)
    assert 0.03 < large < small


# -- the surface -------------------------------------------------------------------------------------


@given(st.floats(14.0, 30.0), st.floats(-0.4, 0.4), st.floats(-0.4, 0.4))
@settings(max_examples=20, deadline=None)
def test_the_surface_keeps_the_volume(radius, x, y):
    """A section that cuts cells at any place: as much metal as it is to have leaves the surface level on average."""
    disc = shapely.Point(x, y).buffer(radius, 32)
    surface = Surface(np.array(disc.bounds), 6.0)
    target = target_of(disc, surface.step_mm, 12.0)
    rng = np.random.default_rng(5)
    for _ in range(6):
        laid = 1.5 * target.share * rng.uniform(0.5, 1.5, target.share.shape)
        laid *= 1.5 * target.share.sum() / laid.sum()
        surface.add(target, laid, 1.5)
    over = surface.over_mm(target)
    assert abs(np.average(over, weights=target.share)) < 0.03


def test_a_bare_place_that_a_bead_could_reach_sinks_and_the_tip_of_a_corner_does_not():
    square = shapely.box(0, 0, 60, 60)
    surface = Surface(np.array(square.bounds), 6.0)
    target = target_of(square, surface.step_mm, 12.0)
    x, y = (target.origin[:, None, None] + (np.mgrid[:84, :84][::-1] + 0.5))[:, : target.share.shape[0]]
    bare = (np.abs(x - 30) < 12) & (np.abs(y - 30) < 12)
    tip = (x < 1) & (y < 1)
    for layer in range(3):
        surface.add(target, np.where(bare | tip, 0.0, 1.5 * target.share), 1.5)
        over = surface.over_mm(target)
        assert over[bare].min() == pytest.approx(-1.5 * (layer + 1), rel=0.05)
        assert over[tip & (target.share > 0.0)].min() > -0.5


def test_what_beads_reach_is_a_square_without_its_tips():
    inside = np.pad(np.ones((40, 30), bool), 2)
    left = inside & ~reachable(inside, 6.0)
    assert 4 <= left.sum() <= 24
    rows, columns = np.nonzero(left)
    assert (np.minimum(rows - 2, 41 - rows) + np.minimum(columns - 2, 31 - columns) < 4).all()
    assert not reachable(np.pad(np.ones((40, 4), bool), 2), 6.0).any()


def test_levelling_moves_no_metal_over_the_border():
    share = np.pad(np.ones((20, 30)), 3)
    height = share * np.random.default_rng(3).uniform(0.0, 2.0, share.shape)
    flat = levelled(height, share, 6.0)
    assert flat.sum() == pytest.approx(height.sum(), rel=1e-6)
    assert flat[share > 0].std() < 0.3 * height[share > 0].std()
    assert (flat[share == 0] == 0.0).all()


# -- wire of single beads --------------------------------------------------------------------------------


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
    return by_section(by_height(made.read(), made.z), made.layers, made.z, made.config.contour_offset_mm, 0.75)


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

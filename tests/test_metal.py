"""Metal: footprints of beads, the balance of their wire, the surface that is built up, and its picture."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from prism_program import Made
from scipy import ndimage
from section_zoo import solids, walls

from ebamcheck.checks.metal import deposit
from ebamcheck.metal import Surface, balanced_widths, footprints, target_of
from ebamcheck.metal.footprints import pooled
from ebamcheck.metal.surface import HALF
from ebamcheck.metal.target import border_distance, moved_to_neighbours

SECTIONS = dict([*solids(), *walls()])
BEAD_MM = 6.0
CELL_MM = 1.0


def laid_by(lines, width_mm, target, step_mm=0.25):
    """Footprints of straight lines (x0, y0, x1, y1), and the metal that they lay."""
    places, length, bead = [], [], []
    for n, (x0, y0, x1, y1) in enumerate(lines):
        whole = np.hypot(x1 - x0, y1 - y0)
        count = max(1, int(np.ceil(whole / step_mm)))
        t = (np.arange(count) + 0.5)[:, None] / count
        places.append((1.0 - t) * [x0, y0] + t * [x1, y1])
        length.append(np.full(count, whole / count))
        bead.append(np.full(count, n))
    cells = (np.concatenate(places) - target.origin) / target.step_mm
    found = footprints(
        cells,
        np.concatenate(length),
        np.concatenate(bead),
        len(lines),
        0.5 * BEAD_MM / target.step_mm,
        target.share.shape,
    )
    return found, found.laid(np.broadcast_to(width_mm, len(lines)), target.share.size, target.step_mm**2)


@pytest.mark.in_turn(5)
@pytest.mark.parametrize("name", SECTIONS)
@pytest.mark.parametrize("step", [0.4, 1.0, 1.7])
def test_cells_have_the_area_of_the_section(name, step):
    section = SECTIONS[name]
    target = target_of(section, step, BEAD_MM)
    area = shapely.union_all(shapely.get_parts(section)).area
    assert target.share.sum() * step**2 == pytest.approx(area, rel=1e-9)
    assert target.share.min() >= 0.0
    assert target.share.max() <= 1.0


@given(st.floats(0, np.pi), st.floats(-40, 40), st.floats(-40, 40), st.floats(0.5, 60))
@settings(max_examples=40, deadline=None)
def test_metal_is_conserved_wherever_a_bead_lies(angle, x, y, length):
    target = target_of(shapely.box(-60, -60, 60, 60), CELL_MM, 60.0)
    line = (x, y, x + length * np.cos(angle), y + length * np.sin(angle))
    found, laid = laid_by([line], 4.0, target)
    assert found.length_mm.sum() == pytest.approx(length)
    assert laid.sum() * CELL_MM**2 == pytest.approx(4.0 * length)


def test_a_long_bead_is_a_parabola():
    target = target_of(shapely.box(0, 0, 100, 20), 0.25, BEAD_MM)
    _, laid = laid_by([(-50, 10, 150, 10)], 4.0, target, step_mm=0.05)
    column = laid.reshape(target.share.shape)[:, target.share.shape[1] // 2]
    y = target.origin[1] + (np.arange(column.size) + 0.5) * target.step_mm - 10.0
    wanted = 1.5 * 4.0 / BEAD_MM * np.maximum(1.0 - (2.0 * y / BEAD_MM) ** 2, 0.0)
    assert column == pytest.approx(wanted, abs=0.02)


def test_beads_of_a_grating_get_their_pitch():
    pitch = 4.2
    section = shapely.box(0, 0, 60, 10 * pitch)
    target = target_of(section, CELL_MM, BEAD_MM)
    lines = [(3.0, (n + 0.5) * pitch, 57.0, (n + 0.5) * pitch) for n in range(10)]
    found, _ = laid_by(lines, 1.0, target)
    width = balanced_widths(found, target.share, np.ones_like(target.share), CELL_MM**2, np.full(10, 3.0), (0.1, 20.0))
    # Beads end half a bead before the border, and lay what lies beyond.
    assert width[3:7] == pytest.approx(pitch * 60.0 / 54.0, rel=0.03)
    assert (width * 54.0).sum() == pytest.approx(section.area, rel=1e-6)


@pytest.mark.parametrize("thickness", [6.0, 5.0, 3.0])
def test_one_bead_in_a_wall_lays_the_wall(thickness):
    section = shapely.box(0, 0, 80, thickness)
    target = target_of(section, 0.5, BEAD_MM)
    found, _ = laid_by([(0, thickness / 2, 80, thickness / 2)], 1.0, target)
    width = balanced_widths(found, target.share, np.ones_like(target.share), 0.25, np.array([4.0]), (0.1, 20.0))
    assert width == pytest.approx([thickness], rel=0.01)


def test_limits_hold_and_turned_sections_get_the_same_widths():
    section = shapely.box(0, 0, 40, 8)
    lines = np.array([(3.0, 2.0, 37.0, 2.0), (3.0, 6.0, 37.0, 6.0)])
    turned = lines[:, [1, 0, 3, 2]]
    widths = []
    for place, beads in ((section, lines), (shapely.box(0, 0, 8, 40), turned)):
        target = target_of(place, CELL_MM, BEAD_MM)
        found, _ = laid_by(beads, 1.0, target)
        args = (found, target.share, np.ones_like(target.share), CELL_MM**2, np.full(2, 3.0))
        widths.append(balanced_widths(*args, (0.1, 20.0)))
        assert balanced_widths(*args, (1.0, 2.5)) == pytest.approx([2.5, 2.5])
    assert widths[0] == pytest.approx(widths[1], rel=1e-9)
    assert widths[0][0] == pytest.approx(widths[0][1], rel=1e-6)


@pytest.mark.parametrize("thickness", [6.5, 7.5])
def test_a_bead_that_others_cover_gets_the_least_wire_while_they_make_up_for_the_rim(thickness):
    target = target_of(shapely.box(0, 0, 60, thickness), 0.5, BEAD_MM)
    middle = [(3.0, y, 57.0, y) for y in (0.5 * thickness - 1.7, 0.5 * thickness + 1.7)]
    found, _ = laid_by([*middle, (28.0, 0.5 * thickness, 32.0, 0.5 * thickness)], 1.0, target)
    some = found, target.share, np.where(target.share < 1.0, 0.4, 1.0), 0.25, np.full(3, 3.0)
    free, held = balanced_widths(*some, (0.01, 20.0)), balanced_widths(*some, (1.0, 20.0))
    assert free[2] < 1.0
    assert held[2] == 1.0
    assert held[:2] == pytest.approx(free[:2], rel=0.1)
    assert found.laid(held, target.share.size, 0.25).sum() == pytest.approx(target.share.sum(), rel=1e-6)


# -- the surface ---------------------------------------------------------------------------------------


def built(section, heights, step=CELL_MM):
    """Surface of layers laid as fields of a height over that of the layer, and their target."""
    surface = Surface(np.array(section.bounds), BEAD_MM)
    target = target_of(section, surface.step_mm, 2.0 * BEAD_MM)
    for height in heights:
        surface.add(target, target.share * height, 1.5)
    return surface.over_mm(target), target


def test_every_layer_too_high_adds_up():
    over, target = built(shapely.box(0, 0, 40, 30), [1.6] * 20)
    assert over[target.share >= HALF] == pytest.approx(2.0)


def test_levelling_loses_no_metal_and_a_heap_spreads():
    section = shapely.box(0, 0, 60, 40)
    surface = Surface(np.array(section.bounds), BEAD_MM)
    target = target_of(section, surface.step_mm, 2.0 * BEAD_MM)
    laid = 1.5 * target.share
    row, column = np.argwhere(target.share == 1.0)[700]
    laid[row - 2 : row + 3, column - 2 : column + 3] += 1.0
    surface.add(target, laid, 1.5)
    first = surface.over_mm(target).max()
    heap = (surface._over_mm * surface._share).sum()
    assert heap == pytest.approx(25.0, rel=1e-9)
    for _ in range(10):
        surface.add(target, 1.5 * target.share, 1.5)
    assert (surface._over_mm * surface._share).sum() == pytest.approx(25.0, rel=1e-9)
    assert 0.0 < surface.over_mm(target).max() < 0.5 * first


def test_new_ground_begins_level_and_what_is_left_is_forgotten():
    surface = Surface(np.array([0, 0, 60, 40]), BEAD_MM)
    small = target_of(shapely.box(0, 0, 30, 40), surface.step_mm, 2.0 * BEAD_MM)
    large = target_of(shapely.box(0, 0, 60, 40), surface.step_mm, 2.0 * BEAD_MM)
    surface.add(small, 2.0 * small.share, 1.5)
    surface.add(large, 1.5 * large.share, 1.5)
    over = surface.over_mm(large)
    middle = over.shape[0] // 2
    filled = np.flatnonzero(large.share[middle] >= HALF)
    assert over[middle, filled[2]] == pytest.approx(0.5, abs=0.05)
    assert over[middle, filled[-2]] == pytest.approx(0.0, abs=0.05)


# -- hundreds of like layers --------------------------------------------------------------------------------


ANGLE = 2.0 * np.pi * np.arange(48) / 48
PRISMS = {
    "a column of 48 sides": shapely.Polygon(16.0 * np.column_stack([np.cos(ANGLE), np.sin(ANGLE)])),
    "a box on the lines of the grid": shapely.box(0.0, 0.0, 20.0, 20.0),
}


@pytest.mark.parametrize("name", PRISMS)
def test_the_surface_of_a_long_prism_stays_where_it_is(name, tmp_path):
    """It sank by 0.026 mm a layer: the plan took rims with a film of metal for bare, and forgot what they lacked."""
    made = Made(tmp_path, PRISMS[name], layers=64)
    table = deposit(made.read(), made.layers, made.z, made.config).layers
    low, high = table["low_mm"].to_numpy(), table["high_mm"].to_numpy()
    middle, last = slice(24, 32), slice(56, 64)
    assert low[last].max() <= low[middle].max() + 0.15
    assert high[last].max() <= high[middle].max() + 0.15
    assert high[last].min() > 0.3  # as much over its height as under it
    assert low.max() < 1.4
    assert 0.97 < (table["laid_mm3"] / table["wanted_mm3"]).iloc[-8:].mean() < 1.02


@pytest.mark.slow
def test_320_like_layers_pass_the_gate_of_the_metal(tmp_path):
    """By default the surface may lie half a bead off: 3 mm. It lay 8 mm off."""
    made = Made(tmp_path, PRISMS["a column of 48 sides"], layers=320)
    failed = made.failed()
    assert failed == set()


@settings(deadline=None, max_examples=60)
@given(st.floats(8.0, 24.0), st.floats(8.0, 24.0), st.floats(1.0, 4.0), st.floats(0.1, 9.0))
def test_pools_keep_metal_and_its_middle(x, y, radius, area):
    laid = pooled(np.array([[x, y]]), np.array([area]), radius, (32, 32), 0.5)
    assert laid.sum() * 0.5 == pytest.approx(area)
    rows, columns = np.mgrid[:32, :32] + 0.5
    assert (laid * columns).sum() / laid.sum() == pytest.approx(x, abs=1e-6)
    assert (laid * rows).sum() / laid.sum() == pytest.approx(y, abs=1e-6)
    away = np.hypot(columns - x, rows - y)
    assert not laid[away > radius + 1.5].any()


# -- distances between cells, against those of SciPy; and what depends on them ------------------------------


def masks():
    """Masks of many shapes, from single rows to blobs."""
    rng = np.random.default_rng(7)
    for _ in range(60):
        shape = tuple(rng.integers(1, 40, 2))
        yield rng.random(shape) < rng.random() ** 0.3
        yield np.kron(rng.random((5, 6)) < 0.7, np.ones(shape)).astype(bool)[:50, :50]


def test_distances_are_those_of_scipy_to_the_last_bit():
    for cells in masks():
        if not cells.all():
            assert np.array_equal(border_distance(cells), ndimage.distance_transform_edt(cells))


def test_values_move_to_the_nearest_cell_that_touches():
    rng = np.random.default_rng(8)
    for to in masks():
        field, moved = rng.random(to.shape), ~to & (rng.random(to.shape) < 0.5)
        found = np.zeros(to.shape)
        moved_to_neighbours(found, field, moved, to)
        touching = ndimage.binary_dilation(to, np.ones((3, 3)))
        assert found.sum() == pytest.approx(field[moved & touching].sum(), abs=1e-9)
        assert not found[~to].any()

"""Metal: footprints of beads, the balance of their wire, and the surface that is built up."""

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from section_zoo import solids, walls

from ebamcheck.metal import Surface, balanced_widths, footprints, target_of
from ebamcheck.metal.surface import HALF

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
    width = balanced_widths(
        found, target.share, np.ones_like(target.share), CELL_MM**2, np.full(10, 3.0), (0.1, 20.0)
    )
    # Beads end half a bead before the border, and lay what lies beyond.
    assert width[3:7] == pytest.approx(pitch * 60.0 / 54.0, rel=0.03)
    assert (width * 54.0).sum() == pytest.approx(section.area, rel=1e-6)


@pytest.mark.parametrize("thickness", [6.0, 5.0, 3.0])
def test_one_bead_in_a_wall_lays_the_wall(thickness):
    section = shapely.box(0, 0, 80, thickness)
    target = target_of(section, 0.5, BEAD_MM)
    found, _ = laid_by([(0, thickness / 2, 80, thickness / 2)], 1.0, target)
    width = balanced_widths(
        found, target.share, np.ones_like(target.share), 0.25, np.array([4.0]), (0.1, 20.0)
    )
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


def test_layers_of_the_right_height_stay_flat():
    over, target = built(shapely.box(0, 0, 40, 30), [1.5] * 20)
    assert np.abs(over).max() == pytest.approx(0.0, abs=1e-12)
    assert target.share.sum() == pytest.approx(1200.0)


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

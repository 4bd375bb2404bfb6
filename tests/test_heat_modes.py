"""Cells and modes of the heat model: areas by shapely, eigenvalues in closed form, orthonormal modes."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely
from closed_form_heat import rectangle_modes, slope_at_base
from heat_sections import RING, SHAPES, gauss
from scipy.special import jnp_zeros
from shapely import affinity

from ebamcheck.errors import GeometryError
from ebamcheck.heat import contour_modes, depth_modes
from ebamcheck.heat.modes import section_grid

# -- cells ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", SHAPES)
def test_cells_have_the_area_that_shapely_cuts(name):
    section = SHAPES[name]
    grid = section_grid(list(shapely.get_parts(section)), 3.7)
    rows, columns = grid.number.shape
    x, y = np.meshgrid(np.arange(columns), np.arange(rows))
    x0, y0 = grid.origin[0] + x * grid.step[0], grid.origin[1] + y * grid.step[1]
    exact = shapely.area(
        shapely.intersection(shapely.box(x0, y0, x0 + grid.step[0], y0 + grid.step[1]), section)
    )
    inside = grid.number >= 0
    assert grid.area_mm2 == pytest.approx(exact[inside], abs=1e-6 * grid.step.prod())
    assert exact[~inside].max(initial=0.0) < 1e-5 * grid.step.prod()
    assert grid.area_mm2.sum() == pytest.approx(section.area, rel=1e-7)


def test_faces_have_the_length_that_shapely_cuts():
    section = SHAPES["ring"]
    grid = section_grid([section], 5.3)
    coupling = grid.coupling.toarray()
    for row, column in ((3, 2), (7, 7), (9, 4), (0, 6), (11, 11)):
        here, right = grid.number[row, column], grid.number[row, column + 1]
        if here < 0 or right < 0:
            continue
        x = grid.origin[0] + (column + 1) * grid.step[0]
        y = grid.origin[1] + np.array([row, row + 1]) * grid.step[1]
        length = shapely.LineString([(x, y[0]), (x, y[1])]).intersection(section).length
        assert -coupling[here, right] == pytest.approx(length / grid.step[0], abs=1e-9)
    assert np.abs(coupling.sum(axis=1)).max() < 1e-12
    assert np.array_equal(coupling, coupling.T)


@pytest.mark.parametrize("name", SHAPES)
def test_shares_of_islands_are_their_areas(name):
    section = SHAPES[name]
    grid = section_grid(list(shapely.get_parts(section)), 2.9)
    x0, y0, x1, y1 = section.bounds
    tiles = [shapely.box(x, y, x + 11, y + 7) for x in np.arange(x0, x1, 11) for y in np.arange(y0, y1, 7)]
    pieces = shapely.get_parts(shapely.intersection(np.array(tiles), section))
    islands = pieces[shapely.area(pieces) > 1e-3]
    shares = grid.island_shares(islands)
    assert np.asarray(shares.sum(axis=1)).ravel() == pytest.approx(1.0)
    assert shapely.area(islands) @ shares == pytest.approx(grid.area_mm2, rel=1e-3, abs=1e-3)


# -- eigenvalues ---------------------------------------------------------------------------------------


def test_eigenvalues_of_a_rectangle_converge_with_the_mesh():
    box = shapely.box(-10, 5, 50, 45)
    exact = rectangle_modes(60, 40, 0.5).eigenvalue[:40]
    errors = []
    for largest in (0.2, 0.8):
        found = contour_modes(box, largest, 400)
        errors.append(np.abs(found.eigenvalue[1:40] / exact[1:] - 1).max())
    assert errors[1] < 0.012
    assert errors[0] / errors[1] > 3.0, "second order: half the step, a quarter of the error"


def test_eigenvalues_of_a_disc_are_zeros_of_bessel_derivatives():
    radius = 30.0
    exact = np.concatenate([[0.0], jnp_zeros(0, 6)])
    exact = np.sort(np.concatenate([exact, *(np.repeat(jnp_zeros(m, 6), 2) for m in range(1, 15))]))[:30]
    found = contour_modes(shapely.Point(0, 0).buffer(radius, 128), 1.2, 400)
    assert found.eigenvalue[1:30] == pytest.approx((exact[1:] / radius) ** 2, rel=0.012)


def test_eigenvalues_do_not_hang_on_how_the_section_lies():
    turned = affinity.rotate(shapely.box(0, 0, 60, 40), 31)
    exact = rectangle_modes(60, 40, 0.5).eigenvalue[1:25]
    assert contour_modes(turned, 0.8, 400).eigenvalue[1:25] == pytest.approx(exact, rel=0.02)


@pytest.mark.parametrize("name", SHAPES)
def test_modes_are_orthonormal_and_one_of_each_region_is_constant(name):
    section = SHAPES[name]
    found = contour_modes(section, 0.1, 300)
    gram = found.values.T @ (found.grid.area_mm2[:, None] * found.values)
    assert gram == pytest.approx(np.eye(len(gram)), abs=1e-9)
    regions = len(shapely.get_parts(section))
    assert np.count_nonzero(found.eigenvalue == 0.0) == regions
    assert np.sort(np.abs(found.integral()))[:-regions].max(initial=0.0) < 1e-9
    assert (np.diff(found.eigenvalue) >= 0).all()


def test_as_many_modes_as_weyl_says_and_no_more_than_asked_for():
    found = contour_modes(RING, 0.3, 1000)
    weyl = RING.area * 0.3 / (4 * math.pi) + RING.length * math.sqrt(0.3) / (4 * math.pi)
    assert len(found.eigenvalue) == pytest.approx(weyl, rel=0.1)
    assert len(contour_modes(RING, 0.3, 50).eigenvalue) <= 50


def test_modes_repeat_to_the_last_bit():
    one, two = contour_modes(RING, 0.3, 300), contour_modes(RING, 0.3, 300)
    assert np.array_equal(one.values, two.values)


def test_no_section_is_refused():
    with pytest.raises(GeometryError, match="without area"):
        contour_modes(shapely.Polygon(), 0.1, 10)


# -- depth ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("cooled", [True, False])
@pytest.mark.parametrize("loss", [0.0, 1e-6, 0.01, 3.0])
def test_depth_modes_are_orthonormal_and_meet_their_conditions(cooled, loss):
    found = depth_modes(12.0, 9, cooled, loss)
    z, weight = gauss(0, 12, 60, 4)
    modes = found.at(z)
    assert modes.T @ (weight[:, None] * modes) == pytest.approx(np.eye(9), abs=1e-9)
    assert found.integral() == pytest.approx(weight @ modes, abs=1e-9)
    layer, share = gauss(0, 1.7, 20)
    assert found.mean_of_layer(1.7) == pytest.approx(share @ found.at(layer) / 1.7, abs=1e-9)
    # Slope at the surface, downwards, is the loss; at the base it is given or the value is zero.
    slope = (found.at(1e-6) - found.at(0.0)) / 1e-6
    assert slope == pytest.approx(loss * found.at(0.0), abs=1e-4)
    assert slope_at_base(found) == pytest.approx((found.at(12 - 1e-6) - found.at(12.0)) / 1e-6, abs=1e-4)
    if cooled:
        assert found.at(12.0) == pytest.approx(0.0, abs=1e-12)

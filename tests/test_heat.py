"""The heat model against closed forms, Green's functions by quadrature, eigenvalues and its own balance of energy."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely
from closed_form_heat import (
    after_line,
    after_source,
    after_spot,
    base_flow_w,
    radiated_w,
    rectangle_modes,
    slope_at_base,
)
from scipy.optimize import brentq
from scipy.special import erf, jnp_zeros
from shapely import affinity

from ebamcheck.errors import GeometryError
from ebamcheck.heat import HeatModel, Medium, contour_modes, depth_modes
from ebamcheck.heat.medium import STEFAN_BOLTZMANN_W_M2K4
from ebamcheck.heat.modes import section_grid
from ebamcheck.settings.config import Config

LINEAR = Medium(conductivity_w_mmk=0.020, heat_capacity_j_mm3k=4300 * 700 * 1e-9)
ALPHA = LINEAR.diffusivity_mm2_s
RING = shapely.Point(3, 4).buffer(40, 64).difference(shapely.Point(10, 4).buffer(12, 32))
SHAPES = {
    "ring": RING,
    "turned L": affinity.rotate(shapely.Polygon([(0, 0), (60, 0), (60, 20), (20, 20), (20, 50), (0, 50)]), 27),
    "two regions": shapely.union_all([shapely.box(0, 0, 40, 30), shapely.Point(80, 10).buffer(17, 32)]),
    "thin wall": affinity.rotate(shapely.box(0, 0, 120, 1.5), 33),
    "far away": affinity.translate(RING, 5e4, -5e4),
}


def gauss(low, high, count, panels=1):
    nodes, weights = np.polynomial.legendre.leggauss(count)
    edges = np.linspace(low, high, panels + 1)
    half = 0.5 * np.diff(edges)
    return ((edges[:-1] + half)[:, None] + half[:, None] * nodes).ravel(), (half[:, None] * weights).ravel()


# -- closed forms --------------------------------------------------------------------------------------


def slab(cooled, depth=40.0, layer=0.02, count=400, medium=LINEAR, side=(70.0, 50.0), largest=0.0):
    loss = medium.radiation_w_mm2k / medium.conductivity_w_mmk
    return HeatModel(rectangle_modes(*side, largest), depth_modes(depth, count, cooled, loss), medium, layer)


@pytest.mark.parametrize("radiation_w_mm2k", [0.0, 3e-4])
def test_steady_slab_conducts_and_radiates_its_flux(radiation_w_mm2k):
    """q = k T / H + h T"""
    medium = Medium(0.020, LINEAR.heat_capacity_j_mm3k, radiation_w_mm2k=radiation_w_mm2k)
    model = slab(cooled=True, medium=medium)
    state = after_source(model, model.cold(), model.plane.integral() / 3500, 3500 * 0.05, 1e7)
    assert model.at(state, [[20, 20]]) == pytest.approx(0.05 / (0.020 / 40 + radiation_w_mm2k), rel=1e-3)


def test_insulated_slab_that_radiates_cools_at_the_root_of_its_condition():
    medium = Medium(0.020, LINEAR.heat_capacity_j_mm3k, radiation_w_mm2k=3e-4)
    model = slab(cooled=False, medium=medium)
    root = brentq(lambda x: x * math.tan(x) - 3e-4 * 40 / 0.020, 1e-9, math.pi / 2 - 1e-9) / 40
    state = after_source(model, model.cold(), model.plane.integral() / 3500, 100.0, 5.0)
    warm = [model.at(model.after(state, t), [[20, 20]])[0] for t in (400.0, 500.0)]
    assert math.log(warm[0] / warm[1]) == pytest.approx(100 * ALPHA * root**2, rel=1e-6)


# -- a moving source against Green's functions ---------------------------------------------------------

WIDTH, HEIGHT, DEPTH, LAYER, SIGMA = 50.0, 36.0, 15.0, 2.0, 2.0
LINE = np.array([[8.0, 9.0], [41.0, 27.0]])
POWER, DURATION = 900.0, 4.0
TIMES = (1.7, 4.0, 5.5, 9.0, 30.0)


def across(x, source, variance, side):
    """Green's function between two insulated walls of a Gaussian that has spread to a variance."""
    total = np.zeros(np.broadcast_shapes(x.shape, source.shape))
    for n in range(-3, 4):
        for place in (source + 2 * n * side, -source + 2 * n * side):
            total += np.exp(-((x - place) ** 2) / (2 * variance)) / np.sqrt(2 * math.pi * variance)
    return total


def through(z, spread, cooled):
    """The same through the depth, of a unit source spread over the layer; sign of images by the base."""
    total = np.zeros_like(spread)
    for n in range(-4, 5):
        sign = (-1.0) ** n if cooled else 1.0
        for low, high in ((2 * n * DEPTH, 2 * n * DEPTH + LAYER), (2 * n * DEPTH - LAYER, 2 * n * DEPTH)):
            total += sign * (erf((high - z) / spread) - erf((low - z) / spread)) / (2 * LAYER)
    return total


def by_quadrature(points, below, time, cooled):
    # The square root of the age is integrated: heat set free just now is then no peak.
    youngest, oldest = max(0.0, time - DURATION), time
    root, weight = gauss(math.sqrt(youngest), math.sqrt(oldest), 24, 24)
    age = root**2
    place = LINE[0] + ((time - age) / DURATION)[:, None] * (LINE[1] - LINE[0])
    variance = SIGMA**2 + 2 * ALPHA * age
    result = np.empty(len(points))
    for k, (x, y) in enumerate(points):
        kernel = across(np.array(x), place[:, 0], variance, WIDTH)
        kernel = kernel * across(np.array(y), place[:, 1], variance, HEIGHT)
        kernel = kernel * through(below, np.sqrt(4 * ALPHA * age), cooled)
        result[k] = (weight * 2 * root * kernel).sum()
    return POWER / LINEAR.heat_capacity_j_mm3k * result


@pytest.mark.parametrize("cooled", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_a_moving_source_is_within_a_twentieth_of_a_kelvin_at_300_points_and_5_times(cooled):
    plane = rectangle_modes(WIDTH, HEIGHT, 6.0)
    model = HeatModel(plane, depth_modes(DEPTH, 150, cooled), LINEAR, LAYER)
    points = np.random.default_rng(0).uniform([0, 0], [WIDTH, HEIGHT], (300, 2))
    for time in TIMES:
        part = min(time / DURATION, 1.0)
        end = LINE[0] + part * (LINE[1] - LINE[0])
        state = after_line(model, model.cold(), LINE[0], end, POWER, part * DURATION, SIGMA)
        state = model.after(state, time - part * DURATION)
        exact = by_quadrature(points, 0.7, time, cooled)
        assert np.abs(model.at(state, points, 0.7) - exact).max() < 0.05
        assert exact.max() > 10.0


def test_a_cubic_field_is_read_exactly_inside_and_nearly_at_the_border():
    grid = section_grid([RING], 2.3)
    row, column = np.nonzero(grid.number >= 0)
    centre = grid.origin + (np.column_stack([column, row]) + 0.5) * grid.step

    def cubic(at):
        x, y = (np.asarray(at) - [3, 4]).T / 40
        return x**3 - 2 * x * y**2 + y + 0.3

    points = np.random.default_rng(3).uniform(-37, 43, (400, 2))
    points = points[shapely.contains_xy(RING, points)]
    deep = shapely.distance(RING.boundary, shapely.points(points)) > 3 * 2.3 * math.sqrt(2)
    error = np.abs(grid.interpolation(points) @ cubic(centre) - cubic(points))
    assert error[deep].max() < 1e-12
    assert error.max() < 0.1


# -- energy --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", SHAPES)
def test_an_insulated_body_keeps_all_energy(name):
    section = SHAPES[name]
    model = HeatModel(contour_modes(section, 0.1, 200), depth_modes(20.0, 12, False), LINEAR, LAYER)
    inside = shapely.get_coordinates(shapely.point_on_surface(shapely.get_parts(section)))
    state = after_spot(model, model.cold(), inside[:1], 250.0, 1.0)
    state = model.after(after_source(model, state, model.plane.at(inside[-1:])[0], 100.0, 3.0), 7.0)
    assert model.stored_j(state) == pytest.approx(550.0, rel=1e-9)
    # It ends even: E / (rho c V) in each region.
    late = model.after(state, 1e7)
    if len(inside) == 1:
        even = 550.0 / (LINEAR.heat_capacity_j_mm3k * section.area * 20.0)
        assert model.at(late, inside) == pytest.approx(even, rel=1e-6)


@pytest.mark.parametrize("cooled", [True, False])
def test_what_is_stored_is_what_came_in_less_what_left(cooled):
    medium = Medium(0.020, LINEAR.heat_capacity_j_mm3k, radiation_w_mm2k=2e-4)
    depth = depth_modes(20.0, 12, cooled, medium.radiation_w_mm2k / medium.conductivity_w_mmk)
    model = HeatModel(contour_modes(RING, 0.1, 200), depth, medium, LAYER)
    begin = after_spot(model, model.cold(), [[-20.0, 4.0]], 250.0)
    time, weight = gauss(0.0, 8.0, 40, 8)
    base, surface = (
        sum(w * flow(model, model.after(begin, t)) for t, w in zip(time, weight, strict=True))
        for flow in (base_flow_w, radiated_w)
    )
    lost = model.stored_j(begin) - model.stored_j(model.after(begin, 8.0))
    assert base + surface == pytest.approx(lost, rel=1e-9)
    assert (base > 0) == cooled
    assert surface > 0


def test_mean_of_an_island_is_that_of_its_points():
    model = HeatModel(contour_modes(RING, 0.4, 400), depth_modes(20.0, 12, True), LINEAR, LAYER)
    island = shapely.box(-24, -3, -12, 9)
    state = after_source(model, model.cold(), model.plane.means(np.array([island]))[0], 2000.0, 5.0)
    state = model.after(state, 3.0)
    x, y = np.meshgrid(np.arange(-23.75, -12, 0.5), np.arange(-2.75, 9, 0.5))
    inside = model.plane.at(np.column_stack([x.ravel(), y.ravel()])) @ (state @ model.in_layer)
    assert model.over(state, model.plane.means(np.array([island]))) == pytest.approx(inside.mean(), rel=0.01)


# -- material ------------------------------------------------------------------------------------------


def test_medium_of_a_profile():
    config = Config().changed(process={"surface_temperature_k": 1200.0})
    medium = Medium.of(config)
    material = config.material
    assert medium.diffusivity_mm2_s == pytest.approx(
        material.conductivity_w_mk / material.density_kg_m3 / material.heat_capacity_j_kgk * 1e6
    )
    cold = config.process.ambient_temperature_k
    flux = material.emissivity * STEFAN_BOLTZMANN_W_M2K4 * (1200.0**4 - cold**4)
    assert 1e6 * medium.radiation_w_mm2k * (1200.0 - cold) == pytest.approx(flux)


def test_a_hair_and_many_specks_have_modes_at_once():
    """Cells are as fine as waves ask, not as thin as a hair: its first waves run along it."""
    hair = contour_modes(shapely.box(0, 0, 100, 1e-3), (2 * math.pi / 3) ** 2, 300)
    assert hair.eigenvalue[1] == pytest.approx((math.pi / 100) ** 2, rel=1e-3)
    specks = shapely.MultiPolygon(
        [shapely.box(4 * i, 4 * j, 4 * i + 2, 4 * j + 2) for i in range(20) for j in range(20)]
    )
    found = contour_modes(specks, (2 * math.pi / 3) ** 2, 300)
    assert np.count_nonzero(found.eigenvalue == 0.0) == 400


# -- cells ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", SHAPES)
def test_cells_have_the_area_that_shapely_cuts(name):
    section = SHAPES[name]
    grid = section_grid(list(shapely.get_parts(section)), 3.7)
    rows, columns = grid.number.shape
    x, y = np.meshgrid(np.arange(columns), np.arange(rows))
    x0, y0 = grid.origin[0] + x * grid.step[0], grid.origin[1] + y * grid.step[1]
    exact = shapely.area(shapely.intersection(shapely.box(x0, y0, x0 + grid.step[0], y0 + grid.step[1]), section))
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
    found = contour_modes(shapely.Point(0, 0).buffer(radius, 128), 1.2, 40)
    assert found.eigenvalue[1:30] == pytest.approx((exact[1:] / radius) ** 2, rel=0.012)


def test_eigenvalues_do_not_hang_on_how_the_section_lies():
    turned = affinity.rotate(shapely.box(0, 0, 60, 40), 31)
    exact = rectangle_modes(60, 40, 0.5).eigenvalue[1:25]
    assert contour_modes(turned, 0.8, 40).eigenvalue[1:25] == pytest.approx(exact, rel=0.02)


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

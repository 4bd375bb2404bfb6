"""The balance of a whole program in one dimension against closed forms, its own energy, and quadrature."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely
from closed_form_heat import after_source
from scipy.integrate import quad

from ebamcheck.heat import HeatModel, Medium, balance, contour_modes, depth_modes
from ebamcheck.heat.balance import HeatColumn, LayerShape, radiating_mm2
from ebamcheck.heat.medium import HOTTEST_K, STEFAN_BOLTZMANN_W_M2K4, EnthalpyTables
from ebamcheck.settings.config import Config

CONFIG = Config()
AMBIENT_K = CONFIG.process.ambient_temperature_k
PER_MM3 = 1e-9 * CONFIG.material.density_kg_m3 * CONFIG.material.heat_capacity_j_kgk


def profile(emissivity=0.6, base="cooled", plate_mm=25.0):
    return CONFIG.changed(process={"base": base, "base_plate_mm": plate_mm}, material={"emissivity": emissivity})


def constant_tables(config):
    """The material of the linear heat model: constant conductivity and heat capacity, no heat of fusion."""
    rise_k = np.array([0.0, HOTTEST_K])
    theta = 1e-3 * config.material.conductivity_w_mk * rise_k
    return EnthalpyTables(PER_MM3 * HOTTEST_K, config.process.ambient_temperature_k + rise_k, theta)


def laid(config, *shapes, tables=None):
    made = HeatColumn(config, tables or constant_tables(config))
    for shape in shapes:
        made.lay(shape)
    return made


def test_areas_in_a_row_resist_in_a_row():
    """Over the plate of 20 mm and the metal, q H / k; the uppermost layer is heated evenly."""
    config = profile(emissivity=0.0, plate_mm=20.0)
    wide, narrow = LayerShape(2.0, 500.0, 0.0), LayerShape(2.0, 100.0, 0.0)
    for shapes, mm_1 in (
        ([wide] * 20, 59.0 / 500.0),
        ([*[wide] * 5, *[narrow] * 5], 30.0 / 500.0 + 9.0 / 100.0),
    ):
        body = laid(config, *shapes)
        for _ in range(60):
            body.advance(1e4, 20.0 * 1e4)
        rise = 20.0 * mm_1 / (1e-3 * config.material.conductivity_w_mk)
        assert body.surface_k - AMBIENT_K == pytest.approx(rise, rel=1e-6)


def test_an_insulated_column_that_does_not_radiate_warms_by_its_heat():
    config = profile(emissivity=0.0, base="insulated")
    body = laid(config, *[LayerShape(1.5, 300.0, 70.0, 20.0, 30.0)] * 8)
    body.advance(80.0, 5e4)
    body.advance(1e7)
    rise = 5e4 / (PER_MM3 * 300.0 * (25.0 + 8 * 1.5))
    assert body.temperature_k - AMBIENT_K == pytest.approx(rise, rel=1e-6)
    assert body.stored_j == pytest.approx(5e4, rel=1e-12)
    assert (body.base_j, body.radiated_j) == (0.0, 0.0)


def test_radiation_alone_follows_the_cube_law():
    cold_k = 1.0
    config = profile(base="insulated", plate_mm=0.5).changed(
        material={"conductivity_w_mk": 1e6}, process={"ambient_temperature_k": cold_k}
    )
    body = laid(config, LayerShape(1.0, 400.0, 80.0))
    body.advance(1.0, 1500.0 * PER_MM3 * 600.0)
    hot_k = body.surface_k
    for _ in range(400):
        body.advance(0.5)
    # dT/dt = -rate T^4: top and sides, over the heat of all metal.
    area = config.material.emissivity * (400.0 + 80.0 * 1.0)
    rate = 1e-6 * STEFAN_BOLTZMANN_W_M2K4 * area / (PER_MM3 * 600.0)
    assert body.surface_k == pytest.approx((hot_k**-3 + 3 * rate * 200.0) ** (-1 / 3), rel=1e-3)
    assert 400.0 < body.surface_k < hot_k - 600.0


@pytest.mark.parametrize("base", ["cooled", "insulated"])
@pytest.mark.parametrize("constant", [True, False])
def test_heat_put_in_is_stored_passed_to_the_table_and_radiated(base, constant):
    config = profile(base=base)
    rng = np.random.default_rng(3)
    count = 80
    shapes = np.stack(
        [*(rng.uniform(low, high, count) for low, high in [(0.5, 6), (300, 900), (60, 200), (0, 90)]),
         np.where(rng.random(count) < 0.2, 0.0, rng.uniform(50, 90, count))]
    ).T  # fmt: skip
    waits, times = rng.uniform(0, 300, count), rng.uniform(10, 200, count)
    energy_j = times * rng.uniform(0, 3e3, count)
    tables = constant_tables(config) if constant else None
    body, before_k = HeatColumn(config, tables), []
    for shape, wait_s, time_s, layer_j in zip(shapes.tolist(), waits, times, energy_j, strict=True):
        body.advance(wait_s)
        before_k.append(body.surface_k)
        body.lay(LayerShape(*shape))
        body.advance(time_s, layer_j)
    assert body.absorbed_j == pytest.approx(energy_j.sum(), rel=1e-12)
    assert body.stored_j + body.base_j + body.radiated_j == pytest.approx(body.absorbed_j, rel=1e-9)
    assert body.radiated_j > 0.0
    assert (body.base_j > 0.0) == (base == "cooled")
    assert min(before_k) >= AMBIENT_K - 1e-6


@pytest.mark.parametrize("excess_k", [-1.0, 10.0, 300.0])
def test_a_wait_is_that_of_steps_taken_one_by_one(excess_k):
    body = laid(profile(), *[LayerShape(2.0, 500.0, 100.0)] * 12)
    body.advance(60.0, 60.0 * 5e3)
    limit_k, other = body.bed_k - excess_k, body.copy()
    stepped_s, step_s = 0.0, 1.0
    while other.bed_k > limit_k:
        other.advance(step_s)
        stepped_s, step_s = stepped_s + step_s, max(1.0, 0.5 * stepped_s)
    assert body.wait_until(limit_k, 1e6) == stepped_s
    assert (body.content == other.content).all()
    assert body.base_j == pytest.approx(other.base_j, rel=1e-12)
    assert body.radiated_j == pytest.approx(other.radiated_j, rel=1e-12)


def test_a_wait_that_would_be_too_long_is_given_up():
    body = laid(profile(), *[LayerShape(2.0, 500.0, 100.0)] * 12)
    body.advance(60.0, 60.0 * 5e3)
    assert 100.0 < body.wait_until(AMBIENT_K - 1.0, 100.0) < 200.0
    assert math.isinf(HeatColumn(CONFIG).wait_until(AMBIENT_K - 1.0, 100.0))
    assert HeatColumn(CONFIG).wait_until(AMBIENT_K, 100.0) == 0.0


@pytest.mark.parametrize("shape", [LayerShape(2.0, 800.0, 110.0), LayerShape(6.0, 800.0, 110.0, 40.0, 120.0)])
@pytest.mark.parametrize("excess_k", [math.inf, -40.0])
def test_beads_driven_at_once_are_beads_driven_one_by_one(shape, excess_k):
    rng = np.random.default_rng(3)
    body = laid(profile(), *[shape] * 5, tables=balance.enthalpy_tables(CONFIG))
    body.advance(60.0, 60.0 * 4000.0)
    one, limit_k = body.copy(), body.bed_k + excess_k
    off_s, time_s = rng.uniform(-1.0, 6.0, 40), rng.uniform(0.0, 20.0, 40)
    energy_j = 3000.0 * time_s
    bed_k, wait_s = body.drive((off_s, time_s, energy_j), limit_k, 1e6)
    assert (wait_s > 0.0).any() == math.isfinite(excess_k)
    for n in range(40):
        one.advance(float(off_s[n]))
        assert bed_k[n] == one.bed_k
        assert wait_s[n] == (one.wait_until(limit_k, 1e6) if one.bed_k > limit_k else 0.0)
        one.advance(float(time_s[n]), float(energy_j[n]))
    assert body.content.tobytes() == one.content.tobytes()
    assert (body.absorbed_j, body.base_j, body.radiated_j) == (one.absorbed_j, one.base_j, one.radiated_j)


def test_no_bead_is_driven_after_a_wait_that_is_too_long():
    body = laid(CONFIG, *[LayerShape(2.0, 800.0, 110.0)] * 3)
    body.advance(100.0, 4e5)
    bed_k, wait_s = body.drive((np.full(3, 5.0),) * 3, AMBIENT_K - 1.0, 100.0)
    assert 100.0 < wait_s[0] < 200.0
    assert wait_s[1:].tolist() == [0.0, 0.0]
    assert bed_k[0] > AMBIENT_K
    assert np.isnan(bed_k[1:]).all()


def test_a_time_without_end_leaves_no_temperature():
    body = laid(CONFIG, *[LayerShape(2.0, 800.0, 110.0)] * 3)
    endless = np.array([1.0, np.inf, 1.0, 1.0])
    bed_k, _ = body.drive((np.ones(4), endless, np.full(4, 100.0)), 1e4, 1.0)
    assert np.isfinite(bed_k[:2]).all()
    assert np.isnan(bed_k[2:]).all()


def test_beads_over_a_bare_plate_find_it_as_it_is():
    bed_k, wait_s = HeatColumn(CONFIG).drive((np.ones(2), np.ones(2), np.ones(2)))
    assert bed_k.tolist() == [AMBIENT_K, AMBIENT_K]
    assert wait_s.tolist() == [0.0, 0.0]
    _, wait_s = HeatColumn(CONFIG).drive((np.ones(2), np.ones(2), np.ones(2)), AMBIENT_K - 1.0)
    assert np.isinf(wait_s).all()


def test_joined_cells_change_nothing_that_can_be_seen(monkeypatch):
    def built():
        body, end_k = HeatColumn(CONFIG), []
        for _ in range(300):
            body.advance(20.0)
            body.lay(LayerShape(0.5, 900.0, 130.0, 40.0, 110.0))
            body.advance(40.0, 1.5e4)
            end_k.append(body.surface_k)
        return np.array(end_k), body.stored_j

    joined_k, joined_j = built()
    monkeypatch.setattr(balance, "joined_cells", lambda size, *_: np.arange(len(size)))
    alone_k, alone_j = built()
    assert np.abs(joined_k - alone_k).max() < 1.0
    assert joined_j == pytest.approx(alone_j, rel=2e-3)


@pytest.mark.parametrize("base", ["cooled", "insulated"])
def test_the_mean_of_the_modes_is_the_column(base, monkeypatch):
    monkeypatch.setattr(balance, "LARGEST_CELL_MM", 0.5)
    config = profile(emissivity=0.0, base=base)
    section = shapely.box(0, 0, 50, 30).difference(shapely.box(10, 10, 20, 18))
    plane, depth = contour_modes(section, 0.05, 60), depth_modes(29.0, 150, base == "cooled")
    modes = HeatModel(plane, depth, Medium.of(config), 2.0)
    column = laid(config, LayerShape.of(section, 2.0), LayerShape.of(section, 2.0))
    state, whole = modes.cold(), plane.means(np.array([section], object))
    for power_w, duration_s in ((900.0, 40.0), (0.0, 60.0), (500.0, 8.0)):
        state = after_source(modes, state, whole[0], power_w, duration_s)
        for part_s in duration_s * np.diff(np.linspace(0.0, 1.0, 61) ** 2):
            column.advance(part_s, power_w * part_s)
        rise = float(modes.over(state, whole)[0])
        assert column.surface_k - AMBIENT_K == pytest.approx(rise, rel=0.015)


# -- channels ----------------------------------------------------------------------------------------


def surfaces(layers, radius, emissivity, height_mm=0.5):
    """Radiating surface of a tube around a channel, in layers of a height; the outside counts as none."""
    even = [np.full(layers, value) for value in (height_mm, 100.0, 0.0, math.tau * radius)]
    return radiating_mm2(*even, np.full(layers, math.pi * radius**2), emissivity)


def test_a_deep_channel_radiates_as_a_black_disc():
    found = surfaces(800, 4.0, 0.5).sum() - 0.5 * 100.0
    assert found == pytest.approx(math.pi * 16.0, rel=0.01)


def test_walls_see_the_opening_by_the_view_factor_of_a_cylinder():
    # Ring at a depth to the disc of the opening, by quadrature over the disc (Lambert's law).
    radius, depth = 4.0, 3.0

    def seen(r):
        def over(angle):
            x, y = r * math.cos(angle), r * math.sin(angle)
            square = (x - radius) ** 2 + y**2 + depth**2
            return (radius - x) * depth / (math.pi * square**2)

        return r * quad(over, -math.pi, math.pi)[0]

    exact = quad(seen, 0.0, radius)[0]
    found = surfaces(4000, radius, 1.0, 0.01)
    row = len(found) - 1 - int(depth / 0.01)
    assert found[row] / (math.tau * radius * 0.01) == pytest.approx(exact, rel=0.01)


def test_a_channel_that_is_closed_or_grey_to_nothing_loses_nothing():
    assert surfaces(40, 4.0, 0.0).sum() == 0.0
    even = [np.full(40, value) for value in (0.5, 100.0, 0.0, 25.0, 50.0)]
    even[1][-1], even[4][-1], even[3][-1] = 150.0, 0.0, 0.0
    closed = radiating_mm2(*even, 0.6)
    assert closed[:-1] == pytest.approx(np.zeros(39), abs=1e-12)
    assert closed[-1] == pytest.approx(0.6 * 150.0)


def test_shapes_of_sections():
    plate = shapely.box(0, 0, 30, 20).difference(shapely.box(5, 5, 9, 8))
    both = shapely.union_all([plate, shapely.box(50, 0, 60, 10)])
    found = LayerShape.of(both, 1.5)
    assert (found.area_mm2, found.outer_mm, found.inner_mm, found.hole_mm2) == (688.0, 140.0, 14.0, 12.0)
    assert LayerShape.of(shapely.Polygon(), 1.5).area_mm2 == 0.0

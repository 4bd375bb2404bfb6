"""The nonlinear referee against its own balance of energy, closed forms, and the linear model on constant data."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from closed_form_heat import after_line, rectangle_modes
from scipy.stats import kendalltau

from benchmarks.referee import judged, referee, referee_of, refereed_entries
from ebamcheck.heat import HeatModel, Medium, depth_modes
from ebamcheck.heat.medium import enthalpy_tables
from ebamcheck.scan.plan.comparing import OrderComparison
from ebamcheck.settings.config import Config

PROFILE = Config()
CONSTANT = {
    "conductivity_by_temperature": ((293.0, 20.0), (5000.0, 20.0)),
    "heat_capacity_by_temperature": ((293.0, 700.0), (5000.0, 700.0)),
    "latent_heat_j_kg": 0.0,
    "emissivity": 0.0,
}
PLATE = shapely.box(0, 0, 60, 42).difference(shapely.box(35, 15, 50, 30))
WHOLE = np.array([shapely.box(0, 0, 60, 42)], object)
LINE = np.array([[8.0, 9.0, 52.0, 36.0]])


def test_heat_content_adds_up_by_the_formulas_of_the_data():
    tables, material = enthalpy_tables(PROFILE), PROFILE.material
    cold = PROFILE.process.ambient_temperature_k
    # 483 + 0.215 T up to the transus, 412.7 + 0.180 T to the solidus.
    sensible = 483 * (1268 - cold) + 0.1075 * (1268**2 - cold**2)
    at_transus = 1e-9 * material.density_kg_m3 * sensible
    assert tables.heat_content(1268.0) == pytest.approx(at_transus, rel=1e-3)
    solid = at_transus + 1e-9 * material.density_kg_m3 * (412.7 * 609 + 0.09 * (1877**2 - 1268**2))
    assert tables.heat_content(1877.0) == pytest.approx(solid, rel=1e-3)
    melt = tables.heat_content(1923.0) - tables.heat_content(1877.0)
    assert melt == pytest.approx(1e-9 * material.density_kg_m3 * (286e3 + 46 * 790.8), rel=5e-3)
    hot = np.array([300.0, 900.0, 1900.0, 2500.0])
    assert tables.temperature(tables.heat_content(hot)) == pytest.approx(hot)
    theta = np.interp(1268.0, tables.temperature_k, tables.theta_w_mm)
    assert theta == pytest.approx(1e-3 * (1.26 * (1268 - cold) + 0.00785 * (1268**2 - cold**2)), rel=2e-3)


@pytest.mark.in_turn(2, first=1)
@pytest.mark.parametrize("base", ["cooled", "insulated"])
def test_what_is_absorbed_is_stored_conducted_away_or_radiated(base):
    model = referee(PLATE, PROFILE.changed(process={"base": base}), 4.0, 3.0)
    found = judged(model, model.cold(), LINE, np.array([0.0]), np.array([5.0]), 6000.0, WHOLE, np.zeros(1), 60.0)
    assert found.absorbed_j == pytest.approx(30000.0, rel=1e-12)
    left = found.to_base_j + found.radiated_j + found.evaporated_j
    assert model.stored_j(found.content) + left == pytest.approx(found.absorbed_j, rel=1e-9)
    assert found.radiated_j > 0.0
    assert (found.to_base_j > 0.0) == (base == "cooled")
    assert found.hottest_k > PROFILE.material.liquidus_k, "the beam melts"


def test_on_constant_data_it_agrees_with_the_linear_model():
    config = PROFILE.changed(material=CONSTANT)
    model = referee(shapely.box(0, 0, 60, 42), config, 5.0, 2.0)
    islands = np.array([shapely.box(x, y, x + 12, y + 14) for x in range(0, 60, 12) for y in (0, 14, 28)])
    found = judged(
        model, model.cold(), LINE, np.array([0.0]), np.array([5.0]), 3000.0, islands, np.full(15, 12.0), 12.0
    )
    medium = Medium.of(config)
    linear = HeatModel(rectangle_modes(60, 42, 1.0), depth_modes(30.0, 40, True), medium, float(model.cell_mm[2]))
    state = after_line(linear, linear.cold(), LINE[0, :2], LINE[0, 2:], 3000.0, 5.0)
    state = linear.after(state, 7.0)
    x, y = np.meshgrid(np.arange(0.5, 12), np.arange(0.5, 14))
    inside = np.column_stack([x.ravel(), y.ravel()])
    wanted = [(linear.plane.at(inside + island.bounds[:2]) @ (state @ linear.in_layer)).mean() for island in islands]
    assert found.entry_k == pytest.approx(wanted, rel=0.04, abs=2.0)
    assert max(wanted) > 100.0


def test_it_ranks_the_islands_of_a_plan_as_the_linear_model_does():
    plate = shapely.box(0, 0, 130, 90).difference(shapely.Point(80, 50).buffer(18, 32))
    compared = OrderComparison.of(plate, PROFILE, 0, 8.0)
    model = referee_of(compared.laid, PROFILE)
    hottest = {}
    for name in ("raster", "farthest", "thermal"):
        result = compared.result(name, 0)
        entry_k, _ = refereed_entries(model, result.plan, PROFILE)
        hottest[name] = entry_k.max()
        rest = result.rank > 0
        assert kendalltau(entry_k[rest], result.entry_k[rest]).statistic > 0.7
    assert hottest["thermal"] < hottest["farthest"] < hottest["raster"]

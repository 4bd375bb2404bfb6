"""Heat carried from layer to layer: projections, energy, and orders of a whole part."""

from __future__ import annotations

import threading

import numpy as np
import pytest
import shapely
from closed_form_heat import after_spot

import ebamcheck
from ebamcheck.errors import SettingsError
from ebamcheck.geometry.regions import layer_section
from ebamcheck.heat import HeatModel, Medium, carried, contour_modes, depth_modes
from ebamcheck.heat.model import overlap_of_depths
from ebamcheck.layers.stack import from_polygons
from ebamcheck.scan import plan_stack
from ebamcheck.scan.order import orders as order
from ebamcheck.scan.plan.whole_part import WHOLE_PART, Stack, ordered_layers, scan_part
from ebamcheck.settings.config import Config
from ebamcheck.settings.stages import order_names

MEDIUM = Medium(conductivity_w_mmk=0.020, heat_capacity_j_mm3k=4300 * 700 * 1e-9)
BRIEF = Config().changed(scan={"annealing_steps": 1000})
"""Orders are improved for a fortieth of the usual time: nothing here hangs on how good they are."""

RING = shapely.Point(3, 4).buffer(40, 64).difference(shapely.Point(10, 4).buffer(12, 32))
PLATE = shapely.box(0, 0, 120, 90).difference(shapely.Point(70, 50).buffer(16, 32))


def body(section, depth_mm, cooled, waves=60, largest=0.1):
    return HeatModel(contour_modes(section, largest, 300), depth_modes(depth_mm, waves, cooled), MEDIUM, 2.0)


@pytest.mark.parametrize("cooled", [True, False])
def test_overlaps_of_depths_are_integrals(cooled):
    old, new = depth_modes(20.0, 7, cooled, 1e-3), depth_modes(21.5, 9, cooled, 2e-3)
    nodes, weights = np.polynomial.legendre.leggauss(80)
    above = 10.0 * (nodes + 1.0)
    exact = new.at(21.5 - above).T @ (10.0 * weights[:, None] * old.at(20.0 - above))
    assert overlap_of_depths(old, new) == pytest.approx(exact, abs=1e-10)


def test_a_layer_on_the_same_section_keeps_the_energy():
    old, new = body(RING, 20.0, False), body(RING, 21.7, False)
    state = old.after(after_spot(old, old.cold(), [[-20.0, 4.0]], 400.0, 2.0), 3.0)
    assert new.stored_j(carried(old, state, new)) == pytest.approx(400.0, rel=1e-9)


@pytest.mark.parametrize("cooled", [True, False])
def test_the_field_stays_where_it_was_and_the_new_layer_is_cold(cooled):
    old, new = body(RING, 20.0, cooled), body(RING, 21.7, cooled, waves=120)
    state = old.after(after_spot(old, old.cold(), [[-20.0, 4.0]], 400.0, 2.0), 6.0)
    points = [[-20.0, 4.0], [-24.0, 10.0], [-16.0, -6.0]]
    after = carried(old, state, new)
    before = old.at(state, points, 6.0)
    assert new.at(after, points, 7.7) == pytest.approx(before, rel=0.02, abs=0.02 * before.max())
    middle = new.plane.at(points) @ (after @ new.in_layer)
    assert np.abs(middle).max() < 0.35 * old.at(state, points).max()


def rows_of_six(base, emissivity):
    config = Config().changed(
        process={"base": base, "interpass": "off"},
        material={"emissivity": emissivity},
        scan={"annealing_steps": 200},
    )
    heights = (np.arange(6) + 0.5) * config.layer_height_mm
    rows = list(scan_part([layer_section(PLATE)] * 6, heights, config, "thermal", 0))
    assert [set(row) for row in rows] == [set(WHOLE_PART)] * 6
    assert rows[0]["body_mean_k"] == 0.0
    return rows


def test_an_insulated_part_that_does_not_radiate_keeps_all_heat():
    rows = rows_of_six("insulated", 0.0)
    stored = np.array([row["stored_j"] for row in rows])
    # The beam is on for as long as lines are laid, which turn from layer to layer.
    assert stored / stored[0] == pytest.approx(np.arange(1, 7), rel=0.05)


@pytest.mark.parametrize("base", ["cooled", "insulated"])
def test_layers_get_warmer_until_they_lose_what_they_get(base):
    rows = rows_of_six(base, 0.6)
    gain = np.diff([row["body_mean_k"] for row in rows])
    # The most is gained over a cold plate; what the sides radiate grows with the height.
    assert 0 < gain.max() == gain[0]
    assert gain[-1] < 0.1 * gain[0]
    kept = rows_of_six(base, 0.0)
    assert all(row["stored_j"] < other["stored_j"] for row, other in zip(rows, kept, strict=True))


def test_a_pause_lets_it_cool_and_an_empty_layer_passes_heat_on():
    config = Config().changed(scan={"order": "raster"}, process={"interpass": "off"})
    sections = [layer_section(PLATE), shapely.Polygon(), layer_section(PLATE)]
    heights = np.array([1.0, 2.6, 4.3])
    warm, cool = (
        list(scan_part(sections, heights, config.changed(process={"layer_pause_s": pause_s}), "raster", 0))
        for pause_s in (0.0, 500.0)
    )
    assert warm[1]["islands"] == 0
    assert warm[2]["body_mean_k"] > 2.0 * cool[2]["body_mean_k"] > 0.0


def plates(count):
    """Layers of a plate whose hole walks along."""
    holes = [shapely.Point(30 + 8 * k, 45).buffer(14, 32) for k in range(count)]
    heights = (np.arange(count) + 0.5) * Config().layer_height_mm
    return from_polygons(heights, [[shapely.box(0, 0, 120, 90).difference(hole)] for hole in holes])


def sections_of(layers):
    return [layers.section(k) for k in range(len(layers))]


@pytest.mark.slow
def test_a_program_drives_the_order_that_the_whole_part_was_planned_in():
    layers = plates(10)
    plan, sections = plan_stack(layers, BRIEF), sections_of(layers)
    rows = list(scan_part(sections, layers.heights, BRIEF, "thermal", 0))
    for name in ("islands", "body_mean_k", "entry_max_k"):
        assert plan.metrics[name].tolist() == [row[name] for row in rows]
    alone = ebamcheck.plan_scan(sections[0], BRIEF, height_mm=float(layers.heights[0]))
    assert np.array_equal(plan.islands_of(0), alone.order)
    assert plan.metrics["entry_max_k"][0] == alone.metrics["entry_max_k"][0]


def test_orders_that_ask_no_heat_have_no_heat_in_their_metrics():
    plan = plan_stack(plates(2), Config().changed(process={"interpass": "off"}), order="raster")
    assert plan.metrics[["body_mean_k", "entry_max_k"]].isna().all(axis=None)
    bare = order.LayerIslands(np.zeros((3, 2)), np.ones(3), np.zeros((0, 2), np.int64))
    for name in order_names():
        if name in ("least-heat", "thermal"):
            with pytest.raises(SettingsError, match="how long islands take"):
                order.scan_order(name, bare)
        else:
            assert len(order.scan_order(name, bare)) == 3


class Asking:
    """A stranger's order that asks for heat, and keeps what it was handed."""

    needs_heat = True

    def __init__(self):
        self.handed = []

    def __call__(self, islands, heat):
        self.handed.append((islands, heat))
        return np.arange(len(islands))


def test_who_needs_heat_is_handed_it_and_the_islands_hold_none():
    layers = plates(2)
    stack = Stack(sections_of(layers), layers.heights, range(len(layers)))
    warm, cold = Asking(), Asking()
    for asking in (warm, cold):
        list(ordered_layers(stack, BRIEF, asking, 0, carry=asking is warm))
    for (islands, begins), (_, from_cold) in zip(warm.handed, cold.handed, strict=True):
        assert len(islands) > 1
        assert begins.modes is not from_cold.modes
        assert np.array_equal(begins.modes.mean, from_cold.modes.mean)
        assert not from_cold.start_k.any()
        assert np.abs(begins.start_k).max() > 1.0


@pytest.mark.parametrize("threads", ["1", "2"])
def test_who_stops_taking_layers_stops_their_making(threads, monkeypatch):
    monkeypatch.setenv("EBAMCHECK_THREADS", threads)
    made = []

    def counted(islands):
        made.append(islands.layer)
        return np.arange(len(islands))

    layers = plates(40)
    rows = scan_part(sections_of(layers), layers.heights, Config(), counted, 0)
    assert next(rows)["layer"] == 0
    rows.close()
    assert made == [0]
    # The threads on which blocks run stay for the whole process, and wait.
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("ThreadPool")]


@pytest.mark.parametrize("count", [0, 1, 2, 40])
def test_layers_lie_on_the_sum_of_those_under_them(count):
    heights = np.cumsum(np.random.default_rng(count).uniform(0.5, 2.0, count))
    config = Config()
    stack = Stack([shapely.Polygon()] * count, heights, range(count))
    steps = [heights[max(k, 1)] - heights[max(k, 1) - 1] if count > 1 else config.layer_height_mm for k in range(count)]
    assert [stack.thickness_mm(k, config) for k in range(count)] == steps
    assert [stack.bottom_mm(k, config) for k in range(count)] == [sum(steps[:k]) for k in range(count)]

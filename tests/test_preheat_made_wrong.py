"""Mistakes that plan and writer of a preheating scan share, planted one by one: checks of its text find them."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from prism_program import Made

from ebamcheck.checks.preheating import WIDEST, pass_way, preheat_checks, widest_gap_mm
from ebamcheck.heat import preheating
from ebamcheck.heat.balance import HeatColumn
from ebamcheck.heat.preheating import BeamWay, SurfaceHeat, pass_lines
from ebamcheck.settings.config import Config


def config_of(process=None, **preheat):
    given = {"when": "plate", "defocus": 20.0, "current_ma": 10.0, **preheat}
    machine = {"set_focus": ["H5={defocus} ; focus"]}
    return Config().changed(preheat=given, machine=machine, process=process or {})


CLAMP = {"name": "clamp", "outline_mm": [(-9, 10), (-3, 10), (-3, 20), (-9, 20)], "z_mm": (0, 4)}
WIDER_MM = 2.0


def half_of_the_rows(monkeypatch):
    right = preheating._rows

    def rows(region, *given):
        found = right(region, *given)
        return found[found[:, 1] < found[:, 1].mean()]

    monkeypatch.setattr(preheating, "_rows", rows)


def rows_twice_as_far(monkeypatch):
    right = preheating._rows
    monkeypatch.setattr(preheating, "_rows", lambda region, spacing, shift: right(region, 2.0 * spacing, shift))


def clamps_left_out(monkeypatch):
    monkeypatch.setattr(preheating, "_free", lambda region, *_: region)


def a_wider_margin(monkeypatch):
    right = preheating._grown_box
    monkeypatch.setattr(preheating, "_grown_box", lambda *given: right(*given).buffer(WIDER_MM))


def more_heat_than_the_beam_has(monkeypatch):
    right = SurfaceHeat.simulate

    def simulate(self, way):
        right(self, BeamWay(way.start, way.end, way.time_s, 1.5 * way.power_w))

    monkeypatch.setattr(SurfaceHeat, "simulate", simulate)


def half_of_the_plate(monkeypatch):
    right = HeatColumn.lay_plate
    monkeypatch.setattr(HeatColumn, "lay_plate", lambda self, area: right(self, 0.5 * area))


MISTAKES = {
    half_of_the_rows: "preheat lines",
    rows_twice_as_far: "preheat lines",
    clamps_left_out: "preheat path",
    a_wider_margin: "preheat path",
    more_heat_than_the_beam_has: "preheat balance",
    half_of_the_plate: "preheat balance",
}


@pytest.mark.parametrize("mistake", [None, *MISTAKES])
def test_a_mistake_that_plan_and_writer_share_is_found(mistake, monkeypatch, tmp_path):
    if mistake is not None:
        mistake(monkeypatch)
    config = config_of(process={"keep_out": [CLAMP]})
    nc = Made(tmp_path, shapely.box(0, 0, 36, 30), config.changed(scan={"order": "raster"}), layers=2).read()
    found = {c.name: c for c in preheat_checks(nc, config, [shapely.box(0, 0, 36, 30)] * 2)}
    assert {"preheat lines", "preheat balance"} <= set(found)
    failed = {name for name, check in found.items() if not check.passed}
    assert (MISTAKES[mistake] in failed) if mistake is not None else not failed


@settings(deadline=None, max_examples=40)
@given(
    st.lists(st.floats(20.0, 110.0), min_size=3, max_size=9), st.floats(2.0, 25.0), st.integers(1, 5),
    st.sampled_from(["lines", "crossed"]),
)  # fmt: skip
def test_sound_lines_of_any_outline_lie_within_the_limit(radii, spacing, passes, pattern):
    region, config = outline(radii), config_of(pattern=pattern, spacing_mm=spacing)
    lines = np.concatenate([pass_lines(region, config, n)[0] for n in range(passes)]).round(6)
    gap_mm = widest_gap_mm(region, lines[:, :2], lines[:, 2:], config)
    assert gap_mm <= WIDEST * spacing + 1e-3


@settings(deadline=None, max_examples=40)
@given(
    st.lists(st.floats(20.0, 110.0), min_size=3, max_size=9), st.floats(2.0, 25.0), st.integers(0, 4),
    st.sampled_from(["lines", "crossed"]), st.booleans(),
)  # fmt: skip
def test_the_check_drives_a_pass_as_the_plan_does(radii, spacing, number, pattern, from_aside):
    """Two codes by one description of the settings."""
    region, config = outline(radii), config_of(pattern=pattern, spacing_mm=spacing)
    here = np.array([-150.0, 20.0]) if from_aside else None
    plan = preheating.pass_way(*pass_lines(region, config, number), config, here)
    check = pass_way(region, config, number, here)
    for name in ("start", "end", "time_s", "power_w"):
        np.testing.assert_allclose(getattr(check, name), getattr(plan, name), atol=1e-9)


def outline(radii):
    """An outline around a hole."""
    angle = 2.0 * np.pi * np.arange(len(radii)) / len(radii)
    region = shapely.Polygon(np.column_stack([np.cos(angle), np.sin(angle)]) * np.array(radii)[:, None])
    return region.difference(shapely.Point(5.0, -3.0).buffer(9.0)).buffer(-3.0)


def test_a_row_along_the_border_of_a_clamp_is_driven_once():
    """The border touches the row in the middle of it, and the cut of both has pieces in both directions."""
    clamp = shapely.Polygon(CLAMP["outline_mm"]).buffer(10.0)
    region = shapely.box(-10, 0, 46, 30).difference(clamp)
    lines, _ = pass_lines(region, config_of(pattern="crossed"), 2)
    ways = shapely.linestrings(lines.reshape(-1, 2, 2))
    assert shapely.length(ways).sum() == pytest.approx(shapely.union_all(ways).length)

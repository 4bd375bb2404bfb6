"""What a live layer is spared gives the same figures as the long way: tables, splines, searches, and what is kept of a part."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from parts import box
from scipy.interpolate import BSpline

from ebamcheck import installed
from ebamcheck.checks.path_checks import spline_points
from ebamcheck.heat.interpass import greatest_that_fits
from ebamcheck.heat.medium import enthalpy_tables
from ebamcheck.heat.near_field import DIRECTIONS, FELT, ON_OUTLINE_MM, enclosed_share, ray_table
from ebamcheck.installed import entry_points
from ebamcheck.settings.checking import as_toml
from ebamcheck.settings.config import Config
from ebamcheck.surface.part_surface import keep_surface_of, once_a_part


def test_temperatures_are_those_of_an_interpolation_to_the_last_bit():
    tables = enthalpy_tables(Config())
    top = tables.step_j_mm3 * (len(tables.temperature_k) - 1)
    draw = np.random.default_rng(1)
    content = np.concatenate([draw.uniform(-0.1 * top, 1.2 * top, 5000), [0.0, top, 0.5 * tables.step_j_mm3]])
    wanted = np.interp(
        content / tables.step_j_mm3, np.arange(len(tables.temperature_k)), tables.temperature_k
    )
    assert np.array_equal(tables.temperature(content), wanted)


@pytest.mark.parametrize("count", [4, 5, 12, 40])
def test_points_of_a_spline_are_those_of_scipy(count):
    draw = np.random.default_rng(count)
    inner = np.sort(draw.uniform(0.0, 10.0, count - 4))
    inner[3:5] = inner[3:4]  # a double knot
    knots, control = np.r_[[0.0] * 4, inner, [10.0] * 4], draw.normal(size=(count, 2))
    breaks = np.unique(knots)
    at = breaks[:-1, None] + np.linspace(0.0, 1.0, 9) * np.diff(breaks)[:, None]
    at[:, -1] = breaks[1:]
    assert spline_points(knots, control, at) == pytest.approx(BSpline(knots, control, 3)(at), abs=1e-13)


def test_the_greatest_that_fits_is_found_from_every_guess():
    for low in range(8):
        for high in range(low + 1, 10):
            for top in range(low - 1, high):
                asked: list[int] = []

                def fits(n: int, top: int = top, asked: list[int] = asked) -> bool:
                    asked.append(n)
                    return n <= top

                for guess in range(12):
                    asked.clear()
                    assert greatest_that_fits(fits, low, high, guess) == max(top, low)
                    assert len(set(asked)) == len(asked)
                    assert all(low <= n < high for n in asked)


@pytest.mark.parametrize("corners", [202, 7, 4 * DIRECTIONS])
def test_what_is_in_sight_is_what_the_plain_sum_says(corners):
    # Of the last ring corners lie on rays from its middle, or a hair beside them.
    turn = np.linspace(0.0, 2.0 * np.pi, corners + 1)
    ring = np.column_stack([(50.0 + 10.0 * np.sin(7.0 * turn)) * f(turn) for f in (np.cos, np.sin)])
    ring[-1] = ring[0]
    segments = np.hstack([ring[:-1], ring[1:]])
    draw = np.random.default_rng(0)
    points, variance = draw.uniform(-25.0, 25.0, (11, 2)), draw.uniform(300.0, 900.0, (11, 3))
    # All of the ring is felt.
    variance[:, 2] = 110.0**2 / (2.0 * FELT)
    points[:4] = np.array([[0.0, 0.0], [1e-13, 0.0], [0.0, -1e-9], [1e-6, 1e-6]])
    a, b = segments[:, :2] - points[:, None], segments[:, 2:] - points[:, None]
    wanted = np.zeros(variance.shape)
    for dx, dy, share in ray_table().T:
        left, right = dx * a[..., 1] - dy * a[..., 0], dx * b[..., 1] - dy * b[..., 0]
        with np.errstate(divide="ignore", invalid="ignore"):
            place = a + (left / (left - right))[..., None] * (b - a)
        reach = place @ np.array([dx, dy])
        met = ((left > 0.0) != (right > 0.0)) & (reach > ON_OUTLINE_MM)
        nearest = np.where(met, reach, np.inf).min(axis=1)
        wanted -= share * np.expm1(-0.5 * nearest[:, None] ** 2 / variance)
    # A second part, far away: no segment goes from the outline of the one to that of the other.
    section = shapely.MultiPolygon([shapely.Polygon(ring), shapely.box(900.0, 0.0, 901.0, 1.0)])
    assert enclosed_share(section, points, variance) == pytest.approx(wanted, abs=1e-10)
    assert ray_table()[2].sum() == pytest.approx(1.0)
    assert np.hypot(*ray_table()[:2]) == pytest.approx(np.ones(DIRECTIONS))


def test_what_follows_from_a_part_is_worked_out_once_where_it_is_kept():
    asked = []

    @once_a_part
    def found(part, key):
        asked.append(key)
        return len(asked)

    once, every = box(), box()
    keep_surface_of(once)
    assert [found(once, 1), found(once, 1), found(once, 2), found(once, 2)] == [1, 1, 2, 2]
    assert [found(every, 1), found(every, 1)] == [3, 4]


def test_plugins_that_are_installed_meanwhile_are_found(tmp_path, monkeypatch):
    names = {point.name for point in entry_points("ebamcheck.controls")}
    assert "sinumerik-840d-sl" in names
    monkeypatch.syspath_prepend(str(tmp_path))
    assert {point.name for point in entry_points("ebamcheck.controls")} == names
    info = tmp_path / "late-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: late\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[ebamcheck.controls]\nlate = nowhere:NOTHING\n")
    found = {point.name: point for point in entry_points("ebamcheck.controls")}
    assert set(found) == names | {"late"}
    assert installed.name_and_version(found["late"].dist) == ("late", "1.0")


def test_settings_that_share_sections_are_written_as_if_alone():
    first = Config()
    other = first.model_copy(
        update={"machine": first.machine.model_copy(update={"program_name": "OTHER", "clearance_mm": 7.0})}
    )
    for config in (first, other, first):
        lines = as_toml(config).split("\n")
        assert f'program_name = "{config.machine.program_name}"' in lines
        assert f"clearance_mm = {config.machine.clearance_mm}" in lines
    assert as_toml(other) == as_toml(Config().changed(machine={"program_name": "OTHER", "clearance_mm": 7.0}))

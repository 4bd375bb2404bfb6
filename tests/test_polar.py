"""Errors of contours: the paper's polar radius and the true normal distance, against closed forms."""

from __future__ import annotations

import json
import math
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pytest
import shapely
from command_line import FAST, write_stl
from typer.testing import CliRunner

from benchmarks.curve_parts import part_of
from benchmarks.curve_parts_solids import regular_prism
from ebamcheck.commands.main import app
from ebamcheck.curves import contour_error, error_reduction, polar_radius
from ebamcheck.errors import ExitCode, SettingsError
from ebamcheck.layers.stack import Layers, from_rings
from ebamcheck.pipeline import run_job
from ebamcheck.settings.config import Config

SQUARE = np.array([(-5, -5), (5, -5), (5, 5), (-5, 5)], float)


def circle(count: int, radius: float = 20.0, x: float = 0.0, y: float = 0.0) -> np.ndarray:
    t = np.arange(count) * (2 * np.pi / count)
    return np.column_stack([x + radius * np.cos(t), y + radius * np.sin(t)])


def flower(count: int, x: float = 0.0) -> np.ndarray:
    t = np.arange(count) * (2 * np.pi / count)
    r = 30 + 3 * np.sin(5 * t)
    return np.column_stack([x + r * np.cos(t), r * np.sin(t)])


def layer(*rings: np.ndarray) -> Layers:
    return from_rings([1.0], [list(rings)])


# -- polar radius ----------------------------------------------------------------------------------


def test_the_polar_radius_agrees_with_shapely() -> None:
    rng = np.random.default_rng(3)
    t = np.sort(rng.uniform(0, 2 * np.pi, 60))
    ring = (rng.uniform(1, 9, 60) * [np.cos(t), np.sin(t)]).T
    theta = rng.uniform(0, 2 * np.pi, 200)
    boundary = shapely.LinearRing(ring)
    for angle, radius in zip(theta, polar_radius(ring, (0, 0), theta), strict=True):
        ray = shapely.LineString([(0, 0), (50 * np.cos(angle), 50 * np.sin(angle))])
        crossing = shapely.get_coordinates(ray.intersection(boundary))
        assert radius == pytest.approx(np.hypot(*crossing[0]), abs=1e-9)


def test_no_radius_where_a_ray_misses_or_meets_the_ring_twice() -> None:
    theta = np.array([0.0, np.pi])
    assert np.isnan(polar_radius(SQUARE, (20, 0), theta)).all()
    u_shape = np.array([(-1, -1), (9, -1), (9, 9), (7, 9), (7, 1), (1, 1), (1, 9), (-1, 9)], float)
    radii = polar_radius(u_shape, (0, 0), [np.pi, np.deg2rad(45.0)])
    assert radii[0] == 1.0
    assert np.isnan(radii[1])


# -- errors ----------------------------------------------------------------------------------------


def test_the_pole_is_the_centre_of_the_references_rectangle() -> None:
    measured, reference = flower(4000, 7.0) * 1.001, flower(4000, 7.0)
    row = contour_error(layer(measured), layer(reference), rays=720).iloc[0]
    low, high = reference.min(axis=0), reference.max(axis=0)
    theta = (np.arange(720) + 0.5) * (2 * np.pi / 720)
    errors = polar_radius(measured, (low + high) / 2, theta) - polar_radius(reference, (low + high) / 2, theta)
    assert row["polar_rms_mm"] == pytest.approx(np.sqrt(np.mean(errors**2)), rel=1e-12)
    assert row["polar_max_mm"] == pytest.approx(errors.max(), rel=1e-12)


def test_holes_have_a_normal_error_with_the_sign_of_the_metal() -> None:
    reference = layer(circle(4000, 20), circle(4000, 5)[::-1])
    measured = layer(circle(4000, 20), circle(4000, 4.9)[::-1])
    table = contour_error(measured, reference, by="ring")
    assert table["outer"].tolist() == [True, False]
    assert table["polar_defined"].tolist() == [True, False]
    assert table["normal_rms_mm"].tolist() == pytest.approx([0, 0.1], abs=1e-5)
    assert table["normal_min_mm"][1] == pytest.approx(0.1, abs=1e-4)  # a smaller hole is metal too much
    row = contour_error(measured, reference).iloc[0]
    assert (row["rings"], row["outer_rings"], row["polar_rings"], row["unmatched"]) == (2, 1, 1, 0)
    assert row["normal_max_mm"] == pytest.approx(0.1, abs=1e-4)
    assert row["polar_max_abs_mm"] == pytest.approx(0, abs=1e-9)


def test_a_shape_that_is_no_star_has_a_normal_error_only() -> None:
    u_shape = shapely.Polygon([(-1, -1), (9, -1), (9, 9), (7, 9), (7, 1), (1, 1), (1, 9), (-1, 9)])
    grown = shapely.get_coordinates(u_shape.buffer(0.25, join_style="mitre").exterior)[:-1][::-1]
    row = contour_error(
        layer(grown), layer(shapely.get_coordinates(shapely.orient_polygons(u_shape).exterior)[:-1])
    ).iloc[0]
    assert not row["polar_defined"]
    assert np.isnan(row["polar_rms_mm"])
    assert row["normal_min_mm"] == pytest.approx(0.25)
    assert row["normal_max_mm"] == pytest.approx(0.25 * np.sqrt(2), rel=0.05)


def test_normal_distances_agree_with_shapely() -> None:
    rng = np.random.default_rng(8)
    t = np.sort(rng.uniform(0, 2 * np.pi, 80))
    reference = (rng.uniform(6, 9, 80) * [np.cos(t), np.sin(t)]).T
    measured = layer(circle(5000, 7.5))
    row = contour_error(measured, layer(reference), samples=5000).iloc[0]
    places = measured.points + 0.5 * (np.roll(measured.points, -1, axis=0) - measured.points)
    solid = shapely.Polygon(reference)
    distance = shapely.distance(shapely.points(places), solid.exterior)
    signed = np.where(shapely.contains(solid, shapely.points(places)), -distance, distance)
    assert row["normal_min_mm"] == pytest.approx(signed.min(), abs=1e-6)
    assert row["normal_max_mm"] == pytest.approx(signed.max(), abs=1e-6)
    assert row["normal_mean_abs_mm"] == pytest.approx(distance.mean(), abs=1e-6)


def test_rings_are_paired_by_place_and_the_rest_is_counted() -> None:
    def rows(*shifts: float) -> Layers:
        return from_rings([0.0, 1.0], [[circle(200, 5.0, x) for x in shifts], []])

    table = contour_error(rows(0, 20, 40), rows(40.1, 0.1, 20.1, 80))
    assert table["rings"].tolist() == [3, 0]
    assert table["unmatched"].tolist() == [1, 0]
    assert table["normal_max_abs_mm"][0] == pytest.approx(0.1, abs=1e-3)
    assert np.isnan(table["normal_rms_mm"][1])
    assert not table["polar_defined"][1]


def test_reductions_are_those_of_the_figures() -> None:
    """The paper's own ranges: 45.9 % of the range and 55.1 % of the greatest error, not 34.2 %."""
    columns = (
        "polar_rings",
        "rings",
        *(f"{k}_{f}_mm" for k in ("polar", "normal") for f in ("min", "max", "rms", "mean_abs")),
    )

    def table(low: float, high: float, rms: float, mean: float) -> pd.DataFrame:
        return pd.DataFrame([(1, 1, *(2 * (low, high, rms, mean)))], columns=list(columns))

    gain = error_reduction(table(-0.2125, 0.1137, 0.1, 0.08), table(-0.0810, 0.0955, 0.05, 0.06))
    assert gain["polar_range"] == pytest.approx(0.4589, abs=1e-4)
    assert gain["polar_max"] == pytest.approx(0.5506, abs=1e-4)
    assert gain["polar_rms"] == pytest.approx(0.5)
    assert gain["normal_mean_abs"] == pytest.approx(0.25)


def test_reductions_over_layers_weigh_rings_alike() -> None:
    reference = from_rings([0.0, 1.0], [[circle(5000, 10)], [circle(5000, 5), circle(5000, 5, 30.0)]])
    measured = from_rings([0.0, 1.0], [[circle(5000, 10.1)], [circle(5000, 5), circle(5000, 5, 30.0)]])
    half = from_rings([0.0, 1.0], [[circle(5000, 10.05)], [circle(5000, 5), circle(5000, 5, 30.0)]])
    before, after = contour_error(measured, reference), contour_error(half, reference)
    assert error_reduction(before, after)["normal_rms"] == pytest.approx(0.5, abs=1e-3)
    by_ring = [contour_error(stack, reference, by="ring") for stack in (measured, half)]
    assert error_reduction(*by_ring)["polar_rms"] == pytest.approx(0.5, abs=1e-3)
    assert np.isnan(error_reduction(contour_error(reference, reference), before)["polar_rms"])


def test_stacks_of_other_heights_are_refused() -> None:
    with pytest.raises(SettingsError, match="same heights"):
        contour_error(layer(SQUARE), from_rings([0.0, 1.0], [[SQUARE], []]))
    with pytest.raises(SettingsError, match="same heights"):
        contour_error(layer(SQUARE), from_rings([1.1], [[SQUARE]]))
    with pytest.raises(SettingsError, match="rays 0"):
        contour_error(layer(SQUARE), layer(SQUARE), rays=0)
    with pytest.raises(SettingsError, match="at least 3 points"):
        polar_radius(SQUARE[:2], (0, 0), [0.0])
    assert len(contour_error(from_rings([], []), from_rings([], []))) == 0


def test_nothing_is_gained_on_an_error_that_is_rounding() -> None:
    """A part that is its own reference: the normal distance of a point from its own ring is not quite 0."""
    reference, measured = layer(flower(500) + 900.0), layer(flower(501) + 900.0)
    table, after = contour_error(reference, reference), contour_error(measured, reference)
    assert 0.0 < table["normal_max_mm"].max() - table["normal_min_mm"].min() < 1e-9
    assert error_reduction(table, after).isna().all()


# -- ``ebamcheck polar`` ------------------------------------------------------------------------------------


SIDES = 24
RADIUS_MM = 28.0


def polar(*arguments: object) -> tuple[int, str]:
    result = CliRunner().invoke(app, ["polar", *map(str, arguments)])
    return result.exit_code, result.output


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("polar")
    coarse, fine = (
        write_stl(part_of(regular_prism(n, RADIUS_MM, 9.0)(1.0), "prism"), folder / f"{n}.stl")
        for n in (SIDES, 40 * SIDES)
    )
    settings = Config().changed(
        slicing={"backends": tuple(FAST.split(","))},
        layers={"layer_height_mm": 3.0},
        curves={"polygon_sagitta_mm": 1.0},
    )
    return run_job(coarse, folder / "run", settings, fine).folder.path


def test_the_figures_are_those_of_a_polygon_in_its_circle(run: Path, tmp_path: Path) -> None:
    code, text = polar(run, "--layer", 3, "--json", "-o", tmp_path / "polar.html")
    assert code == ExitCode.PASS
    contour, curve = json.loads(text)
    sagitta = RADIUS_MM * (1.0 - math.cos(math.pi / SIDES))
    assert contour["least, mm"] == pytest.approx(-sagitta, rel=0.01)
    assert contour["greatest, mm"] == pytest.approx(
        0.0, abs=0.01
    )  # rays miss the corners by up to an eighth of a degree
    assert curve["RMS, mm"] < 0.1 * contour["RMS, mm"]
    page = ElementTree.fromstring(
        (tmp_path / "polar.html").read_text(encoding="utf-8").removeprefix("<!DOCTYPE html>\n")
    )
    assert page.findtext("head/title") == "run: layer 3, z = 7.500 mm"
    assert page.find("body/figure/svg") is not None


def test_bad_arguments_get_one_line(run: Path, tmp_path: Path) -> None:
    wrong = {
        "1 to 3": (run, "--layer", 4),
        "polar.png": (run, "-o", "polar.png"),
        "no finished run folder": (tmp_path,),
    }
    for message, arguments in wrong.items():
        code, text = polar(*arguments)
        assert code == ExitCode.USAGE
        assert message in text

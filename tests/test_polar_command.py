"""``ebamcheck polar``: Figure 11 of the paper for any layer of a run."""

from __future__ import annotations

import json
import math
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from command_line import FAST, write_stl
from typer.testing import CliRunner

from ebamcheck.commands.main import app
from ebamcheck.errors import ExitCode, SettingsError
from ebamcheck.mesh.part import Part, from_arrays
from ebamcheck.pipeline import run_job
from ebamcheck.settings.config import Config

SIDES = 24
RADIUS_MM = 28.0


def prism(sides: int) -> Part:
    """An upright prism whose corners lie on a circle."""
    turn = 2.0 * np.pi * np.arange(sides) / sides
    rim = RADIUS_MM * np.column_stack([np.cos(turn), np.sin(turn)])
    corners = [(*p, z) for z in (0.0, 9.0) for p in rim] + [(0.0, 0.0, 0.0), (0.0, 0.0, 9.0)]
    faces = []
    for i in range(sides):
        j = (i + 1) % sides
        faces += [(i, j, sides + j), (i, sides + j, sides + i)]
        faces += [(2 * sides, j, i), (2 * sides + 1, sides + i, sides + j)]
    return from_arrays(corners, faces, "prism")


def polar(*arguments: object) -> tuple[int, str]:
    result = CliRunner().invoke(app, ["polar", *map(str, arguments)])
    return result.exit_code, result.output


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("polar")
    coarse, fine = (write_stl(prism(n), folder / f"{n}.stl") for n in (SIDES, 40 * SIDES))
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


@pytest.mark.parametrize(
    ("arguments", "message"), [(["--layer", 4], "1 to 3"), (["-o", "polar.png"], "polar.png")]
)
def test_bad_arguments_get_one_line(run: Path, arguments: list[object], message: str) -> None:
    code, text = polar(run, *arguments)
    assert code == ExitCode.USAGE
    assert message in text


def test_what_has_no_reference_is_refused(run: Path, tmp_path: Path) -> None:
    code, text = polar(tmp_path)
    assert code == ExitCode.USAGE
    assert "no finished run folder" in text


def test_a_run_for_a_heat_simulator_is_refused_at_the_start(tmp_path: Path) -> None:
    settings = Config().changed(machine={"control": "3dthesis"})
    with pytest.raises(SettingsError, match="ebamcheck post RUN --control 3dthesis"):
        run_job(tmp_path / "missing.stl", tmp_path / "run", settings)

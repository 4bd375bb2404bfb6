"""The commands ``fit`` and ``post``: single stages of the job."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from command_line import WIDE_TOML, write_stl
from typer.testing import CliRunner

from ebamcheck.commands.main import app
from ebamcheck.curves import METHODS, Curves
from ebamcheck.errors import ExitCode
from ebamcheck.plugins.registry import models
from ebamcheck.program import read_program

CONTROLS = {
    "sinumerik-840d-sl": "MAIN.MPF",
    "linuxcnc": "MAIN.ngc",
    "plain-gcode": "MAIN.gcode",
    "3dthesis": "Path.txt",
}


def run(*arguments: object) -> tuple[int, str]:
    result = CliRunner().invoke(app, [str(a) for a in arguments])
    return result.exit_code, result.output


@pytest.fixture(scope="module")
def stl(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("part") / "prism.stl"
    return write_stl(models(["prism"])["prism"].tessellate(0.1), path)


def test_fit_tells_how_near_each_method_comes(stl: Path, tmp_path: Path) -> None:
    fine = write_stl(models(["prism"])["prism"].tessellate(0.005), tmp_path / "fine.stl")
    code, text = run("fit", stl, "--method", "all", "--reference", fine, "--layer-height", 20, "--json")
    assert code == ExitCode.PASS
    rows = {row["method"]: row for row in json.loads(text)}
    assert set(rows) == set(METHODS)
    assert rows["bounded"]["blocks"] < rows["surface"]["blocks"]
    assert float(rows["bounded"]["normal rms less by"].split()[0]) > 80.0


def test_fit_writes_the_curves(stl: Path, tmp_path: Path) -> None:
    code, _ = run("fit", stl, "--layer-height", 20, "-o", tmp_path / "curves.parquet")
    assert code == ExitCode.PASS
    assert Curves.from_parquet(tmp_path / "curves.parquet").method == "bounded"
    code, text = run("fit", stl, "--method", "all", "-o", tmp_path / "curves.parquet")
    assert code == ExitCode.USAGE
    assert "one method" in text
    code, text = run("fit", stl, "--method", "magic")
    assert code == ExitCode.USAGE
    assert "'magic' is unknown" in text


@pytest.mark.in_turn(3)
@pytest.mark.parametrize("control", CONTROLS)
def test_post_writes_for_every_control(stl: Path, tmp_path: Path, control: str) -> None:
    (tmp_path / "wide.toml").write_text(WIDE_TOML)
    thick = ("-c", tmp_path / "wide.toml", "--layer-height", 20)
    code, text = run("post", stl, "-o", tmp_path / "p", "--control", control, *thick)
    assert code == ExitCode.PASS, text
    main = tmp_path / "p" / CONTROLS[control]
    assert "NOT VALIDATED" in main.read_text()
    if control in ("sinumerik-840d-sl", "linuxcnc", "plain-gcode"):
        assert len(read_program(main).layer_files) > 1


def test_post_writes_one_layer_for_a_simulator_alone(stl: Path, tmp_path: Path) -> None:
    (tmp_path / "wide.toml").write_text(WIDE_TOML)
    thick = ("-c", tmp_path / "wide.toml", "--layer-height", 20)
    arguments = ("post", stl, *thick, "--layer", 2, "-o", tmp_path / "p", "--control")
    code, text = run(*arguments, "3dthesis")
    assert code == ExitCode.PASS, text
    assert f"{tmp_path / 'p' / 'run.sh'} runs it" in text
    heights = {line.split()[3] for line in (tmp_path / "p" / "Path.txt").read_text().splitlines()[1:]}
    assert heights == {"40.000000"}
    code, text = run(*arguments, "linuxcnc")
    assert code == ExitCode.USAGE
    assert "linuxcnc takes a whole program" in text


@pytest.mark.parametrize(
    ("arguments", "told"),
    [(("--control", "abacus"), "abacus"), (("--control", "linuxcnc", "--layer", 1), "whole program")],
)
def test_a_control_that_cannot_be_posted_for_is_refused_before_the_part_is_read(
    tmp_path: Path, arguments: tuple[object, ...], told: str
) -> None:
    code, text = run("post", tmp_path / "gone.stl", "-o", tmp_path / "p", *arguments)
    assert code == ExitCode.USAGE
    assert told in text
    assert "gone.stl" not in text

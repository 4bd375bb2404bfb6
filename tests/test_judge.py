"""``judge``: 3DThesis beside our own model; stand-ins for the program test how its failures are told, and nothing else."""

from __future__ import annotations

import json
import stat
import sys

import numpy as np
import pandas as pd
import pytest
import shapely
import typer
from command_line import FAST, ebamcheck, write_stl
from nc_stack import make_plan
from slicers_here import runs_cut_here as runs_cut_here
from typer.testing import CliRunner

from ebamcheck.accuracy.heat_judge import COLUMNS, PLACES, THESIS, LayerCase, rises_k
from ebamcheck.commands.accuracy import judge_command
from ebamcheck.commands.command_group import guarded
from ebamcheck.errors import BackendFailed, BackendMissing, ExitCode, NothingCompared
from ebamcheck.mesh.part import from_arrays
from ebamcheck.settings.config import Config

needs_thesis = pytest.mark.skipif(THESIS.find() is None, reason=f"3DThesis is not installed; {THESIS.hint}")

SECTION = shapely.box(0, 0, 90, 60)


@pytest.fixture(scope="module")
def plate_run(tmp_path_factory):
    """Run folder of a plate of 90 x 60 mm, with four layers."""
    folder = tmp_path_factory.mktemp("judged")
    box = np.array([(x, y, z) for z in (0, 6) for y in (0, 60) for x in (0, 90)], float)
    faces = [(0, 2, 1), (1, 2, 3), (4, 5, 6), (5, 7, 6), (0, 1, 4), (1, 5, 4)]
    faces += [(2, 6, 3), (3, 6, 7), (0, 4, 2), (2, 4, 6), (1, 3, 5), (3, 7, 5)]
    write_stl(from_arrays(box, faces, "plate"), folder / "plate.stl")
    done = ebamcheck("run", "plate.stl", "-o", "plate.run", "--backends", FAST, cwd=folder)
    assert (folder / "plate.run" / "run.json").is_file(), done.stderr
    return folder / "plate.run"


def judge(*arguments, **options):
    """Exit code and output of the command, whether or not it is among the installed entry points."""
    app = typer.Typer(add_completion=False)
    app.command()(guarded(judge_command))
    result = CliRunner().invoke(app, [str(a) for a in arguments], **options)
    return result.exit_code, result.output


# -- visits and places -------------------------------------------------------------------------------


def two_islands():
    plan = make_plan([0.8], [(0, [(0, 0, 10, 0)]), (0, [(20, 0, 20, 10), (60, 10, 60, 0)])])
    plan.islands[:] = [shapely.box(0, -2, 10, 2), shapely.box(18, 0, 62, 10)]
    return plan


def test_visits_are_when_and_where_the_beam_enters():
    case = LayerCase.of(two_islands(), 0, SECTION, Config())
    visits = case.visits
    rapid = Config().machine.rapid_mm_s
    assert visits.island.tolist() == [0, 1]
    assert visits.entered_s == pytest.approx([0.0, 1.0 + 10.0 / rapid], abs=1e-5)
    assert visits.beam_s == pytest.approx([1.0, 2.0])
    assert visits.left_s - visits.entered_s == pytest.approx([1.0, 2.0 + 40.0 / rapid], abs=1e-5)
    assert visits.place[:, :2].tolist() == [[0, 0], [20, 0]]


def test_places_are_the_entry_and_the_island():
    case = LayerCase.of(two_islands(), 0, SECTION, Config())
    for number, island in enumerate(case.islands):
        mine = case.places[case.owner == number]
        assert mine[0].tolist() == case.visits.place[number].tolist()
        assert 0.5 * PLACES < len(mine) < 2 * PLACES
        inside = mine[1:, :2]
        assert shapely.contains_xy(island, inside[:, 0], inside[:, 1]).all()
        assert inside.mean(axis=0) == pytest.approx(shapely.get_coordinates(island.centroid)[0], abs=1.0)
        assert np.ptp(mine[:, 2]) == 0


def test_a_layer_without_islands_is_not_judged():
    plan = make_plan([0.8, 2.4], [(0, [(0, 0, 10, 0)])])
    with pytest.raises(NothingCompared, match="layer 2 has no islands"):
        LayerCase.of(plan, 1, SECTION, Config())


# -- failures of the program, by stand-ins -----------------------------------------------------------


def stand_in(tmp_path, monkeypatch, text):
    """A program that is none, in the place of 3DThesis."""
    path = tmp_path / "stand-in"
    path.write_text(f"#!{sys.executable}\nimport os, sys\n{text}\n")
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setenv(THESIS.variable, str(path))


RESULTS = "os.mkdir('Data'); open('Data/ebamcheck.Snapshot.00.csv', 'w').write({!r})"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("print('first'); print('no beam', file=sys.stderr); sys.exit(3)", "ended with exit code 3: no beam"),
        ("os.abort()", "ended with SIGABRT"),
        ("print('Failed to Open Path.txt')", "left no temperatures in ebamcheck.Snapshot.00.csv: Failed"),
        (RESULTS.format(""), "left no temperature for each of"),
        (RESULTS.format("x,y,z,T\nhot,hot,hot,hot\n"), "left no temperatures in ebamcheck.Snapshot.00.csv"),
        (RESULTS.format("x,y,z,T\n0,0,0,nan\n"), "left no temperature for each of"),
        (RESULTS.format("x,y,z,T\n" + "9,9,0,300\n" * 40), "left no temperature for each of"),
    ],
)
def test_a_failing_program_is_one_line(plate_run, tmp_path, monkeypatch, text, message):
    stand_in(tmp_path, monkeypatch, text)
    code, output = judge(plate_run, "--layer", 2, "-o", tmp_path / "out")
    assert code == ExitCode.OUT_OF_TOLERANCE
    told = [line for line in output.splitlines() if line]
    assert len(told) == 1
    assert told[0].startswith("ebamcheck: error: 3DThesis ")
    assert message in told[0]
    assert not (tmp_path / "out" / "judged.csv").exists()


def test_temperatures_of_other_places_are_refused(tmp_path, monkeypatch):
    moved = (
        "lines = open('Points.txt').read().splitlines()[1:]\n"
        "os.mkdir('Data'); out = open('Data/ebamcheck.Snapshot.00.csv', 'w'); out.write('x,y,z,T\\n')\n"
        "rows = [[float(v) / 1000 for v in line.split()] for line in lines]\n"
        "out.writelines(f'{x + SHIFT},{y},{z},{TEMPERATURE}\\n' for x, y, z in rows)"
    )
    path = LayerCase.of(two_islands(), 0, SECTION, Config()).path
    places, owner = np.array([[1.0, 2.0, 1.6]]), np.zeros(1, np.int64)

    def rise(shift, kelvin):
        stand_in(tmp_path, monkeypatch, moved.replace("SHIFT", str(shift)).replace("TEMPERATURE", str(kelvin)))
        return rises_k(path, Config(), np.array([0.5]), owner, places)

    assert rise(0.0, 300.0) == pytest.approx([6.85])
    with pytest.raises(BackendFailed, match=r"other places in ebamcheck.Snapshot.00.csv, 1 mm away"):
        rise(1e-3, 300.0)
    with pytest.raises(BackendFailed, match=r"found a place 90 K colder than it was at the beginning"):
        rise(0.0, 203.15)


def test_where_it_is_missing_the_case_is_written_and_one_line_says_how_to_get_it(plate_run, tmp_path, monkeypatch):
    monkeypatch.setenv(THESIS.variable, str(tmp_path / "nothing"))
    code, output = judge(plate_run, "--layer", 2, "-o", tmp_path / "out")
    assert code == ExitCode.BACKEND_MISSING == 4
    assert output.splitlines() == [f"ebamcheck: error: 3DThesis is not installed; {THESIS.hint}"]
    assert "github.com/ORNL-MDF/3DThesis" in output
    assert "EBAMCHECK_3DTHESIS" in output
    case = tmp_path / "out" / "case"
    times = next(line.split()[1] for line in (case / "Mode.txt").read_text().splitlines() if "Times" in line)
    assert len(times.split(",")) > 5
    assert len((case / "Points.txt").read_text().splitlines()) > 0.5 * PLACES * len(times.split(","))
    monkeypatch.setenv(THESIS.variable, "")
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(BackendMissing):
        THESIS.path()


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (("--layer", 5), ExitCode.USAGE, "--layer 5: the run has the layers 1 to 4"),
        (("--layer", 0), ExitCode.USAGE, "--layer 0: layers are counted from 1"),
        (("--layer", 1, "--beads", "walls"), ExitCode.USAGE, "--beads 'walls': choose from islands, all"),
        (("--layer", 1, "--body", "ball"), ExitCode.USAGE, "--body 'ball': choose from half-space, box"),
    ],
)
def test_what_cannot_be_judged_is_refused(plate_run, tmp_path, arguments, code, message):
    found, output = judge(plate_run, *arguments, "-o", tmp_path / "out")
    assert found == code
    assert message in output
    assert len(output.splitlines()) == 1
    found, output = judge(tmp_path, *arguments)
    assert found == ExitCode.USAGE
    assert "is no run folder" in output


# -- the real program --------------------------------------------------------------------------------


def test_mirrors_stand_around_the_section():
    for base, planes in (("cooled", 4), ("insulated", 5)):
        config = Config().changed(process={"base": base})
        case = LayerCase.of(two_islands(), 0, SECTION, config, height_mm=12.0, body="box")
        group = case.mirrors.group()
        assert [group[n] for n in ("X_min", "X_max", "Y_min", "Y_max")] == [0.0, 0.09, 0.0, 0.06]
        assert len(group) == planes + 1
        if base == "insulated":
            depth_mm = 12.0 + config.process.base_plate_mm
            assert group["Z_min"] == pytest.approx(1e-3 * (case.path.rows[0, 3] - depth_mm))


@needs_thesis
def test_a_layer_of_a_run_is_judged(plate_run, tmp_path):
    code, output = judge(plate_run, "--layer", 3, "-o", tmp_path / "out")
    assert code == ExitCode.PASS, output
    table = pd.read_csv(tmp_path / "out" / "judged.csv")
    assert list(table) == list(COLUMNS)
    assert f"rise of its {len(table)} islands" in output
    assert "Spearman" in output
    code, output = judge(plate_run, "--layer", 3, "-o", tmp_path / "out", "--beads", "all", "--json")
    assert code == ExitCode.PASS, output
    warmer = pd.read_csv(tmp_path / "out" / "judged.csv")
    assert json.loads(output)["thesis_max_k"] == pytest.approx(warmer["thesis_k"].max(), abs=1e-3)
    assert (warmer["thesis_k"] > table["thesis_k"]).all(), "contours heat, too"
    assert np.allclose(warmer["model_k"], table["model_k"])

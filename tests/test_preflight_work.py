"""Preflight: work that asks first, heights and files that are refused, and the commands that it speaks through."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest
from command_line import WIDE_TOML, ebamcheck, frame, started, write_stl
from parts import box, moved, sphere

from ebamcheck.commands.preflight import preflight_command
from ebamcheck.errors import InputError, SettingsError
from ebamcheck.layers.heights import crossing_counts, heights_within, layer_heights
from ebamcheck.mesh.files import load
from ebamcheck.pipeline import check_job, run_job
from ebamcheck.preflight.report import ready
from ebamcheck.preflight.workload import mean_section, workload
from ebamcheck.settings.config import Config
from ebamcheck.slicers.slicing import slice_part


@pytest.fixture
def block(tmp_path):
    return write_stl(box((0, 0, 0), (100, 60, 40)), tmp_path / "block.stl")


def stl(tmp_path, part, name="part.stl"):
    return write_stl(part, tmp_path / name)


# -- work --------------------------------------------------------------------------------------------


def test_points_are_those_of_the_slices():
    part = sphere(20.0)
    heights = layer_heights(part, 0.7)
    work = workload(part, heights, Config(), "check")
    assert (work.layers, work.points) == (len(heights), int(crossing_counts(part, heights).sum()))
    assert work.points == len(slice_part(part, heights).points)
    assert work.islands == 0


def test_the_mean_section_is_that_of_a_prism():
    area, border = mean_section(frame())
    assert area == pytest.approx(1376.0)
    assert border == pytest.approx(4 * 40 + 2 * (14 + 16))


def test_more_of_everything_is_more_work(block, tmp_path):
    small = ready(block, Config()).preflight.work
    thin = ready(block, Config().changed(layers={"layer_height_mm": 0.9})).preflight.work
    large = ready(stl(tmp_path, box((0, 0, 0), (300, 180, 120)), "large.stl"), Config()).preflight.work
    for more in (thin, large):
        assert more.time_s > small.time_s
        assert more.layers > small.layers
        assert more.islands > small.islands
        assert more.bead_mm > small.bead_mm
    alone = Config().changed(slicing={"backends": ("planecut",)})
    assert ready(block, alone).preflight.work.memory_mb < small.memory_mb


@pytest.mark.parametrize("job", [run_job, check_job])
def test_more_work_than_is_allowed_asks_first(block, tmp_path, job):
    few = Config().changed(work={"most_layers": 3}, slicing={"backends": ("planecut",)})
    with pytest.raises(SettingsError, match=r"24 layers, over 3 \(work\.most_layers\): give --yes"):
        job(block, tmp_path / "a.run", few)
    assert not (tmp_path / "a.run").exists()


def test_slicing_alone_asks_too(block, tmp_path):
    (tmp_path / "ebamcheck.toml").write_text("work.most_layers = 3\n")
    refused = ebamcheck("slice", "block.stl", "-o", "a.parquet", cwd=tmp_path)
    assert refused.returncode == 2
    assert "24 layers, over 3 (work.most_layers): give --yes" in refused.stderr
    assert not (tmp_path / "a.parquet").exists()
    assert ebamcheck("slice", "block.stl", "-o", "a.parquet", "--yes", cwd=tmp_path).returncode == 0


# -- heights outside of the part ---------------------------------------------------------------------


def test_heights_are_those_of_the_part():
    part = moved(box((0, 0, 0), (10, 10, 30)), shift=(0, 0, 5))
    assert heights_within(part, [5.0, 35.0], "x").tolist() == [5.0, 35.0]
    for outside in (4.999, 35.001, 100.0, -1.0):
        with pytest.raises(SettingsError, match=rf"x: {outside:g} mm is outside .*z = 5 to 35 mm"):
            heights_within(part, [10.0, outside], "x")


@pytest.mark.parametrize(
    "arguments",
    [
        ("slice", "block.stl", "--heights", "100", "-o", "out.parquet"),
        ("slice", "block.stl", "--heights", "10,40.001", "-o", "out.parquet"),
        ("scan", "block.stl", "--height", "300", "-o", "out"),
        ("check", "block.stl", "-c", "outside.toml", "-o", "out"),
        ("run", "block.stl", "-c", "outside.toml", "-o", "out"),
        ("fit", "block.stl", "-c", "outside.toml", "-o", "out.parquet"),
        ("post", "block.stl", "-c", "outside.toml", "-o", "out"),
    ],
    ids=" ".join,
)
def test_heights_outside_of_the_part_are_refused_with_its_range(block, tmp_path, arguments):
    (tmp_path / "outside.toml").write_text(f"layers.heights_mm = [100.0, 101.0]\n{WIDE_TOML}\n")
    before = set(tmp_path.iterdir())
    done = ebamcheck(*arguments, cwd=tmp_path)
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert "outside of the part 'block', which reaches from z = 0 to 40 mm" in line
    assert set(tmp_path.iterdir()) == before


# -- files that are no mesh --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("part.step", "(STEP), and slicers take a closed mesh: export it from your CAD system as STL"),
        ("part.STP", "(STEP), and slicers take a closed mesh: export it from your CAD system as STL"),
        ("part.iges", "(IGES), and"),
        ("part.3dm", "(Rhino), and"),
        ("part.sldprt", "(SolidWorks), and"),
        ("part.glb", "(glTF) that is not read: convert it to one of .stl, .obj, .ply, .3mf"),
        ("part.mpf", "ebamcheck verify"),
        ("part.docx", "unknown suffix '.docx': parts are read from"),
    ],
)
def test_a_file_that_is_not_read_says_how_to_get_there(tmp_path, name, told):
    (tmp_path / name).write_text("ISO-10303-21;\n")
    with pytest.raises(InputError) as error:
        load(tmp_path / name)
    assert told in str(error.value)
    assert "\n" not in str(error.value)


# -- commands ----------------------------------------------------------------------------------------


def test_the_command_tells_by_its_exit_code(block, capsys):
    assert preflight_command(block) == 0
    assert "0 faults, 0 warnings" in capsys.readouterr().out
    assert preflight_command(block, place="990,0") == 1
    said = capsys.readouterr().out
    assert "FAULT  travel X" in said
    assert preflight_command(block, place="990,0", job="check", as_json=True) == 1
    found = json.loads(capsys.readouterr().out)
    assert not found["passed"]
    assert found["work"]["layers"] == 24
    faults = [check for check in found["checks"] if check["level"] == "fault"]
    assert [(c["name"], c["limit"], c["unit"], c["stops"]) for c in faults] == [
        ("travel X", 1000.0, "mm", ["run"])
    ]
    with pytest.raises(SettingsError, match="--job 'fly'"):
        preflight_command(block, job="fly")
    with pytest.raises(SettingsError, match="give either"):
        preflight_command()


def test_the_preflight_is_a_command(block, tmp_path):
    done = started("preflight", block.name, "--place", "-990,0", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (1, "")
    assert "beyond machine.travel_min_mm" in done.stdout
    assert ebamcheck("preflight", "gone.stl", cwd=tmp_path).returncode == 2
    assert ebamcheck("preflight", block.name, "--units", "furlong", cwd=tmp_path).returncode == 2


HEAVY = ("pandas", "ebamcheck.pipeline", "ebamcheck.slicers.slicing", "ebamcheck.curves", "ebamcheck.scan")
"""What takes most of the time of a start; the names of the controls, which the preflight asks for, take a hundredth."""


@pytest.mark.parametrize("arguments", [["run", "--place", "5000,0"], ["preflight"]], ids=str)
def test_nothing_heavy_is_loaded_before_the_preflight_has_spoken(block, tmp_path, arguments):
    start = (
        "import sys, json\nfrom ebamcheck.commands.main import main\n"
        f"sys.argv = {['ebamcheck', arguments[0], block.name, *arguments[1:]]!r}\n"
        "try:\n    main()\nexcept SystemExit as left:\n    pass\n"
        f"print(json.dumps([name for name in {HEAVY!r} if name in sys.modules]))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", start], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert json.loads(done.stdout.splitlines()[-1]) == []
    if arguments[0] == "run":
        assert "preflight: travel X" in done.stderr


def test_a_plate_and_a_part_exclude_each_other(block, tmp_path):
    for arguments in (["run", block.name, "--plate", "p.toml"], ["run"], ["check", "--plate", block.name]):
        done = ebamcheck(*arguments, cwd=tmp_path)
        assert done.returncode == 2
        assert "plate" in done.stderr
        assert len(done.stderr.splitlines()) == 1

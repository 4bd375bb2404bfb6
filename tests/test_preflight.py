"""Preflight: what is found before anything is sliced."""

from __future__ import annotations

import json

import numpy as np
import pytest
import shapely
from command_line import WIDE_TOML, ebamcheck, frame, write_stl
from parts import BOX_FACES, box, moved, sphere

from ebamcheck.commands.run import preflight_command, preflight_text
from ebamcheck.errors import InputError, SettingsError
from ebamcheck.mesh.files import load
from ebamcheck.mesh.part import from_arrays
from ebamcheck.pipeline import check_job, run_job
from ebamcheck.preflight.report import ready
from ebamcheck.preflight.room import enters
from ebamcheck.settings.config import Config
from ebamcheck.settings.process import KeepOut
from ebamcheck.slicers.slicing import slice_part

PLATE = {"base_plate_min_mm": (-100.0, -100.0), "base_plate_max_mm": (100.0, 100.0)}


def levels(path, job="run", yes=False, **sections):
    """Levels of the checks that do not pass, by name."""
    found = ready(path, Config().changed(**sections), job, yes).preflight
    return {check.name: check.level for check in found.checks if check.level != "pass"}


@pytest.fixture
def block(tmp_path):
    return write_stl(box((0, 0, 0), (100, 60, 40)), tmp_path / "block.stl")


def stl(tmp_path, part, name="part.stl"):
    return write_stl(part, tmp_path / name)


# -- checks ------------------------------------------------------------------------------------------


def test_a_sound_part_passes_every_check(block):
    found = ready(block, Config()).preflight
    assert found.passed
    assert {check.level for check in found.checks} == {"pass"}
    expected = "mesh|units|size against the bead|travel X|travel Y|travel Z|process window|feed|work: layers|work: points|work: islands|work: memory|work: time"
    assert set(expected.split("|")) <= {check.name for check in found.checks}


@pytest.mark.parametrize(
    ("sections", "failed"),
    [
        ({"part": {"place_at_mm": (990.0, 0.0)}}, {"travel X": "fault"}),
        ({"part": {"place_at_mm": (0.0, -985.0)}}, {"travel Y": "fault"}),
        ({"machine": {"travel_max_mm": (1000.0, 1000.0, 60.0)}}, {"travel Z": "fault"}),
        # 24 layers of 1.6755 mm and the safe height
        ({"machine": {"travel_max_mm": (1000.0, 1000.0, 60.3)}}, {}),
        ({"machine": PLATE}, {}),
        ({"machine": PLATE, "part": {"place_at_mm": (60.0, 0.0)}}, {"base plate": "fault"}),
        ({"machine": PLATE, "part": {"place_at_mm": (60.0, 0.0), "rotate_deg": 90.0}}, {}),
        ({"machine": {"control": "none-such"}}, {"control": "fault"}),
        ({"machine": {"control": "3dthesis"}}, {"control": "fault"}),
        ({"machine": {"beam_on": ("M60 {power}",)}}, {"control": "fault"}),
        ({"machine": {"beam_on": ("M60 {",)}}, {"control": "fault"}),
        ({"machine": {"beam_on": ()}}, {"control": "fault"}),
        ({"machine": {"feed_max_mm_s": 9.0}}, {"feed": "fault"}),
        ({"kinematics": {"axis_speed_mm_s": (9.0, 9.0, 9.0)}}, {"feed": "fault"}),
        ({"layers": {"layer_height_mm": 0.2}}, {"process window": "fault"}),
        ({"scan": {"hexagon_side_mm": 2.5}}, {"cells": "warning"}),
        ({"process": {"interpass_limit_k": 280.0}}, {"interpass limit": "fault"}),
        ({"material": {"liquidus_k": 1500.0}}, {"material": "fault"}),
        ({"work": {"most_layers": 10}}, {"work: layers": "fault"}),
        ({"work": {"most_time_s": 0.5}}, {"work: time": "fault"}),
        ({"work": {"most_memory_mb": 10.0}}, {"work: memory": "fault"}),
        ({"work": {"most_islands": 10}}, {"work: islands": "fault"}),
        ({"work": {"most_points": 20}}, {"work: points": "fault"}),
    ],
    ids=str,
)
def test_what_cannot_work_is_found(block, sections, failed):
    assert levels(block, **sections) == failed


def test_work_that_is_agreed_to_is_a_warning(block):
    assert levels(block, yes=True, work={"most_layers": 10}) == {"work: layers": "warning"}


def test_every_check_that_does_not_pass_has_a_remedy(tmp_path):
    part = stl(tmp_path, box((0, 0, 0), (3000, 4, 3)))
    found = ready(part, Config().changed(machine=PLATE, work={"most_layers": 1})).preflight
    bad = [check for check in found.checks if check.level != "pass"]
    assert len(bad) >= 4
    assert all(check.remedy for check in bad)
    text = preflight_text(found)
    assert all(check.name in text and check.remedy in text for check in bad)


def test_a_part_beside_the_travel_is_told_where_to_go(tmp_path):
    part = stl(tmp_path, box((5000, 0, 0), (5100, 60, 40)))
    with pytest.raises(
        SettingsError, match=r"travel X: X needs 5003 to 5097 mm of -1000 to 1000 mm.*--place 0,0"
    ):
        run_job(part, tmp_path / "a.run")
    assert levels(part, part={"place_at_mm": (0.0, 0.0)}) == {}
    assert list(tmp_path.iterdir()) == [part]


def test_an_open_mesh_is_a_fault_and_is_sliced_all_the_same(tmp_path):
    whole = box((0, 0, 0), (40, 30, 12))
    part = stl(tmp_path, from_arrays(whole.vertices, BOX_FACES[:-1]))
    found = ready(part, Config()).preflight
    assert [c.name for c in found.checks if c.level == "fault"] == ["mesh"]
    found.stop("run")


# -- units -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("size", "told"),
    [
        ((4, 3, 2), "part of a few beads"),
        ((76.2, 50.8, 25.4), "round in inches"),
        ((3000, 60, 40), "travels 2000 mm"),
        ((100, 60, 40), ""),
        ((254, 127, 381), ""),
    ],
)
def test_sizes_that_speak_for_another_unit_are_warned_of(tmp_path, size, told):
    part = stl(tmp_path, box((0, 0, 0), size))
    warned = [c for c in ready(part, Config()).preflight.checks if c.name == "units" and c.level == "warning"]
    assert bool(warned) == bool(told)
    if told and "few beads" not in told:
        assert told in warned[0].text


# -- keep-outs ---------------------------------------------------------------------------------------


def zone(x0, y0, x1, y1, z=(0.0, 1000.0)):
    return KeepOut(outline_mm=((x0, y0), (x1, y0), (x1, y1), (x0, y1)), z_mm=z)


PARTS = {
    "frame": frame(),
    "ball": moved(sphere(20.0), shift=(20.0, 20.0, 20.0)),
    "raised": moved(frame(), shift=(0.0, 0.0, 77.0)),
}


@pytest.mark.parametrize("name", PARTS)
def test_keep_outs_are_found_as_by_sections(name):
    """Against slices: a zone is entered where it meets a section at one of its heights."""
    part = PARTS[name]
    random = np.random.default_rng(11)
    low = float(part.bounds[0, 2])
    entered = 0
    for _ in range(60):
        x, y = random.uniform(-6.0, 40.0, 2)
        z0 = random.uniform(-3.0, 30.0)
        wide, deep, tall = random.uniform((1.0, 1.0, 0.5), (12.0, 12.0, 9.0))
        where = zone(x, y, x + wide, y + deep, (z0, z0 + tall))
        outline = shapely.Polygon(where.outline_mm)
        found = enters(part, where, outline)
        heights = np.linspace(*where.z_mm, 41)[1:-1] + low
        heights = heights[(heights > low) & (heights < part.bounds[1, 2])]
        layers = slice_part(part, heights) if heights.size else ()
        deepest = max(
            (shapely.union_all(layers.polygons(k)).intersection(outline).area for k in range(len(layers))),
            default=0.0,
        )
        entered += found
        # A facet of the ball may graze a zone between two of the heights that are looked at.
        assert found or deepest == 0.0
        if found and name != "ball":
            assert deepest > 0.0
    assert 5 < entered < 55


def test_a_clamp_in_the_way_stops_a_run_and_not_a_check(block, tmp_path):
    clamp = {
        "name": "left clamp",
        "outline_mm": ((90, 10), (120, 10), (120, 30), (90, 30)),
        "z_mm": (0.0, 30.0),
    }
    assert levels(block, process={"keep_out": (clamp,)}) == {"keep-out left clamp": "fault"}
    with pytest.raises(SettingsError, match=r"preflight: keep-out left clamp: the part reaches into it"):
        run_job(block, tmp_path / "a.run", Config().changed(process={"keep_out": (clamp,)}))
    ready(block, Config().changed(process={"keep_out": (clamp,)}), "check").preflight.stop("check")
    through = {**clamp, "outline_mm": ((101, 10), (120, 10), (120, 30), (101, 30))}
    assert levels(block, process={"keep_out": (through,)}) == {}


# -- work that asks first -------------------------------------------------------------------------------------


@pytest.mark.parametrize("job", [run_job, check_job])
def test_more_work_than_is_allowed_asks_first(block, tmp_path, job):
    few = Config().changed(work={"most_layers": 3}, slicing={"backends": ("planecut",)})
    with pytest.raises(SettingsError, match=r"24 layers, over 3 \(work\.most_layers\): give --yes"):
        job(block, tmp_path / "a.run", few)
    assert not (tmp_path / "a.run").exists()


# -- heights outside of the part ---------------------------------------------------------------------


@pytest.mark.parametrize(
    "arguments",
    [
        ("slice", "block.stl", "--heights", "100", "-o", "out.parquet"),
        ("scan", "block.stl", "--height", "300", "-o", "out"),
        ("run", "block.stl", "-c", "outside.toml", "-o", "out"),
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

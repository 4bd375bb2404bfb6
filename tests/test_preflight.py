"""Preflight: what is found before anything is sliced."""

from __future__ import annotations

import json

import numpy as np
import pytest
import shapely
from command_line import FAST, WIDE, WIDE_TOML, ebamcheck, frame, started, write_stl
from parts import box, moved, sphere

from ebamcheck.commands.run import preflight_command, preflight_text
from ebamcheck.errors import InputError, SettingsError
from ebamcheck.layers.heights import heights_within, layer_heights
from ebamcheck.mesh.files import load
from ebamcheck.mesh.part import from_arrays
from ebamcheck.pipeline import check_job, run_job
from ebamcheck.preflight.report import ready
from ebamcheck.preflight.room import enters
from ebamcheck.preflight.workload import mean_section, workload
from ebamcheck.settings.config import Config
from ebamcheck.settings.process import KeepOut
from ebamcheck.slicers.slicing import slice_part

PLATE = {"base_plate_min_mm": (-100.0, -100.0), "base_plate_max_mm": (100.0, 100.0)}


def levels(path, job="run", yes=False, **sections):
    """Levels of the checks that do not pass, by name; each of them has a remedy, and stands in the text."""
    found = ready(path, Config().changed(**sections), job, yes).preflight
    bad = [check for check in found.checks if check.level != "pass"]
    text = preflight_text(found)
    assert all(check.remedy and check.name in text and check.remedy in text for check in bad)
    return {check.name: check.level for check in bad}


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
    assert {check.name for check in found.checks} >= {
        "mesh", "units", "size against the bead", "travel X", "travel Y", "travel Z", "process window", "feed",
        "work: layers", "work: points", "work: islands", "work: memory", "work: time",
    }  # fmt: skip


@pytest.mark.parametrize(
    ("sections", "failed"),
    [
        ({"part": {"place_at_mm": (990.0, 0.0)}}, {"travel X": "fault"}),
        ({"part": {"place_at_mm": (0.0, -985.0)}}, {"travel Y": "fault"}),
        ({"machine": {"travel_max_mm": (1000.0, 1000.0, 60.0)}}, {"travel Z": "fault"}),
        # 24 layers of 1.6755 mm and the safe height.
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
        (
            {"work": {"most_islands": 10, "most_points": 20}},
            {"work: islands": "fault", "work: points": "fault"},
        ),
    ],
    ids=str,
)
def test_what_cannot_work_is_found(block, sections, failed):
    assert levels(block, **sections) == failed


@pytest.mark.parametrize(
    ("change", "told", "remedy"),
    [
        ("open", "open edges", "close the mesh"),
        ("turned", "every facet faces inwards", "turn them in the model, or use --fix-orientation"),
    ],
)
def test_a_faulty_mesh_is_told_its_own_remedy_once_and_is_sliced_all_the_same(tmp_path, change, told, remedy):
    part = box((0, 0, 0), (40, 40, 30))
    faces = part.faces[:-1] if change == "open" else part.faces[:, ::-1]
    found = ready(stl(tmp_path, from_arrays(part.vertices, faces)), Config()).preflight
    (mesh,) = [check for check in found.checks if check.level == "fault"]
    assert (mesh.name, mesh.remedy) == ("mesh", remedy)
    assert told in mesh.text
    assert remedy not in mesh.text
    found.stop("run")


def test_a_part_beside_the_travel_is_told_where_to_go(tmp_path):
    part = stl(tmp_path, box((5000, 0, 0), (5100, 60, 40)))
    with pytest.raises(SettingsError, match=r"travel X: X needs 5003 to 5097 mm of -1000 to 1000 mm.*--place 0,0"):
        run_job(part, tmp_path / "a.run")
    assert levels(part, part={"place_at_mm": (0.0, 0.0)}) == {}
    assert list(tmp_path.iterdir()) == [part]


def test_beads_run_within_the_part(tmp_path):
    # The axes carry the middle of the bead, half a bead inside of the border.
    part = stl(tmp_path, box((-1002.9, 0, 0), (-900, 60, 40)))
    assert levels(part) == {}
    assert levels(part, scan={"contour_offset_mm": 2.0}) == {"travel X": "fault"}


# -- units -------------------------------------------------------------------------------------------


def test_a_file_in_inches_is_told_what_it_would_be(tmp_path):
    part = stl(tmp_path, box((0, 0, 0), (4, 3, 2)))
    settings = Config().changed(slicing={"backends": tuple(FAST.split(","))}, process=WIDE)
    found = {f["code"]: f for f in check_job(part, tmp_path / "a.run", settings).manifest["findings"]}
    assert found["part-under-beads"]["severity"] == "warning"
    assert "in inches it would be 101.6 x 76.2 x 50.8 mm" in found["part-under-beads"]["remedy"]
    inches = ready(part, settings.changed(part={"units": "inches"}))
    assert inches.part.size == pytest.approx([101.6, 76.2, 50.8])
    assert [c for c in inches.preflight.checks if c.level == "warning"] == []


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
    part, random, entered = PARTS[name], np.random.default_rng(11), 0
    low, high = part.bounds[:, 2]
    for _ in range(60):
        x, y, z = *random.uniform(-6.0, 40.0, 2), random.uniform(-3.0, 30.0)
        side = random.uniform(1.0, 12.0, 2)
        where = zone(x, y, x + side[0], y + side[1], (z, z + random.uniform(0.5, 9.0)))
        outline = shapely.Polygon(where.outline_mm)
        found = enters(part, where, outline)
        heights = np.linspace(*where.z_mm, 41)[1:-1] + low
        layers = slice_part(part, heights[(heights > low) & (heights < high)])
        sections = (shapely.union_all(layers.polygons(k)) for k in range(len(layers)))
        deepest = max((section.intersection(outline).area for section in sections), default=0.0)
        entered += found
        # A facet of the ball may graze a zone between two of the heights that are looked at.
        assert found or deepest == 0.0
        if found and name != "ball":
            assert deepest > 0.0
    assert 5 < entered < 55
    # A zone within the metal, whose border meets no border of a section.
    inner = zone(10, 10, 20, 20, (15.0, 25.0))
    assert enters(box((0, 0, 0), (40, 40, 40)), inner, shapely.Polygon(inner.outline_mm))


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


# -- Preflight: work that asks first, heights and files that are refused, and the commands that it speaks through --


def test_points_are_those_of_the_slices_and_the_mean_section_that_of_a_prism():
    part = sphere(20.0)
    heights = layer_heights(part, 0.7)
    work = workload(part, heights, Config(), "check")
    assert (work.layers, work.points, work.islands) == (
        len(heights),
        len(slice_part(part, heights).points),
        0,
    )
    assert mean_section(frame()) == pytest.approx((1376.0, 4 * 40 + 2 * (14 + 16)))


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


def test_more_work_than_is_allowed_asks_first(block, tmp_path):
    few = Config().changed(work={"most_layers": 3}, slicing={"backends": ("planecut",)})
    for job in (run_job, check_job):
        with pytest.raises(SettingsError, match=r"24 layers, over 3 \(work\.most_layers\): give --yes"):
            job(block, tmp_path / "a.run", few)
        assert not (tmp_path / "a.run").exists()
    assert levels(block, yes=True, work={"most_layers": 3}) == {"work: layers": "warning"}
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
    assert [(c["name"], c["limit"], c["unit"], c["stops"]) for c in faults] == [("travel X", 1000.0, "mm", ["run"])]
    with pytest.raises(SettingsError, match="--job 'fly'"):
        preflight_command(block, job="fly")
    with pytest.raises(SettingsError, match="give either"):
        preflight_command()


def test_the_preflight_is_a_command(block, tmp_path):
    done = started("preflight", block.name, "--place", "-990,0", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (1, "")
    assert "beyond machine.travel_min_mm" in done.stdout
    assert ebamcheck("preflight", block.name, "--units", "furlong", cwd=tmp_path).returncode == 2

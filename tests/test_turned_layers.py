"""A part that is turned between layers: nothing is laid into what stands, and neither beam nor head meets it."""

import json
import shutil

import numpy as np
import pytest
import shapely
from command_line import FAST, ebamcheck, write_stl
from hypothesis import given, settings
from hypothesis import strategies as st
from parts import box, sphere

from ebamcheck.checks.table import _half_plane, _highest, stands_of
from ebamcheck.errors import InputError
from ebamcheck.mesh.part import Part
from ebamcheck.settings.config import Config


def angle(depth=24.0):
    """An upright of 20 mm, 60 mm high, from whose top an arm of 15 mm reaches 25 mm along X."""
    profile = np.array([[0, 0], [20, 0], [20, 45], [45, 45], [45, 60], [0, 60]], np.float64)
    count = len(profile)
    vertices = np.vstack([np.column_stack([profile[:, 0], np.full(count, y), profile[:, 1]]) for y in (0.0, depth)])
    # Of the profile, which is seen along Y: front and back, and the sides between.
    front = [(0, 1, 2), (0, 2, 5), (2, 3, 4), (2, 4, 5)]
    faces = [list(f) for f in front] + [[f[0] + count, f[2] + count, f[1] + count] for f in front]
    for i in range(count):
        j = (i + 1) % count
        faces += [[i, i + count, j], [j, i + count, j + count]]
    return Part(vertices, np.array(faces, np.int32))


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """Folder with a run of that part, on a machine that turns it."""
    folder = tmp_path_factory.mktemp("turned")
    write_stl(angle(), folder / "angle.stl")
    (folder / "tilt.toml").write_text("[machine]\ntilt_axes = true\npark_mm = [-150.0, 12.0]\n")
    done = ebamcheck("run", "angle.stl", "-o", "angle.run", "--backends", FAST, "-c", "tilt.toml", cwd=folder)
    assert (folder / "angle.run" / "run.json").is_file(), done.stdout + done.stderr
    return folder


def relayer(place, out, layer, height, direction="1,0,0"):
    return ebamcheck(
        "relayer", place / "angle.run", "--layer", layer, "--measured-z", height, "--direction", direction, "-o", out, "--json", cwd=place
    )  # fmt: skip


def test_an_arm_is_built_beside_what_stands(place, tmp_path):
    """Twenty layers of the upright stand, 34 mm; turned, the arm lies 11 mm and more off them, and the plate farther than the head."""
    done = relayer(place, tmp_path / "o", 21, 21.7)
    told = json.loads(done.stdout)
    assert done.returncode == 0, [gate for gate in told["gates"] if not gate["passed"]]
    assert told["direction"] == [1.0, 0.0, 0.0]
    assert told["place"]


def test_a_layer_through_what_stands_is_refused_with_the_place(place, tmp_path):
    """Twelve millimetres up the turned part the section is the whole upright, of which 34 mm stand."""
    done = relayer(place, tmp_path / "o", 21, 10.0)
    assert done.returncode == 1
    shut = " ".join(gate["text"] for gate in json.loads(done.stdout)["gates"] if not gate["passed"])
    assert "standing metal" in shut
    assert "of the section stand already, at (" in shut
    assert not list((tmp_path / "o" / "layers").glob("*")) if (tmp_path / "o" / "layers").exists() else True


def test_a_head_that_would_meet_what_stands_is_refused(place, tmp_path):
    """All but the last layers stand: turned the other way, the upright rises beside the arm's foot, nearer than the head."""
    run = shutil.copytree(place / "angle.run", tmp_path / "angle.run")
    done = ebamcheck(
        "relayer", run, "--layer", 21, "--measured-z", 21.7, "--direction", "1,0,-0.6", "-o", tmp_path / "o", "--json",
        "--part", place / "angle.stl", cwd=tmp_path,
    )  # fmt: skip
    assert done.returncode == 1
    shut = " ".join(gate["text"] for gate in json.loads(done.stdout)["gates"] if not gate["passed"])
    assert "over what stands" in shut or "standing metal" in shut


def test_the_direction_of_the_run_itself_asks_nothing(place, tmp_path):
    done = relayer(place, tmp_path / "o", 4, 5.1, "0,0,2")
    assert done.returncode == 0, done.stdout
    assert "standing" not in done.stdout


# -- laws --------------------------------------------------------------------------------------------


@settings(deadline=None, max_examples=60)
@given(st.floats(-1, 1), st.floats(-1, 1), st.floats(-50, 50), st.floats(-80, 80), st.floats(-80, 80))
def test_a_half_plane_holds_what_its_inequality_says(a, b, most, x, y):
    value = a * x + b * y
    if abs(value - most) < 1e-3 or np.hypot(a, b) < 1e-2:
        return
    assert _half_plane(np.array([a, b]), most).contains(shapely.Point(x, y)) == (value < most)


@pytest.mark.parametrize("direction", [(1, 0, 0), (0, 1, 0), (0, 0, -1), (1, 2, 3), (-1, 0.3, 0.2)])
def test_what_stands_is_where_it_was_built(direction):
    part = box((3, 4, 0), (33, 28, 40))
    now = part.along(direction)
    stands = stands_of(part, now, 12.0, Config())
    n, d = stands.up
    # Heights before, of every corner, from where it lies now.
    heights = now.vertices @ n - d
    assert heights == pytest.approx(part.vertices[:, 2] - part.bounds[0, 2], abs=1e-9)


def test_the_highest_around_a_place_is_that_of_what_was_built():
    """Turned by a quarter, a box of which 12 mm stand is a box 12 mm wide and as high as it was long; beside it, the plate."""
    part = box((0, 0, 0), (30, 24, 40))
    config = Config().changed(machine={"base_plate_min_mm": (0.0, 0.0), "base_plate_max_mm": (30.0, 24.0)})
    now = part.along((1, 0, 0))
    stands = stands_of(part, now, 12.0, config)
    high = now.bounds[1, 2]
    # The direction before points along some axis of the plane now.
    n, d = stands.up
    across = n[:2] / np.hypot(*n[:2])
    side = np.array([-across[1], across[0]])
    middle = (now.bounds[0, :2] + now.bounds[1, :2]) * 0.5
    foot = middle - across * (across @ middle)

    def at(height, aside=0.0):
        return (across * (height + d) + foot + side * aside)[None]

    assert _highest(at(6.0), 1.0, stands)[0] == pytest.approx(high, abs=1e-6)
    assert _highest(at(11.0), 1.0, stands)[0] == pytest.approx(high, abs=1e-6)
    assert _highest(at(20.0), 1.0, stands)[0] == -np.inf
    assert _highest(at(20.0), 10.0, stands)[0] == pytest.approx(high, abs=1e-6)
    assert _highest(at(-12.0), 1.0, stands)[0] == pytest.approx(high, abs=1e-6)  # the plate, 25 mm thick
    assert _highest(at(-40.0), 1.0, stands)[0] == -np.inf


def test_parts_of_different_files_are_refused():
    with pytest.raises(InputError, match="another file"):
        stands_of(box(), sphere(), 1.0, Config())
    with pytest.raises(InputError, match="another file"):
        stands_of(box(upper=(2, 2, 2)), box(upper=(2, 3, 2)), 1.0, Config())

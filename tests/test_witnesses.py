"""Outside witnesses: programs of others and trimesh as slicers, and what they have in common."""

from __future__ import annotations

import contextlib
import io
import struct
import sys
import time
import zipfile
import zlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
import shapely

from ebamcheck.comparison import compare
from ebamcheck.errors import BackendFailed, BackendMissing
from ebamcheck.layers.even_odd import directed_by_nesting
from ebamcheck.layers.stack import Layers, from_rings
from ebamcheck.mesh.part import Part
from ebamcheck.scratch import scratch_folder
from ebamcheck.slicers.outside.lattices import (
    Lattice,
    LatticeStack,
    Placement,
    Program,
    scale_to,
)
from ebamcheck.testing import SlicerSuite
from ebamcheck.testing.solids import box, house_rule, joined, mapped, sections, simple, sphere
from ebamcheck_cura import Cura, read_paths
from ebamcheck_planecut import PlaneCut
from ebamcheck_prusa import Prusa, archived_images, contours
from ebamcheck_slic3r import Slic3r, slices
from ebamcheck_trimesh import TrimeshSections

WITNESSES: list[Any] = [Slic3r(), Cura(), Prusa(), TrimeshSections()]
PROGRAMS: list[Any] = WITNESSES[:3]
INTERPRETER = Program("Python", sys.executable, "NO_SUCH_VARIABLE", "python3", ("--version",), r"Python (\S+)")


def available(witness: Any) -> None:
    """Skip the test where this machine cannot run a witness."""
    probe = witness.probe()
    if not probe.available:
        pytest.skip(f"{witness.name} is not available: {probe.why}; {probe.hint}")


def named(witness: Any) -> str:
    return str(witness.name)


def cut(witness: Any, part: Part, heights: Any, **settings: Any) -> Layers:
    with witness.prepare(part, witness.Settings(**settings)) as prepared:
        return prepared.slice(np.asarray(heights, np.float64))


def within_bounds(witness: Any, part: Part, heights: Any) -> None:
    """The layers of a witness agree with those of the exact slicer of this house within the declared bound."""
    exact, found = cut(PlaneCut(), part, heights), cut(witness, part, heights)
    slack_mm = 1e-6 * float(part.size.max())
    bound_mm = witness.error_bound_mm(part, witness.Settings()) + witness.height_bound_mm(part, witness.Settings())
    table = compare(exact, found, tolerance_mm=slack_mm, bound_b_mm=bound_mm, exact_a=True, exact_b=witness.exact)
    assert table["agrees"].all(), table[~table["agrees"]].to_string()
    assert (found.areas() > 0.0).all()


def middles(part: Part, count: int) -> Any:
    low, high = part.bounds[:, 2]
    return low + (np.arange(count) + 0.5) * (high - low) / count


# -- rings without direction ---------------------------------------------------------------------------


def test_nested_rings_are_turned_by_their_depth() -> None:
    def square(low: float, high: float) -> list[tuple[float, float]]:
        return [(low, low), (low, high), (high, high), (high, low)]

    raw = from_rings([1.0], [[square(0, 9), square(1, 8), square(2, 7)[::-1], square(20, 21)]], [[[(0, 0), (5, 5)]]])
    found = directed_by_nesting(raw, 1e-9, "a slicer")
    assert sorted(found.ring_areas.tolist()) == [-49.0, 0.0, 1.0, 25.0, 81.0]
    assert found.open_counts().tolist() == [1]


def test_crossing_rings_are_refused_and_touching_ones_are_not() -> None:
    first, second = shapely.box(0, 0, 4, 4), shapely.box(3, 3, 8, 8)
    beside = shapely.box(4 - 1e-12, 0, 8, 3)

    def layers(*boxes: Any) -> Layers:
        return from_rings([0.0, 1.0], [[], [shapely.get_coordinates(b)[:-1] for b in boxes]])

    assert directed_by_nesting(layers(first, beside), 1e-9, "a slicer").outer_counts().tolist() == [0, 2]
    with pytest.raises(BackendFailed, match="rings cross at z = 1 mm"):
        directed_by_nesting(layers(first, second), 1e-9, "a slicer")


# -- the witnesses themselves --------------------------------------------------------------------------


@pytest.mark.in_turn(3)
@pytest.mark.parametrize("witness", WITNESSES, ids=named)
@pytest.mark.parametrize("name", ["tilted plate", "upright torus", "cavity", "two bodies"])
def test_stacks_agree_with_the_exact_cut(witness: Any, name: str) -> None:
    available(witness)
    part = replace(simple(name), name=f'{name}; "odd" $name/..')
    within_bounds(witness, part, middles(part, 41))


@pytest.mark.parametrize("witness", WITNESSES, ids=named)
def test_layers_of_other_heights_agree(witness: Any) -> None:
    """Single planes, runs of two steps, and heights a hair over the bottom and under the top."""
    available(witness)
    part = simple("tilted plate")
    low, high = part.bounds[:, 2].tolist()
    heights = [
        *(low + np.array([0.4, 1.1])),
        *(low + 2.0 + 0.25 * np.arange(8)),
        *(low + 6.0 + 0.7 * np.arange(9)),
        high - 0.4,
    ]
    within_bounds(witness, part, heights)


@pytest.mark.parametrize("witness", [Slic3r(), Prusa()], ids=named)
def test_parts_that_a_program_would_mend_are_refused(witness: Any) -> None:
    available(witness)
    part = simple("box")
    with pytest.raises(BackendFailed, match="is open"):
        cut(witness, Part(part.vertices, part.faces[:-1]), [1.0])
    with pytest.raises(BackendFailed, match="negative volume"):
        cut(witness, part.reversed(), [1.0])


def test_curaengine_keeps_open_paths() -> None:
    witness = Cura()
    available(witness)
    part = simple("box")
    lidless = Part(part.vertices, part.faces[~(part.triangles[:, :, 0] == 20.0).all(axis=1)])
    layers = cut(witness, lidless, [2.0])
    assert layers.ring_counts().tolist() == [0]
    assert layers.ring_lengths.sum() == pytest.approx(20.0 + 14.0 + 20.0, abs=0.01)


@pytest.mark.parametrize("witness", [Cura(), TrimeshSections()], ids=named)
def test_crossing_shells_are_refused_where_rings_have_no_direction(witness: Any) -> None:
    available(witness)
    with pytest.raises(BackendFailed, match="rings cross"):
        cut(witness, joined(box((0, 0, 0), (9, 8, 5)), box((4, 3, 1), (14, 12, 6))), [2.0])


def test_slic3r_unites_crossing_shells() -> None:
    witness = Slic3r()
    available(witness)
    part = joined(box((0, 0, 0), (9, 8, 5)), box((4, 3, 1), (14, 12, 6)))
    found, wanted = cut(witness, part, [2.0]), sections(part, [2.0], house_rule)
    assert found.areas() == pytest.approx(wanted.areas(), abs=1e-3)
    assert found.ring_counts().tolist() == [1]


@pytest.mark.parametrize("witness", PROGRAMS, ids=named)
def test_a_time_limit_ends_a_run_and_leaves_nothing(
    witness: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    available(witness)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with pytest.raises(BackendFailed, match=r"took over 0\.001 s"):
        cut(witness, simple("sphere"), middles(simple("sphere"), 20), time_limit_s=0.001)
    assert not list(tmp_path.iterdir())


class TestTrimesh(SlicerSuite):
    slicer = TrimeshSections
    models = ("cube", "torus")


@pytest.mark.slow
class TestSlic3r(SlicerSuite):
    slicer = Slic3r
    models = ("cube", "torus", "tilted-plate")


@pytest.mark.slow
class TestCura(SlicerSuite):
    slicer = Cura
    models = ("cube", "torus", "tilted-plate")


@pytest.mark.slow
class TestPrusa(SlicerSuite):
    slicer = Prusa
    models = ("cube", "torus", "tilted-plate")


# -- programs ------------------------------------------------------------------------------------------


def test_a_program_runs_without_a_shell_in_its_folder() -> None:
    with scratch_folder() as folder:
        said = INTERPRETER.run(
            ["-c", "import sys, os; print(sys.argv[1:], os.getcwd(), os.environ['HOME'])", "a b; $X"],
            folder,
            60.0,
        )
        assert "['a b; $X']" in said
        assert said.count(str(folder)) == 2
    assert not folder.exists()


def _ends(pid: int) -> bool:
    """Whether a process is gone, or dead and only not yet collected, within ten seconds: a signal takes a moment."""
    for _ in range(200):
        with contextlib.suppress(psutil.NoSuchProcess):
            if psutil.Process(pid).status() != psutil.STATUS_ZOMBIE:
                time.sleep(0.05)
                continue
        return True
    return False


def test_a_program_that_hangs_is_ended_with_what_it_started(tmp_path: Path) -> None:
    told = tmp_path / "pids"
    script = (
        "import os, subprocess, sys, time; "
        "child = subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(600)']); "
        f"open({str(told)!r}, 'w').write(f'{{os.getpid()}} {{child.pid}}'); time.sleep(600)"
    )
    with scratch_folder() as folder, pytest.raises(BackendFailed, match="took over 3 s"):
        INTERPRETER.run(["-c", script], folder, 3.0)
    for pid in map(int, told.read_text().split()):
        assert _ends(pid)


@pytest.mark.parametrize("witness", PROGRAMS, ids=named)
def test_an_absent_program_is_a_clear_line(witness: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "/nowhere")
    probe = witness.probe()
    assert not probe.available
    assert "not on the PATH" in probe.why
    assert "apt install" in probe.hint
    with pytest.raises(BackendMissing, match="apt install"):
        witness.prepare(simple("box"), witness.Settings())


# -- what the programs write ---------------------------------------------------------------------------

SVG = b"""<?xml version="1.0" encoding="UTF-8" standalone="yes"?>
<svg width="4" height="3" xmlns="http://www.w3.org/2000/svg">
  <g id="layer0" slic3r:z="5e-07">
    <polygon slic3r:type="contour" points="4,0 4,3 0,3 0,0" style="fill: white" />
    <polygon slic3r:type="hole" points="1,1 2,1 2,2 1,2" style="fill: black" />
  </g>
  <g id="layer1" slic3r:z="1.5e-06">
  </g>
  <g id="layer2" slic3r:z="2.5e-06">
    <polygon slic3r:type="contour" points="0,3 4,3 4,0.125" style="fill: white" />
  </g>
</svg>
"""


def test_slices_of_slic3r_are_read() -> None:
    found = list(slices(io.BytesIO(SVG)))
    assert [round(height_mm, 9) for height_mm, _ in found] == [0.5, 1.5, 2.5]
    assert [len(rings) for _, rings in found] == [2, 0, 1]
    areas = [shapely.Polygon(ring).exterior.is_ccw for ring in found[0][1]]
    assert areas == [True, False]
    assert shapely.Polygon(found[2][1][0]).exterior.is_ccw
    assert found[2][1][0].shape == (4, 2)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        (SVG[: len(SVG) // 2], "is cut"),
        (b"", "is cut"),
        (SVG.replace(b"2,1 2,2", b"2,1 x,2"), "points that are none"),
        (SVG.replace(b"2,1 2,2", b"2,1 2"), "points that are none"),
        (SVG.replace(b' slic3r:z="1.5e-06"', b""), "without a height"),
    ],
)
def test_broken_slices_of_slic3r_are_refused(text: bytes, why: str) -> None:
    with pytest.raises(BackendFailed, match=why):
        list(slices(io.BytesIO(text)))


GCODE = b""";FLAVOR:Marlin
G1 F200 E3
G0 X9 Y9
G1 X8 Y8 E1
;LAYER_COUNT:3
;LAYER:0
G0 F3600 X1 Y1 Z0.2
;TYPE:WALL-OUTER
G1 F600 X3 Y1 E0.28043
G1 X3.000 Y-2.5 E0.5
G92 E0
G1 X1 Y1 E1
G1 X-1 Y1 E2
G1 X-1 Y3 E3
G1 X1 Y1 E4
;LAYER:1
;LAYER:2
G0 X0.001 Y0
G1 X5 Y0 E1
G1 X5 Y0 E1
G1 X5 Y5 E2
G0 X7 Y7
G0 X7 Y8
;TIME_ELAPSED:2
M107
G1 F300 E-1
;End of Gcode
"""


def test_paths_of_curaengine_are_read() -> None:
    found = read_paths(GCODE)
    assert sorted(found) == [0, 2]
    assert [path.tolist() for path in found[0]] == [
        [[1, 1], [3, 1], [3, -2.5], [1, 1]],
        [[1, 1], [-1, 1], [-1, 3], [1, 1]],
    ]
    assert [path.tolist() for path in found[2]] == [[[0.001, 0], [5, 0], [5, 5]]]


def test_cut_gcode_is_refused() -> None:
    with pytest.raises(BackendFailed, match="is cut"):
        read_paths(GCODE[:-20])


def png(image: Any, filtered: int = 0) -> bytes:
    """A grey image of 8 bits whose rows go downwards, all with one filter."""
    rows = {
        0: image,
        1: np.diff(image, axis=1, prepend=np.uint8(0)),
        2: np.diff(image, axis=0, prepend=np.uint8(0)),
    }[filtered]
    data = np.insert(rows, 0, filtered, axis=1).astype(np.uint8).tobytes()

    def chunk(word: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + word + body + struct.pack(">I", zlib.crc32(word + body))

    head = struct.pack(">IIBBBBB", image.shape[1], image.shape[0], 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(data)) + chunk(b"IEND", b"")


@pytest.mark.parametrize("filtered", [0, 1, 2])
def test_images_of_prusaslicer_are_read(tmp_path: Path, filtered: int) -> None:
    image = np.zeros((20, 30), np.uint8)
    image[2:12, 5:25] = 255
    image[5:8, 8:20] = 0
    with zipfile.ZipFile(tmp_path / "part.sl1", "w") as archive:
        archive.writestr("config.ini", "layerHeight = 1\n")
        archive.writestr("part00001.png", png(image, filtered))
        archive.writestr("thumbnail/thumbnail400x400.png", b"not looked at")
    ((number, solid),) = archived_images(tmp_path / "part.sl1")
    assert number == 1
    assert np.array_equal(solid, image[::-1] > 127)
    outer, hole = sorted(contours(solid), key=lambda ring: -len(shapely.Polygon(ring).wkb) - shapely.Polygon(ring).area)
    assert shapely.Polygon(outer).bounds == (5.0, 8.0, 25.0, 18.0)
    assert shapely.Polygon(hole).bounds == (8.0, 12.0, 20.0, 15.0)
    assert shapely.LinearRing(outer).is_ccw
    assert not shapely.LinearRing(hole).is_ccw
    # Corners are cut off half a pixel before they come; nothing else is a point.
    assert len(outer) == len(hole) == 9


def test_unreadable_archives_are_refused(tmp_path: Path) -> None:
    (tmp_path / "part.sl1").write_bytes(b"PK no archive")
    with pytest.raises(BackendFailed, match="cannot be read"):
        list(archived_images(tmp_path / "part.sl1"))
    with zipfile.ZipFile(tmp_path / "other.sl1", "w") as archive:
        archive.writestr("a00000.png", b"GIF89a")
    with pytest.raises(BackendFailed, match="no PNG"):
        list(archived_images(tmp_path / "other.sl1"))
    with zipfile.ZipFile(tmp_path / "cut.sl1", "w") as archive:
        archive.writestr("a00000.png", png(np.arange(400, dtype=np.uint8).reshape(20, 20))[:60])
    with pytest.raises(BackendFailed, match="no PNG"):
        list(archived_images(tmp_path / "cut.sl1"))


# -- heights and lattices ------------------------------------------------------------------------------


class Counted:
    """Cuts squares whose side is the height, and counts its runs."""

    def __init__(self) -> None:
        self.runs: list[Lattice] = []

    def __call__(self, lattice: Lattice) -> Layers:
        self.runs.append(lattice)
        return from_rings(lattice.heights, [[[(0, 0), (z, 0), (z, z), (0, z)]] for z in lattice.heights.tolist()])


def test_blocks_of_a_stack_are_cut_once_and_come_back_in_order() -> None:
    counted = Counted()
    part = box((0, 0, 1), (3, 3, 9))
    heights = 1.0 + (np.arange(40) + 0.5) * 0.2
    done: list[int] = []
    with LatticeStack(part, {"backend": "counted"}, counted) as stack:
        first = stack.slice(heights[:10], done.append)
        stack.slice(heights[10:])
        single = stack.slice(heights[7:8])
    assert len(counted.runs) == 1
    assert sum(done) == 10
    assert np.array_equal(first.heights, heights[:10])
    assert np.array_equal(single.points, first.block(7, 8).points)
    assert first.areas() == pytest.approx(heights[:10] ** 2)
    assert first.backend == "counted"


# -- placement -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("count", [1, 3, 17])
def test_planes_lie_in_the_middles_of_layers_and_marks_are_cut_in_layer_0_only(count: int) -> None:
    part = mapped(sphere(), shift=(1000.0, -70.0, 33.3))
    low, high = part.bounds[:, 2].tolist()
    step = (high - low) / count
    lattice = Lattice(low + 0.31 * step, step, count)
    placement = Placement(part, lattice, scale_to(part, 512.0), 0.5)
    placed = placement.triangles()
    assert placed.min() >= 0.0
    assert 256.0 < placed[:, :, :2].max() <= 512.0
    z = placed[:, :, 2]
    planes = (placement.first_layer + np.arange(count) + 0.5) * 0.5
    wanted = part.triangles[:, :, 2]
    for k, plane in enumerate(planes):
        assert np.array_equal(z[:-8] > plane, wanted > lattice.heights[k])
        assert not ((z[-8:] > plane).any(axis=1) & (z[-8:] < plane).any(axis=1)).any()
    assert (z[:-8] > 0.25).all()
    assert ((z[-8:-4] > 0.25).any(axis=1) & (z[-8:-4] < 0.25).any(axis=1)).any()
    assert z.max() >= 0.5 * placement.layer_count

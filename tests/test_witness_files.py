"""Programs of others at work, and what they write: each is run in its folder, and its slices are read or refused."""

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
from witness_programs import INTERPRETER, PROGRAMS, WITNESSES, named

from ebamcheck.errors import BackendFailed, BackendMissing
from ebamcheck.scratch import scratch_folder
from ebamcheck.testing.solids import simple
from ebamcheck_cura import read_paths
from ebamcheck_prusa import archived_images, contours
from ebamcheck_slic3r import slices

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


def test_a_program_that_fails_says_why_in_one_line() -> None:
    with (
        scratch_folder() as folder,
        pytest.raises(BackendFailed, match=r"exit code 3: no such thing$") as failure,
    ):
        INTERPRETER.run(
            ["-c", "import sys; print('much', 'text'); sys.exit((print('no such thing'), 3)[1])"],
            folder,
            60.0,
        )
    assert "\n" not in str(failure.value)


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


def test_a_program_tells_its_version() -> None:
    probe = INTERPRETER.probe()
    assert probe.available
    assert probe.versions["Python"] == ".".join(map(str, sys.version_info[:3]))
    mute = replace(INTERPRETER, version_arguments=("-c", "print('hello')"))
    assert "does not tell a version" in mute.probe().why


@pytest.mark.parametrize("witness", PROGRAMS, ids=named)
def test_an_absent_program_is_a_clear_line(witness: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "/nowhere")
    probe = witness.probe()
    assert not probe.available
    assert "not on the PATH" in probe.why
    assert "apt install" in probe.hint
    with pytest.raises(BackendMissing, match="apt install"):
        witness.prepare(simple("box"), witness.Settings())


@pytest.mark.parametrize("witness", WITNESSES, ids=named)
def test_witnesses_take_part_only_where_they_are_named(witness: Any) -> None:
    assert witness.priority < 0


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
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", head)
        + chunk(b"IDAT", zlib.compress(data))
        + chunk(b"IEND", b"")
    )


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
    outer, hole = sorted(
        contours(solid), key=lambda ring: -len(shapely.Polygon(ring).wkb) - shapely.Polygon(ring).area
    )
    assert shapely.Polygon(outer).bounds == (5.0, 8.0, 25.0, 18.0)
    assert shapely.Polygon(hole).bounds == (8.0, 12.0, 20.0, 15.0)
    assert shapely.LinearRing(outer).is_ccw
    assert not shapely.LinearRing(hole).is_ccw
    # Corners are cut off half a pixel before they come; nothing else is a point.
    assert len(outer) == len(hole) == 9


def test_solid_up_to_the_edge_of_an_image_has_a_closed_contour() -> None:
    (ring,) = contours(np.ones((3, 4), np.bool_))
    assert shapely.Polygon(ring).bounds == (0.0, 0.0, 4.0, 3.0)


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

"""``ebamcheck scan``: table, JSON, pictures, and what it refuses."""

from __future__ import annotations

import base64
import csv
import io
import json
import signal
import subprocess
from xml.etree import ElementTree

import numpy as np
import pytest
import shapely
from command_line import WIDE_TOML, command, ebamcheck, write_stl
from parts import box
from PIL import Image

from ebamcheck.heat import contour_modes
from ebamcheck.showing.colours import SCALE as COLOURS
from ebamcheck.showing.pictures import TemperatureScale, field_svg, frontier, islands_svg, pareto_svg

AT_12 = ("--height", "12")
SVG = "{http://www.w3.org/2000/svg}"


@pytest.fixture(scope="module")
def plate(tmp_path_factory):
    return write_stl(box((0, 0, 0), (150, 80, 30)), tmp_path_factory.mktemp("parts") / "plate.stl")


@pytest.mark.slow
def test_all_orders_in_a_table_with_pictures(plate, tmp_path):
    done = ebamcheck("scan", plate, "--height", 12, "--orders", "all", "--seeds", 3, "-o", "out", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "islands at z = 12 mm, cooled base" in done.stdout
    rows = json.loads((tmp_path / "out" / "orders.json").read_text())
    names = [row["order"] for row in rows]
    assert names[-1] == "thermal"
    assert {"pareto.svg"} | {f"{n}-{kind}.svg" for n in names for kind in ("rank", "entry", "field")} == {
        path.name for path in (tmp_path / "out").glob("*.svg")
    }
    by_name = {row["order"]: row for row in rows}
    assert by_name["random"]["seeds"] == 3
    assert by_name["thermal"]["entry_max_k"] < 0.6 * by_name["farthest"]["entry_max_k"]
    count = int(done.stdout.split()[0])
    picture = ElementTree.parse(tmp_path / "out" / "thermal-rank.svg").getroot()
    assert len(picture.findall(f"{SVG}path")) == count


def test_a_height_over_a_part_that_stands_off_zero_is_that_over_its_lowest_point(tmp_path):
    raised = write_stl(box((0, 0, 100), (60, 40, 130)), tmp_path / "raised.stl")
    asked = ("scan", raised, "--height", 112, "--orders", "raster", "--export", "3dthesis", "-o", "out")
    assert ebamcheck(*asked, cwd=tmp_path).returncode == 0
    rows = np.loadtxt(tmp_path / "out" / "paths" / "raster" / "3dthesis" / "Path.txt", skiprows=1)
    assert np.unique(rows[rows[:, 4] > 0.0, 3]) == pytest.approx([12.0], abs=1e-6)


def test_pictures_of_a_layer_share_frame_path_and_scale(plate, tmp_path):
    asked = ("scan", plate, "--height", 12, "--orders", "raster,thermal", "-o", "out")
    assert ebamcheck(*asked, cwd=tmp_path).returncode == 0
    pictures = {
        (order, kind): ElementTree.parse(tmp_path / "out" / f"{order}-{kind}.svg").getroot()
        for order in ("raster", "thermal")
        for kind in ("rank", "entry", "field")
    }
    outlines = {(p.get("viewBox"), p.find(f"{SVG}g/{SVG}path[@class='outline']").get("d")) for p in pictures.values()}
    assert len(outlines) == 1
    for order in ("raster", "thermal"):
        for name in ("contour", "lines", "jumps"):
            drawn = {
                p.find(f"{SVG}g/{SVG}path[@class='{name}']").get("d") for (o, _), p in pictures.items() if o == order
            }
            assert len(drawn) == 1
            assert "M" in drawn.pop()
    scales = {
        tuple(t.text for t in p.findall(f"{SVG}text") if t.text.endswith((" K", " more")))
        for (_, kind), p in pictures.items()
        if kind != "rank"
    }
    assert len(scales) == 1
    assert {"solidus 1584 K", "boiling 3240 K"} <= set(scales.pop())


def test_rises_are_printed_between_nothing_and_boiling():
    scale = TemperatureScale.of(9000.0, 1877.0 - 293.15, 3533.0 - 293.15)
    assert scale.greatest == scale.boiling == pytest.approx(3533.0 - 293.15)
    told = {-30.2: "0", -0.2: "0", 0.0: "0", 17.6: "18", 3239.8: "3240", 3240.4: "over 3240"}
    assert {k: scale.told(k) for k in told} == told
    assert TemperatureScale.of(-4.0, 1583.85, 3239.85).greatest == 1.0
    islands = np.array([shapely.box(10 * n, 0, 10 * n + 10, 10) for n in range(2)], object)
    picture = islands_svg(islands, np.array([-50.0, 5000.0]), "a", " K", temperatures=scale)
    root = ElementTree.fromstring(picture)
    texts = [t.text for t in root.findall(f"{SVG}text")]
    assert {"0", "over 3240", "solidus 1584 K", "boiling 3240 K"} <= set(texts)
    marks = [float(m.get("d")[1:].split(",")[0]) - 16.0 for m in root.findall(f"{SVG}path[@class='mark']")]
    assert marks[0] / marks[1] == pytest.approx(1584.0 / 3240.0, abs=1e-3)


def test_frontier_is_what_no_other_order_beats():
    figures = {"a": (10.0, 900.0), "b": (20.0, 950.0), "c": (30.0, 100.0), "d": (30.0, 300.0)}
    assert frontier(figures) == ["a", "c"]
    root = ElementTree.fromstring(pareto_svg(figures, "a < b"))
    assert len(root.findall(f"{SVG}circle")) == 4


def test_json_of_the_order_of_the_settings(plate, tmp_path):
    (tmp_path / "ebamcheck.toml").write_text('[scan]\norder = "farthest"\n')
    done = ebamcheck("scan", plate, "--height", 12, "--json", cwd=tmp_path)
    assert [row["order"] for row in json.loads(done.stdout)] == ["farthest"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((*AT_12, "--orders", "raster,spiral"), "unknown order: choose one of farthest"),
        ((*AT_12, "--orders", "random", "--seeds", "0"), "--seeds 0: give at least 1"),
        ((*AT_12, "--export", "foam", "-o", "x"), "--export 'foam': choose from 3dthesis"),
        ((*AT_12, "--export", "all"), "--export: give the folder with -o"),
        (("--height", 31), "31 mm is outside of the part 'plate', which reaches from z = 0 to 30 mm"),
        (("--all", "--orders", "all"), "--all plans in one order, not 9"),
        ((*AT_12, "--all"), "give either --height Z for one layer, or --all"),
        ((*AT_12, "--pause", "5"), "--pause: the wait between layers belongs to --all"),
    ],
)
def test_what_cannot_be_planned_is_refused_in_one_line(plate, tmp_path, arguments, message):
    done = ebamcheck("scan", plate, *arguments, cwd=tmp_path)
    assert done.returncode == 2
    assert message in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_a_whole_part_is_a_row_a_layer(plate, tmp_path):
    (tmp_path / "ebamcheck.toml").write_text(WIDE_TOML)
    done = ebamcheck("scan", plate, "--all", "--layer-height", 10, "-o", "out", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "3 layers in the order thermal, cooled base" in done.stdout
    lines = (tmp_path / "out" / "layers.csv").read_text().splitlines()
    assert len(lines) == 4
    assert lines[0].startswith("layer,height_mm,islands,body_mean_k")
    rows = list(csv.DictReader(lines))
    assert [row["layer"] for row in rows] == ["1", "2", "3"]
    waited = ebamcheck("scan", plate, "--all", "--layer-height", 10, "--pause", 100, "--json", cwd=tmp_path)
    paused = json.loads(waited.stdout)
    for found, pause in ((rows, 0.0), (paused, 100.0)):
        layer_s, wait_s = (np.array([float(row[name]) for row in found]) for name in ("time_s", "wait_s"))
        assert [float(row["built_s"]) for row in found] == pytest.approx(np.cumsum(layer_s + wait_s))
        assert (wait_s[1:] >= pause).all()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("asked", "file", "told"),
    [
        (
            ("--height", 12, "--orders", "raster,random", "--seeds", 10**6),
            "orders.json",
            "1 of 2 orders are done",
        ),
        (("--all", "--layer-height", 0.01), "layers.csv", "of 3000 layers are done"),
    ],
)
def test_an_interrupt_keeps_what_is_done(plate, tmp_path, asked, file, told):
    (tmp_path / "ebamcheck.toml").write_text(WIDE_TOML)
    scan = subprocess.Popen(
        command("scan", plate, *asked, "-o", "out"), cwd=tmp_path, stderr=subprocess.PIPE, text=True
    )
    path = tmp_path / "out" / file
    while not path.is_file() or path.read_text().count("\n") < 2:
        assert scan.poll() is None
    scan.send_signal(signal.SIGINT)
    # A kernel that was compiled on the way is told of.
    told_of = scan.communicate()[1].splitlines()
    (error,) = [line for line in told_of if not line.startswith("ebamcheck: compil")]
    assert scan.returncode == 130
    assert error.startswith("ebamcheck: interrupted; ")
    assert f"{told}, kept in out" in error
    if file == "orders.json":
        assert [row["order"] for row in json.loads(path.read_text())] == ["raster"]
        assert {p.name for p in path.parent.glob("*.svg")} >= {"raster-rank.svg", "pareto.svg"}
    else:
        lines = path.read_text().splitlines()
        assert error.split()[2] == str(len(lines) - 1)
        assert all(line.count(",") == lines[0].count(",") for line in lines)


def image_of(picture):
    address = ElementTree.fromstring(picture).find(f".//{SVG}image").get("href")
    assert address.startswith("data:image/png;base64,")
    return Image.open(io.BytesIO(base64.b64decode(address.split(",")[1])))


def test_a_field_is_drawn_where_it_is():
    section = shapely.box(0, 0, 100, 50).difference(shapely.box(40, 20, 60, 30))
    plane = contour_modes(section, 0.02, 200)
    _, column = np.nonzero(plane.grid.number >= 0)
    x = plane.grid.origin[0] + (column + 0.5) * plane.grid.step[0]
    colours = np.asarray(
        image_of(field_svg(lambda at: plane.grid.interpolation(at) @ x, section, "a < b", " K", 100.0)).convert("RGB")
    )
    rows, columns = colours.shape[:2]
    assert columns / rows == pytest.approx(2.0, rel=0.02)
    for share in (0.1, 0.5, 0.9):
        wanted = COLOURS[round(255 * share)].astype(int)
        assert np.abs(colours[rows // 8, round(share * columns)].astype(int) - wanted).max() < 12

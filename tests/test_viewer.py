"""The viewer: what it packs comes back, its figures are those of the run, and a browser shows them."""

from __future__ import annotations

import base64
import html
import re
import subprocess
import zlib
from pathlib import Path

import numpy as np
import pytest
from browser import shown_page
from command_line import ebamcheck
from finished_runs import certified_plate
from program_text import ProgramText

from ebamcheck.nc.reader import read_program
from ebamcheck.record.run_folder import RunFolder
from ebamcheck_reports.run_data import RunData
from ebamcheck_viewer.columns import packed, packed_text
from ebamcheck_viewer.contents import SHARE, Contents, notes, of_files, of_run, strips
from ebamcheck_viewer.page import document


@pytest.fixture(scope="module")
def plate(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return certified_plate(tmp_path_factory)[0]


@pytest.fixture(scope="module")
def contents(plate: Path) -> Contents:
    return of_run(RunFolder(plate))


def inflated(text: str) -> bytes:
    return zlib.decompress(base64.b64decode(text), -15)


def unpacked(text: str) -> dict[str, np.ndarray]:
    """The columns of a blob, read as the page reads them."""
    data, at, found = inflated(text), 0, {}

    def number() -> int:
        nonlocal at
        value = shift = 0
        while True:
            byte = data[at]
            at += 1
            value |= (byte & 127) << shift
            shift += 7
            if byte < 128:
                return (value >> 1) ^ -(value & 1)

    while at < len(data):
        size = data[at]
        name = data[at + 1 : at + 1 + size].decode()
        at += 1 + size
        found[name] = np.cumsum([number() for _ in range(number())])
    return found


def test_columns_come_back() -> None:
    random = np.random.default_rng(1)
    columns = {
        "a": random.integers(-(2**50), 2**50, 400),
        "none": np.zeros(0, np.int64),
        "one": np.array([-1]),
        "up": np.arange(300) * 127,
    }
    found = unpacked(packed(columns))
    assert list(found) == list(columns)
    assert all(np.array_equal(found[name], column) for name, column in columns.items())


def test_texts_come_back_but_for_numbers_in_steps_of_ten() -> None:
    assert inflated(packed_text(b"%_N\nN10 G0\nN20 X1\nN25 X2\nN35 X3\n")) == b"%_N\n\1G0\n\1X1\nN25 X2\n\1X3\n"


def test_motions_take_the_time_of_the_program(plate: Path, contents: Contents) -> None:
    table = RunData(RunFolder(plate)).table("program.csv")
    for k, row in enumerate(table.itertuples()):
        columns = unpacked(contents.blobs[f"L{k + 1}"])
        assert columns["m.ms"].sum() / 1000 == pytest.approx(row.deposit_s + row.travel_s, abs=1e-3 * row.motions)
        assert len(columns["m.kind"]) == row.motions


def test_the_worst_layers_are_those_of_the_gates(plate: Path, contents: Contents) -> None:
    record = RunFolder(plate).manifest()
    strips = {strip["gate"]: strip for strip in contents.index["strips"]}
    assert {"agreement", "coverage", "deposit"} <= set(strips)
    depths = [pair["max_depth_mm"] for pair in record["comparison"]["pairs"]]
    assert max(f for f in strips["agreement"]["figure"] if f is not None) == pytest.approx(
        max(depths), rel=1e-5, abs=1e-12
    )
    covered = next(gate for gate in record["gates"] if gate["name"] == "coverage")
    assert min(strips["coverage"]["figure"]) == pytest.approx(covered["figure"], rel=1e-5)
    assert len(contents.index["notes"]) == sum(
        map(len, (record["gates"], record["findings"], record["program"]["checks"]))
    )


def test_contours_are_the_sections_to_a_step(plate: Path, contents: Contents) -> None:
    stack = RunFolder(plate).read_layers("planecut").block(0, 1)
    columns = unpacked(contents.blobs["L1"])
    x, y = (columns[f"c.planecut.{axis}"] * contents.index["step_mm"] for axis in "xy")
    assert [x.min(), y.min(), x.max(), y.max()] == pytest.approx(
        [*stack.points.min(axis=0), *stack.points.max(axis=0)], abs=1e-3
    )
    assert columns["c.planecut.closed"].tolist() == stack.closed.tolist()


def test_beads_of_islands_lie_in_them(contents: Contents) -> None:
    columns = unpacked(contents.blobs["L1"])
    filled = columns["m.island"][columns["m.island"] >= 0]
    assert set(filled) == set(columns["i.number"])
    assert (columns["m.ring"] >= 0).any()


def test_hostile_names_are_text(contents: Contents) -> None:
    name = "</script><script>alert(1)</script><img src=x onerror=alert(2)>"
    page = document(Contents({**contents.index, "name": name}, contents.blobs))
    assert name not in page
    assert page.count("<script>") == 1
    assert html.escape(name) in page
    assert "http://" not in page.replace("http://www.w3.org/2000/svg", "")


def test_the_command_writes_a_page(plate: Path, tmp_path: Path) -> None:
    done = ebamcheck("view", str(plate), "-o", "plate.html", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "plate.html").read_text(encoding="utf-8").startswith("<!DOCTYPE html>")
    layers = [str(plate / "layers" / f"{name}.parquet") for name in ("planecut", "manifold")]
    done = ebamcheck("view", *layers, str(plate / "program" / "MAIN.MPF"), "-o", "files.html", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert '"slicers":["planecut","manifold"]' in (tmp_path / "files.html").read_text(encoding="utf-8")
    for wrong, what in (
        (("view", "."), "program"),
        (("view", str(plate), "-o", "a.txt"), "FILE.html"),
        (("view", str(plate), "-o", str(plate / "v.html")), "lies in the run"),
    ):
        refused = ebamcheck(*wrong, cwd=tmp_path)
        assert refused.returncode == 2
        assert what in refused.stderr


def test_a_browser_shows_the_layer_and_block_of_an_address(plate: Path, contents: Contents, tmp_path: Path) -> None:
    page = tmp_path / "plate.html"
    page.write_text(document(contents), encoding="utf-8")
    file = contents.index["files"][1]
    text = (RunFolder(plate).program_folder / file).read_text(encoding="ascii").split("\n")
    line = next(n for n, block in enumerate(text, 1) if " G1 " in block or " POLY " in block)
    shown = shown_page(page, tmp_path, f"#layer=1&line={file}:{line}")
    assert 'data-ready="1"' in shown
    said = re.search(r'id="said"[^>]*>([^<]*)', shown)
    assert said
    assert said[1].startswith(f"layer 2 of {contents.index['layers']}, Z ")
    now = re.search(r'<li class="now"><button[^>]*>([^<]*)', shown)
    assert now
    assert html.unescape(now[1]) == text[line - 1]


def test_layers_of_one_file_are_told_by_their_lines(tmp_path: Path) -> None:
    text = ProgramText("linuxcnc", tmp_path / "p")
    index = of_files({}, read_program(tmp_path / "p", text.config), text.config).index
    assert index["files"] == [text.main] * 2
    begins = [text.layer(k)[1] + 1 for k in (1, 2)]
    assert begins[0] < index["lines"][0] < begins[1] < index["lines"][1]


def test_the_page_holds_what_its_sources_are_bundled_to(tmp_path: Path) -> None:
    viewer = Path(__file__).parents[1] / "reports" / "viewer"
    esbuild = viewer / "node_modules" / ".bin" / "esbuild"
    if not esbuild.exists():
        pytest.skip("esbuild is not installed: make viewer installs it")
    words = [
        "src/main.js",
        "--bundle",
        "--minify",
        "--format=iife",
        "--target=es2022",
        f"--outfile={tmp_path / 'v.js'}",
    ]
    subprocess.run([esbuild, *words], cwd=viewer, check=True, capture_output=True)
    assert (tmp_path / "v.js").read_bytes() == (viewer / "ebamcheck_viewer" / "dist" / "viewer.min.js").read_bytes()


def test_a_layer_over_a_limit_of_nothing_is_the_worst(plate: Path) -> None:
    run = RunData(RunFolder(plate))
    pairs = run.pair_table.copy()
    one = pairs["layer"] == 2
    pairs.loc[one, ["gated", "depth_mm", "limit_mm"]] = [True, 0.01, 0.0]
    run.__dict__["pair_table"] = pairs
    share = next(strip for strip in strips(run) if strip["gate"] == "agreement")["share"]
    assert share[1] == max(share) > 1.0 / SHARE


@pytest.mark.parametrize(
    ("place", "at"),
    [("layer 3, (1.5, -2.25)", [1.5, -2.25]), ("(1.2.3, 4)", None), ("(-., 1)", None), ("(1, 2, 3)", [1.0, 2.0])],
)
def test_places_in_words_are_found_or_left_alone(plate: Path, place: str, at: list[float] | None) -> None:
    run = RunData(RunFolder(plate))
    run.__dict__["manifest"] = {
        **run.manifest,
        "findings": [{"code": "a", "severity": "note", "text": "b", "place": place}],
    }
    note = next(note for note in notes(run) if note["kind"] == "finding")
    assert note.get("at") == at

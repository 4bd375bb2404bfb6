"""The benchmarks: what becomes of figures, the parts that they are taken on, and one of them from end to end."""

from __future__ import annotations

import json
import sys
import xml.etree.ElementTree as ElementTree
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
from benchmark_figures import cell, one_round, raw_figures

import ebamcheck
from benchmarks import __main__ as command
from benchmarks import curves, ladder, parts, plot, targets, yardsticks
from benchmarks.even_mesh import even_mesh
from benchmarks.figures import Spread, cell_times, is_scaled, quantity, ratio, spread, spread_text, total_s
from benchmarks.ladder import Effort, Method, measure_ladder
from benchmarks.mutants import mutants
from benchmarks.watch import ROOT, run_task, watch
from benchmarks.worker import some_of
from ebamcheck.curves import METHODS
from ebamcheck.errors import BackendFailed
from ebamcheck.mesh.files import load
from ebamcheck.mesh.inspection import inspect
from ebamcheck_models import LADDER, write_stl

# -- figures -------------------------------------------------------------------------------------------


def test_the_spread_is_that_of_the_figures():
    assert spread([5.0, 1.0, 2.0, 4.0]) == Spread(3.0, 1.0, 5.0, 4)
    with pytest.raises(ValueError, match="no figures"):
        spread([])


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (0.0, "s", "0 ms"), (0.00512, "s", "5.12 ms"), (0.9996, "s", "1000 ms"), (89.99, "s", "90.0 s"), (600.4, "s", "600 s"),
        (2.5e-7, "mm", "2.5e-07 mm"), (0.25, "", "0.25"), (8192.0, "MB", "8.19 GB"),
    ],
)  # fmt: skip
def test_quantities_are_written_with_three_digits(value: float, unit: str, text: str):
    assert quantity(value, unit) == text


def test_one_figure_has_no_spread():
    assert spread_text(spread([1.5])) == "1.50 s"


def test_a_time_of_some_layers_is_scaled_in_its_slicing_alone():
    some = cell("p", "m", 4.0, layers_cut=10)
    assert is_scaled(some)
    assert cell_times(some).median == pytest.approx(1.0 + 1.0 + 20.0)
    assert not is_scaled(cell("p", "m", 4.0))


def test_the_first_round_of_a_process_is_not_its_warm_time():
    assert total_s({"rounds": [one_round(9.0), one_round(2.0), one_round(4.0)]}) == pytest.approx(3.0)
    assert total_s({"rounds": [one_round(9.0)]}) == pytest.approx(9.0)


def test_a_ratio_has_the_ends_that_both_spreads_allow():
    found = ratio(spread([1.0, 2.0, 3.0]), spread([10.0, 20.0, 40.0]))
    assert (found.least, found.median, found.greatest) == (1.0 / 40.0, 0.1, 0.3)
    assert ratio(None, spread([1.0])) is None


def test_heights_are_chosen_over_the_whole_part_and_all_where_there_are_few():
    heights = np.arange(100.0)
    chosen = some_of(heights, 9)
    assert np.array_equal(chosen, [10.0, 20.0, 30.0, 40.0, 50.0, 59.0, 69.0, 79.0, 89.0])
    assert np.array_equal(some_of(heights, 100), heights)


# -- tables and plot -----------------------------------------------------------------------------------


def test_tables_mark_what_was_scaled_cut_short_or_missing():
    text = ladder.ladder_text(raw_figures())
    row = next(line for line in text.splitlines() if line.startswith("| 1,480,000"))
    assert [c.strip() for c in row.strip("|").split("|")] == ["1,480,000", "400 ms", "~25.0 s", "> 60.0 s"]
    assert "- cura, missing: the program | is not installed" in text
    assert "| ~25.0 s |" in ladder.readme_text(raw_figures())


def test_the_table_of_targets_has_a_row_for_each():
    raw = raw_figures()
    raw["targets"] = {"ladder": {"cold": [{"status": "done", "why": "", "wall_s": 5.0}]}}
    done = {"status": "done", "why": ""}
    raw["job"] = {
        "main job": [{**done, "wall_s": 12.0, "processor_s": 56.0}],
        "islands": [{**done, "layer_s": [9.0, 0.2, 0.6, 0.6], "islands": [10, 10, 10, 10]}],
    }
    text = targets.targets_text(raw)
    for row in (*targets.TARGETS, *targets.JOB):
        assert f"| {row.what} |" in text
    assert "**missed**: 2.00 times the target" in text
    # The first layer brings everything up: it counts in no row.
    assert "| 467 ms | met |" in text
    assert "| 3 | **missed**: 2.73 times the target |" in text


def test_the_plot_is_one_picture_that_says_what_is_not_measured():
    lines = plot.lines_of(raw_figures(), "ladder")
    assert [[p.kind for p in line.points] for line in lines] == [["measured"] * 3, ["scaled"], ["over"]]
    root = ElementTree.fromstring(plot.time_chart(lines, "Times", "<a & b>"))
    space = "{http://www.w3.org/2000/svg}"
    assert root.tag == f"{space}svg"
    words = [text.text for text in root.iter(f"{space}text")]
    assert any("89 s" in w and "1,483,132" in w for w in words)
    assert "stencil literal: ~25.0 s" in words
    assert "slic3r: > 60.0 s" in words
    fills = [circle.get("fill") for circle in root.iter(f"{space}circle")]
    assert fills.count("white") == 1
    assert len(fills) == 4
    labels = sorted(
        float(t.get("y"))
        for t in root.iter(f"{space}text")
        if t.text.startswith(("plane", "stencil l", "slic3r:"))
    )
    assert min(np.diff(labels)) >= plot.LABEL_STEP_PX - 0.1


# -- parts ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("facets", [4822, 37747])
def test_the_even_mesh_is_closed_near_equilateral_and_of_the_size_asked_for(facets: int, tmp_path: Path):
    part = even_mesh(LADDER, facets)
    assert abs(len(part.faces) - facets) < 0.02 * facets
    assert inspect(part).passed
    assert part.volume == pytest.approx(LADDER.volume, rel=0.02)
    assert np.array_equal(part.vertices, part.vertices.astype(np.float32))
    edges = np.linalg.norm(part.triangles - np.roll(part.triangles, 1, axis=1), axis=2)
    assert np.median(edges.max(axis=1) / edges.min(axis=1)) < 1.1
    write_stl(part, tmp_path / "even.stl")
    assert len(load(tmp_path / "even.stl").vertices) == len(part.vertices)


def test_shuffled_facets_are_the_same_facets(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(parts, "FOLDER", tmp_path / "parts")
    given = parts.benchmark_part("even", 1)
    mixed = parts.shuffled(given)
    one, other = (
        sorted(np.frombuffer(p.path.read_bytes(), "V50", offset=84).tolist()) for p in (given, mixed)
    )
    assert one == other
    assert given.path.read_bytes() != mixed.path.read_bytes()
    assert parts.shuffled(given).path.stat().st_mtime_ns == mixed.path.stat().st_mtime_ns
    assert given.facets == len(one)


@pytest.mark.parametrize("text", ["0", "12", "a", "3-", "5-4"])
def test_sizes_that_are_none_are_refused(text: str):
    with pytest.raises(ValueError, match=r"sizes|invalid literal"):
        parts.sizes_of(text if text != "3-" else "x-3")


# -- measurements --------------------------------------------------------------------------------------


def test_the_slice_stage_is_read_from_the_log():
    log = [
        "[2026-01-01 00:00:01.000000] [0x1] [debug]   TriangleMesh::repair() finished\n",
        "10 => Processing triangulated mesh\n",
        "[2026-01-01 00:00:02.250000] [0x1] [debug]   slice_mesh to polygons\n",
        "[2026-01-01 00:00:03.500000] [0x1] [debug]   Slicing volumes - removing top empty layers\n",
        "[2026-01-01 00:00:09.000000] [0x1] [debug]   never read\n",
    ]
    assert yardsticks.stage_seconds(log) == 1.25
    with pytest.raises(BackendFailed, match="Objects could not fit"):
        yardsticks.stage_seconds([*log[:3], "Objects could not fit on the bed\n"])


def test_a_process_that_outlives_its_limit_is_ended():
    found = watch([sys.executable, "-c", "while True: pass"], limit_s=0.2)
    assert found.ended == "time"
    assert found.code != 0


def test_memory_of_children_counts_and_can_end_a_process():
    child = "import subprocess, sys; subprocess.run([sys.executable, '-c', 'x = bytearray(400_000_000)\\nwhile True: pass'])"
    found = watch([sys.executable, "-c", child], limit_s=60.0, memory_mb=300.0)
    assert found.ended == "memory"
    assert found.peak_mb > 300.0


def test_last_words_name_no_folder_of_this_machine():
    here = str(Path(__file__).resolve())
    found = watch([sys.executable, "-c", f"import sys; sys.exit({here!r})"], limit_s=60.0)
    assert (found.code, found.ended) == (1, "")
    assert found.last_words == "tests/test_benchmarks.py"


def test_a_task_that_fails_says_why():
    method = asdict(Method("none", backend="no-such-slicer"))
    found = run_task("time", {"stl": "none.stl", "layer_mm": 1.0, "method": method}, 60.0)
    assert found["status"] == "failed"
    assert "no-such-slicer" in found["why"]


def test_what_ran_over_the_limit_is_not_tried_on_larger_parts(monkeypatch: pytest.MonkeyPatch):
    asked = []

    def measured(task: str, request: dict[str, object], limit_s: float) -> dict[str, object]:
        asked.append(request["stl"])
        return {"status": "over", "why": "ended after 1 s"}

    monkeypatch.setattr("benchmarks.ladder.run_task", measured)
    sizes = [parts.BenchmarkPart("ladder", n, Path(f"{n}.stl"), 1000 * n, 0.2) for n in (1, 2)]
    planecut = Method("planecut", backend="planecut")
    cells = measure_ladder(sizes, [planecut], Effort(repeats=3, limit_s=1.0), lambda _: None, lambda _: None)
    assert asked == ["1.stl"]
    assert [c["status"] for c in cells] == ["over", "over"]
    assert cells[1]["why"] == "not tried: over the limit at 1,000 facets"


def test_methods_hold_every_backend_and_the_yardsticks():
    found = {m.name: m for m in ladder.all_methods()}
    assert set(ebamcheck.plugins.registry.slicers()) <= set(found)
    assert {ladder.LITERAL, ladder.MANIFOLD_ALONE, ladder.PRUSA_STAGE} <= set(found)
    assert found[ladder.LITERAL].by_layer
    assert [m.name for m in ladder.GPU_METHODS] == ["stencil", ladder.LITERAL]


@pytest.mark.slow
def test_one_command_measures_and_writes_figures_tables_and_a_plot(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    chosen = [Method("planecut", backend="planecut"), Method(ladder.MANIFOLD_ALONE, "manifold3d")]
    monkeypatch.setattr(ladder, "all_methods", lambda: chosen)
    monkeypatch.setattr(parts, "FOLDER", tmp_path / "parts")
    arguments = ["--quick", "--part", "even", "--sizes", "1", "--no-targets", "-o", str(tmp_path / "out")]
    assert command.main(arguments) == 0
    raw = json.loads((tmp_path / "out" / "benchmark.json").read_text(encoding="utf-8"))
    planecut, alone = raw["cells"]
    assert (planecut["status"], alone["status"]) == ("done", "done")
    for measured in (planecut, alone):
        (run,) = measured["runs"]
        assert 0 < run["rounds"][0]["points"] == planecut["runs"][0]["rounds"][0]["points"]
        assert run["peak_mb"] > run["resident_mb"] > 10.0
    assert "planecut" in (tmp_path / "out" / "ladder.md").read_text(encoding="utf-8")
    ElementTree.parse(tmp_path / "out" / "even.svg")
    before = (tmp_path / "out" / "ladder.md").read_bytes()
    assert command.main([*arguments[:-2], "--render", "-o", str(tmp_path / "out")]) == 0
    assert (tmp_path / "out" / "ladder.md").read_bytes() == before
    assert "turn 1" in capsys.readouterr().err


@pytest.mark.long
def test_the_tables_of_the_curves_name_every_kind_and_method(tmp_path: Path) -> None:
    curves.main(["--quick", "-o", str(tmp_path)])
    record = json.loads((tmp_path / "curves.json").read_text())
    kinds = {row["kind"] for row in record["parts"]}
    assert kinds == {
        *(f"regular {mm:g}" for mm in (1.0, 0.3, 0.1)),
        "irregular",
        "cad",
        "flat",
        "decimated",
        "noise",
    }
    methods = {*METHODS, *curves.PEERS}
    assert {(row["kind"], row["method"]) for row in record["summary"]} == {
        (k, m) for k in kinds for m in methods
    }
    text = (tmp_path / "curves.md").read_text()
    assert all(f"| {row['part']} |" in text for row in record["parts"])
    assert all(row["crossing"] == 0 for row in record["parts"] if row["method"] in METHODS)


def test_every_wrong_change_can_be_planted() -> None:
    """Rows of ``benchmarks/mutations`` follow the code: each text stands once in its file, and its tests are there."""
    for row in mutants():
        assert row.planted((ROOT / row.file).read_text(encoding="utf-8"))
        assert all((ROOT / test.partition("::")[0]).exists() for test in row.tests), row

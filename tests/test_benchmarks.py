"""The benchmarks: what becomes of figures, the parts that they are taken on, and one of them from end to end."""

from __future__ import annotations

import json
import sys
import xml.etree.ElementTree as ElementTree
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import ebamcheck
from benchmarks import __main__ as command
from benchmarks import curves, ladder, parts, targets
from benchmarks.acceptance import BACKENDS, DEFAULTS, PAIRS, REMEDIES, apart, rendered, row
from benchmarks.figures import cell_times, is_scaled, ratio, spread, total_s
from benchmarks.ladder import Effort, Method, measure_ladder
from benchmarks.mutants import mutants
from benchmarks.targets import TARGETS, Figures, targets_text
from benchmarks.watch import ROOT, run_task, watch
from benchmarks.worker import stage_seconds
from ebamcheck.curves import METHODS
from ebamcheck.errors import BackendFailed
from ebamcheck.mesh.files import load
from ebamcheck.mesh.inspection import inspect
from ebamcheck.plugins.registry import models
from ebamcheck.settings.config import Config
from ebamcheck_models import LADDER


def one_round(seconds: float, layers_cut: int = 100, layers: int = 100, points: int = 1000) -> dict[str, object]:
    return {
        "load_s": 0.25 * seconds, "prepare_s": 0.25 * seconds, "slice_s": 0.5 * seconds,
        "layers": layers, "layers_cut": layers_cut, "points": points, "rings": 10, "output_bytes": 16 * points,
    }  # fmt: skip


def cell(part: str, method: str, *seconds: float, **round_: int) -> dict[str, object]:
    runs = [{"rounds": [one_round(s, **round_)], "peak_mb": 300.0, "resident_mb": 100.0} for s in seconds]
    return {"part": part, "method": method, "status": "done", "why": "", "limit_s": 60.0, "runs": runs}


def over(part: str, method: str) -> dict[str, object]:
    return {**cell(part, method), "status": "over", "why": "ended after 60 s"}


def raw_figures() -> dict[str, object]:
    facets = {1: 4_000, 6: 38_000, 11: 1_480_000}
    return {
        "command": "python -m benchmarks",
        "machine": {
            "cpu": "made up", "cores": 2, "memory_gb": 24.0, "load_at_start": [0.1, 0.1, 0.1], "started": "now",
            "ebamcheck": "0", "commit": "", "python": "3", "packages": {"numpy": "2"}, "renderer": "llvmpipe (made up)",
        },
        "methods": ["planecut", "stencil literal", "slic3r", "cura"],
        "parts": {
            f"ladder-{size}": {"series": "ladder", "size": size, "facets": n, "bytes": 50 * n, "layer_mm": 0.2}
            for size, n in facets.items()
        },
        "cells": [
            cell("ladder-1", "planecut", 0.01), cell("ladder-6", "planecut", 0.02, points=38_000),
            cell("ladder-11", "planecut", 0.40, 0.42, 0.38, points=8_000_000),
            cell("ladder-11", "stencil literal", 10.0, layers_cut=25), over("ladder-11", "slic3r"),
            {**cell("ladder-11", "cura"), "status": "missing", "why": "the program | is not installed"},
        ],
        "targets": {"ladder": {}}, "job": {},
    }  # fmt: skip


# -- figures -------------------------------------------------------------------------------------------


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


# -- tables and plot -----------------------------------------------------------------------------------


def test_tables_mark_what_was_scaled_cut_short_or_missing():
    text = ladder.ladder_text(raw_figures())
    line_of = next(line for line in text.splitlines() if line.startswith("| 1,480,000"))
    assert [c.strip() for c in line_of.strip("|").split("|")] == [
        "1,480,000",
        "400 ms",
        "~25.0 s",
        "> 60.0 s",
    ]
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
    for target in (*targets.TARGETS, *targets.JOB):
        assert f"| {target.what} |" in text
    assert "**missed**: 2.00 times the target" in text
    # The first layer brings everything up: it counts in no row.
    assert "| 467 ms | met |" in text
    assert "| 3 | **missed**: 2.73 times the target |" in text


def test_the_chart_is_one_picture_that_says_what_is_not_measured(tmp_path: Path):
    points = ladder.plotted(raw_figures(), "ladder")
    assert [[kind for _, _, kind in line] for line in points.values()] == [
        ["measured"] * 3,
        ["scaled"],
        ["over"],
    ]
    ladder.write_chart(raw_figures(), "ladder", tmp_path / "a.svg")
    ladder.write_chart(raw_figures(), "ladder", tmp_path / "b.svg")
    assert (tmp_path / "a.svg").read_bytes() == (tmp_path / "b.svg").read_bytes()
    root = ElementTree.parse(tmp_path / "a.svg").getroot()
    words = [text.text for text in root.iter("{http://www.w3.org/2000/svg}text")]
    assert {"planecut: 400 ms", "stencil literal: ~25.0 s", "slic3r: > 60.0 s"} <= set(words)
    assert any("89 s" in w and "1,483,132" in w for w in words)


# -- parts ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("facets", [4822, 37747])
def test_the_even_mesh_is_closed_near_equilateral_and_of_the_size_asked_for(facets: int, tmp_path: Path, monkeypatch):
    count = parts.write_even_mesh(LADDER, facets, tmp_path / "even.stl")
    part = load(tmp_path / "even.stl")
    assert len(part.faces) == count
    assert abs(count - facets) < 0.02 * facets
    assert inspect(part).passed
    assert part.volume == pytest.approx(LADDER.volume, rel=0.02)
    edges = np.linalg.norm(part.triangles - np.roll(part.triangles, 1, axis=1), axis=2)
    assert np.median(edges.max(axis=1) / edges.min(axis=1)) < 1.1
    monkeypatch.setattr(parts, "FACETS_A_BAND", 1 << 10)
    parts.write_even_mesh(LADDER, facets, tmp_path / "bands.stl")
    assert (tmp_path / "bands.stl").read_bytes() == (tmp_path / "even.stl").read_bytes()


def test_shuffled_facets_are_the_same_facets(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(parts, "FOLDER", tmp_path / "parts")
    given = parts.benchmark_part("even", 1)
    mixed = parts.shuffled(given)
    one, other = (sorted(np.frombuffer(p.path.read_bytes(), "V50", offset=84).tolist()) for p in (given, mixed))
    assert one == other
    assert given.path.read_bytes() != mixed.path.read_bytes()
    assert parts.shuffled(given).path.stat().st_mtime_ns == mixed.path.stat().st_mtime_ns
    assert given.facets == len(one)


# -- measurements --------------------------------------------------------------------------------------


def test_the_slice_stage_is_read_from_the_log():
    log = [
        "[2026-01-01 00:00:01.000000] [0x1] [debug]   TriangleMesh::repair() finished\n",
        "10 => Processing triangulated mesh\n",
        "[2026-01-01 00:00:02.250000] [0x1] [debug]   slice_mesh to polygons\n",
        "[2026-01-01 00:00:03.500000] [0x1] [debug]   Slicing volumes - removing top empty layers\n",
        "[2026-01-01 00:00:09.000000] [0x1] [debug]   never read\n",
    ]
    assert stage_seconds(log) == 1.25
    with pytest.raises(BackendFailed, match="Objects could not fit"):
        stage_seconds([*log[:3], "Objects could not fit on the bed\n"])


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
    assert {(row["kind"], row["method"]) for row in record["summary"]} == {(k, m) for k in kinds for m in methods}
    text = (tmp_path / "curves.md").read_text()
    assert all(f"| {row['part']} |" in text for row in record["parts"])
    assert all(row["crossing"] == 0 for row in record["parts"] if row["method"] in METHODS)


def test_every_wrong_change_can_be_planted() -> None:
    """Rows of ``benchmarks/mutations`` follow the code: each text stands once in its file, and its tests are there."""
    for one in mutants():
        assert one.planted((ROOT / one.file).read_text(encoding="utf-8"))
        assert all((ROOT / test.partition("::")[0]).exists() for test in one.tests), one


# -- targets --------------------------------------------------------------------------------------------------


DONE = {"status": "done", "why": ""}


def results(**tasks: list[dict[str, object]]) -> dict[str, tuple[str, str]]:
    raw = raw_figures()
    figures = Figures(raw["cells"], tasks, raw["parts"], "ladder", 11)
    return {target.what.partition(",")[2].strip() or target.what: target.judged(figures) for target in TARGETS}


def test_a_target_is_met_missed_or_says_why_it_was_not_measured():
    told = results(**{"cold": [{"status": "failed", "why": "it crashed"}], "start-up": [{**DONE, "wall_s": 1.6}]})
    assert told["file to contours, warm process"] == ("400 ms (380 ms .. 420 ms, n = 3)", "met")
    assert told["whole command, cold"] == ("-", "not measured (failed: it crashed)")
    assert told["one layer)"] == ("1.60 s", "**missed**: 2.00 times the target")
    assert told["the paper's way, 0.1 mm pixels"] == ("22.5 s", "no target")
    assert told["part loaded"] == ("-", "not measured (not measured)")


def test_growth_is_per_facet_and_point_over_the_base_size():
    base, small = 0.02 / (38_000 + 38_000), 0.01 / (4_000 + 1_000)
    figure, verdict = results()["worst of all sizes"]
    assert float(figure) == pytest.approx(small / base, rel=1e-2)
    assert verdict == "**missed**: 2.53 times the target"


def test_memory_is_related_to_file_and_layers():
    figure, _ = results()["peak memory of the process over input + output"]
    assert float(figure.split()[0]) == pytest.approx(300e6 / (50 * 1_480_000 + 16 * 8_000_000), rel=1e-2)


def test_a_gpu_has_targets_of_its_own():
    cells = [cell("ladder-11", "stencil", 0.5, points=1_000_000), cell("ladder-11", "stencil literal", 10.0)]
    text = targets_text({**raw_figures(), "cells": cells}, gpu=True)
    assert "| 500 ms | met |" in text
    assert "| 10.0 s | **missed**: 2.00 times the target |" in text


# -- the table of reference parts -----------------------------------------------------------------------------


CONFIG = Config().changed(slicing={"backends": BACKENDS})


def sums(value: float) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Sums of three layers by plan and text, all of them alike."""
    ours = {name: [value, 2.0 * value, 0.0] for names in PAIRS.values() for name in names}
    text = {theirs: [len(names) * value, 2.0 * len(names) * value, 0.0] for theirs, names in PAIRS.items()}
    return pd.DataFrame(ours), pd.DataFrame(text)


def test_equal_sums_are_not_apart():
    assert apart(*sums(125.0)) == 0.0
    assert apart(*sums(0.0)) == 0.0


@pytest.mark.parametrize("column", PAIRS)
def test_whatever_one_layer_has_more_in_the_text_is_seen(column):
    plan, text = sums(125.0)
    text.loc[0, column] *= 1.1
    assert apart(plan, text) == pytest.approx(0.05)


@pytest.mark.slow
def test_a_cube_is_built_as_planned_and_told_so():
    found = row("cube", models(("cube",))["cube"], CONFIG, DEFAULTS)
    assert found["verdict"] == "VALIDATED"
    assert found["apart"] < 1e-6
    assert found["starts_plan"] == found["starts_text"] > 0
    assert found["over_sections"] == pytest.approx(1.0, abs=0.02)
    assert max(found["plan_k"], found["text_k"]) <= found["limit_k"]
    text = rendered(pd.DataFrame([found]))
    assert "| cube | defaults | 12 |" in text
    assert "met" in text
    assert "What shut the gates" not in text


@pytest.mark.slow
@pytest.mark.parametrize("part", ["bracket", "thin-walls", "two-spheres"])
def test_a_part_that_is_refused_is_built_with_its_remedy(part):
    model, remedy = models((part,))[part], REMEDIES[part]
    before = row(part, model, CONFIG, DEFAULTS)
    after = row(part, model, CONFIG.changed(**remedy.changes), str(remedy))
    assert (before["verdict"], after["verdict"]) == ("NOT VALIDATED", "VALIDATED")
    text = rendered(pd.DataFrame([before, after]))
    assert f"- {part}: `{before['gates'].split()[0]}`" in text
    assert f"- {part}: `{remedy}`: {remedy.why}." in text

"""Report writers: what they show is what run.json says, without scripts or network."""

from __future__ import annotations

import csv
import json
import re
import shutil
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import shapely
from parts import box
from report_runs import changed, data, inside_out, render, rows, run, section, whole_run, words

from ebamcheck import load
from ebamcheck.curves import Curves, contour_error
from ebamcheck.layers import files as layer_files
from ebamcheck.layers.stack import from_polygons
from ebamcheck.pipeline.stages import bead_paths
from ebamcheck.program import read_program, write_program
from ebamcheck.record.run_folder import RunFolder
from ebamcheck.scan import ScanPlan, plan_stack
from ebamcheck.settings.config import Config
from ebamcheck.slicers.slicing import slice_part
from ebamcheck_reports import charts, html, program_pictures
from ebamcheck_reports.canvas import Canvas
from ebamcheck_reports.markup import element, table
from ebamcheck_reports.run_data import CHECK_GATES, GATES
from ebamcheck_reports.sections import agreement
from ebamcheck_reports.sections.fit import polar_errors


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> RunFolder:
    return whole_run(tmp_path_factory)


@pytest.fixture
def copy(whole: RunFolder, tmp_path: Path) -> RunFolder:
    shutil.copytree(whole.path, tmp_path / "run")
    return RunFolder(tmp_path / "run")


def test_page_needs_nothing_from_outside(whole: RunFolder) -> None:
    text, page, _ = render(whole)
    assert "http" not in text
    assert not re.search(r"\bsrc\s*=|@import|url\(|<link\b|<iframe\b", text)
    links = [a.get("href", "") for a in page.iter("a")]
    assert links
    ids = {node.get("id") for node in page.iter()}
    assert all(link[0] == "#" and link[1:] in ids for link in links)
    assert not any(name.startswith("on") for node in page.iter() for name in node.attrib)
    assert "prefers-color-scheme: dark" in text
    assert "@media print" in text


def test_names_from_files_are_escaped(whole: RunFolder) -> None:
    text, page, cases = render(whole)
    assert "part & <co>" in words(page)
    assert "<co>" not in text
    assert any(p.get("value") == "part & <co>" for p in cases.iter("property"))


def test_figures_are_those_of_the_record(whole: RunFolder) -> None:
    _, page, _ = render(whole)
    record = whole.manifest()
    shown = {row.get("data-gate"): data(row) for row in rows(page, "gates")}
    assert shown == {g["name"]: [g["figure"], g["limit"]] for g in record["gates"]}
    keys = (
        "max_depth_mm",
        "limit_mm",
        "max_hausdorff_mm",
        "max_p95_mm",
        "max_area_difference_mm2",
        "min_iou",
    )
    pairs = [data(row) for row in rows(section(page, "agreement"), "pairs")]
    assert pairs == [[p[k] for k in keys] for p in record["comparison"]["pairs"]]
    checks = {words(row[0]): data(row) for row in rows(section(page, "program"), "checks")}
    assert checks == {c["name"]: [c["value"], c["limit"]] for c in record["program"]["checks"]}
    assert set(record["program"]["totals"].values()) <= set(data(section(page, "program")))
    reference = record["reference"]
    errors = {reference[of][f"normal_{end}_mm"] for of in ("contour", "curve") for end in ("min", "max")}
    errors |= {reference["reduction"][f"normal_{f}"] for f in ("range", "max", "rms")}
    assert errors <= set(data(section(page, "fit")))


def test_verdict_is_that_of_the_record(whole: RunFolder) -> None:
    _, page, cases = render(whole)
    record = whole.manifest()
    passed = record["exit_code"] == 0 and record["program"]["validated"]
    assert words(section(page, "verdict")).startswith("✔ VALIDATED" if passed else "✘ NOT VALIDATED")
    failed = {
        c.get("name")
        for c in cases.iter("testcase")
        if c.find("failure") is not None and c.get("classname") == "ebamcheck.gate"
    }
    assert failed == {g["name"] for g in record["gates"] if not g["passed"]}


def test_pictures_show_every_backend_and_a_place_enlarged(whole: RunFolder) -> None:
    _, page, _ = render(whole)
    frames = [f for f in page.iter("figure") if f.get("class") == "frame"]
    assert 3 <= len(frames) <= agreement.MOST_LAYERS
    for frame in frames:
        drawn = [g.get("data-name") for g in frame.iter("g") if g.get("class") == "slicer"]
        assert drawn == sorted(whole.manifest()["backends"])
        assert len(list(frame.iter("svg"))) == 2
    for anchor in ("agreement", "fit", "scan"):
        assert any("chart" in (s.get("class") or "") for s in section(page, anchor).iter("svg"))


def test_junit_has_one_case_a_gate_finding_backend_pair_and_check(whole: RunFolder) -> None:
    _, _, root = render(whole)
    record = whole.manifest()
    of = "ebamcheck.backend."
    expected = [
        *(("ebamcheck.gate", g["name"]) for g in record["gates"]),
        *(("ebamcheck.finding", f"{f['code']} {f['place']}".strip()) for f in record["findings"]),
        *((f"{of}{b}", "slice") for b in record["backends"]),
        *((f"{of}{p['a']}", f"agrees with {p['b']}") for p in record["comparison"]["pairs"]),
        *(("ebamcheck.program", c["name"]) for c in record["program"]["checks"]),
    ]
    names = [(c.get("classname"), c.get("name")) for c in root.iter("testcase")]
    assert sorted(names) == sorted(expected)
    assert len(set(names)) == len(names)
    of_suites = sum(int(s.get("tests", "0")) for s in root.iter("testsuite"))
    assert int(root.get("tests", "0")) == of_suites == len(names)


def test_summary_has_the_figures_of_the_record(whole: RunFolder) -> None:
    render(whole)
    record = whole.manifest()
    with (whole.path / "summary.csv").open(encoding="utf-8", newline="") as file:
        found = list(csv.DictReader(file))
    gates, pairs = ([r for r in found if r["kind"] == kind] for kind in ("gate", "pair"))
    assert [float(r["figure"]) for r in gates] == [g["figure"] for g in record["gates"]]
    assert [(r["backend"], r["against"], float(r["min_iou"])) for r in pairs] == [
        (p["a"], p["b"], p["min_iou"]) for p in record["comparison"]["pairs"]
    ]
    assert {r["part_sha256"] for r in found} == {record["part"]["sha256"]}


def test_polar_chart_has_the_errors_that_the_run_measures(whole: RunFolder) -> None:
    # The extremes over the rays are those of contour_error, which measures the same ring pair by ring.
    layers = whole.read_layers(whole.manifest()["primary"])
    curves = Curves.from_parquet(whole.path / "curves.parquet")
    truth = slice_part(load(whole.path.parent / "fine.stl"), layers.heights)
    k = len(layers) // 2
    rays = 720
    theta = (np.arange(rays) + 0.5) * (2 * np.pi / rays)
    drawn = polar_errors(layers, curves, truth, k, theta)
    assert drawn is not None
    largest = max(layers.rings_of(k), key=lambda r: layers.ring_areas[r])
    for error, measured in zip(drawn, (layers, curves), strict=True):
        table_ = contour_error(measured, truth, rays=rays, by="ring")
        row = table_[table_["ring"] == largest].iloc[0]
        assert error.min() == pytest.approx(row["polar_min_mm"], abs=1e-9)
        assert error.max() == pytest.approx(row["polar_max_mm"], abs=1e-9)


def test_polar_chart_appears_with_a_kept_reference(copy: RunFolder, whole: RunFolder) -> None:
    heights = copy.read_layers(copy.manifest()["primary"]).heights
    truth = slice_part(load(whole.path.parent / "fine.stl"), heights)
    layer_files.write_parquet(truth, copy.path / "reference.parquet")
    _, page, _ = render(copy)
    assert "Polar error of the largest outer contour" in words(section(page, "fit"))
    curves = copy.manifest()["settings"]["curves"]
    limit_mm = curves["largest_lift_mm"] + curves["tolerance_mm"] + curves["near_point_mm"]
    assert f"limit of both by the settings{limit_mm:.4g} mm" in words(section(page, "fit"))


def test_temperatures_of_the_layers_are_shown_where_the_order_asked_for_them(copy: RunFolder, whole: RunFolder) -> None:
    plan = ScanPlan.from_parquet(copy.path / "scan.parquet")
    assert plan.metrics["entry_max_k"].notna().any()
    _, page, _ = render(whole)
    told = words(section(page, "scan"))
    assert "Temperatures by the heat model" in told
    assert all(f"build time {what}" in told for what in ("without waits", "with waits at full", "as programmed"))
    assert "Waits that keep the entry of each bead under the limit" in told
    unasked = replace(plan, metrics=plan.metrics.assign(entry_max_k=np.nan))
    unasked.to_parquet(copy.path / "scan.parquet")
    _, page, _ = render(copy)
    assert "Temperatures by the heat model" not in words(section(page, "scan"))


def test_program_picture_is_the_path_of_the_text(tmp_path: Path) -> None:
    angle, config = np.linspace(0.0, 2.0 * np.pi, 300, endpoint=False), Config()
    outline = np.column_stack([60.0 * np.cos(angle) + 5.0 * np.cos(3.0 * angle), 40.0 * np.sin(angle)])
    layers = from_polygons(np.array([0.8]), [[shapely.Polygon(outline)]])
    plan = plan_stack(layers, config)
    files = write_program(bead_paths(layers, plan, config), plan, config, tmp_path / "program")
    program = read_program(files.main, config)
    motions = np.flatnonzero(program.deposit)
    spans = program_pictures.bezier_form(program, motions)
    assert len(spans) >= len(motions)
    np.testing.assert_allclose(spans[0, 0], program.start[motions[0], :2], atol=1e-5)
    np.testing.assert_allclose(spans[-1, 3], program.end[motions[-1], :2], atol=1e-5)
    curved = motions[program.kind[motions] == program_pictures.POLYNOMIAL]
    assert curved.size
    t = np.linspace(0, 1, 7)
    for row in curved[:20].tolist():
        (b,) = program_pictures.bezier_form(program, np.array([row]))
        powers = np.stack([(1 - t) ** 3, 3 * (1 - t) ** 2 * t, 3 * (1 - t) * t**2, t**3], 1)
        np.testing.assert_allclose(powers @ b, program.evaluate(np.full(7, row), t), atol=1e-9)


def test_failed_backend_and_gate_show_everywhere(copy: RunFolder) -> None:
    record = copy.manifest()
    # Layers of 8 mm ask for more wire than there is, and melt too little: these gates are shut before.
    shut_before = int(render(copy)[2].get("failures", "0"))
    backends = record["backends"]
    backends["stencil"] |= {
        "status": "timed out",
        "why": "no answer after 600 s <deadlock>",
        "file": "",
        "rings": 0,
    }
    copy.layers_file("stencil").unlink()
    gates = [
        g | {"passed": False, "text": "worst & wide", "figure": "NaN"} if g["name"] == "fit" else g
        for g in record["gates"]
    ]
    pairs = [p for p in record["comparison"]["pairs"] if "stencil" not in (p["a"], p["b"])]
    pairs[0] |= {"agree": pairs[0]["gated"] - 1, "max_depth_mm": 0.5, "max_hausdorff_mm": "Infinity"}
    finding = {
        "layer": 2, "height_mm": 12.0, "backend": pairs[0]["a"], "against": pairs[0]["b"], "metric": "depth", "value": 0.5,
        "limit": 0.001, "x_mm": 7.25, "y_mm": "NaN", "cause": "thin feature", "program_z_mm": 16.0,
    }  # fmt: skip
    comparison = record["comparison"] | {"pairs": pairs, "findings": [finding] * 25}
    changed(
        copy,
        backends=backends,
        gates=gates,
        comparison=comparison,
        exit_code=1,
        program=record["program"] | {"validated": False},
    )
    text, page, root = render(copy)
    assert "TIMED OUT" in text
    assert "no answer after 600 s <deadlock>" in words(section(page, "slicers"))
    assert "worst & wide" in words(section(page, "verdict"))
    assert "infinite" in words(section(page, "agreement"))
    assert "… and 5 more" in words(section(page, "agreement"))
    assert words(section(page, "verdict")).startswith("✘ NOT VALIDATED")
    cases = {(c.get("classname"), c.get("name")): c for c in root.iter("testcase")}
    error = cases["ebamcheck.backend.stencil", "slice"].find("error")
    assert error is not None
    assert "600 s" in error.get("message", "")
    failure = cases["ebamcheck.gate", "fit"].find("failure")
    assert failure is not None
    assert "worst & wide" in failure.get("message", "")
    pair = cases[f"ebamcheck.backend.{pairs[0]['a']}", f"agrees with {pairs[0]['b']}"].find("failure")
    assert pair is not None
    assert "0.5" in pair.get("message", "")
    assert "thin feature" in (pair.text or "")
    assert (root.get("errors"), int(root.get("failures", "0"))) == ("1", shut_before + 2)


def test_inside_out_part_without_contours(tmp_path: Path) -> None:
    folder = run(inside_out(box((0, 0, 0), (20, 20, 9))), tmp_path, 3.0, slicing={"backends": ("planecut", "manifold")})
    _, page, root = render(folder)
    assert "inside-out" in words(section(page, "verdict"))
    assert "facets face inwards" in words(section(page, "part"))
    missing = [words(row) for row in rows(page, "gates") if row.get("class") == "missing"]
    assert len(missing) == len(GATES) - len(CHECK_GATES)
    assert all("not reached" in text for text in missing)
    skipped = {c.get("name") for c in root.iter("testcase") if c.find("skipped") is not None}
    assert {"fit", "coverage", "program", "agrees with manifold"} <= skipped
    assert "nothing to compare" in words(section(page, "agreement"))
    assert "✔" not in words(section(page, "agreement"))


@pytest.mark.parametrize(
    "name", ["scan.parquet", "curves.parquet", "compare.parquet", "fit.csv", "layers/planecut.parquet"]
)
@pytest.mark.parametrize("content", [b"neither one nor the other", None])
def test_damaged_file_costs_its_sections_only(copy: RunFolder, name: str, content: bytes | None) -> None:
    if content is None:
        (copy.path / name).unlink()
    else:
        (copy.path / name).write_bytes(content)
    html.write(copy)
    text = (copy.path / "report.html").read_text(encoding="utf-8")
    page = ElementTree.fromstring(text.removeprefix("<!DOCTYPE html>\n"))
    assert [s.get("id") for s in page.iter("section")] == [anchor for anchor, _, _ in html.SECTIONS]
    assert {words(row[0]) for row in rows(page, "gates")} == {g["name"] for g in copy.manifest()["gates"]}
    if content is not None:
        assert "This section cannot be shown" in text
        assert name.partition("/")[2] in text


def test_text_that_xml_cannot_hold_is_replaced() -> None:
    made = element("p", "a\x00\udc80<b>&", title='"\x01"')
    node = ElementTree.fromstring(made)
    assert node.text == "a\ufffd\ufffd<b>&"
    made.encode("utf-8")


@pytest.mark.parametrize("values", [[np.nan], [np.inf], [], [5.0], [1.0, np.nan, np.inf, 2.0], [0.0] * 5000])
def test_charts_of_odd_series(values: list[float]) -> None:
    chart = charts.line_chart([charts.Series("a", range(len(values)), values)], "x", "y", limit=1.0)
    assert "nan" not in chart
    ElementTree.fromstring(f"<div>{chart}</div>")


def test_long_charts_stay_small_and_keep_peaks() -> None:
    y = np.zeros(200_000)
    y[123_456] = 7.0
    chart = charts.line_chart([charts.Series("a", np.arange(y.size), y)], "x", "y")
    assert len(chart) < 20_000
    _, kept = charts.thinned(np.arange(y.size, dtype=float), y)
    assert kept.max() == 7.0


def test_canvas_cuts_what_lies_outside() -> None:
    far = shapely.LineString([(-1e6, 0.5), (1e6, 0.5)])
    canvas = Canvas((0.0, 0.0, 1.0, 1.0), 200.0)
    canvas.lines(far, stroke="#000")
    (x0, x1) = (float(v) for v in re.findall(r"[ML ]?(-?[\d.]+),", canvas.body[0])[:2])
    assert abs(x0) < 1000
    assert abs(x1) < 1000
    ElementTree.fromstring(canvas.svg("a < b"))


def test_table_escapes_and_sets_numbers_right() -> None:
    node = ElementTree.fromstring(table(("a", "b"), [("<x>", 1.5), ("y", 2)]))
    cells = [(c.text, c.get("class")) for c in node.iter("td")]
    assert cells[0] == ("<x>", None)
    assert all(c.get("class") == "number" for c in list(node.iter("td"))[1::2])


def test_record_is_read_with_numbers_that_json_has_not(copy: RunFolder) -> None:
    record = json.loads((copy.path / "run.json").read_text())
    reference = record["reference"]
    for of in ("contour", "curve"):
        reference[of] = dict.fromkeys(reference[of], "NaN")
    reference["reduction"] = dict.fromkeys(reference["reduction"], "NaN")
    changed(copy, reference=reference | {"unmatched_rings": 44})
    _, page, _ = render(copy)
    assert "not defined" in words(section(page, "fit"))
    assert "44 contours" in words(section(page, "fit"))

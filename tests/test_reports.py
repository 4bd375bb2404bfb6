"""Report writers: what they show is what run.json says, without scripts or network."""

from __future__ import annotations

import csv
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import shapely
from report_runs import data, render, rows, section, whole_run, words

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
from ebamcheck_reports import html, program_pictures
from ebamcheck_reports.sections import agreement
from ebamcheck_reports.sections.fit import polar_errors


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> RunFolder:
    return whole_run(tmp_path_factory)


@pytest.fixture
def copy(whole: RunFolder, tmp_path: Path) -> RunFolder:
    shutil.copytree(whole.path, tmp_path / "run")
    return RunFolder(tmp_path / "run")


def test_every_section_says_what_is_checked_first(whole: RunFolder) -> None:
    _, page, _ = render(whole)
    names = [s.get("id") for s in page.iter("section")]
    assert names == [anchor for anchor, _, _ in html.SECTIONS]
    for part in page.iter("section"):
        sentence = next(p for p in part.iter("p") if p.get("class") == "what")
        assert re.search(r"\bGood is\b|must pass", words(sentence)), part.get("id")


def test_page_needs_nothing_from_outside(whole: RunFolder) -> None:
    text, page, _ = render(whole)
    assert "http" not in text
    assert not re.search(r"\bsrc\s*=|@import|url\(|<link\b|<iframe\b", text)
    links = [a.get("href", "") for a in page.iter("a")]
    assert links
    ids = {node.get("id") for node in page.iter()}
    assert all(link[0] == "#" and link[1:] in ids for link in links)
    assert not any(name.startswith("on") for node in page.iter() for name in node.attrib)


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
    pairs = [data(row) for row in rows(section(page, "agreement"), "pairs")]
    keys = (
        "max_depth_mm",
        "limit_mm",
        "max_hausdorff_mm",
        "max_p95_mm",
        "max_area_difference_mm2",
        "min_iou",
    )
    assert pairs == [[p[k] for k in keys] for p in record["comparison"]["pairs"]]
    checks = {words(row[0]): data(row) for row in rows(section(page, "program"), "checks")}
    assert checks == {c["name"]: [c["value"], c["limit"]] for c in record["program"]["checks"]}
    totals = data(section(page, "program"))
    assert all(value in totals for value in record["program"]["totals"].values())
    errors = data(section(page, "fit"))
    assert {
        record["reference"][of][f"normal_{end}_mm"] for of in ("contour", "curve") for end in ("min", "max")
    } <= set(errors)
    assert all(record["reference"]["reduction"][f"normal_{f}"] in errors for f in ("range", "max", "rms"))


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
    for anchor in ("agreement", "fit", "scan", "program"):
        assert (
            any("chart" in (s.get("class") or "") for s in section(page, anchor).iter("svg"))
            or anchor == "program"
        )


def test_junit_has_one_case_a_gate_finding_backend_pair_and_check(whole: RunFolder) -> None:
    _, _, root = render(whole)
    record = whole.manifest()
    names = [(c.get("classname"), c.get("name")) for c in root.iter("testcase")]
    expected = [("ebamcheck.gate", g["name"]) for g in record["gates"]]
    expected += [("ebamcheck.finding", f"{f['code']} {f['place']}".strip()) for f in record["findings"]]
    expected += [(f"ebamcheck.backend.{b}", "slice") for b in record["backends"]]
    expected += [
        (f"ebamcheck.backend.{p['a']}", f"agrees with {p['b']}") for p in record["comparison"]["pairs"]
    ]
    expected += [("ebamcheck.program", c["name"]) for c in record["program"]["checks"]]
    assert sorted(names) == sorted(expected)
    assert len(set(names)) == len(names)
    assert (
        int(root.get("tests", "0"))
        == len(names)
        == sum(int(s.get("tests", "0")) for s in root.iter("testsuite"))
    )


def test_summary_has_the_figures_of_the_record(whole: RunFolder) -> None:
    render(whole)
    record = whole.manifest()
    with (whole.path / "summary.csv").open(encoding="utf-8", newline="") as file:
        found = list(csv.DictReader(file))
    assert [float(r["figure"]) for r in found if r["kind"] == "gate"] == [
        g["figure"] for g in record["gates"]
    ]
    pairs = [r for r in found if r["kind"] == "pair"]
    assert [(r["backend"], r["against"]) for r in pairs] == [
        (p["a"], p["b"]) for p in record["comparison"]["pairs"]
    ]
    assert [float(r["min_iou"]) for r in pairs] == [p["min_iou"] for p in record["comparison"]["pairs"]]
    assert {r["part_sha256"] for r in found} == {record["part"]["sha256"]}


def test_same_run_same_bytes(copy: RunFolder) -> None:
    names = ("report.html", "junit.xml", "summary.csv")
    render(copy)
    before = [(copy.path / name).read_bytes() for name in names]
    render(copy)
    assert [(copy.path / name).read_bytes() for name in names] == before


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


def test_temperatures_of_the_layers_are_shown_where_the_order_asked_for_them(
    copy: RunFolder, whole: RunFolder
) -> None:
    plan = ScanPlan.from_parquet(copy.path / "scan.parquet")
    assert plan.metrics["entry_max_k"].notna().any()
    _, page, _ = render(whole)
    told = words(section(page, "scan"))
    assert "Temperatures by the heat model" in told
    assert all(
        f"build time {what}" in told for what in ("without waits", "with waits at full", "as programmed")
    )
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

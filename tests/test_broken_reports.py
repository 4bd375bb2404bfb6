"""Reports of broken and partial runs, and the pieces that every page is made of."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import shapely
from parts import box
from report_runs import changed, inside_out, render, rows, run, section, whole_run, words

from ebamcheck.record.run_folder import RunFolder
from ebamcheck_reports import charts, html
from ebamcheck_reports.canvas import Canvas
from ebamcheck_reports.markup import element, table
from ebamcheck_reports.run_data import CHECK_GATES, GATES


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> RunFolder:
    return whole_run(tmp_path_factory)


@pytest.fixture
def copy(whole: RunFolder, tmp_path: Path) -> RunFolder:
    shutil.copytree(whole.path, tmp_path / "run")
    return RunFolder(tmp_path / "run")


# -- broken and partial runs -----------------------------------------------------------------------


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
    folder = run(
        inside_out(box((0, 0, 0), (20, 20, 9))), tmp_path, 3.0, slicing={"backends": ("planecut", "manifold")}
    )
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


def test_one_backend_alone(tmp_path: Path) -> None:
    folder = run(box((0, 0, 0), (30, 20, 9)), tmp_path, 3.0, slicing={"backends": ("planecut",)})
    _, page, root = render(folder)
    assert "two are needed" in words(section(page, "agreement"))
    assert "No reference was given" in words(section(page, "fit"))
    assert words(section(page, "verdict")).startswith("✘ NOT VALIDATED")
    assert not [s for s in root.iter("testsuite") if s.get("name") == "ebamcheck.agreement"]


@pytest.mark.parametrize(
    "name", ["scan.parquet", "curves.parquet", "compare.parquet", "fit.csv", "layers/planecut.parquet"]
)
@pytest.mark.parametrize("content", [b"neither one nor the other", b"", None])
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


# -- pieces ----------------------------------------------------------------------------------------


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

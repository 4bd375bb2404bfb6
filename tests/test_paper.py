"""The paper, reproduced: its own arithmetic, one small run end to end, and any mesh in the bunny's place."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
import typer
from command_line import frame, write_stl
from parts import sphere
from typer.testing import CliRunner

from ebamcheck.errors import BackendFailed, ExitCode, SettingsError
from ebamcheck.layers.stack import from_rings
from ebamcheck.mesh.part import from_arrays
from ebamcheck.plugins import registry
from ebamcheck_reports.paper import layer_figures, paper, published, timing
from ebamcheck_reports.paper.layer_figures import find_subject
from ebamcheck_reports.paper.page import Reproduction, as_text, document, reproduce
from ebamcheck_reports.paper.polar import published_record
from ebamcheck_reports.paper.published import Effort

TINY = Effort("tiny", finest_mm=0.8, layer_step=1500, literal_layers=2, polar_layers=4)


def silent(text: str) -> None:
    assert text


@pytest.fixture(scope="module")
def made() -> Reproduction:
    return reproduce(TINY, None, "mm", silent)


@pytest.fixture(scope="module")
def page(made: Reproduction) -> str:
    return document(made)


def numbers(value: Any) -> Iterator[float]:
    """Every number of a JSON value."""
    if isinstance(value, dict):
        for item in value.values():
            yield from numbers(item)
    elif isinstance(value, list):
        for item in value:
            yield from numbers(item)
    elif isinstance(value, int | float) and not isinstance(value, bool):
        yield float(value)


# -- the paper's own numbers ---------------------------------------------------------------------------


def test_ranges_of_the_paper_give_45_9_and_55_1_per_cent_but_not_34_2() -> None:
    found = published.published_reductions()
    assert found["range"] == pytest.approx(1 - (0.0955 + 0.0810) / (0.1137 + 0.2125), abs=1e-12)
    assert round(100 * found["range"], 1) == 45.9
    assert found["max"] == pytest.approx(1 - 0.0955 / 0.2125, abs=1e-12)
    assert round(100 * found["max"], 1) == 55.1
    assert all(abs(value - published.CLAIMED_REDUCTION) > 0.1 for value in found.values())
    assert published_record()["claimed_reduction"] == 0.342
    size_mb = (timing.STL_HEADER_BYTES + timing.STL_FACET_BYTES * published.FACETS) / 2**20
    assert size_mb == pytest.approx(published.SIZES_MB[-1], abs=0.01)


# -- the page ------------------------------------------------------------------------------------------


def test_page_and_pictures_are_well_formed_and_need_nothing_beside_them(page: str) -> None:
    tree = ElementTree.fromstring(page.removeprefix("<!DOCTYPE html>\n"))
    assert len(list(tree.iter("svg"))) > 6
    anchors = {e.get("id") for e in tree.iter("section")}
    assert [a.get("href") for a in tree.iter("a")] == [
        "#overview", "#timing", "#bitmap", "#corners", "#polar", "#partition",
    ]  # fmt: skip
    assert anchors == {a.get("href", "")[1:] for a in tree.iter("a")}
    assert not list(tree.iter("script"))
    assert not re.search(r'(src|href)="(?!#|data:)', page)
    for path in tree.iter("path"):
        assert "nan" not in path.get("d", "").lower()


def test_every_number_of_the_page_is_one_of_the_record(made: Reproduction, page: str) -> None:
    known = set(numbers(json.loads(as_text(made.record))))
    shown = [float(v) for v in re.findall(r'<data value="([^"]*)"', page)]
    assert len(shown) > 150
    assert {v for v in shown if math.isfinite(v)} <= known


def test_the_table_at_the_top_says_what_the_record_says(made: Reproduction) -> None:
    rows = {row["figure"].partition(":")[0]: row for row in made.record["comparison"]}
    assert list(rows) == [
        "Figures 3 to 5", "Figure 7", "Figure 8", "Figure 9", "Section 5.2", "Figures 10 and 11", "Section 5.1",
    ]  # fmt: skip
    assert all(row["why"] and row["comparable"] in ("yes", "partly", "no") for row in rows.values())
    assert {"45.89 %", "55.06 %"} <= set(re.findall(r"[\d.]+ %", rows["Section 5.2"]["ours"]))
    for found in made.record["corners"]["layers"]:
        assert f"layer {found['layer']}: {found['curve_parts']} curve parts" in rows["Figure 7"]["ours"]
    assert f"n = {made.record['partition']['n']}" in rows["Figure 8"]["ours"]


# -- what was measured ---------------------------------------------------------------------------------


def test_times_are_scaled_from_the_layers_cut(made: Reproduction) -> None:
    sizes = made.record["timing"]["sizes"]
    assert [s["tolerance_mm"] for s in sizes] == [1.0, 0.8]
    assert all(s["layers"] == published.LAYERS for s in sizes)
    assert sizes[0]["facets"] < sizes[1]["facets"]
    done = [t for s in sizes for t in s["times"].values() if t["status"] == "done"]
    assert done
    for t in done:
        assert t["total_s"] == pytest.approx(t["prepare_s"] + t["slice_s"] * published.LAYERS / t["layers"])
    if timing.LITERAL in sizes[0]["times"] and registry.probe("stencil").available:
        assert sizes[0]["times"][timing.LITERAL]["layers"] == TINY.literal_layers
        assert next(iter(sizes[0]["times"])) == timing.LITERAL


def test_a_slicer_that_refuses_the_part_is_told_with_its_reason() -> None:
    whole = frame()
    opened = from_arrays(whole.vertices, whole.faces[:-1], "opened")
    method = timing.Method("manifold", "manifold", {})
    found = timing.timed(opened, np.array([1.0, 2.0, 3.0]), method, TINY)
    assert (found["status"], found["total_s"]) == ("failed", None)
    assert "opened" in found["why"]


@pytest.mark.gl
def test_image_contours_and_section_agree(made: Reproduction) -> None:
    found = made.record["bitmap"]
    if found["status"] != "done":
        pytest.skip(found["why"])
    assert found["depth_mm"] <= found["bound_mm"]
    perimeter_px = found["points"]
    assert abs(found["black_area_mm2"] - found["contour_area_mm2"]) < perimeter_px * published.PIXEL_MM**2
    assert found["contour_area_mm2"] == pytest.approx(found["exact_area_mm2"], rel=1e-3)


def test_the_image_of_another_layer_is_refused() -> None:
    image = np.zeros((9, 12), np.bool_)
    image[2:5, 3:9] = True
    x, y = 0.1 * 3, 0.1 * 2
    contours = from_rings([0.0], [[[(x, y), (x + 0.6, y), (x + 0.6, y + 0.3), (x, y + 0.3)]]])
    layer_figures.check(image, contours)
    assert np.allclose(layer_figures.pixel_corner_mm(image, contours), 0.0)
    image[7, 3] = True
    with pytest.raises(BackendFailed, match="6 x 6 pixels"):
        layer_figures.check(image, contours)


def test_reductions_follow_from_the_ranges_of_the_same_table(made: Reproduction) -> None:
    for row in made.record["polar"]["models"]:
        for found in row["fits"].values():
            for kind in ("polar", "normal"):
                before, after, given = row["polyline"][kind], found[kind], found["reductions"][kind]
                assert given["range"] == pytest.approx(
                    published.reduction(before["high_mm"] - before["low_mm"], after["high_mm"] - after["low_mm"]),
                    nan_ok=True,
                )
                for key in ("rms", "mean_abs"):
                    assert given[key] == pytest.approx(
                        published.reduction(before[f"{key}_mm"], after[f"{key}_mm"]), nan_ok=True
                    )


def test_polygons_lie_inside_of_a_round_body_and_errors_are_signed_so(made: Reproduction) -> None:
    ladder = made.record["polar"]["models"][0]
    assert ladder["model"] == "ladder"
    low, high = (ladder["polyline"]["polar"][key] for key in ("low_mm", "high_mm"))
    assert -1.01 <= low < 0.0
    assert high < -0.1 * low


@pytest.mark.parametrize(
    ("short_mm", "side_mm", "rounded", "case", "n"),
    [(100.0, 10.0, 11, "odd", 11), (110.0, 10.0, 12, "even", 13), (114.0, 10.0, 12, "even", 13)],
)
def test_odd_and_even_case_of_the_hexagons(short_mm: float, side_mm: float, rounded: int, case: str, n: int) -> None:
    corners = np.array([(0, 0), (short_mm, 0), (short_mm, 300.0), (0, 300.0)])
    found = layer_figures.lattice(corners, side_mm)
    assert (found["rounded"], found["case"], found["n"]) == (rounded, case, n)
    assert found["L1_mm"] == pytest.approx(short_mm)
    assert found["L2_mm"] == pytest.approx(300.0)
    assert layer_figures.lattice(corners, math.nan)["case"] == "none"


# -- any mesh in the bunny's place ---------------------------------------------------------------------


def test_a_mesh_of_the_users_takes_the_bunnys_place(tmp_path: Path, made: Reproduction) -> None:
    ball = find_subject(write_stl(sphere(20.0, 24, 48), tmp_path / "ball & <co>.stl"), "mm")
    assert ball.layer == published.CURVE_LAYER - 1
    assert ball.count == 200
    plate = find_subject(write_stl(frame(), tmp_path / "frame.stl"), "mm")
    assert (plate.count, plate.layer) == (60, 30)
    assert "no layer 118" in plate.about
    inches = find_subject(tmp_path / "frame.stl", "in")
    assert inches.layer == published.CURVE_LAYER - 1
    assert inches.section.areas()[0] == pytest.approx(1376.0 * 25.4**2)
    record, pictures = layer_figures.measure_partition(ball)
    assert record["area_mm2"] == pytest.approx(math.pi * 20.0**2, rel=0.02)
    assert len(pictures) == 2


def test_command_writes_both_files_or_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, made: Reproduction) -> None:
    monkeypatch.setattr(published, "QUICK", TINY)
    given: list[Any] = []

    def ready(effort: Effort, bunny: Path | None, units: str, note: published.Note) -> Reproduction:
        given.append((effort, bunny, units))
        return made

    monkeypatch.setattr("ebamcheck_reports.paper.page.reproduce", ready)
    app = typer.Typer()
    app.command()(paper)
    target = tmp_path / "a" / "paper"
    result = CliRunner().invoke(app, ["-o", str(target), "--bunny", "x.stl", "--units", "m", "--json"])
    assert result.exit_code == ExitCode.PASS
    assert given == [(TINY, Path("x.stl"), "m")]
    assert sorted(p.name for p in target.iterdir()) == ["paper.html", "paper.json"]
    record = json.loads((target / "paper.json").read_text())
    assert json.loads(result.stdout) == record == json.loads(as_text(made.record))
    assert (target / "paper.html").read_text(encoding="utf-8") == document(made)
    table = CliRunner().invoke(app, ["-o", str(target)])
    assert "Figure 9" in table.stdout
    assert "paper.html" in table.stdout
    (tmp_path / "file").write_text("")
    with pytest.raises(SettingsError, match="cannot be made"):
        paper(tmp_path / "file" / "x", None, "mm", False, False)


# -- pieces --------------------------------------------------------------------------------------------

"""The report as a reader gets it: one page first, eight styles, failed checks with their place, print, phone and darkness."""

from __future__ import annotations

import itertools
import re
import shutil
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pytest
import typer
from browser import printed_pages, width_px
from command_line import WIDE
from parts import box
from report_runs import changed, render, section, words
from typer.testing import CliRunner

import ebamcheck
from ebamcheck.errors import InputError, SettingsError
from ebamcheck.layers.stack import from_rings
from ebamcheck.record.run_folder import RunFolder
from ebamcheck.settings.config import Config
from ebamcheck.showing.colours import COLOURS, DASHES
from ebamcheck_reports import html, part_picture
from ebamcheck_reports.report_command import report
from ebamcheck_reports.sections.summary import EVENTS, beam_energy_j

SLICERS = 8
PAGES = 7  # Of the print of a whole run, at most
PHONE_PX = 375
# CIE 1976 distance of any two colours of slicers; from about 2.3 on a trained eye sees one at all
LEAST_COLOUR_DIFFERENCE = 12.0

# Linear RGB as it is seen (Machado, Oliveira and Fernandes 2009, full severity)
COLOUR_VISION = {
    "all three cones": np.eye(3),
    "no long ones": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "no middle ones": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
    "no short ones": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
}  # fmt: skip


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> RunFolder:
    folder = tmp_path_factory.mktemp("page")
    file = ebamcheck.save(box((0, 0, 0), (60, 40, 12)), folder / "block.stl")
    config = Config().changed(
        layers={"layer_height_mm": 3.0}, process=WIDE, slicing={"backends": ("planecut", "manifold")}
    )
    return RunFolder(ebamcheck.run(file, folder / "block.run", config).path)


@pytest.fixture
def copy(whole: RunFolder, tmp_path: Path) -> RunFolder:
    shutil.copytree(whole.path, tmp_path / "run")
    return RunFolder(tmp_path / "run")


def with_failures(folder: RunFolder) -> list[str]:
    """Shut some checks that point at a motion, at a line without one, and at nothing; returns all that failed."""
    record = folder.manifest()
    checks = record["program"]["checks"]
    wanted = {"section": None, "header": "MAIN.MPF:5", "mass balance": "MAIN_L0002.SPF:30", "unchanged": ""}
    for check in checks:
        if check["name"] in wanted:
            check["passed"] = False
            where = wanted[check["name"]]
            check["where"] = check["where"] if where is None else where
    record["program"]["validated"], record["exit_code"] = False, 1
    changed(folder, **record)
    failed = [check["name"] for check in checks if not check["passed"]]
    assert set(wanted) <= set(failed)
    return failed


def with_slicers(folder: RunFolder, count: int) -> list[str]:
    """Give the run as many slicers as that, all of which found what the first one did."""
    record = folder.manifest()
    first = next(iter(record["backends"]))
    layers, pairs = pd.read_csv(folder.path / "layers.csv"), pd.read_parquet(folder.path / "compare.parquet")
    names = [*record["backends"], *(f"slicer{n}" for n in range(count - len(record["backends"])))]
    for name in names[len(record["backends"]) :]:
        record["backends"][name] = record["backends"][first]
        shutil.copy(folder.layers_file(first), folder.layers_file(name))
        for column in [c for c in layers if c.endswith(f"_{first}")]:
            layers[column.replace(first, name)] = layers[column]
    rows = [pairs.assign(a=a, b=b) for a, b in itertools.combinations(names, 2)]
    pd.concat(rows).to_parquet(folder.path / "compare.parquet")
    layers.to_csv(folder.path / "layers.csv", index=False)
    changed(folder, **record)
    return names


# -- the first page --------------------------------------------------------------------------------


def test_summary_comes_first_and_says_who_what_and_how_much(whole: RunFolder) -> None:
    _, page, _ = render(whole)
    first = next(iter(page.iter("section")))
    record = whole.manifest()
    assert first.get("id") == "summary"
    said = words(first)
    assert ("✔ VALIDATED" in said) == bool(record["program"]["validated"])
    for name in ("mass of the metal laid", "time", "energy of the beam", "wire", "approver", "signature"):
        assert name in said
    values = [float(d.get("value", "nan")) for d in first.iter("data")]
    assert {record["program"]["totals"][k] for k in ("wire_kg", "wire_mm")} <= set(values)
    assert all(g["name"] in said for g in record["gates"])
    assert all(f["text"] in said for f in record["findings"][:6])
    assert any(s.get("class") == "solid" for s in first.iter("svg"))
    drawn = [f.get("data-check") for f in page.iter("figure") if f.get("class") == "place"]
    assert drawn == [c["name"] for c in record["program"]["checks"] if not c["passed"]]


def test_energy_is_power_times_time_of_the_text(whole: RunFolder) -> None:
    # The reader of the program knows nothing of the table of events.
    program = ebamcheck.Run(whole.path).program
    on = program.deposit
    feed_mm_s = program.feed_mm_min[on] / 60.0
    expected = float((program.power_w[on] * program.lengths[on] / feed_mm_s).sum())
    assert expected > 0
    assert beam_energy_j(whole.path / EVENTS) == pytest.approx(expected, rel=1e-4)


def test_release_of_the_certificate_is_shown(copy: RunFolder) -> None:
    path = copy.path / "certificate.json"
    paper = path.read_text(encoding="utf-8").replace('"approver": ""', '"approver": "A. Approver"')
    path.write_text(paper, encoding="utf-8")
    _, page, _ = render(copy)
    assert "A. Approver" in words(section(page, "summary"))


# -- failed checks ---------------------------------------------------------------------------------


def test_every_failed_check_is_named_first_and_has_its_place(copy: RunFolder) -> None:
    failed = with_failures(copy)
    _, page, _ = render(copy)
    banner = next(d for d in section(page, "summary").iter("div") if "banner" in (d.get("class") or ""))
    assert all(name in words(banner) for name in failed)
    figures = {f.get("data-check"): f for f in page.iter("figure") if f.get("class") == "place"}
    assert list(figures) == failed
    for name in ("section", "mass balance"):
        assert len(list(figures[name].iter("svg"))) == 2, name
        assert list(figures[name].iter("circle")), name
    marked = [words(m) for m in figures["header"].iter("mark")]
    line = (copy.program_folder / "MAIN.MPF").read_text().splitlines()[4]
    assert marked == [f"5 {' '.join(line.split())}"]
    assert "no single place" in words(figures["unchanged"])


# -- styles ----------------------------------------------------------------------------------------


def seen(colour: str, eye: object) -> np.ndarray:
    """CIE L*a*b* of a colour as an eye sees it."""
    srgb = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255.0
    linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    to_xyz = [
        [0.4124564, 0.3575761, 0.1804375],
        [0.2126729, 0.7151522, 0.0721750],
        [0.0193339, 0.1191920, 0.9503041],
    ]
    xyz = to_xyz @ np.clip(np.asarray(eye) @ linear, 0.0, 1.0) / [0.95047, 1.0, 1.08883]
    f = np.where(xyz > 0.008856, np.cbrt(xyz), 7.787 * xyz + 16.0 / 116.0)
    return np.array([116.0 * f[1] - 16.0, 500.0 * (f[0] - f[1]), 200.0 * (f[1] - f[2])])


@pytest.mark.parametrize("eye", COLOUR_VISION)
def test_colours_of_slicers_stay_apart_for_every_eye(eye: str) -> None:
    assert len(set(DASHES)) == len(DASHES) == len(COLOURS) == SLICERS
    colours = [seen(colour, COLOUR_VISION[eye]) for colour in COLOURS]
    least = min(float(np.linalg.norm(a - b)) for a, b in itertools.combinations(colours, 2))
    assert least > LEAST_COLOUR_DIFFERENCE


def test_eight_slicers_have_eight_styles(copy: RunFolder) -> None:
    names = with_slicers(copy, SLICERS)
    _, page, _ = render(copy)
    frame = next(f for f in page.iter("figure") if f.get("class") == "frame")
    styles = {
        g.get("data-name"): {(p.get("stroke"), p.get("stroke-dasharray")) for p in g.iter("path")}
        for g in frame.iter("g")
        if g.get("class") == "slicer"
    }
    assert set(styles) == set(names)
    assert all(len(style) == 1 for style in styles.values())
    assert len(set.union(*styles.values())) == SLICERS
    agreement = section(page, "agreement")
    legends = [d for d in agreement.iter("div") if d.get("class") == "legend"]
    for legend in legends:
        keys = [(p.get("stroke"), p.get("stroke-dasharray")) for p in legend.iter("path")]
        assert len(set(keys)) == len(keys) >= SLICERS


# -- the picture of the part -----------------------------------------------------------------------


def square(half_mm: float, hole_mm: float = 0.0) -> list[list[tuple[float, float]]]:
    ring = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]
    rings = [[(half_mm * x, half_mm * y) for x, y in ring]]
    return [*rings, [(hole_mm * x, hole_mm * y) for x, y in ring[::-1]]] if hole_mm else rings


def test_picture_of_the_part_has_a_top_for_each_slab_and_walls_that_are_seen() -> None:
    stack = from_rings([1.0, 3.0, 5.0], [square(10.0), square(10.0, 4.0), []])
    svg = part_picture.draw(stack, "a < b")
    assert svg is not None
    paths = list(ElementTree.fromstring(svg).iter("path"))
    tops = [p for p in paths if p.get("fill") == part_picture.TOP]
    assert [p.get("d", "").count("M") for p in tops] == [1, 2]
    # Two sides of a square are seen, and with a hole two of its sides as well.
    walls = [p for p in paths if p.get("fill") != part_picture.TOP]
    assert sum(len(re.findall("l", p.get("d", ""))) for p in walls) == 2 * (2 + 4)


def test_picture_of_many_layers_stays_small() -> None:
    turn = np.linspace(0, 2 * np.pi, 2000, endpoint=False)
    ring = np.column_stack([30 * np.cos(turn), 20 * np.sin(turn)])
    svg = part_picture.draw(from_rings(np.arange(1.0, 500.0), [[ring]] * 499), "many")
    assert svg is not None
    assert len(svg) < 100_000
    assert part_picture.draw(from_rings([1.0], [[]]), "empty") is None


# -- the command -----------------------------------------------------------------------------------


def command() -> typer.Typer:
    app = typer.Typer()
    app.command()(report)
    return app


def test_report_of_a_finished_run_is_made_again_elsewhere(whole: RunFolder, tmp_path: Path) -> None:
    before = {p: p.read_bytes() for p in whole.path.rglob("*") if p.is_file()}
    target = tmp_path / "again.html"
    made = CliRunner().invoke(command(), [str(whole.path), "-o", str(target)])
    assert made.exit_code == 0, made.output
    assert target.read_text(encoding="utf-8") == html.document(html.RunData(whole))
    assert {p: p.read_bytes() for p in whole.path.rglob("*") if p.is_file()} == before


def test_report_refuses_what_it_cannot_do(whole: RunFolder, tmp_path: Path) -> None:
    for run, output, error in (
        (tmp_path, tmp_path / "a.html", InputError),
        (whole.path, tmp_path / "a.pdf", SettingsError),
        (whole.path, whole.path / "report.html", SettingsError),
    ):
        made = CliRunner().invoke(command(), [str(run), "-o", str(output)])
        assert isinstance(made.exception, error)
    assert not list(tmp_path.iterdir())


# -- in a browser ----------------------------------------------------------------------------------


@pytest.mark.parametrize("failing", [False, True])
def test_no_part_of_the_page_is_wider_than_a_phone(copy: RunFolder, tmp_path: Path, failing: bool) -> None:
    if failing:
        with_failures(copy)
        with_slicers(copy, SLICERS)
    text, _, _ = render(copy)
    unfolded = text.replace('<details class="chapter">', '<details class="chapter" open="open">')
    wide, beyond = width_px(unfolded, PHONE_PX, tmp_path)
    assert wide <= PHONE_PX
    assert beyond == 0


def test_sections_whose_gates_passed_are_folded_and_the_others_open(copy: RunFolder) -> None:
    def opened() -> dict[str, bool]:
        chapters = [box for box in render(copy)[1].iter("details") if box.get("class") == "chapter"]
        return {str(box.find("section").get("id")): box.get("open") is not None for box in chapters}  # type: ignore[union-attr]

    sound = opened()
    assert set(sound) == {anchor for anchor, _, _ in html.SECTIONS} - {"summary"}
    assert not any(sound.values())
    manifest = copy.manifest()
    for gate in manifest["gates"]:
        gate["passed"] = gate["name"] != "heat"
    changed(copy, gates=manifest["gates"], exit_code=1)
    shown = {anchor for anchor, is_open in opened().items() if is_open}
    assert shown == {"verdict", "scan", "certificate", "reproduce"}


@pytest.mark.slow
def test_print_is_short_and_the_summary_one_page(copy: RunFolder, tmp_path: Path) -> None:
    text, _, _ = render(copy)
    assert 1 < printed_pages(copy.path / html.NAME, tmp_path) <= PAGES
    alone = tmp_path / "summary.html"
    head, rest = text.split("</section>", 1)
    assert 'id="summary"' in head
    alone.write_text(f"{head}</section></main></body></html>", encoding="utf-8")
    assert rest
    assert printed_pages(alone, tmp_path) == 1

"""Runs whose reports are tested, and what is read of a page."""

from __future__ import annotations

import shutil
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from command_line import WIDE, write_stl
from finished_runs import made_once
from parts import box, join, moved, sphere
from slicers_here import slicers_here

from ebamcheck.json_values import write_json
from ebamcheck.mesh.part import Part
from ebamcheck.pipeline import run_job
from ebamcheck.record.run_folder import RunFolder
from ebamcheck.settings.config import Config
from ebamcheck_reports import html, junit, summary

STRETCHED = ((1.0, 0.0, 0.0), (0.0, 1.3, 0.0), (0.0, 0.0, 1.0))


def inside_out(part: Part) -> Part:
    return Part(part.vertices, np.ascontiguousarray(part.faces[:, ::-1]), part.name)


def run(part: Part, folder: Path, height_mm: float, fine: Part | None = None, **sections: dict) -> RunFolder:
    source = write_stl(part, folder / "part & <co>.stl")
    reference = write_stl(fine, folder / "fine.stl") if fine is not None else None
    config = Config().changed(layers={"layer_height_mm": height_mm}, process=WIDE).changed(**sections)
    with slicers_here():
        return run_job(source, folder / "run", config, reference).folder


def render(folder: RunFolder) -> tuple[str, ElementTree.Element, ElementTree.Element]:
    """Text and tree of the page, and the tree of the test cases."""
    assert [*html.write(folder), *junit.write(folder), *summary.write(folder)] == [
        "report.html", "junit.xml", "summary.csv",
    ]  # fmt: skip
    text = (folder.path / "report.html").read_text(encoding="utf-8")
    assert text.startswith("<!DOCTYPE html>\n")
    assert "This section cannot be shown" not in text
    page = ElementTree.fromstring(text.removeprefix("<!DOCTYPE html>\n"))
    return text, page, ElementTree.parse(folder.path / "junit.xml").getroot()


def changed(folder: RunFolder, **parts: object) -> None:
    write_json({**folder.manifest(), **parts}, folder.path / "run.json")


def whole_run(factory: pytest.TempPathFactory) -> RunFolder:
    """A run that comes to its end: a body with a hole beside an ellipsoid, against a finer tessellation."""

    def parts(rings: int) -> Part:
        body = moved(sphere(20.0, rings, 2 * rings), STRETCHED, (0, 0, 20.3))
        return join(body, box((25, -20, 0), (60, 20, 40)), inside_out(box((35, -8, 5.1), (48, 8, 35.1))))

    folder = made_once(factory, "ellipsoid", lambda at: run(parts(12), at, 8.0, parts(48)))
    # Reports are written into it: each file has a copy of its own.
    shutil.copytree(folder, copied := factory.mktemp("whole") / "ellipsoid")
    return RunFolder(copied / "run")


def data(node: ElementTree.Element) -> list[float]:
    return [float(d.get("value", "")) for d in node.iter("data")]


def words(node: ElementTree.Element) -> str:
    return " ".join("".join(node.itertext()).split())


def section(page: ElementTree.Element, name: str) -> ElementTree.Element:
    return next(s for s in page.iter("section") if s.get("id") == name)


def rows(node: ElementTree.Element, class_: str) -> list[ElementTree.Element]:
    found = next(t for t in node.iter("table") if t.get("class") == class_)
    return list(found.find("tbody") or [])

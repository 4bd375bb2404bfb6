"""Places of failed program checks: each drawn in its layer, with the lines of the text around it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from ebamcheck.errors import InputError
from ebamcheck.program import NCProgram, read_program
from ebamcheck.result import Place, check_of_record
from ebamcheck.settings.config import Config
from ebamcheck_reports import program_picture
from ebamcheck_reports.canvas import Canvas, around, outline
from ebamcheck_reports.markup import Markup, element, join, paragraph
from ebamcheck_reports.run_data import RunData

WIDTH_PX, INSET_PX = 420.0, 320.0

INSET_BEADS = 4.0
"""Half the side of the inset over the width of a bead: wide enough to show what lies beside the place."""

BEAD_WIDTH_MM = 6.0
"""Bead width if the settings name none."""

RING_PX, PLACE = 11.0, "#b3261e"
LINES_AROUND = 3
"""Lines of the text shown before and after the one in question."""

PROGRAMS_KEPT = 4
"""Files kept in memory after parsing: several checks often fail in one file."""


def render(run: RunData) -> list[Markup]:
    """One figure for each failed check, in the order of the checks."""
    failed = [check for check in run.checks if not check["passed"]]
    return (
        [element("h3", "Where checks failed"), *(_figure(run, check) for check in failed)] if failed else []
    )


def _figure(run: RunData, check: Mapping[str, Any]) -> Markup:
    place, program = _place(run, check)
    parts = [*_pictures(run, place, program, str(check["name"])), *_excerpt(run, place)]
    if not parts:
        parts = [
            paragraph("This check is about the program as a whole: it has no single place.", class_="note")
        ]
    caption = join([element("b", check["name"]), f": {check['text']}{_said(place)}"])
    return element(
        "figure",
        element("div", *parts, class_="beside"),
        element("figcaption", caption),
        class_="place",
        data_check=check["name"],
    )


def _said(place: Place) -> str:
    text = f", at ({place.x_mm:.3f}, {place.y_mm:.3f}) mm" if place.is_point else ""
    if place.layer is not None:
        text += f", layer {place.layer + 1}"
    return text + (f", {place.file}:{place.line}" if place.line else "") + "."


def _place(run: RunData, check: Mapping[str, Any]) -> tuple[Place, NCProgram | None]:
    """Place of a check by its record, completed from the text by the motion of the line that it names; and the program there."""
    place = check_of_record(check).at
    program = _program(run, place.file)
    if program is None:
        return place, None
    row = _row(program, place.file, place.line)
    if row is not None and not place.is_point:
        x, y = program.end[row, :2].tolist()
        place = replace(place, x_mm=x, y_mm=y)
    if place.layer is None:
        place = replace(place, layer=_layer(run, place.file, -1 if row is None else int(program.layer[row])))
    return place, program


def _layer(run: RunData, file: str, in_program: int) -> int | None:
    """Layer of a subprogram, by the program's table; for a program in a single file, the layer of the motion."""
    table = run.table("program.csv")
    if len(run.part_of("program")["files"]) > 1 and "file" in table:
        named = np.flatnonzero((table["file"] == file).to_numpy())
        return int(named[0]) if named.size else None
    return in_program if in_program >= 0 else None


def _program(run: RunData, file: str) -> NCProgram | None:
    """Program in a file; None for the main file of several, because all of them would be read."""
    files = [str(f["name"]) for f in run.part_of("program").get("files", [])]
    path = run.folder.program_folder / file
    if file not in files or (len(files) > 1 and file == files[0]) or not path.is_file():
        return None
    try:
        return _read(path, run.config)
    except InputError:
        return None  # the check may have failed because the file cannot be read


@lru_cache(maxsize=PROGRAMS_KEPT)
def _read_text(path: Path, stamp: int, settings: str) -> NCProgram:
    return read_program(path, Config.model_validate_json(settings))


def _read(path: Path, config: Config) -> NCProgram:
    return _read_text(path, path.stat().st_mtime_ns, config.model_dump_json())


def _row(program: NCProgram, file: str, line: int) -> int | None:
    """Motion commanded by a line, or the first one after it."""
    index = next((k for k, source in enumerate(program.files) if source.name == file), -1)
    after = np.flatnonzero((program.file == index) & (program.line >= line))
    return int(after[0]) if after.size and line else None


# -- drawing -------------------------------------------------------------------------------------------


def _pictures(run: RunData, place: Place, program: NCProgram | None, name: str) -> list[Markup]:
    """The whole layer with the place circled, and the place enlarged with the path of the text."""
    if not place.is_point:
        return []
    bead_mm = run.setting("process", "bead_width_mm", BEAD_WIDTH_MM)
    pictures = []
    whole = _section(run, place)
    if whole:
        points = np.concatenate([*whole, [[place.x_mm, place.y_mm]]])
        low, high = points.min(axis=0), points.max(axis=0)
        canvas = Canvas((float(low[0]), float(low[1]), float(high[0]), float(high[1])), WIDTH_PX)
        _draw(canvas, whole, place)
        pictures.append(canvas.svg(f"place of the failed check {name}"))
    inset = Canvas(around(place.x_mm, place.y_mm, INSET_BEADS * bead_mm), INSET_PX)
    if program is not None:
        program_picture.paint(inset, program, place.layer if len(program.layer_files) > 1 else None)
    _draw(inset, whole, place)
    return [*pictures, inset.svg(f"place of the failed check {name}, enlarged")]


def _section(run: RunData, place: Place) -> list[np.ndarray[Any, np.dtype[np.float64]]]:
    """Outlines of the section in the layer of the place."""
    layers, layer = run.primary, place.layer
    if layers is None or layer is None or not 0 <= layer < len(layers):
        return []
    return [outline(layers, ring) for ring in layers.rings_of(layer) if len(layers.ring(ring)) > 1]


def _draw(canvas: Canvas, section: list[Any], place: Place) -> None:
    for ring in section:
        canvas.lines(shapely.LineString(ring), stroke="#000", stroke_width=1.2)
    canvas.circle(place.x_mm, place.y_mm, RING_PX, PLACE)


def _excerpt(run: RunData, place: Place) -> list[Markup]:
    """Lines of the text around the one in question, which is marked."""
    path = run.folder.program_folder / place.file
    if not place.line or not place.file or not path.is_file():
        return []
    lines = path.read_text(encoding="latin-1").splitlines()
    first = max(0, place.line - 1 - LINES_AROUND)
    rows = [
        join([element("mark" if k + 1 == place.line else "span", f"{k + 1:>6}  {lines[k]}"), "\n"])
        for k in range(first, min(len(lines), place.line + LINES_AROUND))
    ]
    return [element("pre", *rows)] if rows else []

"""Pictures of the path that a program commands, as its text is read back: of a layer, and of the places of failed checks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from ebamcheck.errors import InputError
from ebamcheck.kernels import Bools, Floats, Ints
from ebamcheck.nc.motions import ARC, POLYNOMIAL, RAPID, SPLINE_SPAN, NCProgram
from ebamcheck.program import read_program
from ebamcheck.result import Place, check_of_record
from ebamcheck.settings.config import Config
from ebamcheck.showing.colours import ramp
from ebamcheck_reports.canvas import Canvas, around, outlines
from ebamcheck_reports.markup import Markup, element, join, paragraph
from ebamcheck_reports.run_data import BEAD_WIDTH_MM, RunData

CONTOUR, RAPID_MOVE, PLACE = "#d55e00", "#555555", "#b3261e"
LIGHTEST = 0.85  # Part of the ramp that is used: thin lines of its last colours cannot be seen on white
ARC_PARTS = 16  # Straight parts of a drawn arc

LEGEND = (
    ("contour, beam on", CONTOUR, ""),
    ("first hatch lines, beam on", ramp(0.0), ""),
    ("last hatch lines, beam on", ramp(LIGHTEST), ""),
    ("rapid move, beam off", RAPID_MOVE, "4 4"),
)


def draw(program: NCProgram, title: str, layer: int | None = None) -> Markup | None:
    """Draw every motion of a program, or of one of its layers; None where there is none in the plane."""
    moved = _moved(program, layer)
    if not moved.any():
        return None
    canvas = Canvas.of(np.concatenate([program.start[moved, :2], program.end[moved, :2]]), 880.0)
    _paint(canvas, program, moved)
    return canvas.svg(title)


def _paint(canvas: Canvas, program: NCProgram, moved: Bools) -> None:
    """Paint motions on a canvas: hatch lines in the colour of their island's rank, contours over them."""
    rapid = np.flatnonzero(moved & (program.kind == RAPID))
    ends = (program.start[rapid, :2], program.end[rapid, :2])
    canvas.segments(*ends, stroke=RAPID_MOVE, stroke_width=0.9, stroke_dasharray="4 4")
    feed = moved & (program.kind != RAPID)
    hatch = np.flatnonzero(feed & (program.island >= 0))
    islands, first = np.unique(program.island[hatch], return_index=True)
    for rank, island in enumerate(islands[np.argsort(first)].tolist()):
        lines = bezier_form(program, hatch[program.island[hatch] == island])
        colour = ramp(LIGHTEST * rank / max(len(islands) - 1, 1))
        canvas.beziers(lines, stroke=colour, stroke_width=1.3)
    contour = np.flatnonzero(feed & (program.island < 0))
    canvas.beziers(bezier_form(program, contour), stroke=CONTOUR, stroke_width=2.2)


def _moved(program: NCProgram, layer: int | None) -> Bools:
    """Motions (B,) in the plane, of the whole program or of one of its layers."""
    known = np.isfinite(program.start[:, :2]).all(axis=1) & np.isfinite(program.end[:, :2]).all(axis=1)
    moved = known & (program.start[:, :2] != program.end[:, :2]).any(axis=1)
    return np.asarray(moved if layer is None else moved & (program.layer == layer))


def bezier_form(program: NCProgram, rows: Ints) -> Floats:
    """Bezier control points (n, 4, 2) of motions; arcs become short straight ones."""
    pieces: list[Floats] = []
    for row in np.asarray(rows).tolist():
        kind = program.kind[row]
        if kind in (POLYNOMIAL, SPLINE_SPAN):
            a, b, c, d = program.coefficients[row].T  # of the powers of t
            pieces.append(np.stack([a, a + b / 3.0, a + (2.0 * b + c) / 3.0, a + b + c + d])[None])
        elif kind == ARC:
            t = np.linspace(0.0, 1.0, ARC_PARTS + 1)
            points = program.evaluate(np.full(t.size, row), t)
            pieces.append(_straight(points[:-1], points[1:]))
        else:
            pieces.append(_straight(program.start[row : row + 1, :2], program.end[row : row + 1, :2]))
    return np.concatenate(pieces) if pieces else np.zeros((0, 4, 2))


def _straight(start: Floats, end: Floats) -> Floats:
    third = (end - start) / 3.0
    return np.stack([start, start + third, end - third, end], axis=1)


# -- places of failed checks -----------------------------------------------------------------------

# Half the side of the inset over the width of a bead: wide enough to show what lies beside the place
INSET_BEADS = 4.0
LINES_AROUND = 3  # Lines of the text shown before and after the one in question


def failed_checks(run: RunData) -> list[Markup]:
    """One figure for each failed check, in the order of the checks: its place in the layer, and the lines of the text around it."""
    failed = [check for check in run.checks if not check["passed"]]
    return [element("h3", "Where checks failed"), *(_figure(run, check) for check in failed)] if failed else []


def _figure(run: RunData, check: Mapping[str, Any]) -> Markup:
    place, program = _place(run, check)
    parts = [*_pictures(run, place, program, str(check["name"])), *_excerpt(run, place)]
    if not parts:
        none = "This check is about the program as a whole: it has no single place."
        parts = [paragraph(none, class_="note")]
    said = f", at ({place.x_mm:.3f}, {place.y_mm:.3f}) mm" if place.is_point else ""
    said += "" if place.layer is None else f", layer {place.layer + 1}"
    said += f", {place.file}:{place.line}." if place.line else "."
    caption = element("figcaption", element("b", check["name"]), f": {check['text']}{said}")
    drawn = element("div", *parts, class_="beside")
    return element("figure", drawn, caption, class_="place", data_check=check["name"])


def _place(run: RunData, check: Mapping[str, Any]) -> tuple[Place, NCProgram | None]:
    """Place of a check by its record, completed from the text by the motion of the line that it names; and the program there."""
    place = check_of_record(check).at
    program = _program(run, place.file)
    if program is None:
        return place, None
    row = _row(program, place)
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
        return _read_text(path, path.stat().st_mtime_ns, run.config.model_dump_json())
    except InputError:
        return None  # the check may have failed because the file cannot be read


@lru_cache(maxsize=4)  # several checks often fail in one file
def _read_text(path: Path, stamp: int, settings: str) -> NCProgram:
    return read_program(path, Config.model_validate_json(settings))


def _row(program: NCProgram, place: Place) -> int | None:
    """Motion commanded by the line of a place, or the first one after it."""
    index = next((k for k, source in enumerate(program.files) if source.name == place.file), -1)
    after = np.flatnonzero((program.file == index) & (program.line >= place.line))
    return int(after[0]) if after.size and place.line else None


def _pictures(run: RunData, place: Place, program: NCProgram | None, name: str) -> list[Markup]:
    """The whole layer with the place circled, and the place enlarged with the path of the text."""
    if not place.is_point:
        return []
    layers, layer = run.primary, place.layer
    known = layers is not None and layer is not None and 0 <= layer < len(layers)
    section = outlines(layers, layer or 0) if known else []
    pictures = []
    if section:
        whole = Canvas.of(np.concatenate([*section, [[place.x_mm, place.y_mm]]]), 420.0)
        _mark(whole, section, place)
        pictures.append(whole.svg(f"place of the failed check {name}"))
    half_mm = INSET_BEADS * run.setting("process", "bead_width_mm", BEAD_WIDTH_MM)
    inset = Canvas(around(place.x_mm, place.y_mm, half_mm), 320.0)
    if program is not None:
        _paint(inset, program, _moved(program, place.layer if len(program.layer_files) > 1 else None))
    _mark(inset, section, place)
    return [*pictures, inset.svg(f"place of the failed check {name}, enlarged")]


def _mark(canvas: Canvas, section: Sequence[Floats], place: Place) -> None:
    for ring in section:
        canvas.lines(shapely.LineString(ring), stroke="#000", stroke_width=1.2)
    canvas.circle(place.x_mm, place.y_mm, 11.0, PLACE)


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

"""Picture of the path that one subprogram commands, as its text is read back."""

from __future__ import annotations

import numpy as np

from ebamcheck.kernels import Bools, Floats, Ints
from ebamcheck.nc.motions import ARC, POLYNOMIAL, RAPID, SPLINE_SPAN, NCProgram
from ebamcheck.showing.colours import ramp
from ebamcheck_reports.canvas import Canvas
from ebamcheck_reports.markup import Markup, legend

WIDTH_PX = 880.0
CONTOUR, RAPID_MOVE = "#d55e00", "#555555"

LIGHTEST = 0.85
"""Part of the ramp that is used: thin lines of its last colours cannot be seen on white."""

ARC_PARTS = 16
"""Straight parts of a drawn arc."""

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
    ends = np.concatenate([program.start[moved, :2], program.end[moved, :2]])
    low, high = ends.min(axis=0), ends.max(axis=0)
    canvas = Canvas((float(low[0]), float(low[1]), float(high[0]), float(high[1])), WIDTH_PX)
    paint(canvas, program, layer)
    return canvas.svg(title)


def paint(canvas: Canvas, program: NCProgram, layer: int | None = None) -> None:
    """Paint every motion in the plane of a program, or of one of its layers, on a canvas."""
    moved = _moved(program, layer)
    rapid = np.flatnonzero(moved & (program.kind == RAPID))
    canvas.segments(
        program.start[rapid, :2],
        program.end[rapid, :2],
        stroke=RAPID_MOVE,
        stroke_width=0.9,
        stroke_dasharray="4 4",
    )
    feed = moved & (program.kind != RAPID)
    hatch = np.flatnonzero(feed & (program.island >= 0))
    islands, first = np.unique(program.island[hatch], return_index=True)
    for rank, island in enumerate(islands[np.argsort(first)].tolist()):
        rows = hatch[program.island[hatch] == island]
        canvas.beziers(
            bezier_form(program, rows),
            stroke=ramp(LIGHTEST * rank / max(len(islands) - 1, 1)),
            stroke_width=1.3,
        )
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
            pieces.append(_from_powers(program.coefficients[row])[None])
        elif kind == ARC:
            t = np.linspace(0.0, 1.0, ARC_PARTS + 1)
            points = program.evaluate(np.full(t.size, row), t)
            pieces.append(_straight(points[:-1], points[1:]))
        else:
            pieces.append(_straight(program.start[row : row + 1, :2], program.end[row : row + 1, :2]))
    return np.concatenate(pieces) if pieces else np.zeros((0, 4, 2))


def _from_powers(coefficients: Floats) -> Floats:
    """Control points (4, 2) of a cubic given by powers of t, (2, 4)."""
    a, b, c, d = coefficients.T
    return np.stack([a, a + b / 3.0, a + (2.0 * b + c) / 3.0, a + b + c + d])


def _straight(start: Floats, end: Floats) -> Floats:
    third = (end - start) / 3.0
    return np.stack([start, start + third, end - third, end], axis=1)


def key() -> Markup:
    """Explain colours and lines."""
    return legend(LEGEND)

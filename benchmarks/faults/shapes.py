"""Geometry of blocks: what a shift, turn, scale or mirror makes of the words of a motion."""

from __future__ import annotations

import math
import re

import numpy as np
from numpy.typing import ArrayLike, NDArray

from benchmarks.faults.program_text import ProgramText, with_word, word

Floats = NDArray[np.float64]
VECTORS = (("I", "J"), ("P", "Q"))
"""Words that are relative to an end of their motion."""


MOTION = r"G[01235]\b|POLY\b"


def moved(code: str, matrix: ArrayLike, offset: ArrayLike = (0.0, 0.0)) -> str:
    """Return a motion's block with its path mapped by ``matrix p + offset``; one without X and Y stays."""
    a, b = np.asarray(matrix, float), np.asarray(offset, float)
    if code.startswith("POLY"):
        return _polynomial(code, a, b)
    x, y = word(code, "X"), word(code, "Y")
    if x is None or y is None:
        return code
    code = _with(code, ("X", "Y"), a @ (x, y) + b)
    for names in VECTORS:
        u, v = word(code, names[0]), word(code, names[1])
        if u is not None and v is not None:
            code = _with(code, names, a @ (u, v))
    if np.linalg.det(a) < 0.0:
        code = swapped(code)
    return code


def swapped(code: str) -> str:
    """Return an arc's block with its direction reversed."""
    return {"G2": "G3", "G3": "G2"}.get(code[:2], code[:2]) + code[2:]


def _with(code: str, names: tuple[str, str], values: Floats) -> str:
    for name, value in zip(names, values, strict=True):
        code = with_word(code, name, float(value))
    return code


def _polynomial(code: str, a: Floats, b: Floats) -> str:
    lists = re.findall(r"PO\[[XY]\]=\(([^)]*)\)", code)
    values = a @ np.array([[float(v) for v in some.split(",")] for some in lists])
    values[:, 0] += b
    for axis, row in zip("XY", values, strict=True):
        code = re.sub(rf"PO\[{axis}\]=\([^)]*\)", f"PO[{axis}]=({','.join(f'{v:.6f}' for v in row)})", code)
    return code


def move_lines(
    text: ProgramText, file: str, lines: range | tuple[int, ...], matrix: ArrayLike, offset: ArrayLike
) -> None:
    """Map the motions of some lines."""
    for i in lines:
        code = text.code(file, i)
        if re.match(MOTION, code):
            text.set(file, i, moved(code, matrix, offset))


def turn(angle_deg: float) -> Floats:
    """Matrix of a turn, counter-clockwise."""
    c, s = math.cos(math.radians(angle_deg)), math.sin(math.radians(angle_deg))
    return np.array([[c, -s], [s, c]])


def about(matrix: ArrayLike, centre: ArrayLike) -> Floats:
    """Offset by which a matrix leaves a centre where it is."""
    c = np.asarray(centre, float)
    return np.asarray(c - np.asarray(matrix, float) @ c)


def ends(text: ProgramText, file: str, lines: range | tuple[int, ...]) -> Floats:
    """Ends of the motions in X and Y of some lines, (n, 2)."""
    found = []
    for i in lines:
        code = text.code(file, i)
        x, y = (word(code, a, word(code, f"PO[{a}]=(")) for a in "XY")
        if x is not None and y is not None:
            found.append((x, y))
    return np.array(found).reshape(-1, 2)


def centre(text: ProgramText, file: str, lines: range | tuple[int, ...]) -> Floats:
    """Middle of the box around the ends of some lines."""
    points = ends(text, file, lines)
    return np.asarray(0.5 * (points.min(axis=0) + points.max(axis=0)))


def bounds(text: ProgramText) -> tuple[Floats, Floats]:
    """Least and greatest X, Y of all ends of motions of a program."""
    points = np.concatenate([ends(text, file, range(len(lines))) for file, lines in text.files.items()])
    return points.min(axis=0), points.max(axis=0)

"""Strict reader of Wavefront OBJ files: vertices and polygons; anything invalid is refused with its line."""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

from ebamcheck.errors import InputError
from ebamcheck.mesh.polygons import checked_finite, numbers_of, polygon_corners

SURFACES = (b"surf", b"curv", b"curv2", b"cstype")
"""Keywords of free-form geometry, which is no mesh."""

_REFERENCE = re.compile(rb"([+-]?\d{1,18})(/[+-]?\d*){0,2}")
_KEYWORD = re.compile(rb"[A-Za-z_#][\w#]*")


def read_obj(data: bytes, name: str) -> tuple[NDArray[np.float64], list[str]]:
    """Read the corner points of every facet of an OBJ file; polygons become triangle fans from their first corner.

    Parameters
    ----------
    data
        The whole file.
    name
        Name of the file, for messages.

    Returns
    -------
    triangles
        (F, 3, 3) corners in the file's unit.
    notes
        Harmless irregularities, one line each.

    Raises
    ------
    InputError
        If a vertex has fewer than three numbers, a polygon fewer than three corners or a corner that is no vertex of
        the file, a number is invalid or not finite, or there is no facet.
    """
    if not data:
        raise InputError(f"{name}: is empty (0 bytes)")
    # A line that ends in a backslash continues on the next one; an empty line keeps the line numbers.
    joined = re.sub(rb"\\[ \t]*(\r\n|\n|\r)", b" ", data)
    lines = joined.splitlines()
    heads = [line.split(None, 1)[:1] for line in lines]
    vertex_lines = [k for k, head in enumerate(heads) if head == [b"v"]]
    face_lines = [k for k, head in enumerate(heads) if head in ([b"f"], [b"fo"])]
    _refuse_others(heads, lines, name)
    if not face_lines:
        raise InputError(f"{name}: holds no facet (OBJ)")
    vertices = _vertices(lines, vertex_lines, name)
    before = np.searchsorted(np.array(vertex_lines, np.int64), np.array(face_lines, np.int64))
    index, sizes = _polygons(lines, face_lines, before, len(vertices), name)
    notes = []
    if max(vertex_lines[-1], face_lines[-1]) == len(lines) - 1 and not data.endswith((b"\n", b"\r")):
        notes.append("the last line has no end: the file may have been cut there")
    return checked_finite(polygon_corners(vertices, index, sizes), name), notes


def _refuse_others(heads: list[list[bytes]], lines: list[bytes], name: str) -> None:
    """Refuse free-form surfaces, which would be lost, and lines that are not in this format."""
    for k, head in enumerate(heads):
        if head and head[0] in SURFACES:
            word = head[0].decode()
            raise InputError(f"{name}: line {k + 1}: {word!r} is free-form geometry, no mesh: export facets")
        if head and not (_KEYWORD.match(head[0])):
            raise InputError(f"{name}: line {k + 1}: {_shown(lines[k])} is no line of an OBJ file")


def _vertices(lines: list[bytes], where: list[int], name: str) -> NDArray[np.float64]:
    """Vertices (V, 3); weights and colours after them are ignored."""
    rows = [lines[k].split()[1:] for k in where]
    for k, row in zip(where, rows, strict=True):
        if not 3 <= len(row) <= 8:
            raise InputError(
                f"{name}: line {k + 1}: {_shown(lines[k])} has {len(row)} numbers: a vertex has three"
            )
    if not rows:
        raise InputError(f"{name}: holds facets and no vertex (OBJ)")
    return numbers_of([token for row in rows for token in row[:3]], name).reshape(-1, 3)


def _polygons(
    lines: list[bytes], where: list[int], before: NDArray[np.int64], count: int, name: str
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Vertices of all corners, polygon after polygon, and number of corners of each polygon."""
    found: list[int] = []
    sizes: list[int] = []
    for k, seen in zip(where, before.tolist(), strict=True):
        corners = lines[k].split()[1:]
        if len(corners) < 3:
            raise InputError(
                f"{name}: line {k + 1}: {_shown(lines[k])} has {len(corners)} corners: a facet has three"
            )
        for corner in corners:
            told = _REFERENCE.fullmatch(corner)
            row = int(told[1]) if told else 0
            row = row - 1 if row > 0 else seen + row if row < 0 else -1
            if not 0 <= row < count:
                raise InputError(
                    f"{name}: line {k + 1}: corner {_shown(corner)} is none of the {count} vertices of the file"
                )
            found.append(row)
        sizes.append(len(corners))
    return np.array(found, np.int64), np.array(sizes, np.int64)


def _shown(text: bytes) -> str:
    return repr(text[:40].decode("ascii", "replace"))

"""Reader of the slices that Slic3r writes as SVG: contours and holes of each layer, in millimetres."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np

from ebamcheck.errors import BackendFailed
from ebamcheck.numeric.rings import Floats

HEIGHT_UNIT_MM = 1e6
"""Unit of heights in the file, mm: Slic3r wrongly divides them by a million, as if they were its integers."""

_LAYER = re.compile(rb'<g id="layer\d+"(?: slic3r:z="([^"]*)")?')
_POLYGON = re.compile(rb'<polygon slic3r:type="(contour|hole)" points="([^"]*)"')


class Slice(NamedTuple):
    """One slice as Slic3r wrote it."""

    height_mm: float
    """Height of the plane above the bed."""
    rings: list[Floats]
    """Points (n, 2), mm from the least corner of the part, the first again at the end; contours run
    counter-clockwise, holes clockwise."""


def slices(lines: Iterable[bytes]) -> Iterator[Slice]:
    """Read slices one after the other.

    Raises
    ------
    BackendFailed
        If the text is truncated or not what Slic3r writes.
    """
    height_mm = 0.0
    rings: list[Floats] | None = None
    line = b""
    for line in lines:
        if polygon := _POLYGON.search(line):
            if rings is None:
                raise BackendFailed("Slic3r wrote a polygon outside of any layer")
            rings.append(_ring(polygon[1], polygon[2]))
        elif layer := _LAYER.search(line):
            if rings is not None:
                yield Slice(height_mm, rings)
            if layer[1] is None:
                raise BackendFailed("Slic3r wrote a layer without a height")
            height_mm, rings = float(layer[1]) * HEIGHT_UNIT_MM, []
    if line.strip() != b"</svg>":
        raise BackendFailed("what Slic3r wrote is cut: the file does not end with </svg>")
    if rings is not None:
        yield Slice(height_mm, rings)


def _ring(kind: bytes, text: bytes) -> Floats:
    try:
        numbers = np.array(text.replace(b",", b" ").split(), dtype="S").astype(np.float64)
        points = numbers.reshape(-1, 2)
    except ValueError:
        raise BackendFailed(
            f"Slic3r wrote points that are none: {text[:60].decode('ascii', 'replace')!r}"
        ) from None
    points = np.concatenate([points, points[:1]])
    x, y = (points - points[:1]).T
    twice_area = float(np.dot(x[:-1], y[1:]) - np.dot(y[:-1], x[1:]))
    return points if (twice_area > 0.0) == (kind == b"contour") else points[::-1]

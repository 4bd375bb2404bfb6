"""The Common Layer Interface: slice files (``.cli``) that machines and other programs read.

Version 2.0 of the format (Brite-EuRam project BE 2578), text and binary. Precision of a file:

- text, written in millimetres: every coordinate in the shortest digits that read back to the same bits;
- binary, written in its long form: coordinates and heights rounded to 32-bit floats, a relative error of
  at most 6e-8 (0.00003 mm at 500 mm).

The height of a layer is the height at which it was cut. (The format means the top of a layer; other
programs differ in which of the two they write.) Closed contours repeat their first point, as the format
requires. Labels of :class:`~ebamcheck.layers.stack.Layers` are written as user data and read back, with the number of
polylines, by which a file truncated between two of them is recognised; cut edges are not written.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ebamcheck.atomic_file import replacing
from ebamcheck.errors import SettingsError
from ebamcheck.layers.common_layer_binary import LAYER_LONG, POLYLINE_LONG
from ebamcheck.layers.common_layer_geometry import EXTERNAL, INTERNAL, OPEN_LINE
from ebamcheck.layers.common_layer_header import USER_DATA
from ebamcheck.layers.common_layer_reader import SliceFile, read_cli, read_slice_file
from ebamcheck.layers.stack import Layers
from ebamcheck.numeric.rings import Floats

__all__ = ["SliceFile", "read_cli", "read_slice_file", "write_cli"]


def write_cli(layers: Layers, path: str | Path, *, binary: bool = False, units_mm: float = 1.0) -> None:
    """Write layers as a slice file; the file appears whole or not at all.

    Parameters
    ----------
    layers
        Layers with strictly increasing heights, as the format requires.
    path
        The file, by convention ``.cli``.
    binary
        The binary form: 8 bytes per point and quick to read, but rounded to 32-bit floats.
    units_mm
        Length of one unit of the file's numbers, mm. With 1 the text form is exact; with another the
        division and the multiplication each round once.

    Raises
    ------
    SettingsError
        If heights do not increase (in the binary form: as 32-bit floats), the unit is not a positive
        number, or the file cannot be written.
    """
    if not (math.isfinite(units_mm) and units_mm > 0.0):
        raise SettingsError(f"units of {units_mm} mm: give a positive number of millimetres")
    heights = layers.heights / units_mm
    if binary:
        heights = heights.astype(np.float32).astype(np.float64)
    if not np.isfinite(heights).all() or (np.diff(heights) <= 0.0).any():
        k = int(np.flatnonzero(~(np.diff(heights, prepend=-math.inf) > 0.0))[0])
        raise SettingsError(
            f"{path}: layer {k + 1} at {layers.heights[k]} mm is not above the one before it: a slice file "
            "needs increasing heights" + (" (as 32-bit floats)" if binary else "")
        )
    records = _binary_records if binary else _text_records
    with replacing(path) as temporary, temporary.open("wb") as file:
        file.write(_header(layers, binary, units_mm))
        for record in records(layers, heights, units_mm):
            file.write(record)


def _header(layers: Layers, binary: bool, units_mm: float) -> bytes:
    """The header, always text; binary data follow directly after its last character."""
    lines = [
        "$$HEADERSTART",
        "$$BINARY" if binary else "$$ASCII",
        f"$$UNITS/{units_mm!r}",
        "$$VERSION/200",
        "$$LABEL/1,part",
        f"$$LAYERS/{len(layers)}",
    ]
    if len(layers.points):
        x0, y0, x1, y1 = (v / units_mm for v in layers.bounds())
        z0, z1 = layers.heights[0] / units_mm, layers.heights[-1] / units_mm
        lines.append("$$DIMENSION/" + ",".join(repr(float(v)) for v in (x0, y0, z0, x1, y1, z1)))
    labels = json.dumps({**json.loads(layers.labels_json()), "polylines": layers.closed.size})
    lines.append(f"$$USERDATA/{USER_DATA},{len(labels)},{labels}")
    lines.append("$$HEADEREND" if binary else "$$HEADEREND\n$$GEOMETRYSTART\n")
    return "\n".join(lines).encode("ascii")


def _polylines(layers: Layers, layer: int, units_mm: float) -> Iterator[tuple[int, Floats]]:
    """Direction and points, in units of the file, of each ring of a layer."""
    for r in layers.rings_of(layer):
        points = layers.ring(r) / units_mm
        if not layers.closed[r]:
            yield OPEN_LINE, points
        else:
            yield (
                EXTERNAL if layers.ring_areas[r] >= 0.0 else INTERNAL,
                np.concatenate([points, points[:1]]),
            )


def _text_records(layers: Layers, heights: Floats, units_mm: float) -> Iterator[bytes]:
    for k, height in enumerate(heights.tolist()):
        yield f"$$LAYER/{height!r}\n".encode()
        for direction, points in _polylines(layers, k, units_mm):
            numbers = ",".join(map(repr, points.ravel().tolist()))
            yield f"$$POLYLINE/1,{direction},{len(points)},{numbers}\n".encode()
    yield b"$$GEOMETRYEND\n"


def _binary_records(layers: Layers, heights: Floats, units_mm: float) -> Iterator[bytes]:
    for k, height in enumerate(heights.tolist()):
        yield struct.pack("<Hf", LAYER_LONG, height)
        for direction, points in _polylines(layers, k, units_mm):
            yield struct.pack("<Hiii", POLYLINE_LONG, 1, direction, len(points))
            yield points.astype("<f4").tobytes()

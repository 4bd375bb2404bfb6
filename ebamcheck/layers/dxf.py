"""Contours as DXF of release 12, which every CAD system reads: one polyline a ring at its height, one DXF layer a layer.

Outer rings, holes and open paths have the colours 5 (blue), 1 (red) and 6 (magenta). The units of the drawing are millimetres;
release 12 itself has no word for that. Heights stand in comments as well, so that layers without a contour are read back.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ebamcheck.atomic_file import replacing
from ebamcheck.errors import InputError
from ebamcheck.layers.contour_table import stack_of_rings
from ebamcheck.layers.stack import Layers
from ebamcheck.numeric.rings import Ints

OUTER, HOLE, OPEN = 5, 1, 6
"""Colours of the AutoCAD colour index."""

DECIMALS = 6
"""A nanometre: far under what is compared."""

HEIGHT = "ebamcheck height"
"""Begins a comment that holds the height of a layer."""

UNITS_MM = {0: 1.0, 1: 25.4, 2: 304.8, 4: 1.0, 5: 10.0, 6: 1000.0}
"""Millimetres of the drawing units that ``$INSUNITS`` of later releases names; 0: it names none."""

HEADER = "0\nSECTION\n2\nHEADER\n9\n$ACADVER\n1\nAC1009\n0\nENDSEC\n"
VERTEX = f"0\nVERTEX\n8\n%s\n10\n%.{DECIMALS}f\n20\n%.{DECIMALS}f\n30\n%.{DECIMALS}f\n"


def write_stack(layers: Layers, path: str | Path) -> None:
    """Write the contours; the DXF layer of layer 7 is ``LAYER_0007``."""
    names = [f"LAYER_{k:04d}" for k in range(1, len(layers) + 1)]
    with replacing(path) as temporary, temporary.open("w", encoding="ascii", newline="\r\n") as file:
        file.write("".join(f"999\n{HEIGHT} {height:.{DECIMALS}f}\n" for height in layers.heights.tolist()))
        file.write(HEADER + _table(names) + "0\nSECTION\n2\nENTITIES\n")
        for ring, layer in enumerate(layers.ring_layer.tolist()):
            file.write(_polyline(layers, ring, names[layer], float(layers.heights[layer])))
        file.write("0\nENDSEC\n0\nEOF\n")


def _table(names: list[str]) -> str:
    rows = "".join(f"0\nLAYER\n2\n{name}\n70\n0\n62\n7\n6\nCONTINUOUS\n" for name in names)
    return f"0\nSECTION\n2\nTABLES\n0\nTABLE\n2\nLAYER\n70\n{len(names)}\n{rows}0\nENDTAB\n0\nENDSEC\n"


def _polyline(layers: Layers, ring: int, name: str, height_mm: float) -> str:
    """One ring as POLYLINE, its points as VERTEX."""
    closed = bool(layers.closed[ring])
    colour = OPEN if not closed else HOLE if layers.ring_areas[ring] < 0.0 else OUTER
    head = (
        f"0\nPOLYLINE\n8\n{name}\n62\n{colour}\n66\n1\n10\n0.0\n20\n0.0\n"
        f"30\n{height_mm:.{DECIMALS}f}\n70\n{int(closed)}\n"
    )
    # All points of the ring are written by one format.
    points = layers.ring(ring)
    values = np.empty((len(points), 4), object)
    values[:, 0], values[:, 1:3], values[:, 3] = name, points, height_mm
    return head + VERTEX * len(points) % tuple(values.reshape(-1).tolist()) + f"0\nSEQEND\n8\n{name}\n"


def read_stack(path: str | Path) -> Layers:
    """Read polylines of a text DXF (POLYLINE and LWPOLYLINE) as the contours of the layers at their heights.

    Raises
    ------
    InputError
        If the file is missing, is no text DXF, or a polyline is bulged, has a slope, or is no number.
    """
    try:
        lines = Path(path).read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    try:
        codes, texts = np.array(lines[::2], np.int64), np.char.strip(np.array(lines[1::2], np.str_))
        if len(codes) != len(texts) or not len(codes) or (codes[-1], texts[-1]) != (0, "EOF"):
            raise ValueError("it does not end with EOF")
        return _stack(codes, texts)
    except ValueError as error:
        raise InputError(f"{path}: is no text DXF with contours at heights: {error}") from None


def _stack(codes: Ints, texts: NDArray[np.str_]) -> Layers:
    """Contours of the groups of a file: codes, and the texts that belong to them."""
    begins = codes == 0
    entity = np.cumsum(begins) - 1
    kind = texts[begins][entity]
    is_ring = begins & np.isin(kind, ("POLYLINE", "LWPOLYLINE"))
    ring, light, vertex = np.cumsum(is_ring) - 1, kind == "LWPOLYLINE", kind == "VERTEX"
    if (texts[(codes == 42) & (light | vertex)].astype(np.float64) != 0.0).any():
        raise ValueError("a polyline has bulges: draw it with straight segments")
    at = (codes == 10) & (light | vertex)
    points = np.column_stack(
        [texts[(codes == code) & (light | vertex)].astype(np.float64) for code in (10, 20)]
    )
    closed, level = np.zeros(ring[-1] + 1, np.bool_), np.zeros(ring[-1] + 1)
    flags = (codes == 70) & (light | (kind == "POLYLINE"))
    closed[ring[flags]] = texts[flags].astype(np.int64) & 1 != 0
    raised = (codes == 38) & light | (codes == 30) & vertex
    level[ring[raised]] = texts[raised].astype(np.float64)
    if (level[ring[raised]] != texts[raised].astype(np.float64)).any():
        raise ValueError("a polyline does not lie at one height")
    unit = texts[1:][(codes[:-1] == 9) & (texts[:-1] == "$INSUNITS")].astype(np.int64)
    if not np.isin(unit, tuple(UNITS_MM)).all():
        raise ValueError(f"$INSUNITS {unit[0]} is no known unit: draw in millimetres")
    scale = UNITS_MM[int(unit[0])] if len(unit) else 1.0
    comments = texts[codes == 999].tolist()
    said = [float(text.removeprefix(HEIGHT)) for text in comments if text.startswith(HEIGHT)]
    heights = np.unique(np.concatenate([said, level]))
    sizes = np.bincount(ring[at], minlength=len(level))
    return stack_of_rings(heights * scale, np.searchsorted(heights, level), sizes, closed, points * scale)

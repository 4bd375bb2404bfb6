"""Contours as DXF of release 12, which every CAD system reads: one polyline a ring at its height, one DXF layer a layer.

Outer rings, holes and open paths have the colours 5 (blue), 1 (red) and 6 (magenta). The units of the drawing are millimetres;
release 12 itself has no word for that.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ebamcheck.atomic_file import replacing
from ebamcheck.layers.stack import Layers

OUTER, HOLE, OPEN = 5, 1, 6
"""Colours of the AutoCAD colour index."""

DECIMALS = 6
"""A nanometre: far under what is compared."""

HEADER = "0\nSECTION\n2\nHEADER\n9\n$ACADVER\n1\nAC1009\n0\nENDSEC\n"
VERTEX = f"0\nVERTEX\n8\n%s\n10\n%.{DECIMALS}f\n20\n%.{DECIMALS}f\n30\n%.{DECIMALS}f\n"


def write_stack(layers: Layers, path: str | Path) -> None:
    """Write the contours; the DXF layer of layer 7 is ``LAYER_0007``."""
    names = [f"LAYER_{k:04d}" for k in range(len(layers))]
    with replacing(path) as temporary, temporary.open("w", encoding="ascii", newline="\r\n") as file:
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

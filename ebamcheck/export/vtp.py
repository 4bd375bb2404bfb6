"""VTK XML PolyData (``.vtp``), which ParaView and pyvista read: facets of a part, contours of a stack.

Numbers stand appended in base64 with a header of 64 bits, so that the file is XML throughout (VTK file formats, "XML File
Formats").
"""

from __future__ import annotations

import base64
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import NDArray

from ebamcheck.atomic_file import replacing
from ebamcheck.layers.stack import Layers
from ebamcheck.mesh.part import Part
from ebamcheck.numeric.rings import Ints

TYPES = {"<f8": "Float64", "<i8": "Int64", "<i4": "Int32", "|u1": "UInt8"}


def write_part(part: Part, path: str | Path) -> None:
    """Write the facets of a part."""
    count = len(part.faces)
    cells = part.faces.astype("<i8").reshape(-1), 3 * np.arange(1, count + 1)
    _write(path, part.vertices, "Polys", cells, {})


def write_stack(layers: Layers, path: str | Path) -> None:
    """Write every contour as a polyline at its height, with ``layer``, ``area_mm2`` and ``closed`` of each."""
    sizes = np.diff(layers.ring_starts)
    heights = np.repeat(layers.heights[layers.ring_layer], sizes)
    # A closed line ends at the point where it starts.
    first, past = layers.ring_starts[:-1][layers.closed], layers.ring_starts[1:][layers.closed]
    rows = np.insert(np.arange(len(layers.points)), past, first)
    figures = {
        "layer": layers.ring_layer.astype("<i8"),
        "area_mm2": layers.ring_areas,
        "closed": layers.closed.astype("u1"),
    }
    _write(
        path,
        np.column_stack([layers.points, heights]),
        "Lines",
        (rows, np.cumsum(sizes + layers.closed)),
        figures,
        {"height_mm": heights},
    )


def _write(
    path: str | Path,
    points: NDArray[np.float64],
    kind: str,
    cells: tuple[Ints, Ints],
    cell_data: Mapping[str, NDArray[Any]],
    point_data: Mapping[str, NDArray[Any]] | None = None,
) -> None:
    appended: list[bytes] = []
    length = 0

    def array(name: str, values: NDArray[Any], components: int = 1) -> str:
        nonlocal length
        little = np.ascontiguousarray(values, values.dtype.newbyteorder("<"))
        data = little.tobytes()
        encoded = base64.b64encode(len(data).to_bytes(8, "little") + data)
        offset, length = length, length + len(encoded)
        appended.append(encoded)
        return (
            f'<DataArray type="{TYPES[little.dtype.str]}" Name={quoteattr(name)} NumberOfComponents="{components}" '
            f'format="appended" offset="{offset}"/>'
        )

    counts = " ".join(
        f'NumberOf{name}="{len(cells[1]) if name == kind else 0}"'
        for name in ("Verts", "Lines", "Strips", "Polys")
    )
    connectivity, offsets = (np.asarray(column, np.int64) for column in cells)
    lines = [
        '<?xml version="1.0"?>',
        '<VTKFile type="PolyData" version="1.0" byte_order="LittleEndian" header_type="UInt64">',
        "<PolyData>",
        f'<Piece NumberOfPoints="{len(points)}" {counts}>',
        "<PointData>",
        *(array(name, column) for name, column in (point_data or {}).items()),
        "</PointData>",
        "<CellData>",
        *(array(name, column) for name, column in cell_data.items()),
        "</CellData>",
        "<Points>",
        array("Points", points, 3),
        "</Points>",
        f"<{kind}>",
        array("connectivity", connectivity),
        array("offsets", offsets),
        f"</{kind}>",
        "</Piece>",
        "</PolyData>",
        '<AppendedData encoding="base64">',
    ]
    with replacing(path) as temporary, temporary.open("wb") as file:
        file.write("\n".join(lines).encode() + b"\n_")
        file.writelines(appended)
        file.write(b"\n</AppendedData>\n</VTKFile>\n")

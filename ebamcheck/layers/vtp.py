"""VTK XML PolyData (``.vtp``), which ParaView and pyvista read: facets of a part, contours of a stack.

Numbers stand appended in base64 with a header of 64 bits, so that the file is XML throughout (VTK file formats, "XML File
Formats").
"""

from __future__ import annotations

import base64
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import NDArray

from ebamcheck.atomic_file import replacing
from ebamcheck.errors import InputError
from ebamcheck.layers.contour_table import stack_of_rings
from ebamcheck.layers.stack import Layers
from ebamcheck.mesh.part import Part
from ebamcheck.numeric.rings import Ints

TYPES = {"<f8": "Float64", "<i8": "Int64", "<i4": "Int32", "|u1": "UInt8"}

READABLE = {
    **{name: dtype for dtype, name in TYPES.items()},
    "Float32": "<f4",
    "UInt32": "<u4",
    "UInt64": "<u8",
    "Int8": "|i1",
}


def write_part(part: Part, path: str | Path) -> None:
    """Write the facets of a part."""
    count = len(part.faces)
    cells = part.faces.astype("<i8").reshape(-1), 3 * np.arange(1, count + 1)
    _write(path, part.vertices, "Polys", cells, {})


def write_stack(layers: Layers, path: str | Path) -> None:
    """Write every contour as a polyline at its height, with ``layer`` (from 1), ``area_mm2`` and ``closed`` of each."""
    sizes = np.diff(layers.ring_starts)
    heights = np.repeat(layers.heights[layers.ring_layer], sizes)
    # A closed line ends at the point where it starts.
    first, past = layers.ring_starts[:-1][layers.closed], layers.ring_starts[1:][layers.closed]
    rows = np.insert(np.arange(len(layers.points)), past, first)
    figures = {
        "layer": (layers.ring_layer + 1).astype("<i8"),
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
        layers.heights,
    )


def read_stack(path: str | Path) -> Layers:
    """Read the polylines of a file as the contours of the layers at their heights.

    Arrays may stand as text or in base64, appended or in place, without compression. A line that ends where it starts is closed.

    Raises
    ------
    InputError
        If the file is missing, is no such PolyData, or a line does not lie at one height.
    """
    try:
        root = ElementTree.parse(path).getroot()
        if root.get("compressor") or root.get("type") != "PolyData":
            raise ValueError("it is compressed, or no PolyData: save it as PolyData without compression")
        points = _read(root, "Points/DataArray").reshape(-1, 3)
        rows, ends = (
            _read(root, f"Lines/DataArray[@Name='{name}']").astype(np.int64)
            for name in ("connectivity", "offsets")
        )
        said = root.find(".//FieldData/DataArray[@Name='height_mm']")
        return _stack(
            points[rows], np.diff(ends, prepend=0), np.zeros(0) if said is None else _values(root, said)
        )
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None
    except (ElementTree.ParseError, ValueError, IndexError, LookupError) as error:
        raise InputError(f"{path}: is no VTK PolyData with contours at heights: {error}") from None


def _stack(points: NDArray[np.float64], sizes: Ints, said: NDArray[np.float64]) -> Layers:
    """Contours of lines, one after the other; heights of layers without one are said besides."""
    if (sizes < 2).any() or sizes.sum() != len(points):
        raise ValueError("a line has fewer than two points, or the offsets of lines do not rise")
    first = np.cumsum(sizes) - sizes
    level = points[first, 2]
    if (np.repeat(level, sizes) != points[:, 2]).any():
        raise ValueError("a line does not lie at one height")
    closed = (points[first] == points[first + sizes - 1]).all(axis=1) & (sizes > 2)
    kept = np.ones(len(points), np.bool_)
    kept[(first + sizes - 1)[closed]] = False
    heights = np.unique(np.concatenate([said, level]))
    return stack_of_rings(heights, np.searchsorted(heights, level), sizes - closed, closed, points[kept, :2])


def _read(root: ElementTree.Element, place: str) -> NDArray[Any]:
    array = root.find(f".//Piece/{place}")
    if array is None:
        raise ValueError(f"it has no {place}")
    return _values(root, array)


def _values(root: ElementTree.Element, array: ElementTree.Element) -> NDArray[Any]:
    """Numbers of one DataArray."""
    dtype = READABLE[array.get("type", "")]
    text = "".join((array.text or "").split())
    if array.get("format") == "ascii":
        return np.array((array.text or "").split(), dtype)
    if array.get("format") == "appended":
        appended = root.find("AppendedData")
        if appended is None or appended.get("encoding") != "base64":
            raise ValueError("its appended data are not in base64: save them so")
        text = (appended.text or "").strip()[1 + int(array.get("offset", "")) :]
    width = 8 if root.get("header_type") == "UInt64" else 4
    length = int.from_bytes(base64.b64decode(text[: 4 * -(-width // 3)])[:width], "little")
    data = base64.b64decode(text[: 4 * -(-(width + length) // 3)])[width:]
    return np.frombuffer(data, dtype, count=length // np.dtype(dtype).itemsize)


def _write(
    path: str | Path,
    points: NDArray[np.float64],
    kind: str,
    cells: tuple[Ints, Ints],
    cell_data: Mapping[str, NDArray[Any]],
    point_data: Mapping[str, NDArray[Any]] | None = None,
    heights: NDArray[np.float64] | None = None,
) -> None:
    appended: list[bytes] = []
    length = 0

    def array(name: str, values: NDArray[Any], components: int = 1, more: str = "") -> str:
        nonlocal length
        little = np.ascontiguousarray(values, values.dtype.newbyteorder("<"))
        data = little.tobytes()
        encoded = base64.b64encode(len(data).to_bytes(8, "little") + data)
        offset, length = length, length + len(encoded)
        appended.append(encoded)
        return (
            f'<DataArray type="{TYPES[little.dtype.str]}" Name={quoteattr(name)} NumberOfComponents="{components}"{more} '
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
        "<FieldData>",
        *([] if heights is None else [array("height_mm", heights, more=f' NumberOfTuples="{len(heights)}"')]),
        "</FieldData>",
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

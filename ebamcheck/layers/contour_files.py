"""Contours in files of points that other programs read: CSV, DXF of release 12, VTK PolyData, and 3MF slices."""

from __future__ import annotations

import base64
import contextlib
import itertools
import locale
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.sax.saxutils import quoteattr

import numpy as np
import pyarrow as pa
import pyarrow.csv as pc
from numpy.typing import NDArray

from ebamcheck.atomic_file import replacing
from ebamcheck.columns_file import starts_of
from ebamcheck.errors import InputError, SettingsError
from ebamcheck.kernels import Bools, Floats, Ints, ShortInts
from ebamcheck.layers.stack import Layers, canonical, from_paths
from ebamcheck.mesh.part import Part

TYPES = dict.fromkeys(("layer", "ring", "closed"), pa.int64())
TYPES |= dict.fromkeys(("height_mm", "x_mm", "y_mm"), pa.float64())


def stack_of_rings(heights: Floats, ring_layer: Ints, sizes: Ints, closed: Bools, points: Floats) -> Layers:
    """Stack of rings in any order: layer, number of points and whether closed (R,) of each, and all points (N, 2), mm."""
    order = np.argsort(ring_layer, kind="stable")
    rows = np.argsort(np.repeat(ring_layer, sizes), kind="stable")
    layer_starts = starts_of(np.bincount(ring_layer, minlength=len(heights)))
    return canonical(heights, points[rows], starts_of(sizes[order]), layer_starts, closed[order])


def write_csv(layers: Layers, path: str | Path) -> None:
    """Write the contours as CSV with digits that read back to the same bits; an empty layer has one row without a ring."""
    sizes, layer = np.diff(layers.ring_starts), layers.ring_layer
    empty = np.flatnonzero(np.diff(layers.layer_starts) == 0)
    where = np.concatenate([np.repeat(layer, sizes), empty])
    order = np.argsort(where, kind="stable")
    of_points: dict[str, NDArray[Any]] = {
        "ring": np.repeat(np.arange(len(sizes)) - layers.layer_starts[layer], sizes),
        "closed": np.repeat(layers.closed, sizes),
        "x_mm": layers.points[:, 0],
        "y_mm": layers.points[:, 1],
    }
    columns = {"layer": pa.array(where[order] + 1), "height_mm": pa.array(layers.heights[where[order]])}
    for name, values in of_points.items():
        padded = np.concatenate([values, np.zeros(len(empty))])[order]
        columns[name] = pa.array(padded, TYPES[name], mask=order >= len(layers.points), safe=False)
    with replacing(path) as temporary:
        pc.write_csv(pa.table(columns), temporary)


def read_csv(path: str | Path) -> Layers:
    """Read contours from CSV."""
    options = pc.ConvertOptions(column_types=TYPES, include_columns=list(TYPES))
    with _read_as(path, f"table of contours with the columns {', '.join(TYPES)}"):
        table = pc.read_csv(path, convert_options=options)
    held = {name: table[name].to_numpy() for name in ("layer", "height_mm")}
    layer, first = np.unique(held["layer"], return_index=True)
    if not np.array_equal(layer, np.arange(1, len(layer) + 1)):
        raise InputError(f"{path}: the layers are not numbered 1, 2, 3, ...: number all of them")
    heights = held["height_mm"][first]
    if not np.array_equal(heights[held["layer"] - 1], held["height_mm"]):
        raise InputError(f"{path}: the points of one layer have several heights: give each layer one")
    rows = table.filter(table["ring"].is_valid())
    if any(rows[name].null_count for name in TYPES):
        raise InputError(f"{path}: a point lacks a number: fill in all fields, or leave `ring` to `y_mm` empty")
    of_layer, ring, closed = (rows[name].to_numpy() for name in ("layer", "ring", "closed"))
    points = np.column_stack([rows["x_mm"].to_numpy(), rows["y_mm"].to_numpy()])
    begins = np.flatnonzero((np.diff(of_layer, prepend=0) != 0) | (np.diff(ring, prepend=-1) != 0))
    sizes = np.diff(np.append(begins, len(ring)))
    return stack_of_rings(heights, of_layer[begins] - 1, sizes, closed[begins] != 0, points)


@contextlib.contextmanager
def _read_as(path: str | Path, what: str) -> Iterator[None]:
    """Tell what a file should be where it cannot be read as that."""
    try:
        yield
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None
    except (pa.ArrowInvalid, ElementTree.ParseError, ValueError, LookupError) as error:
        raise InputError(f"{path}: is no {what}: {error}") from None


OUTER, HOLE, OPEN = 5, 1, 6  # colours of the AutoCAD colour index

DECIMALS = 6  # a nanometre: far under what is compared
HEIGHT = "ebamcheck height"  # begins a comment that holds the height of a layer

# Millimetres of the drawing units that `$INSUNITS` of later releases names; 0: it names none
UNITS_MM = {0: 1.0, 1: 25.4, 2: 304.8, 4: 1.0, 5: 10.0, 6: 1000.0}

HEAD = "0\nSECTION\n2\nHEADER\n9\n$ACADVER\n1\nAC1009\n0\nENDSEC\n"
VERTEX = f"0\nVERTEX\n8\n%s\n10\n%.{DECIMALS}f\n20\n%.{DECIMALS}f\n30\n%.{DECIMALS}f\n"


def write_dxf(layers: Layers, path: str | Path) -> None:
    """Write a polyline a ring, mm; layer 7 is ``LAYER_0007``. Heights stand in comments, too, for layers without a contour."""
    names = [f"LAYER_{k:04d}" for k in range(1, len(layers) + 1)]
    with replacing(path) as temporary, temporary.open("w", encoding="ascii", newline="\r\n") as file:
        file.write("".join(f"999\n{HEIGHT} {height:.{DECIMALS}f}\n" for height in layers.heights.tolist()))
        rows = "".join(f"0\nLAYER\n2\n{name}\n70\n0\n62\n7\n6\nCONTINUOUS\n" for name in names)
        table = f"0\nSECTION\n2\nTABLES\n0\nTABLE\n2\nLAYER\n70\n{len(names)}\n{rows}0\nENDTAB\n0\nENDSEC\n"
        file.write(HEAD + table + "0\nSECTION\n2\nENTITIES\n")
        for ring, layer in enumerate(layers.ring_layer.tolist()):
            file.write(_polyline(layers, ring, names[layer], float(layers.heights[layer])))
        file.write("0\nENDSEC\n0\nEOF\n")


def _polyline(layers: Layers, ring: int, name: str, height_mm: float) -> str:
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


def read_dxf(path: str | Path) -> Layers:
    """Read polylines of a text DXF (POLYLINE and LWPOLYLINE) as the contours of the layers at their heights."""
    with _read_as(path, "text DXF with contours at heights"):
        lines = Path(path).read_text(encoding="utf-8", errors="replace").splitlines()
        codes, texts = np.array(lines[::2], np.int64), np.char.strip(np.array(lines[1::2], np.str_))
        if len(codes) != len(texts) or not len(codes) or (codes[-1], texts[-1]) != (0, "EOF"):
            raise ValueError("it does not end with EOF")
        return _stack_of_groups(codes, texts)


def _stack_of_groups(codes: Ints, texts: NDArray[np.str_]) -> Layers:
    """Contours of the groups of a file: codes, and the texts that belong to them."""
    begins = codes == 0
    entity = np.cumsum(begins) - 1
    kind = texts[begins][entity]
    is_ring = begins & np.isin(kind, ("POLYLINE", "LWPOLYLINE"))
    ring, light, vertex = np.cumsum(is_ring) - 1, kind == "LWPOLYLINE", kind == "VERTEX"
    if (texts[(codes == 42) & (light | vertex)].astype(np.float64) != 0.0).any():
        raise ValueError("a polyline has bulges: draw it with straight segments")
    at = (codes == 10) & (light | vertex)
    x, y = (texts[(codes == code) & (light | vertex)].astype(np.float64) for code in (10, 20))
    points = np.column_stack([x, y])
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


VTK_TYPES = {"<f8": "Float64", "<i8": "Int64", "<i4": "Int32", "|u1": "UInt8"}
READABLE = {name: dtype for dtype, name in VTK_TYPES.items()}
READABLE |= {"Float32": "<f4", "UInt32": "<u4", "UInt64": "<u8", "Int8": "|i1"}


def write_part(part: Part, path: str | Path) -> None:
    """Write the facets of a part."""
    count = len(part.faces)
    cells = part.faces.astype("<i8").reshape(-1), 3 * np.arange(1, count + 1)
    _write_polydata(path, part.vertices, "Polys", cells, {})


def write_vtp(layers: Layers, path: str | Path) -> None:
    """Write every contour as a polyline at its height, appended in base64, with ``layer`` (from 1), ``area_mm2`` and ``closed``."""
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
    points, cells = np.column_stack([layers.points, heights]), (rows, np.cumsum(sizes + layers.closed))
    _write_polydata(path, points, "Lines", cells, figures, {"height_mm": heights}, layers.heights)


def read_vtp(path: str | Path) -> Layers:
    """Read uncompressed polylines at heights, as text or base64; a line that ends where it starts is closed."""
    with _read_as(path, "VTK PolyData with contours at heights"):
        root = ElementTree.parse(path).getroot()
        if root.get("compressor") or root.get("type") != "PolyData":
            raise ValueError("it is compressed, or no PolyData: save it as PolyData without compression")
        points = _array(root, "Points/DataArray").reshape(-1, 3)
        names = ("connectivity", "offsets")
        rows, ends = (_array(root, f"Lines/DataArray[@Name='{n}']").astype(np.int64) for n in names)
        said = root.find(".//FieldData/DataArray[@Name='height_mm']")
        besides = np.zeros(0) if said is None else _values(root, said)
        return _stack_of_lines(points[rows], np.diff(ends, prepend=0), besides)


def _stack_of_lines(points: Floats, sizes: Ints, said: Floats) -> Layers:
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


def _array(root: ElementTree.Element, place: str) -> NDArray[Any]:
    array = root.find(f".//Piece/{place}")
    if array is None:
        raise ValueError(f"it has no {place}")
    return _values(root, array)


def _values(root: ElementTree.Element, array: ElementTree.Element) -> NDArray[Any]:
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


def _write_polydata(
    path: str | Path, points: Floats, kind: str, cells: tuple[Ints, Ints],
    cell_data: Mapping[str, NDArray[Any]], point_data: Mapping[str, NDArray[Any]] | None = None,
    heights: Floats | None = None,
) -> None:  # fmt: skip
    appended: list[bytes] = []
    length = 0

    def array(name: str, values: NDArray[Any], components: int = 1, more: str = "") -> str:
        nonlocal length
        little = np.ascontiguousarray(values, values.dtype.newbyteorder("<"))
        data = little.tobytes()
        encoded = base64.b64encode(len(data).to_bytes(8, "little") + data)
        offset, length = length, length + len(encoded)
        appended.append(encoded)
        kind_of_array = f'type="{VTK_TYPES[little.dtype.str]}" Name={quoteattr(name)} NumberOfComponents="{components}"'
        return f'<DataArray {kind_of_array}{more} format="appended" offset="{offset}"/>'

    def section(tag: str, *arrays: str) -> list[str]:
        return [f"<{tag}>", *arrays, f"</{tag}>"]

    numbers = {name: len(cells[1]) if name == kind else 0 for name in ("Verts", "Lines", "Strips", "Polys")}
    counts = " ".join(f'NumberOf{name}="{number}"' for name, number in numbers.items())
    of_stack = {} if heights is None else {"height_mm": heights}
    fields = [array(name, column, more=f' NumberOfTuples="{len(column)}"') for name, column in of_stack.items()]
    of_points = [array(name, column) for name, column in (point_data or {}).items()]
    of_cells = [array(name, column) for name, column in cell_data.items()]
    places = array("Points", points, 3)
    joined = [array(n, np.asarray(c, np.int64)) for n, c in zip(("connectivity", "offsets"), cells, strict=True)]
    lines = [
        '<?xml version="1.0"?>',
        '<VTKFile type="PolyData" version="1.0" byte_order="LittleEndian" header_type="UInt64">',
        "<PolyData>",
        *section("FieldData", *fields),
        f'<Piece NumberOfPoints="{len(points)}" {counts}>',
        *section("PointData", *of_points),
        *section("CellData", *of_cells),
        *section("Points", places),
        *section(kind, *joined),
        "</Piece>",
        "</PolyData>",
        '<AppendedData encoding="base64">',
    ]
    with replacing(path) as temporary, temporary.open("wb") as file:
        file.write("\n".join(lines).encode() + b"\n_")
        file.writelines(appended)
        file.write(b"\n</AppendedData>\n</VTKFile>\n")


# Millimetres of the units of a 3MF model, as lib3mf numbers them: micrometre to metre
MM_A_UNIT = {0: 0.001, 1: 1.0, 2: 10.0, 3: 25.4, 4: 304.8, 5: 1000.0}


@contextlib.contextmanager
def keeping_locale() -> Iterator[None]:
    """Put the locale of the process back, which lib3mf sets to C: files would else be read as ASCII from then on."""
    before = locale.setlocale(locale.LC_ALL)
    try:
        yield
    finally:
        locale.setlocale(locale.LC_ALL, before)


def write_3mf(layers: Layers, path: str | Path) -> None:
    """Write closed contours as slices (3MF Slice Extension 1.0), in 32-bit numbers, with the part's mesh or a rough box."""
    import lib3mf

    bottom, tops = slice_heights(layers)
    if open_paths := int(np.count_nonzero(~layers.closed)):
        raise SettingsError(f"{path}: 3MF holds closed contours only: the stack has {open_paths} open paths")
    wrapper = lib3mf.get_wrapper()
    model = wrapper.CreateModel()
    model.SetUnit(lib3mf.ModelUnit.MilliMeter)
    stack = model.AddSliceStack(bottom)
    for layer, top in enumerate(tops.tolist()):
        made, of = stack.AddSlice(top), layers.rings_of(layer)
        if not len(of):
            continue
        starts = layers.ring_starts[of.start : of.stop + 1].tolist()
        points = np.ascontiguousarray(layers.points[starts[0] : starts[-1]], np.float32)
        made.SetVertices([lib3mf.Position2D.from_buffer_copy(row) for row in points])
        for a, b in itertools.pairwise(starts):
            made.AddPolygon([*range(a - starts[0], b - starts[0]), a - starts[0]])
    body = model.AddMeshObject()
    mesh = layers.mesh
    vertices, faces = (mesh.vertices, mesh.faces) if mesh else _box(layers, bottom, float(tops[-1]))
    body.SetGeometry(
        [lib3mf.Position.from_buffer_copy(row) for row in np.ascontiguousarray(vertices, np.float32)],
        [lib3mf.Triangle.from_buffer_copy(row) for row in np.ascontiguousarray(faces, np.uint32)],
    )
    body.AssignSliceStack(stack)
    resolution = lib3mf.SlicesMeshResolution
    body.SetSlicesMeshResolution(resolution.Lowres if layers.mesh is None else resolution.Fullres)
    model.AddBuildItem(body, wrapper.GetIdentityTransform())
    writer = model.QueryWriter("3mf")
    with replacing(path) as temporary, keeping_locale():
        writer.WriteToFile(str(temporary))


def read_3mf(path: str | Path) -> Layers:
    """Read the one stack of slices in a file."""
    import lib3mf

    with _read_as(path, "3MF"):
        data = Path(path).read_bytes()
    try:
        with keeping_locale():
            model = lib3mf.get_wrapper().CreateModel()
            model.QueryReader("3mf").ReadFromBuffer(data)
            found = model.GetSliceStacks()
            if found.Count() != 1:
                raise InputError(f"{path}: holds {found.Count()} stacks of slices, where one belongs")
            found.MoveNext()
            stack = found.GetCurrentSliceStack()
            scale = MM_A_UNIT[model.GetUnit()]
            bottom = stack.GetBottomZ()
            slices = [stack.GetSlice(k) for k in range(stack.GetSliceCount())]
            tops = np.array([bottom, *(one.GetZTop() for one in slices)])
            rings = [_rings(one) for one in slices]
    except lib3mf.ELib3MFException as error:
        raise InputError(f"{path}: is no 3MF that can be read: {error}") from None
    layers = [[(ring * scale, ring[0].tolist() == ring[-1].tolist()) for ring in layer] for layer in rings]
    return from_paths(0.5 * (tops[1:] + tops[:-1]) * scale, layers)


def _rings(one: Any) -> list[Floats]:
    """Points of the polygons of a slice, in units of the file."""
    points = np.array([tuple(vertex.Coordinates) for vertex in one.GetVertices()], np.float64).reshape(-1, 2)
    return [points[np.array(one.GetPolygonIndices(k), np.int64)] for k in range(one.GetPolygonCount())]


def slice_heights(layers: Layers) -> tuple[float, Floats]:
    """Bottom of the first slice and the top of each, mm, from the heights of the cuts."""
    cuts = layers.heights
    steps = np.diff(cuts)
    if cuts.size < 2 or (steps <= 0.0).any():
        raise SettingsError("3MF slices need at least two layers whose heights rise: sort them and drop repeats")
    borders = cuts[:-1] + 0.5 * steps
    return float(cuts[0] - 0.5 * steps[0]), np.append(borders, cuts[-1] + 0.5 * steps[-1])


def _box(layers: Layers, bottom: float, top: float) -> tuple[Floats, ShortInts]:
    if not len(layers.points):
        raise SettingsError("there is no contour on any layer: there is nothing to write as 3MF")
    x0, y0, x1, y1 = layers.bounds()
    corners = [(x, y, z) for z in (bottom, top) for x, y in ((x0, y0), (x1, y0), (x1, y1), (x0, y1))]
    sides = [(k, (k + 1) % 4, (k + 1) % 4 + 4, k + 4) for k in range(4)]
    facets = [(0, 2, 1), (0, 3, 2), (4, 5, 6), (4, 6, 7)]
    facets += [face for a, b, c, d in sides for face in ((a, b, c), (a, c, d))]
    return np.array(corners), np.array(facets, np.int32)

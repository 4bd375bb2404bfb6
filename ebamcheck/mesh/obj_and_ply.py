"""Strict readers of OBJ and PLY files: polygons become triangle fans; an error names the place."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ebamcheck.errors import InputError
from ebamcheck.mesh.reading import checked_finite, numbers_of, polygon_corners

_REFERENCE = re.compile(rb"([+-]?\d{1,18})(/[+-]?\d*){0,2}")
_KEYWORD = re.compile(rb"[A-Za-z_#][\w#]*")


def read_obj(data: bytes | memoryview, name: str) -> tuple[NDArray[np.float64], list[str]]:
    """Corner points of the facets of an OBJ file, (F, 3, 3) in its unit, and harmless irregularities, one line each."""
    data = bytes(data)
    if not data:
        raise InputError(f"{name}: is empty (0 bytes)")
    # A line that ends in a backslash continues on the next one.
    lines = re.sub(rb"\\[ \t]*(\r\n|\n|\r)", b" ", data).splitlines()
    vertices: list[bytes] = []
    corners: list[tuple[int, int, list[bytes]]] = []  # line, vertices before it, and words of each facet
    last = 0
    for k, line in enumerate(lines):
        words = line.split()
        if not words:
            continue
        where, word = f"{name}: line {k + 1}", words[0]
        if word in (b"surf", b"curv", b"curv2", b"cstype"):
            raise InputError(f"{where}: {word.decode()!r} is free-form geometry, no mesh: export facets")
        if not _KEYWORD.match(word):
            raise InputError(f"{where}: {_shown(line)} is no line of an OBJ file")
        if word == b"v":
            # Weights and colours behind the coordinates are ignored.
            if not 4 <= len(words) <= 9:
                raise InputError(f"{where}: {_shown(line)} has {len(words) - 1} numbers: a vertex has three")
            vertices += words[1:4]
        elif word in (b"f", b"fo"):
            if len(words) < 4:
                raise InputError(f"{where}: {_shown(line)} has {len(words) - 1} corners: a facet has three")
            corners.append((k, len(vertices) // 3, words[1:]))
        else:
            continue
        last = k
    if not corners:
        raise InputError(f"{name}: holds no facet (OBJ)")
    if not vertices:
        raise InputError(f"{name}: holds facets and no vertex (OBJ)")
    points = numbers_of(vertices, name).reshape(-1, 3)
    index = [
        _row(corner, before, len(points), f"{name}: line {k + 1}") for k, before, words in corners for corner in words
    ]
    sizes = np.array([len(words) for _, _, words in corners], np.int64)
    cut = last == len(lines) - 1 and not data.endswith((b"\n", b"\r"))
    notes = ["the last line has no end: the file may have been cut there"] if cut else []
    return checked_finite(polygon_corners(points, np.array(index, np.int64), sizes), name), notes


def _row(corner: bytes, before: int, count: int, where: str) -> int:
    """Vertex of a corner; a negative number counts back from the vertices before it."""
    told = _REFERENCE.fullmatch(corner)
    row = int(told[1]) if told else 0
    row = row - 1 if row > 0 else before + row if row < 0 else -1
    if not 0 <= row < count:
        raise InputError(f"{where}: corner {_shown(corner)} is none of the {count} vertices of the file")
    return row


def _shown(text: bytes) -> str:
    return repr(text[:40].decode("ascii", "replace"))


# NumPy types by the names of types in a header
TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8",
}  # fmt: skip

FORMATS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
MOST_CORNERS = 100_000  # most corners of a facet: more come from a damaged file


@dataclass(frozen=True)
class Property:
    """One property of an element: its name, its type and, for a list, the type of its count."""

    name: str
    kind: str
    count_kind: str = ""


@dataclass(frozen=True)
class Element:
    """One kind of element, as the header declares it."""

    name: str
    count: int
    properties: tuple[Property, ...]


# By property: its numbers, element after element, and how many each element has
Columns = dict[str, tuple[NDArray[np.float64], NDArray[np.int64]]]


def read_ply(data: bytes | memoryview, name: str) -> tuple[NDArray[np.float64], list[str]]:
    """Corner points of the facets of a PLY file, (F, 3, 3) in its unit; there are no harmless irregularities."""
    data = bytes(data)
    if not data:
        raise InputError(f"{name}: is empty (0 bytes)")
    order, elements, start = _header(data, name)
    body = data[start:]
    found = _read_binary(body, elements, order, name) if order else _read_ascii(body, elements, name)
    columns = found.get("vertex", {})
    if lacking := [axis for axis in "xyz" if axis not in columns]:
        raise InputError(f"{name}: its vertices have no {lacking[0]} (PLY)")
    vertices = np.stack([columns[axis][0] for axis in "xyz"], axis=1)
    faces = found.get("face", {})
    corners = next((faces[key] for key in ("vertex_indices", "vertex_index") if key in faces), None)
    if corners is None or not corners[1].size:
        what = "tristrips, which are not read: export triangles" if "tristrips" in found else "no facet (PLY)"
        raise InputError(f"{name}: holds {what}")
    told, sizes = corners
    if (sizes < 3).any():
        facet = int(np.flatnonzero(sizes < 3)[0])
        raise InputError(f"{name}: facet {facet} has {sizes[facet]} corners: a facet has three")
    good = (told >= 0) & (told < len(vertices)) & (told == np.floor(told))  # false for NaN
    if not good.all():
        at = int(np.flatnonzero(~good)[0])
        facet = int(np.searchsorted(np.cumsum(sizes), at, side="right"))
        raise InputError(f"{name}: facet {facet} names vertex {told[at]:g}, which is none of {len(vertices)} vertices")
    index = told.astype(np.int64)
    return checked_finite(polygon_corners(vertices, index, sizes), name), []


def _header(data: bytes, name: str) -> tuple[str, list[Element], int]:
    """Byte order (empty: ASCII), elements, and offset of the body."""
    head = data[: 1 << 16]
    at = head.find(b"end_header")
    end = head.find(b"\n", at) + 1 if at >= 0 else 0
    if not head.startswith(b"ply") or not end:
        raise InputError(f"{name}: is no PLY file: it lacks {'ply' if end else 'end_header'} in its header")
    order, elements = None, list[Element]()
    for number, line in enumerate(head[:at].decode("ascii", "replace").splitlines()[1:], 2):
        words = line.split()
        try:
            if words[:1] == ["format"]:
                order = FORMATS[words[1]]
            elif words[:1] == ["element"]:
                elements.append(Element(words[1], _count(words[2]), ()))
            elif words[:1] == ["property"]:
                last = elements[-1]
                elements[-1] = Element(last.name, last.count, (*last.properties, _property(words)))
            elif words and words[0] not in ("comment", "obj_info"):
                raise ValueError
        except (KeyError, IndexError, ValueError):
            raise InputError(f"{name}: line {number}: {line[:60]!r} is no line of a PLY header") from None
    names = [e.name for e in elements]
    if order is None or len(set(names)) != len(names):
        told = "has no format" if order is None else "tells an element twice"
        raise InputError(f"{name}: its header {told}")
    return order, elements, end


def _count(word: str) -> int:
    if not (word.isascii() and word.isdecimal()):
        raise ValueError
    return int(word)


def _property(words: list[str]) -> Property:
    if words[1] != "list":
        kind, name = words[1:]
        return Property(name, TYPES[kind])
    count, kind, name = words[2:]
    if TYPES[count][0] == "f":
        raise ValueError
    return Property(name, TYPES[kind], TYPES[count])


def _truncated(name: str, element: Element, what: str) -> InputError:
    return InputError(
        f"{name}: its header counts {element.count} of {element.name!r}, but {what}: truncated, or its counts are wrong"
    )


def _read_ascii(body: bytes, elements: list[Element], name: str) -> dict[str, Columns]:
    """Columns of every kind of element; each element is a line."""
    rows = [words for line in body.splitlines() if (words := line.split())]
    found, first = dict[str, Columns](), 0
    for element in elements:
        mine = rows[first : first + element.count]
        if len(mine) < element.count:
            raise _truncated(name, element, f"there are lines for {len(mine)}")
        found[element.name] = _ascii_columns(mine, element, name)
        first += element.count
    if len(rows) > first:
        raise InputError(f"{name}: {len(rows) - first} lines follow the last element that its header counts")
    return found


def _ascii_columns(rows: list[list[bytes]], element: Element, name: str) -> Columns:
    places = [0] * len(rows)
    columns: Columns = {}
    for prop in element.properties:
        words: list[bytes] = []
        sizes: list[int] = []
        for k, row in enumerate(rows):
            at, size = places[k], 1
            if prop.count_kind:
                size = int(row[at]) if at < len(row) and row[at].isdigit() and len(row[at]) < 7 else -1
                at += 1
            if size < 0 or at + size > len(row):
                raise _truncated(name, element, f"number {k} lacks some of {prop.name!r}")
            words += row[at : at + size]
            sizes.append(size)
            places[k] = at + size
        columns[prop.name] = (numbers_of(words, name), np.array(sizes, np.int64))
    for k, (row, place) in enumerate(zip(rows, places, strict=True)):
        if place != len(row):
            raise InputError(f"{name}: {element.name} {k} has {len(row)} numbers, its properties are {place}")
    return columns


def _read_binary(body: bytes, elements: list[Element], order: str, name: str) -> dict[str, Columns]:
    found, at = dict[str, Columns](), 0
    for element in elements:
        columns, at = _binary_columns(body, at, element, order, name)
        found[element.name] = columns
    if body[at:].strip(b"\r\n \t\0"):
        raise InputError(f"{name}: {len(body) - at} bytes follow the last element that its header counts")
    return found


def _binary_columns(body: bytes, at: int, element: Element, order: str, name: str) -> tuple[Columns, int]:
    """Columns of one kind of element, and offset of the next kind."""
    left = len(body) - at
    # Lengths of the lists of the first element, which in most files are those of all.
    sizes, where = [], at
    fields: list[tuple[str, str] | tuple[str, str, tuple[int]]] = []
    for i, prop in enumerate(element.properties):
        size = 1
        if prop.count_kind:
            size, where = _number(body, where, order, prop.count_kind)
            size = size if 0 <= size <= MOST_CORNERS else 0
            fields.append((f"n{i}", order + prop.count_kind))
        sizes.append(size)
        where += size * np.dtype(prop.kind).itemsize
        fields.append((f"v{i}", order + prop.kind, (size,)))
    kind = np.dtype(fields)
    least_bytes = sum(np.dtype(p.count_kind or p.kind).itemsize for p in element.properties)
    lists = [i for i, prop in enumerate(element.properties) if prop.count_kind]
    same = element.count * kind.itemsize <= left
    if element.count * least_bytes > left or not (same or lists):
        raise _truncated(name, element, f"{left} bytes are left for them")
    table = np.frombuffer(body, kind, element.count if same else 0, at)
    if not same or any((table[f"n{i}"] != sizes[i]).any() for i in lists):
        return _mixed_columns(body, at, element, order, name)
    columns = {
        prop.name: (table[f"v{i}"].astype(np.float64).reshape(-1), np.full(element.count, sizes[i], np.int64))
        for i, prop in enumerate(element.properties)
    }
    return columns, at + element.count * kind.itemsize


def _number(body: bytes, at: int, order: str, kind: str) -> tuple[int, int]:
    """An integer and the offset after it; -1 if it lies beyond the end of the file."""
    width = np.dtype(kind).itemsize
    raw = body[at : at + width]
    if len(raw) < width:
        return -1, at
    return int.from_bytes(raw, "big" if order == ">" else "little", signed=kind[0] == "i"), at + width


def _mixed_columns(body: bytes, at: int, element: Element, order: str, name: str) -> tuple[Columns, int]:
    """Columns of a kind of element whose lists differ in length, read element by element."""
    values: list[list[float]] = [[] for _ in element.properties]
    sizes: list[list[int]] = [[] for _ in element.properties]
    for k in range(element.count):
        for i, prop in enumerate(element.properties):
            size = 1
            if prop.count_kind:
                size, at = _number(body, at, order, prop.count_kind)
            width = np.dtype(prop.kind).itemsize
            if not 0 <= size <= MOST_CORNERS or at + size * width > len(body):
                raise _truncated(name, element, f"number {k} lacks some of {prop.name!r}")
            values[i] += np.frombuffer(body, order + prop.kind, size, at).tolist()
            sizes[i].append(size)
            at += size * width
    return {
        prop.name: (np.array(values[i], np.float64), np.array(sizes[i], np.int64))
        for i, prop in enumerate(element.properties)
    }, at

"""The Common Layer Interface: slice files (``.cli``) that machines and other programs read, text and binary.

Version 2.0 of the format (Brite-EuRam project BE 2578). Precision of a file:

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
import logging
import math
import re
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ebamcheck.atomic_file import regular_file, replacing
from ebamcheck.errors import InputError, SettingsError
from ebamcheck.geometry.rings import signed_areas
from ebamcheck.json_values import parsed_json
from ebamcheck.kernels import Floats, Ints
from ebamcheck.layers.stack import Layers, canonical
from ebamcheck.mesh.reading import is_number

VERSIONS = (100, 101, 200)
USER_DATA = "ebamcheck.layers"
# A file whose header does not begin within this many bytes is another kind of file
HEADER_WITHIN_BYTES = 65536
SHOWN_CHARACTERS = 40  # characters of a wrong value that a message quotes

_COMMENT = re.compile(rb"//.*?//", re.DOTALL)
_COMMAND = re.compile(rb"\$\$([A-Za-z]+)\s*/?")
_USER_DATA = re.compile(rb"\$\$USERDATA\s*/\s*([^,$]*?)\s*,\s*(\d+)\s*,")


@dataclass
class Header:
    """Values of the header, and its start and end in the file."""

    start: int
    end: int
    binary: bool = False
    aligned: bool = False
    units_mm: float = math.nan
    version: int = 200
    layers: int | None = None
    models: dict[int, str] = field(default_factory=dict)
    labels: dict[str, Any] = field(default_factory=dict)
    # Number of polylines, if this program wrote the file: the format itself does not give it
    polylines: int | None = None


def read_header(data: bytes, path: Path) -> Header:
    """Read the header from the bytes of a whole file; raises InputError if it is invalid."""
    start = data.find(b"$$HEADERSTART", 0, HEADER_WITHIN_BYTES)
    if start < 0:
        raise InputError(f"{path}: is no Common Layer Interface file: it has no $$HEADERSTART")
    end = data.find(b"$$HEADEREND", start)
    if end < 0:
        raise place_error(path, data, len(data), "the header has no $$HEADEREND: the file is cut off")
    header = Header(start, end + len(b"$$HEADEREND"))
    text = without_comments(data[:end])
    form = ""
    position = start
    while 0 <= position < end:
        name, value, following = command(text, position)
        try:
            if name in ("ASCII", "BINARY"):
                form = name
            elif name == "USERDATA":
                following = _read_user_data(data, position, end, header)
            else:
                _read_value(name, value, header)
        except ValueError:
            raise place_error(path, data, position, f"unknown or wrong: $${name} {shown(value)}") from None
        position = following
    if not form:
        raise place_error(path, data, end, "the header names neither $$ASCII nor $$BINARY")
    if math.isnan(header.units_mm):
        raise place_error(path, data, end, "the header has no $$UNITS: the length of a unit is unknown")
    header.binary = form == "BINARY"
    return header


def _read_value(name: str, value: bytes, header: Header) -> None:
    """Store the value of one header command; raises ValueError if it is invalid."""
    if name == "UNITS":
        header.units_mm = float(value)
        if not (math.isfinite(header.units_mm) and header.units_mm > 0.0):
            raise ValueError
    elif name == "VERSION":
        header.version = int(value)
        if header.version not in VERSIONS:
            raise ValueError
    elif name == "LAYERS":
        header.layers = int(value)
        if header.layers < 0:
            raise ValueError
    elif name == "LABEL":
        number, _, label = value.partition(b",")
        header.models[int(number)] = label.strip().decode("utf-8", "replace")
    elif name == "ALIGN":
        header.aligned = True
    elif name not in ("HEADERSTART", "DATE", "DIMENSION"):
        raise ValueError


def _read_user_data(data: bytes, position: int, end: int, header: Header) -> int:
    """Skip user data, whose length is given before them; read the labels if this program wrote them."""
    match = _USER_DATA.match(data, position)
    if match is None or match.end() + int(match[2]) > end:
        raise ValueError
    after = match.end() + int(match[2])
    if match[1] == USER_DATA.encode():
        values = dict(parsed_json(data[match.end() : after]))
        if "polylines" in values:
            header.polylines = int(values["polylines"])
        header.labels = {
            "part": str(values.get("part", "")),
            "direction": tuple(float(v) for v in values.get("direction", (0.0, 0.0, 1.0))),
            "backend": str(values.get("backend", "")),
            "settings": dict(values.get("settings", {})),
        }
    following = data.find(b"$$", after, end)
    return following if following >= 0 else end


def without_comments(text: bytes) -> bytes:
    """Replace comments by blanks, so that every other byte keeps its offset and every line its number."""
    if b"//" not in text:
        return text
    return _COMMENT.sub(lambda match: re.sub(rb"[^\n]", b" ", match[0]), text)


def command(text: bytes, position: int) -> tuple[str, bytes, int]:
    """Name and argument of the command at `position`, and the position of the next one."""
    following = text.find(b"$$", position + 2)
    following = following if following >= 0 else len(text)
    match = _COMMAND.match(text, position, following)
    if match is None:
        return "", text[position:following].strip(), following
    return match[1].decode().upper(), text[match.end() : following].strip(), following


def shown(value: bytes) -> str:
    """The beginning of a value, for a message."""
    text = value.decode("utf-8", "replace")
    return repr(text if len(text) <= SHOWN_CHARACTERS else text[:SHOWN_CHARACTERS] + "..")


def place_error(path: Path, data: bytes, offset: int, message: str, binary: bool = False) -> InputError:
    """Make an error that names the line, or in binary data the byte."""
    line = data.count(b"\n", 0, offset) + 1
    place = f"byte {offset}" if binary else f"line {line}"
    return InputError(f"{path}, {place}: {message}")


log = logging.getLogger(__name__)

# Directions of a polyline: clockwise (hole), counter-clockwise (outer), open
INTERNAL, EXTERNAL, OPEN_LINE = 0, 1, 2


class Gathered:
    """Layers and polylines as they come out of a file."""

    def __init__(self, path: Path, data: bytes, header: Header) -> None:
        self.path = path
        self.data = data
        self.header = header
        self.commands = 0
        self.heights: list[float] = []
        self.hatches: list[int] = []
        self._layer_starts: list[int] = []
        self._points: list[Floats] = []
        self._directions: list[int] = []

    def layer(self, height: float, offset: int) -> None:
        """Begin a layer, or continue the previous one if the height is the same."""
        height *= self.header.units_mm
        self.commands += 1
        if not math.isfinite(height):
            raise self.error(offset, f"layer height {height} is not a finite number")
        if self.heights and height == self.heights[-1]:
            return
        if self.heights and height < self.heights[-1]:
            raise self.error(
                offset, f"layer at {height} mm lies below the one before, at {self.heights[-1]} mm"
            )
        self.heights.append(height)
        self.hatches.append(0)
        self._layer_starts.append(len(self._points))

    def polyline(self, direction: int, coordinates: NDArray[np.floating[Any]], offset: int) -> None:
        """Add a polyline to the layer; coordinates are x, y, x, y .. in units of the file."""
        self._check("polyline", coordinates, offset)
        if direction not in (INTERNAL, EXTERNAL, OPEN_LINE):
            raise self.error(
                offset, f"polyline of direction {direction}: it is 0 (internal), 1 (external) or 2 (open)"
            )
        self._points.append(coordinates.astype(np.float64).reshape(-1, 2) * self.header.units_mm)
        self._directions.append(direction)

    def hatch_lines(self, coordinates: NDArray[np.floating[Any]], offset: int) -> None:
        """Count hatch lines; coordinates are x, y of the start, x, y of the end .."""
        self._check("hatches", coordinates, offset)
        self.hatches[-1] += coordinates.size // 4

    @property
    def polylines(self) -> int:
        """Number of polylines so far."""
        return len(self._points)

    def layers(self) -> Layers:
        """Everything gathered, in canonical form."""
        directions = np.asarray(self._directions, dtype=np.int64)
        closed = directions != OPEN_LINE
        ring_starts = np.cumsum([0] + [len(p) for p in self._points]).astype(np.int64)
        points = np.concatenate(self._points) if self._points else np.zeros((0, 2))
        declared = np.where(directions == EXTERNAL, 1.0, -1.0)
        turned = np.flatnonzero(signed_areas(points, ring_starts, closed) * declared < 0.0)
        for r in turned:
            points[ring_starts[r] : ring_starts[r + 1]] = self._points[r][::-1]
        if turned.size:
            log.warning(
                "%s: %d of %d polylines run against their declared direction and were turned (first: %d)",
                self.path, turned.size, len(directions), turned[0],
            )  # fmt: skip
        layer_starts = np.asarray([*self._layer_starts, len(self._points)], dtype=np.int64)
        return canonical(
            np.asarray(self.heights), points, ring_starts, layer_starts, closed, **self.header.labels
        )

    def error(self, offset: int, message: str) -> InputError:
        """Make an error that names the line, or in binary data the byte."""
        return place_error(self.path, self.data, offset, message, binary=self.header.binary)

    def _check(self, what: str, coordinates: NDArray[np.floating[Any]], offset: int) -> None:
        if not self.heights:
            raise self.error(offset, f"{what} before the first layer")
        if not np.isfinite(coordinates).all():
            k = int(np.flatnonzero(~np.isfinite(coordinates))[0])
            raise self.error(offset, f"coordinate {k} of {what} is {coordinates[k]}: it must be finite")


LAYER_LONG, POLYLINE_LONG = 127, 130
COMMANDS = {
    LAYER_LONG: ("<f", "", 0),
    128: ("<H", "", 0),
    129: ("<3H", "<u2", 2),
    POLYLINE_LONG: ("<3i", "<f4", 2),
    131: ("<2H", "<u2", 4),
    132: ("<2i", "<f4", 4),
}
"""Commands of the binary form, layers, polylines and hatches, short and long: form of the head, whose last number is a count but
for layers, type of the coordinates, and how many make one."""


def _read_binary(gathered: Gathered) -> None:
    """Read everything after the header."""
    data, begin = gathered.data, gathered.header.end
    # Some writers end the header's last line; no command index looks like the end of a line.
    while data[begin : begin + 1] in (b"\r", b"\n"):
        begin += 1
    alignment = 4 if gathered.header.aligned else 2
    offset = begin
    while offset < len(data):
        (command,) = _unpack(gathered, "<H", offset)
        if command not in COMMANDS:
            raise gathered.error(offset, f"unknown command {command}")
        form, kind, each = COMMANDS[command]
        head, after = _unpack(gathered, form, offset + alignment), offset + alignment + struct.calcsize(form)
        if not each:
            gathered.layer(float(head[0]), offset)
        else:
            count, size = each * head[-1], np.dtype(kind).itemsize
            if count < 0 or after + size * count > len(data):
                raise gathered.error(
                    after, f"{count} coordinates belong here, {len(data) - after} bytes are left: cut off"
                )
            coordinates = np.frombuffer(data, kind, count, after)
            after += coordinates.nbytes
            if each == 2:
                gathered.polyline(head[1], coordinates, offset)
            else:
                gathered.hatch_lines(coordinates, offset)
        offset = after + (begin - after) % alignment
    if not gathered.heights and len(data) == begin and gathered.header.layers is None:
        raise gathered.error(offset, "no geometry follows the header: the file is cut off")


def _unpack(gathered: Gathered, form: str, offset: int) -> tuple[Any, ...]:
    try:
        return struct.unpack_from(form, gathered.data, offset)
    except struct.error:
        raise gathered.error(offset, "the file ends in the middle of a command: it is cut off") from None


@dataclass(frozen=True)
class SliceFile:
    """Content of a slice file."""

    layers: Layers
    hatches: Ints  # (L,) number of hatch lines of each layer; they are only counted
    models: Mapping[int, str]  # names of the models by their identifiers; polylines of all models are joined
    units_mm: float
    version: int
    binary: bool


def read_cli(path: str | Path) -> Layers:
    """Read the contours of a slice file, text or binary; see :func:`read_slice_file`."""
    return read_slice_file(path).layers


def read_slice_file(path: str | Path) -> SliceFile:
    """Read a slice file, text or binary, whichever its header names; a message names the line, or the byte.

    A polyline whose points contradict its declared direction is reversed, with a warning in
    the log: the direction shows which side is solid. A layer at the height of the previous one continues it.
    """
    path = Path(path)
    try:
        data = regular_file(path).read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    header = read_header(data, path)
    gathered = Gathered(path, data, header)
    if header.binary:
        _read_binary(gathered)
    else:
        _read_text(gathered)
    if header.layers is not None and gathered.commands < header.layers:
        raise InputError(
            f"{path}: holds {gathered.commands} layers, its header says {header.layers}: it is cut off"
        )
    if header.polylines is not None and gathered.polylines != header.polylines:
        raise InputError(
            f"{path}: holds {gathered.polylines} polylines, its header says {header.polylines}: it is cut off"
        )
    hatches = np.asarray(gathered.hatches, dtype=np.int64)
    return SliceFile(
        gathered.layers(), hatches, header.models, header.units_mm, header.version, header.binary
    )


def _read_text(gathered: Gathered) -> None:
    text = without_comments(gathered.data)
    position = text.find(b"$$", gathered.header.end)
    ended = False
    while 0 <= position < len(text) and not ended:
        name, value, following = command(text, position)
        if name == "LAYER":
            gathered.layer(float(_numbers(gathered, value, position, 1)[0]), position)
        elif name == "POLYLINE":
            numbers = _numbers(gathered, value, position, 3)
            _check_count(gathered, numbers, 2, 2, position)
            gathered.polyline(_whole(numbers[1]), numbers[3:], position)
        elif name == "HATCHES":
            numbers = _numbers(gathered, value, position, 2)
            _check_count(gathered, numbers, 1, 4, position)
            gathered.hatch_lines(numbers[2:], position)
        elif name == "GEOMETRYEND":
            ended = True
        elif name != "GEOMETRYSTART":
            raise gathered.error(position, f"unknown command {shown(text[position : position + 20])}")
        position = following
    if not ended:
        raise gathered.error(len(text), "the file ends without $$GEOMETRYEND: it is cut off")


def _numbers(gathered: Gathered, value: bytes, position: int, least: int) -> Floats:
    """Numbers separated by commas, at least `least` of them."""
    fields = value.split(b",")
    try:
        if b"_" in value:  # Python would read 1_0 as ten
            raise ValueError
        numbers = np.array(list(map(float, fields)))
    except ValueError:
        wrong = next(f for f in fields if not is_number(f))
        raise gathered.error(position, f"{shown(wrong.strip())} is not a number") from None
    if numbers.size < least:
        raise gathered.error(position, f"{numbers.size} numbers where at least {least} belong")
    return numbers


def _whole(number: float) -> int:
    """The number as an integer; -1 if it is not whole."""
    return int(number) if math.isfinite(number) and number == int(number) else -1


def _check_count(gathered: Gathered, numbers: Floats, at: int, each: int, position: int) -> None:
    """Refuse a command whose count, `numbers[at]`, does not match the coordinates after it."""
    said, found = float(numbers[at]), (numbers.size - at - 1) / each
    if said != found:
        raise gathered.error(position, f"the count is {said:g}, but coordinates of {found:g} follow")


def write_cli(layers: Layers, path: str | Path, *, binary: bool = False, units_mm: float = 1.0) -> None:
    """Write layers with strictly increasing heights as a slice file; it appears whole or not at all.

    The binary form has 8 bytes a point and is quick to read, but rounded to 32-bit floats. `units_mm` is the length of one unit
    of the file's numbers: with 1 the text form is exact, with another the division and the multiplication each round once.
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
            continue
        yield EXTERNAL if layers.ring_areas[r] >= 0.0 else INTERNAL, np.concatenate([points, points[:1]])


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

"""Reading slice files of the Common Layer Interface, strictly: text and binary."""

from __future__ import annotations

import json
import logging
import math
import re
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ebamcheck.errors import InputError
from ebamcheck.layers.stack import Layers, canonical
from ebamcheck.numeric.rings import Floats, Ints, signed_areas

log = logging.getLogger(__name__)

INTERNAL, EXTERNAL, OPEN_LINE = 0, 1, 2
"""Directions of a polyline: clockwise (hole), counter-clockwise (outer), open."""

LAYER_LONG, LAYER_SHORT = 127, 128
POLYLINE_SHORT, POLYLINE_LONG = 129, 130
HATCHES_SHORT, HATCHES_LONG = 131, 132
"""Command indices of the binary form; short ones hold unsigned 16-bit numbers."""

VERSIONS = (100, 101, 200)
USER_DATA = "ebamcheck.layers"
HEADER_WITHIN_BYTES = 65536
"""A file whose header does not begin within this many bytes is another kind of file."""
SHOWN_CHARACTERS = 40
"""What a message quotes of a wrong value."""


@dataclass(frozen=True)
class SliceFile:
    """What a slice file holds."""

    layers: Layers
    hatches: Ints
    """(L,) hatch lines of each layer; they are counted and passed over."""
    models: Mapping[int, str]
    """Names of the models by their identifiers; polylines of all models are joined."""
    units_mm: float
    version: int
    binary: bool


def read_cli(path: str | Path) -> Layers:
    """Read the contours of a slice file, text or binary; see :func:`read_slice_file`."""
    return read_slice_file(path).layers


def read_slice_file(path: str | Path) -> SliceFile:
    """Read a slice file, text or binary, whichever its header names.

    A polyline whose points run the other way than its declared direction is turned, with a warning in
    the log: the direction says which side is solid. A layer at the height of the one before continues it.

    Raises
    ------
    InputError
        If the file is missing, is no slice file, is cut off, has a wrong count, an unknown command, a
        number that is none or not finite, or a layer below the one before; the message names the line
        (text) or the byte (binary).
    """
    path = Path(path)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    header = _read_header(data, path)
    gathered = _Gathered(path, data, header)
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
    return SliceFile(
        layers=gathered.layers(),
        hatches=np.asarray(gathered.hatches, dtype=np.int64),
        models=header.models,
        units_mm=header.units_mm,
        version=header.version,
        binary=header.binary,
    )


@dataclass
class _Header:
    """What the header says, and where it ends."""

    start: int
    end: int
    binary: bool = False
    aligned: bool = False
    units_mm: float = math.nan
    version: int = 200
    layers: int | None = None
    models: dict[int, str] = field(default_factory=dict)
    labels: dict[str, Any] = field(default_factory=dict)
    polylines: int | None = None
    """How many there are, where this program wrote the file: the format itself does not say."""


class _Gathered:
    """Layers and polylines as they come out of a file."""

    def __init__(self, path: Path, data: bytes, header: _Header) -> None:
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
        """Begin a layer, or go on with the one before where the height is the same."""
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
        """Polylines so far."""
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
        return _error(self.path, self.data, offset, message, binary=self.header.binary)

    def _check(self, what: str, coordinates: NDArray[np.floating[Any]], offset: int) -> None:
        if not self.heights:
            raise self.error(offset, f"{what} before the first layer")
        if not np.isfinite(coordinates).all():
            k = int(np.flatnonzero(~np.isfinite(coordinates))[0])
            raise self.error(offset, f"coordinate {k} of {what} is {coordinates[k]}: it must be finite")


def _error(path: Path, data: bytes, offset: int, message: str, binary: bool = False) -> InputError:
    line = data.count(b"\n", 0, offset) + 1
    place = f"byte {offset}" if binary else f"line {line}"
    return InputError(f"{path}, {place}: {message}")


# -- the header ------------------------------------------------------------------------------------


def _read_header(data: bytes, path: Path) -> _Header:
    start = data.find(b"$$HEADERSTART", 0, HEADER_WITHIN_BYTES)
    if start < 0:
        raise InputError(f"{path}: is no Common Layer Interface file: it has no $$HEADERSTART")
    end = data.find(b"$$HEADEREND", start)
    if end < 0:
        raise _error(path, data, len(data), "the header has no $$HEADEREND: the file is cut off")
    header = _Header(start, end + len(b"$$HEADEREND"))
    text = _without_comments(data[:end])
    form = ""
    position = start
    while 0 <= position < end:
        name, value, following = _command(text, position)
        try:
            if name in ("ASCII", "BINARY"):
                form = name
            elif name == "USERDATA":
                following = _read_user_data(data, position, end, header)
            else:
                _read_header_value(name, value, header)
        except ValueError:
            raise _error(path, data, position, f"unknown or wrong: $${name} {_shown(value)}") from None
        position = following
    if not form:
        raise _error(path, data, end, "the header names neither $$ASCII nor $$BINARY")
    if math.isnan(header.units_mm):
        raise _error(path, data, end, "the header has no $$UNITS: the length of a unit is unknown")
    header.binary = form == "BINARY"
    return header


def _read_header_value(name: str, value: bytes, header: _Header) -> None:
    """Take one command of the header; raises ValueError where its value makes no sense."""
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


def _read_user_data(data: bytes, position: int, end: int, header: _Header) -> int:
    """Pass over user data, whose length stands before them; take the labels where they are ours."""
    match = _USER_DATA.match(data, position)
    if match is None or match.end() + int(match[2]) > end:
        raise ValueError
    after = match.end() + int(match[2])
    if match[1] == USER_DATA.encode():
        values = dict(json.loads(data[match.end() : after]))
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


# -- the text form ---------------------------------------------------------------------------------

_COMMENT = re.compile(rb"//.*?//", re.DOTALL)
_COMMAND = re.compile(rb"\$\$([A-Za-z]+)\s*/?")
_USER_DATA = re.compile(rb"\$\$USERDATA\s*/\s*([^,$]*?)\s*,\s*(\d+)\s*,")


def _without_comments(text: bytes) -> bytes:
    """Comments blanked out, so that every other byte keeps its place and every line its number."""
    if b"//" not in text:
        return text
    return _COMMENT.sub(lambda match: re.sub(rb"[^\n]", b" ", match[0]), text)


def _command(text: bytes, position: int) -> tuple[str, bytes, int]:
    """Name and argument of the command at `position`, and where the next one stands."""
    following = text.find(b"$$", position + 2)
    following = following if following >= 0 else len(text)
    match = _COMMAND.match(text, position, following)
    if match is None:
        return "", text[position:following].strip(), following
    return match[1].decode().upper(), text[match.end() : following].strip(), following


def _shown(value: bytes) -> str:
    """The beginning of a value, for a message."""
    text = value.decode("utf-8", "replace")
    return repr(text if len(text) <= SHOWN_CHARACTERS else text[:SHOWN_CHARACTERS] + "..")


def _read_text(gathered: _Gathered) -> None:
    text = _without_comments(gathered.data)
    position = text.find(b"$$", gathered.header.end)
    ended = False
    while 0 <= position < len(text) and not ended:
        name, value, following = _command(text, position)
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
            raise gathered.error(position, f"unknown command {_shown(text[position : position + 20])}")
        position = following
    if not ended:
        raise gathered.error(len(text), "the file ends without $$GEOMETRYEND: it is cut off")


def _numbers(gathered: _Gathered, value: bytes, position: int, least: int) -> Floats:
    """Numbers between commas, at least so many."""
    fields = value.split(b",")
    try:
        if b"_" in value:  # Python would read 1_0 as ten
            raise ValueError
        numbers = np.array(list(map(float, fields)))
    except ValueError:
        wrong = next(f for f in fields if not _is_number(f))
        raise gathered.error(position, f"{_shown(wrong.strip())} is not a number") from None
    if numbers.size < least:
        raise gathered.error(position, f"{numbers.size} numbers where at least {least} belong")
    return numbers


def _is_number(text: bytes) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return b"_" not in text


def _whole(number: float) -> int:
    """The number as an integer, -1 where it is none."""
    return int(number) if math.isfinite(number) and number == int(number) else -1


def _check_count(gathered: _Gathered, numbers: Floats, at: int, each: int, position: int) -> None:
    """Refuse a command whose count, `numbers[at]`, is not that of the coordinates after it."""
    said, found = float(numbers[at]), (numbers.size - at - 1) / each
    if said != found:
        raise gathered.error(position, f"the count is {said:g}, but coordinates of {found:g} follow")


# -- the binary form -------------------------------------------------------------------------------


def _read_binary(gathered: _Gathered) -> None:
    data, begin = gathered.data, gathered.header.end
    # Some writers end the header's last line; no command index looks like the end of a line.
    while data[begin : begin + 1] in (b"\r", b"\n"):
        begin += 1
    alignment = 4 if gathered.header.aligned else 2
    offset = begin
    while offset < len(data):
        (command,) = _unpack(gathered, "<H", offset)
        reader = _BINARY_COMMANDS.get(command)
        if reader is None:
            raise gathered.error(offset, f"unknown command {command}")
        after = reader(gathered, offset, offset + alignment)
        offset = after + (begin - after) % alignment
    if not gathered.heights and len(data) == begin and gathered.header.layers is None:
        raise gathered.error(offset, "no geometry follows the header: the file is cut off")


def _unpack(gathered: _Gathered, form: str, offset: int) -> tuple[Any, ...]:
    try:
        return struct.unpack_from(form, gathered.data, offset)
    except struct.error:
        raise gathered.error(offset, "the file ends in the middle of a command: it is cut off") from None


def _coordinates(gathered: _Gathered, kind: str, count: int, offset: int) -> NDArray[Any]:
    size = np.dtype(kind).itemsize * count
    if count < 0 or offset + size > len(gathered.data):
        raise gathered.error(
            offset, f"{count} coordinates belong here, {len(gathered.data) - offset} bytes are left: cut off"
        )
    return np.frombuffer(gathered.data, kind, count, offset)


def _layer(form: str) -> Callable[[_Gathered, int, int], int]:
    def read(gathered: _Gathered, start: int, offset: int) -> int:
        (height,) = _unpack(gathered, form, offset)
        gathered.layer(float(height), start)
        return offset + struct.calcsize(form)

    return read


def _polyline(form: str, kind: str) -> Callable[[_Gathered, int, int], int]:
    def read(gathered: _Gathered, start: int, offset: int) -> int:
        _, direction, count = _unpack(gathered, form, offset)
        offset += struct.calcsize(form)
        coordinates = _coordinates(gathered, kind, 2 * count, offset)
        gathered.polyline(direction, coordinates, start)
        return offset + coordinates.nbytes

    return read


def _hatches(form: str, kind: str) -> Callable[[_Gathered, int, int], int]:
    def read(gathered: _Gathered, start: int, offset: int) -> int:
        _, count = _unpack(gathered, form, offset)
        offset += struct.calcsize(form)
        coordinates = _coordinates(gathered, kind, 4 * count, offset)
        gathered.hatch_lines(coordinates, start)
        return offset + coordinates.nbytes

    return read


_BINARY_COMMANDS = {
    LAYER_LONG: _layer("<f"),
    LAYER_SHORT: _layer("<H"),
    POLYLINE_SHORT: _polyline("<3H", "<u2"),
    POLYLINE_LONG: _polyline("<3i", "<f4"),
    HATCHES_SHORT: _hatches("<2H", "<u2"),
    HATCHES_LONG: _hatches("<2i", "<f4"),
}
"""What reads each command of the binary form: (gathered, its start, where its data begin) -> its end."""

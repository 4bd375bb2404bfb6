"""The Common Layer Interface: slice files (``.cli``) of machines and other programs, version 2.0 (Brite-EuRam BE 2578). Text is
exact; the binary form rounds coordinates and heights to 32-bit floats (6e-8 of them at most). The height of a layer is that of its
cut; the format means the top of a layer, and other programs differ in which of the two they write."""

from __future__ import annotations

import json
import logging
import math
import re
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ebamcheck.atomic_file import regular_file, replacing
from ebamcheck.columns_file import starts_of
from ebamcheck.errors import InputError, SettingsError
from ebamcheck.geometry.rings import signed_areas
from ebamcheck.json_values import parsed_json
from ebamcheck.kernels import Floats
from ebamcheck.layers.stack import Layers, canonical
from ebamcheck.mesh.reading import is_number

USER_DATA = "ebamcheck.layers"
HEADER_WITHIN_BYTES = 65536  # a file whose header begins later is another kind of file

INTERNAL, EXTERNAL, OPEN_LINE = 0, 1, 2  # directions of a polyline: clockwise (hole), counter-clockwise, open
# Least numbers of a command, the last of which counts what follows, and how many coordinates make one of that
NUMBERS = {"LAYER": (1, 0), "POLYLINE": (3, 2), "HATCHES": (2, 4)}

# Commands of the binary form, short and long: form of the head, whose last number is a count but for layers, and type of coordinates
LAYER_LONG, POLYLINE_LONG = 127, 130
COMMANDS = {
    LAYER_LONG: ("LAYER", "<f", "<f4"),
    128: ("LAYER", "<H", "<u2"),
    129: ("POLYLINE", "<3H", "<u2"),
    POLYLINE_LONG: ("POLYLINE", "<3i", "<f4"),
    131: ("HATCHES", "<2H", "<u2"),
    132: ("HATCHES", "<2i", "<f4"),
}

_COMMENT = re.compile(rb"//.*?//", re.DOTALL)
_COMMAND = re.compile(rb"\$\$([A-Za-z]+)\s*/?")
_USER_DATA = re.compile(rb"\$\$USERDATA\s*/\s*([^,$]*?)\s*,\s*(\d+)\s*,")
_log = logging.getLogger(__name__)


def read_cli(path: str | Path) -> Layers:
    """Read the contours of a slice file, text or binary; errors name the line, or the byte.

    A polyline whose points contradict its declared direction is reversed, with a warning in the log: the direction shows which side
    is solid. A layer at the height of the previous one continues it. Polylines of all models are joined, hatch lines left out."""
    path = Path(path)
    try:
        data = regular_file(path).read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    return _Reading(path, data).layers()


class _Reading:
    """What the header and the commands of a file have told so far."""

    def __init__(self, path: Path, data: bytes) -> None:
        self.path, self.data = path, data
        self.form = b""
        self.aligned = False
        self.units_mm = math.nan
        self.counts: dict[str, int] = {}  # layers and polylines by the header
        self.labels: dict[str, Any] = {}
        self.commands = 0  # layers by their commands, two of which may have one height
        self.heights: list[float] = []
        self.layer_starts: list[int] = []
        self.points: list[Floats] = []
        self.directions: list[int] = []

    def layers(self) -> Layers:
        """Read the whole file."""
        start = self.data.find(b"$$HEADERSTART", 0, HEADER_WITHIN_BYTES)
        if start < 0:
            raise InputError(f"{self.path}: is no Common Layer Interface file: it has no $$HEADERSTART")
        end = self.data.find(b"$$HEADEREND", start)
        if end < 0:
            raise self._error(len(self.data), "the header has no $$HEADEREND: the file is cut off")
        self._read_header(start, end)
        read = self._read_binary if self.form == b"BINARY" else self._read_geometry
        read(end + len(b"$$HEADEREND"))
        for what, found in (("layers", self.commands), ("polylines", len(self.points))):
            said = self.counts.get(what, found)
            if found < said or (what == "polylines" and found != said):
                raise InputError(f"{self.path}: holds {found} {what}, its header says {said}: it is cut off")
        return self._stack()

    def _read_header(self, start: int, end: int) -> None:
        header = self._without_user_data(start, end)
        for at, name, value in _commands(_without_comments(header), start):
            try:
                self._take(name, value)
            except ValueError:
                raise self._error(at, f"unknown or wrong: $${name} {_shown(value)}") from None
        if not self.form:
            raise self._error(end, "the header names neither $$ASCII nor $$BINARY")
        if math.isnan(self.units_mm):
            raise self._error(end, "the header has no $$UNITS: the length of a unit is unknown")

    def _without_user_data(self, start: int, end: int) -> bytes:
        """Header with blanks in place of user data, whose length is given before them; the labels among them are kept."""
        header = self.data[:end]
        position = start
        while match := _USER_DATA.search(header, position):
            try:
                position = match.end() + int(match[2])
                if position > end:
                    break
                if match[1] == USER_DATA.encode():
                    values = dict(parsed_json(self.data[match.end() : position]))
                    self.counts["polylines"] = int(values.pop("polylines"))
                    direction = tuple(map(float, values["direction"]))
                    self.labels = {"part": str(values["part"]), "backend": str(values["backend"])}
                    self.labels |= {"direction": direction, "settings": dict(values["settings"])}
            except (KeyError, TypeError, ValueError):
                break  # the command stays, and is refused as wrong
            header = header[: match.start()] + _blank(header[match.start() : position]) + header[position:]
        return header

    def _take(self, name: str, value: bytes) -> None:
        """Take one command of the header; raises ValueError for a wrong one."""
        wrong = False
        if name in ("ASCII", "BINARY"):
            self.form = name.encode()
        elif name == "UNITS":
            self.units_mm = float(value)
            wrong = not (math.isfinite(self.units_mm) and self.units_mm > 0.0)
        elif name == "VERSION":
            wrong = int(value) not in (100, 101, 200)
        elif name == "LAYERS":
            self.counts["layers"] = int(value)
            wrong = self.counts["layers"] < 0
        elif name == "ALIGN":
            self.aligned = True
        else:
            wrong = name not in ("HEADERSTART", "DATE", "DIMENSION", "LABEL")
        if wrong:
            raise ValueError

    def _read_geometry(self, start: int) -> None:
        text = b" " * start + _without_comments(self.data[start:])
        for at, name, value in _commands(text, text.find(b"$$")):
            if name in NUMBERS:
                self._add(name, self._numbers(name, value, at), at)
            elif name == "GEOMETRYEND":
                return
            elif name != "GEOMETRYSTART":
                raise self._error(at, f"unknown command {_shown(text[at : at + 20])}")
        raise self._error(len(text), "the file ends without $$GEOMETRYEND: it is cut off")

    def _read_binary(self, begin: int) -> None:
        # Some writers end the header's last line; no command index looks like the end of a line.
        while self.data[begin : begin + 1] in (b"\r", b"\n"):
            begin += 1
        at, step = begin, 4 if self.aligned else 2
        while at < len(self.data):
            (command,) = self._unpacked("<H", at)
            if command not in COMMANDS:
                raise self._error(at, f"unknown command {command}")
            name, form, kind = COMMANDS[command]
            head, after = self._unpacked(form, at + step), at + step + struct.calcsize(form)
            count = NUMBERS[name][1] * int(head[-1]) if NUMBERS[name][1] else 0
            if count < 0 or after + np.dtype(kind).itemsize * count > len(self.data):
                left = len(self.data) - after
                raise self._error(after, f"{count} coordinates belong here, {left} bytes are left: cut off")
            coordinates = np.frombuffer(self.data, kind, count, after)
            self._add(name, np.concatenate([head, coordinates]).astype(np.float64), at)
            after += coordinates.nbytes
            at = after + (begin - after) % step
        if at == begin and "layers" not in self.counts:
            raise self._error(at, "no geometry follows the header: the file is cut off")

    def _unpacked(self, form: str, at: int) -> tuple[Any, ...]:
        try:
            return struct.unpack_from(form, self.data, at)
        except struct.error:
            raise self._error(at, "the file ends in the middle of a command: it is cut off") from None

    def _numbers(self, name: str, value: bytes, at: int) -> Floats:
        """Numbers of a command, of which there are as many as it says."""
        fields = value.split(b",")
        if wrong := [field for field in fields if not is_number(field)]:
            raise self._error(at, f"{_shown(wrong[0].strip())} is not a number")
        numbers, (least, each) = np.array(list(map(float, fields))), NUMBERS[name]
        if numbers.size < least:
            raise self._error(at, f"{numbers.size} numbers where at least {least} belong")
        if each and (said := float(numbers[least - 1])) != (found := (numbers.size - least) / each):
            raise self._error(at, f"the count is {said:g}, but coordinates of {found:g} follow")
        return numbers

    def _add(self, name: str, numbers: Floats, at: int) -> None:
        """Add a layer, or a polyline to the last one."""
        if name == "LAYER":
            self._begin_layer(float(numbers[0]) * self.units_mm, at)
            return
        coordinates = numbers[NUMBERS[name][0] :]
        if not self.heights:
            raise self._error(at, f"{name.lower()} before the first layer")
        if (wrong := np.flatnonzero(~np.isfinite(coordinates))).size:
            told = f"coordinate {wrong[0]} of {name.lower()} is {coordinates[wrong[0]]}: it must be finite"
            raise self._error(at, told)
        if name == "POLYLINE":
            if numbers[1] not in (INTERNAL, EXTERNAL, OPEN_LINE):
                told = f"polyline of direction {numbers[1]:g}: it is 0 (internal), 1 (external) or 2 (open)"
                raise self._error(at, told)
            self.points.append(coordinates.reshape(-1, 2) * self.units_mm)
            self.directions.append(int(numbers[1]))

    def _begin_layer(self, height: float, at: int) -> None:
        self.commands += 1
        if not math.isfinite(height):
            raise self._error(at, f"layer height {height} is not a finite number")
        before = self.heights[-1] if self.heights else -math.inf
        if height < before:
            raise self._error(at, f"layer at {height} mm lies below the one before, at {before} mm")
        if height > before:
            self.heights.append(height)
            self.layer_starts.append(len(self.points))

    def _stack(self) -> Layers:
        """Everything gathered, in canonical form."""
        directions = np.asarray(self.directions, np.int64)
        closed, starts = directions != OPEN_LINE, starts_of(np.array([len(p) for p in self.points], np.int64))
        points = np.concatenate([np.zeros((0, 2)), *self.points])
        declared = np.where(directions == EXTERNAL, 1.0, -1.0)
        turned = np.flatnonzero(signed_areas(points, starts, closed) * declared < 0.0)
        for r in turned:
            points[starts[r] : starts[r + 1]] = self.points[r][::-1]
        if turned.size:
            said = "%s: %d of %d polylines run against their declared direction and were turned (first: %d)"
            _log.warning(said, self.path, turned.size, len(directions), turned[0])
        layer_starts = np.array([*self.layer_starts, len(self.points)], np.int64)
        return canonical(self.heights, points, starts, layer_starts, closed, **self.labels)

    def _error(self, offset: int, message: str) -> InputError:
        line = self.data.count(b"\n", 0, offset) + 1
        place = f"byte {offset}" if self.form == b"BINARY" else f"line {line}"
        return InputError(f"{self.path}, {place}: {message}")


def _blank(text: bytes) -> bytes:
    """As many blanks, so that every other byte keeps its offset and every line its number."""
    return re.sub(rb"[^\n]", b" ", text)


def _without_comments(text: bytes) -> bytes:
    return _COMMENT.sub(lambda match: _blank(match[0]), text) if b"//" in text else text


def _commands(text: bytes, position: int) -> Iterator[tuple[int, str, bytes]]:
    """Place, name and argument of each command of a text, from the one at `position` on."""
    while 0 <= position < len(text):
        following = text.find(b"$$", position + 2)
        following = following if following >= 0 else len(text)
        match = _COMMAND.match(text, position, following)
        value = text[match.end() if match else position : following].strip()
        yield position, match[1].decode().upper() if match else "", value
        position = following


def _shown(value: bytes) -> str:
    """The beginning of a value, for a message."""
    text = value.decode("utf-8", "replace")
    return repr(text if len(text) <= 40 else text[:40] + "..")


def write_cli(layers: Layers, path: str | Path, *, binary: bool = False) -> None:
    """Write layers with strictly increasing heights as a slice file; it appears whole or not at all."""
    heights = layers.heights.astype(np.float32).astype(np.float64) if binary else layers.heights
    wrong = ~np.isfinite(heights)
    wrong[1:] |= heights[1:] <= heights[:-1]
    if wrong.any():
        k = int(np.flatnonzero(wrong)[0])
        raise SettingsError(
            f"{path}: layer {k + 1} at {layers.heights[k]} mm is not above the one before it: a slice file needs increasing heights"
            + (" (as 32-bit floats)" if binary else "")
        )
    lines = ["$$HEADERSTART", "$$BINARY" if binary else "$$ASCII", "$$UNITS/1.0", "$$VERSION/200"]
    lines += ["$$LABEL/1,part", f"$$LAYERS/{len(layers)}"]
    if len(layers.points):
        x0, y0, x1, y1 = layers.bounds()
        box = (x0, y0, float(layers.heights[0]), x1, y1, float(layers.heights[-1]))
        lines.append("$$DIMENSION/" + ",".join(map(repr, box)))
    labels = json.dumps({**json.loads(layers.labels_json()), "polylines": layers.closed.size})
    # Binary data follow directly after the last character of the header.
    lines.append(f"$$USERDATA/{USER_DATA},{len(labels)},{labels}")
    lines.append("$$HEADEREND" + ("" if binary else "\n$$GEOMETRYSTART\n"))
    with replacing(path) as temporary, temporary.open("wb") as file:
        file.write("\n".join(lines).encode("ascii"))
        for k, height in enumerate(heights.tolist()):
            file.write(struct.pack("<Hf", LAYER_LONG, height) if binary else f"$$LAYER/{height!r}\n".encode())
            for r in layers.rings_of(k):
                file.write(_polyline(layers, r, binary))
        file.write(b"" if binary else b"$$GEOMETRYEND\n")


def _polyline(layers: Layers, ring: int, binary: bool) -> bytes:
    """Command of a ring; a closed one repeats its first point."""
    points, direction = layers.ring(ring), OPEN_LINE
    if layers.closed[ring]:
        points = np.concatenate([points, points[:1]])
        direction = EXTERNAL if layers.ring_areas[ring] >= 0.0 else INTERNAL
    if binary:
        head = struct.pack("<Hiii", POLYLINE_LONG, 1, direction, len(points))
        return head + points.astype("<f4").tobytes()
    numbers = ",".join(map(repr, points.ravel().tolist()))
    return f"$$POLYLINE/1,{direction},{len(points)},{numbers}\n".encode()

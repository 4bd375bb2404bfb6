"""The header of a slice file of the Common Layer Interface, and how its commands are told apart."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ebamcheck.errors import InputError
from ebamcheck.json_values import parsed_json

VERSIONS = (100, 101, 200)
USER_DATA = "ebamcheck.layers"
HEADER_WITHIN_BYTES = 65536
"""A file whose header does not begin within this many bytes is another kind of file."""

SHOWN_CHARACTERS = 40
"""Characters of a wrong value that a message quotes."""

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
    polylines: int | None = None
    """Number of polylines, if this program wrote the file: the format itself does not give it."""


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

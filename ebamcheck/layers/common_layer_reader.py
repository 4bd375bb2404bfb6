"""Reading slice files of the Common Layer Interface, strictly: text and binary."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ebamcheck.errors import InputError
from ebamcheck.layers.common_layer_binary import read_binary
from ebamcheck.layers.common_layer_geometry import Gathered
from ebamcheck.layers.common_layer_header import command, read_header, shown, without_comments
from ebamcheck.layers.stack import Layers
from ebamcheck.numeric.rings import Floats, Ints
from ebamcheck.regular_file import regular_file


@dataclass(frozen=True)
class SliceFile:
    """Content of a slice file."""

    layers: Layers
    hatches: Ints
    """(L,) number of hatch lines of each layer; they are only counted."""
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

    A polyline whose points contradict its declared direction is reversed, with a warning in
    the log: the direction shows which side is solid. A layer at the height of the previous one continues it.

    Raises
    ------
    InputError
        If the file is missing, is no slice file, is truncated, has a wrong count, an unknown command, an
        invalid or infinite number, or a layer below the previous one; the message names the line
        (text) or the byte (binary).
    """
    path = Path(path)
    try:
        data = regular_file(path).read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    header = read_header(data, path)
    gathered = Gathered(path, data, header)
    if header.binary:
        read_binary(gathered)
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
        wrong = next(f for f in fields if not _is_number(f))
        raise gathered.error(position, f"{shown(wrong.strip())} is not a number") from None
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
    """The number as an integer; -1 if it is not whole."""
    return int(number) if math.isfinite(number) and number == int(number) else -1


def _check_count(gathered: Gathered, numbers: Floats, at: int, each: int, position: int) -> None:
    """Refuse a command whose count, `numbers[at]`, does not match the coordinates after it."""
    said, found = float(numbers[at]), (numbers.size - at - 1) / each
    if said != found:
        raise gathered.error(position, f"the count is {said:g}, but coordinates of {found:g} follow")

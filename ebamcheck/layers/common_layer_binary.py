"""The binary form of slice files of the Common Layer Interface."""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ebamcheck.layers.common_layer_geometry import Gathered

LAYER_LONG, LAYER_SHORT = 127, 128
POLYLINE_SHORT, POLYLINE_LONG = 129, 130
HATCHES_SHORT, HATCHES_LONG = 131, 132
"""Command indices; short ones hold unsigned 16-bit numbers."""


def read_binary(gathered: Gathered) -> None:
    """Read everything after the header; raises InputError if it is truncated or has an unknown command."""
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


def _unpack(gathered: Gathered, form: str, offset: int) -> tuple[Any, ...]:
    try:
        return struct.unpack_from(form, gathered.data, offset)
    except struct.error:
        raise gathered.error(offset, "the file ends in the middle of a command: it is cut off") from None


def _coordinates(gathered: Gathered, kind: str, count: int, offset: int) -> NDArray[Any]:
    size = np.dtype(kind).itemsize * count
    if count < 0 or offset + size > len(gathered.data):
        raise gathered.error(
            offset, f"{count} coordinates belong here, {len(gathered.data) - offset} bytes are left: cut off"
        )
    return np.frombuffer(gathered.data, kind, count, offset)


def _layer(form: str) -> Callable[[Gathered, int, int], int]:
    def read(gathered: Gathered, start: int, offset: int) -> int:
        (height,) = _unpack(gathered, form, offset)
        gathered.layer(float(height), start)
        return offset + struct.calcsize(form)

    return read


def _polyline(form: str, kind: str) -> Callable[[Gathered, int, int], int]:
    def read(gathered: Gathered, start: int, offset: int) -> int:
        _, direction, count = _unpack(gathered, form, offset)
        offset += struct.calcsize(form)
        coordinates = _coordinates(gathered, kind, 2 * count, offset)
        gathered.polyline(direction, coordinates, start)
        return offset + coordinates.nbytes

    return read


def _hatches(form: str, kind: str) -> Callable[[Gathered, int, int], int]:
    def read(gathered: Gathered, start: int, offset: int) -> int:
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
"""Reader of each command of the binary form: (gathered, offset of the command, offset of its data) -> offset after it."""

"""A binary STL file that is read block by block: its box and hash in one pass, then the facets of any slab.

Only two columns of heights are kept in memory. The file is read, not memory-mapped: mapped pages count as the process's
memory, and a file truncated meanwhile would kill the process.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from ebamcheck.errors import InputError
from ebamcheck.mesh.files import extent_notes, told_if_unreadable
from ebamcheck.mesh.part import FROM_DEFAULT, FROM_SETTINGS, Part
from ebamcheck.mesh.stl import FACET_BYTES, FOREIGN, HEADER_BYTES, facet_corners, looks_like_ascii
from ebamcheck.settings.units import UNITS_MM, unit_named

BLOCK = 1 << 18
"""Facets read at once: 13 MB."""

MOST_FACETS = 2**31 - 1
"""Most facets of a file: their numbers have 32 bits."""

HEAD_BYTES = 4096
"""Bytes examined of a file that is no binary STL, to tell what it is."""

Singles = NDArray[np.float32]
Index = NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class FacetFile:
    """A binary STL file, after a first pass over all of it.

    Parameters
    ----------
    path
        The file.
    low, high
        (F,) least and greatest z of each facet, in the file's unit.
    millimetres
        Length of that unit, mm.
    outline
        The part without its mesh: the corners of its box as vertices, its names, and the hash of the file.
    stamp
        Size and modification time of the file when it was read.
    """

    path: Path
    low: Singles
    high: Singles
    millimetres: float
    outline: Part
    stamp: tuple[int, int]

    def __len__(self) -> int:
        """Return the number of facets."""
        return len(self.low)

    def corners(self, numbers: Index) -> Singles:
        """Corner points (N, 3, 3) of facets by their ascending numbers, in the file's unit.

        Raises
        ------
        InputError
            If the file has changed.
        """
        result = np.empty((len(numbers), 3, 3), np.float32)
        with opened(self.path) as file:
            self.check_unchanged(file)
            at = 0
            while at < len(numbers):
                first = int(numbers[at])
                past = int(np.searchsorted(numbers, first + BLOCK))
                block = read_facets(file, self.path, first, int(numbers[past - 1]) + 1 - first)
                chosen = np.ascontiguousarray(block[numbers[at:past] - first])
                chosen.flags.writeable = False
                result[at:past] = facet_corners(chosen, self.path.name, first)
                at = past
        return result

    def check_unchanged(self, file: BinaryIO) -> None:
        """Raise :class:`InputError` if the file was modified since the first pass."""
        if _stamp(file) != self.stamp:
            raise InputError(f"{self.path}: was changed while it was read: start again")


def is_binary_stl(path: Path) -> bool:
    """Whether a file is a binary STL, by its name and its size."""
    try:
        if path.suffix.lower() not in (".stl", "") or not path.is_file():
            return False
        with path.open("rb") as file:
            return path.stat().st_size == _expected(_count(file.read(HEADER_BYTES)))
    except OSError:
        return False


def facet_count(path: Path) -> int:
    """Number of facets by the header of a binary STL file."""
    with opened(path) as file:
        return _count(file.read(HEADER_BYTES))


def read_once(path: str | Path, units: str = "", progress: Callable[[int], None] | None = None) -> FacetFile:
    """Read a binary STL file from end to end: its box, its hash, and the heights of its facets.

    Parameters
    ----------
    path
        The file.
    units
        Unit of its numbers; empty: mm.
    progress
        Called with the number of facets read since the last call.

    Raises
    ------
    InputError
        If it is missing, no binary STL file, truncated, or holds NaN, inf or no facet.
    """
    path = Path(path)
    if path.suffix.lower() not in (".stl", ""):
        raise InputError(
            f"{path.name}: only a binary STL file is read in slabs: write it as binary STL, or check it whole (--slabs 1)"
        )
    unit = unit_named(units or "mm")
    millimetres = UNITS_MM[unit]
    with opened(path) as file, ThreadPoolExecutor(1) as aside:
        stamp = _stamp(file)
        head = file.read(HEADER_BYTES)
        count, notes = _checked_count(head, stamp[0], file, path.name)
        digest = hashlib.sha256(head)
        low, high = np.empty(count, np.float32), np.empty(count, np.float32)
        least, greatest = np.full(3, np.inf), np.full(3, -np.inf)
        for first, block in _blocks(file, path, count):
            # Hashing takes as long as everything else, and is independent of it.
            hashing = aside.submit(digest.update, block.data)
            corners = facet_corners(block, path.name, first)
            past = first + len(block)
            # Corner by corner and column by column: many times faster than numpy along an axis of three.
            for c in range(3):
                columns = [corners[:, c, axis] for axis in range(3)]
                least = np.minimum(least, [column.min() for column in columns])
                greatest = np.maximum(greatest, [column.max() for column in columns])
            z = [corners[:, c, 2] for c in range(3)]
            np.minimum(np.minimum(z[0], z[1]), z[2], out=low[first:past])
            np.maximum(np.maximum(z[0], z[1]), z[2], out=high[first:past])
            hashing.result()
            if progress is not None:
                progress(len(block))
        digest.update(file.read())
    box = (np.stack([least, greatest]) + 0.0) * millimetres
    notes += extent_notes(float((box[1] - box[0]).max()), unit)
    outline = Part(
        box,
        np.array([[0, 1, 1]], np.int32),
        name=path.stem,
        source=str(path),
        source_sha256=digest.hexdigest(),
        units=unit,
        units_from=FROM_SETTINGS if units else FROM_DEFAULT,
        notes=tuple(notes),
    )
    return FacetFile(path, low, high, millimetres, outline, stamp)


def opened(path: Path) -> BinaryIO:
    """Open a mesh file; raises :class:`InputError` if it cannot be opened."""
    with told_if_unreadable(path):
        return path.open("rb")


def read_facets(file: BinaryIO, path: Path, first: int, count: int) -> NDArray[np.uint16]:
    """Consecutive facets as 16-bit words, (F, 25); raises :class:`InputError` if the file ends too early."""
    file.seek(HEADER_BYTES + FACET_BYTES * first)
    data = file.read(FACET_BYTES * count)
    if len(data) < FACET_BYTES * count:
        raise InputError(f"{path}: was cut while it was read: start again")
    return np.frombuffer(data, np.uint16).reshape(count, -1)


def _blocks(file: BinaryIO, path: Path, count: int) -> Iterator[tuple[int, NDArray[np.uint16]]]:
    for first in range(0, count, BLOCK):
        yield first, read_facets(file, path, first, min(BLOCK, count - first))


def _stamp(file: BinaryIO) -> tuple[int, int]:
    found = os.fstat(file.fileno())
    return found.st_size, found.st_mtime_ns


def _count(head: bytes) -> int:
    return int.from_bytes(head[80:HEADER_BYTES], "little") if len(head) == HEADER_BYTES else 0


def _expected(count: int) -> int:
    return HEADER_BYTES + FACET_BYTES * count


def _checked_count(head: bytes, size: int, file: BinaryIO, name: str) -> tuple[int, list[str]]:
    """Number of facets by the first bytes and the size of a file, and harmless irregularities; refuses other formats."""
    count = _count(head)
    expected = _expected(count)
    if size < HEADER_BYTES or size != expected:
        _refuse_others(head + file.read(HEAD_BYTES), name)
    if size < HEADER_BYTES:
        raise InputError(f"{name}: is no binary STL file: {size} bytes, under the 84 of its header")
    if size < expected:
        room = (size - HEADER_BYTES) // FACET_BYTES
        raise InputError(
            f"{name}: truncated or not an STL file: byte 80 counts {count} facets, which need {expected} bytes, "
            f"but there are {size} (room for {room} facets)"
        )
    if count == 0:
        raise InputError(f"{name}: holds no facet (binary STL with count 0)")
    if count > MOST_FACETS:
        raise InputError(
            f"{name}: {count} facets are over the {MOST_FACETS} that slabs can number: split the part"
        )
    if size - expected >= FACET_BYTES:
        raise InputError(
            f"{name}: byte 80 counts {count} facets, but {size - expected} bytes follow the last one: "
            "wrong count, or files joined end to end"
        )
    return count, [f"{size - expected} bytes after the last facet were ignored"] if size > expected else []


def _refuse_others(start: bytes, name: str) -> None:
    """Refuse a file that begins like another format; the message names that."""
    if looks_like_ascii(start):
        raise InputError(
            f"{name}: is an ASCII STL: only a binary one is read in slabs: write it as binary STL, or check it whole (--slabs 1)"
        )
    for first_bytes, what in FOREIGN:
        if start.lstrip().startswith(first_bytes):
            raise InputError(f"{name}: is {what}")

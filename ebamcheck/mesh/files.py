"""From a mesh file to a welded part: STL, OBJ and PLY by our own readers, 3MF through lib3mf."""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ebamcheck.atomic_file import regular_file
from ebamcheck.errors import InputError, SettingsError
from ebamcheck.mesh.obj_and_ply import read_obj, read_ply
from ebamcheck.mesh.part import FROM_DEFAULT, FROM_SETTINGS, Part
from ebamcheck.mesh.reading import how_to_read
from ebamcheck.mesh.stl import read_triangles
from ebamcheck.mesh.three_mf import read_3mf
from ebamcheck.mesh.topology import weld
from ebamcheck.settings.base import UNITS_MM, unit_named

_log = logging.getLogger(__name__)

READERS: dict[str, Callable[..., Any]] = {".obj": read_obj, ".ply": read_ply, ".3mf": read_3mf}
READERS |= dict.fromkeys((".stl", ""), read_triangles)


class Facets(NamedTuple):
    """What a mesh file holds."""

    corners: NDArray[np.float32] | NDArray[np.float64]  # (F, 3, 3) corners, in the file's own numbers
    notes: list[str]  # remarks from reading it
    units: str = ""  # unit that the file itself states, or that its format does; empty where neither says any
    units_from: str = ""  # which of the two does


def load(path: str | Path, units: str = "") -> Part:
    """Read a part from an STL, OBJ, PLY or 3MF file.

    Parameters
    ----------
    path
        The file; STL is recognised by content, other formats by suffix.
    units
        Unit of the file's numbers: mm, cm, m, um, in or ft, or a longer name of one. Empty: that of the file where it has one
        (3MF), else mm. Never guessed.

    Returns
    -------
    Part
        The part in mm; vertices that are equal in all bits are welded.

    Raises
    ------
    InputError
        If the file is missing, truncated, not what its name says, or holds NaN, inf or no facet.
    SettingsError
        If the unit is unknown, or is not the one that the file states.

    Examples
    --------
    >>> import tempfile
    >>> import ebamcheck
    >>> from ebamcheck_models import CUBE
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = ebamcheck.save(CUBE.tessellate(0.1), Path(folder) / "cube.stl")
    ...     load(file, units="in").size.tolist()
    [508.0, 508.0, 508.0]
    """
    path, given = Path(path), unit_named(units) if units else ""
    data = _bytes_of(path)
    with ThreadPoolExecutor(1) as aside:  # hashing takes as long as parsing, and is independent of it
        digest = aside.submit(hashlib.sha256, data)
        part = _part_of(_facets_of(data, path), path, given)
        return replace(part, source_sha256=digest.result().hexdigest())


def _part_of(read: Facets, path: Path, given: str) -> Part:
    if given and read.units and given != read.units:
        raise SettingsError(
            f"{path.name}: its unit is {read.units} ({read.units_from}), and --units (part.units) says {given}: leave that out, "
            "or mend the file"
        )
    units, notes = given or read.units or "mm", read.notes
    vertices, faces = weld(read.corners)
    if units != "mm":
        vertices *= UNITS_MM[units]
    units_from = read.units_from or (FROM_SETTINGS if given else FROM_DEFAULT)
    part = Part(vertices, faces, name=path.stem, source=str(path), units=units, units_from=units_from)
    notes += extent_notes(float(part.size.max()), units)
    for note in notes:
        _log.warning("%s: %s", path.name, note)
    return replace(part, notes=tuple(notes))


def read_facets(path: Path) -> Facets:
    """Facets of a mesh file in its own numbers, and what reading it told."""
    return _facets_of(_bytes_of(path), path)


def _facets_of(data: bytes | memoryview, path: Path) -> Facets:
    suffix = path.suffix.lower()
    if suffix not in READERS:
        raise InputError(f"{path.name}: {how_to_read(suffix)}")
    return Facets(*READERS[suffix](data, path.name))


def extent_notes(largest_mm: float, units: str) -> list[str]:
    """Warning that the unit of a file may be wrong, by the largest extent of its part; empty for 1 mm to 10 m, the usual ones."""
    told = f"the part is {largest_mm:.4g} mm in its largest extent: check the unit of the file (read as {units}; see --units)"
    return [] if 1.0 <= largest_mm <= 10_000.0 else [told]


def _bytes_of(path: Path) -> bytes | memoryview:
    """Read the whole file; numpy allocates large pages, which are filled in half the time."""
    with told_if_unreadable(path):
        return np.fromfile(path, np.uint8).data.toreadonly()


@contextmanager
def told_if_unreadable(path: Path) -> Iterator[None]:
    """Turn the system's errors on reading a mesh file into an :class:`InputError`; what is no file is not opened."""
    try:
        regular_file(path)
        yield
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such file") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None

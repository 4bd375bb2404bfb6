"""From a mesh file to a welded part: STL, OBJ and PLY by our own readers, 3MF through trimesh."""

from __future__ import annotations

import hashlib
import io
import logging
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ebamcheck.errors import InputError
from ebamcheck.mesh.obj import read_obj
from ebamcheck.mesh.part import LARGEST_EXTENT_MM, SMALLEST_EXTENT_MM, Part
from ebamcheck.mesh.ply import read_ply
from ebamcheck.mesh.polygons import checked_finite
from ebamcheck.mesh.stl import read_triangles
from ebamcheck.mesh.unread_formats import how_to_read
from ebamcheck.mesh.welding import weld
from ebamcheck.settings.units import UNITS_MM, unit_named

OWN_READERS = {".obj": read_obj, ".ply": read_ply}
TRIMESH_SUFFIXES = (".3mf",)
_log = logging.getLogger(__name__)


def load(path: str | Path, units: str = "mm") -> Part:
    """Read a part from an STL, OBJ, PLY or 3MF file.

    Parameters
    ----------
    path
        The file; STL is recognised by content, other formats by suffix.
    units
        Unit of the file's numbers: mm, cm, m, um, in or ft, or a longer name of one. Never guessed.

    Returns
    -------
    Part
        The part in mm; vertices that are equal in all bits are welded.

    Raises
    ------
    InputError
        If the file is missing, truncated, not what its name says, or holds NaN, inf or no facet.
    SettingsError
        If the unit is unknown.

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
    unit = unit_named(units)
    return _read(Path(path), unit, UNITS_MM[unit])


def _read(path: Path, units: str, millimetres: float) -> Part:
    data = _bytes_of(path)
    with ThreadPoolExecutor(1) as aside:  # hashing takes as long as parsing, and is independent of it
        digest = aside.submit(hashlib.sha256, data)
        part = _part_of(data, path, units, millimetres)
        return replace(part, source_sha256=digest.result().hexdigest())


def _part_of(data: bytes | memoryview, path: Path, units: str, millimetres: float) -> Part:
    triangles, notes = _triangles_of(data, path)
    vertices, faces = weld(triangles)
    if millimetres != 1.0:
        vertices *= millimetres
    part = Part(
        vertices,
        faces,
        name=path.stem,
        source=str(path),
        units=units,
    )
    notes += extent_notes(float(part.size.max()), units)
    for note in notes:
        _log.warning("%s: %s", path.name, note)
    return replace(part, notes=tuple(notes))


def corners_of(path: Path) -> NDArray[np.float32] | NDArray[np.float64]:
    """Corners (F, 3, 3) of the facets of a mesh file, in its own numbers."""
    return _triangles_of(_bytes_of(path), path)[0]


def _triangles_of(
    data: bytes | memoryview, path: Path
) -> tuple[NDArray[np.float32] | NDArray[np.float64], list[str]]:
    """Corners of the facets of a mesh file, and remarks from reading it."""
    suffix = path.suffix.lower()
    triangles: NDArray[np.float32] | NDArray[np.float64]
    notes: list[str] = []
    if suffix in OWN_READERS:
        triangles, notes = OWN_READERS[suffix](bytes(data), path.name)
    elif suffix in TRIMESH_SUFFIXES:
        triangles = _through_trimesh(data, suffix[1:], path.name)
    elif suffix in (".stl", ""):
        triangles, notes = read_triangles(data, path.name)
    else:
        raise InputError(f"{path.name}: {how_to_read(suffix)}")
    return triangles, notes


def extent_notes(largest_mm: float, units: str) -> list[str]:
    """Warning that the unit of a file may be wrong, by the largest extent of its part; empty for a usual extent."""
    if SMALLEST_EXTENT_MM <= largest_mm <= LARGEST_EXTENT_MM:
        return []
    return [
        f"the part is {largest_mm:.4g} mm in its largest extent: check the unit of the file (read as {units}; see --units)"
    ]


def _bytes_of(path: Path) -> bytes | memoryview:
    """Read the whole file; numpy allocates large pages, which are filled in half the time."""
    with told_if_unreadable(path):
        if not path.is_file():
            return path.read_bytes()
        return np.fromfile(path, np.uint8).data.toreadonly()


@contextmanager
def told_if_unreadable(path: Path) -> Iterator[None]:
    """Turn the system's errors on reading a mesh file into an :class:`InputError`."""
    try:
        yield
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such file") from None
    except IsADirectoryError:
        raise InputError(f"{path}: is a folder, not a mesh file") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None


def _through_trimesh(data: bytes | memoryview, kind: str, name: str) -> NDArray[np.float64]:
    """Corner points (F, 3, 3) of all meshes of a scene, as placed in it."""
    import trimesh

    try:
        scene: Any = trimesh.load_scene(io.BytesIO(data), file_type=kind, process=False)
        meshes = [mesh for mesh in scene.dump(concatenate=False) if isinstance(mesh, trimesh.Trimesh)]
        for mesh in meshes:
            if len(mesh.faces) and not 0 <= mesh.faces.min() <= mesh.faces.max() < len(mesh.vertices):
                raise IndexError(f"a facet names a vertex that is none of {len(mesh.vertices)}")
        triangles = [np.asarray(mesh.triangles, dtype=np.float64) for mesh in meshes if len(mesh.faces)]
    except Exception as error:
        why = " ".join(str(error).split())[:160]
        raise InputError(f"{name}: cannot be read as {kind.upper()}: {type(error).__name__}: {why}") from None
    if not triangles:
        raise InputError(f"{name}: holds no facet ({kind.upper()})")
    return checked_finite(np.concatenate(triangles), name)

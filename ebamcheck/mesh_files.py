"""From a mesh file to a welded part: STL by our own reader, OBJ, PLY and 3MF through trimesh."""

from __future__ import annotations

import hashlib
import io
import logging
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ebamcheck.errors import InputError, SettingsError
from ebamcheck.kernels import kernel
from ebamcheck.part import LARGEST_EXTENT_MM, SMALLEST_EXTENT_MM, UNITS_MM, Part
from ebamcheck.stl import read_triangles

TRIMESH_SUFFIXES = (".obj", ".ply", ".3mf")
_log = logging.getLogger(__name__)


def load(path: str | Path, units: str = "mm") -> Part:
    """Read a part from an STL, OBJ, PLY or 3MF file.

    Parameters
    ----------
    path
        The file; its format is told by content for STL and by suffix for the others.
    units
        Unit of the file's numbers: mm, cm, m, um, in or ft. Never guessed.

    Returns
    -------
    Part
        Vertices equal in all bits welded, in mm.

    Raises
    ------
    InputError
        If the file is missing, truncated, not what its name says, or holds NaN, inf or no facet.
    SettingsError
        If the unit is unknown.
    """
    if units not in UNITS_MM:
        raise SettingsError(f"unknown unit {units!r}: use one of {', '.join(UNITS_MM)}")
    return _read(Path(path), units, UNITS_MM[units])


def _read(path: Path, units: str, millimetres: float) -> Part:
    data = _bytes_of(path)
    suffix = path.suffix.lower()
    triangles: NDArray[np.float32] | NDArray[np.float64]
    notes: list[str] = []
    if suffix in TRIMESH_SUFFIXES:
        triangles = _through_trimesh(data, suffix[1:], path.name)
    elif suffix in (".stl", ""):
        triangles, notes = read_triangles(data, path.name)
    else:
        known = ", ".join((".stl", *TRIMESH_SUFFIXES))
        raise InputError(f"{path.name}: unknown suffix {suffix!r}: parts are read from {known}")
    vertices, faces = weld(triangles)
    if millimetres != 1.0:
        vertices *= millimetres
    part = Part(
        vertices,
        faces,
        name=path.stem,
        source=str(path),
        source_sha256=hashlib.sha256(data).hexdigest(),
        units=units,
    )
    largest = float(part.size.max())
    if not SMALLEST_EXTENT_MM <= largest <= LARGEST_EXTENT_MM:
        notes.append(
            f"the part is {largest:.4g} mm in its largest extent: check the unit of the file (read as {units}; see --units)"
        )
    for note in notes:
        _log.warning("%s: %s", path.name, note)
    return replace(part, notes=tuple(notes))


def _bytes_of(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such file") from None
    except IsADirectoryError:
        raise InputError(f"{path}: is a folder, not a mesh file") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None


def _through_trimesh(data: bytes, kind: str, name: str) -> NDArray[np.float64]:
    """Corner points (F, 3, 3) of all meshes of a scene, as placed in it."""
    import trimesh

    try:
        scene: Any = trimesh.load_scene(io.BytesIO(data), file_type=kind, process=False)
        meshes = [mesh for mesh in scene.dump(concatenate=False) if isinstance(mesh, trimesh.Trimesh)]
        triangles = [np.asarray(mesh.triangles, dtype=np.float64) for mesh in meshes if len(mesh.faces)]
    except Exception as error:
        why = " ".join(str(error).split())[:160]
        raise InputError(f"{name}: cannot be read as {kind.upper()}: {type(error).__name__}: {why}") from None
    if not triangles:
        raise InputError(f"{name}: holds no facet ({kind.upper()})")
    corners = np.concatenate(triangles)
    if not np.isfinite(corners).all():
        facet, corner, axis = np.argwhere(~np.isfinite(corners))[0]
        raise InputError(
            f"{name}: facet {facet}, vertex {corner}, {'xyz'[axis]} is {corners[facet, corner, axis]}: "
            "coordinates must be finite"
        )
    return corners


def weld(
    triangles: NDArray[np.float32] | NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Merge vertices that are equal in all bits (0 and -0 are equal).

    Parameters
    ----------
    triangles
        (F, 3, 3) corner points, finite.

    Returns
    -------
    vertices
        (V, 3) float64, in order of first appearance.
    faces
        (F, 3) int32 rows of `vertices`.
    """
    corners = triangles.reshape(-1, 3) + triangles.dtype.type(0)
    keys = corners.view(np.uint32 if corners.dtype == np.float32 else np.uint64)
    size = 1 << max(4, int(2 * len(corners) // 3 * 2 - 1).bit_length())
    first, index = _weld(keys, np.full(size, -1, np.int32))
    return corners[first].astype(np.float64), index.reshape(-1, 3)


@kernel
def _weld(keys: NDArray[Any], table: NDArray[np.int32]) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Open-addressing hash over the bits of three numbers: first row of each vertex, vertex of each row."""
    count = keys.shape[0]
    mask = np.uint64(table.size - 1)
    first = np.empty(count, np.int32)
    index = np.empty(count, np.int32)
    found = 0
    for i in range(count):
        x, y, z = np.uint64(keys[i, 0]), np.uint64(keys[i, 1]), np.uint64(keys[i, 2])
        mixed = (x * np.uint64(0x9E3779B97F4A7C15)) ^ (y * np.uint64(0xC2B2AE3D27D4EB4F))
        mixed = (mixed ^ (mixed >> np.uint64(29))) * np.uint64(0xBF58476D1CE4E5B9)
        mixed = (mixed ^ (z * np.uint64(0x94D049BB133111EB))) * np.uint64(0xFF51AFD7ED558CCD)
        slot = (mixed ^ (mixed >> np.uint64(32))) & mask
        while True:
            v = table[slot]
            if v < 0:
                table[slot] = found
                first[found] = i
                index[i] = found
                found += 1
                break
            j = first[v]
            if keys[j, 0] == keys[i, 0] and keys[j, 1] == keys[i, 1] and keys[j, 2] == keys[i, 2]:
                index[i] = v
                break
            slot = (slot + np.uint64(1)) & mask
    return first[:found].copy(), index

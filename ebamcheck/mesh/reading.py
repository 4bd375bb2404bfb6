"""Shared by the readers of mesh files: formats that are not read, polygons as triangles, and the refusal of no numbers."""

from __future__ import annotations

import re
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from ebamcheck.errors import InputError

Corners = TypeVar("Corners", NDArray[np.float32], NDArray[np.float64])

READ = (".stl", ".obj", ".ply", ".3mf")  # suffixes of the mesh files that are read

EXPORT = (
    "export it from your CAD system as STL (binary, in mm) with a chord tolerance of 0.01 mm or less and a fine angle; "
    "a second, four times finer one serves as --reference"
)

# Suffixes of formats of surfaces and solids, by the names of the formats
SOLIDS = {
    "STEP": (".step", ".stp", ".p21", ".stpz"), "IGES": (".iges", ".igs"), "ACIS": (".sat", ".sab"),
    "Parasolid": (".x_t", ".x_b", ".xmt_txt", ".xmt_bin"), "JT": (".jt",), "Rhino": (".3dm",),
    "SolidWorks": (".sldprt", ".sldasm"), "Inventor": (".ipt", ".iam"), "CATIA": (".catpart", ".catproduct"),
    "NX, Creo or Solid Edge": (".prt", ".asm", ".par", ".psm"), "Fusion": (".f3d", ".f3z"), "FreeCAD": (".fcstd",),
    "OpenCASCADE": (".brep", ".brp"), "DXF or DWG": (".dxf", ".dwg"),
}  # fmt: skip
# Suffixes of mesh formats that are not read, by the names of the formats
MESHES = {
    "glTF": (".gltf", ".glb"), "AMF": (".amf",), "OFF": (".off",), "VRML": (".wrl", ".vrml", ".x3d"),
    "Collada": (".dae",), "FBX": (".fbx",), "Blender": (".blend",), "VTK": (".vtp", ".vtu", ".vtk"),
    "Nastran or Abaqus": (".nas", ".bdf", ".inp"),
}  # fmt: skip
PROGRAMS = (".gcode", ".g", ".nc", ".mpf", ".spf", ".ngc")  # suffixes of NC programs


def how_to_read(suffix: str) -> str:
    """Say in one line why a file with this suffix is not read, and how to convert it.

    >>> how_to_read(".stp")[:60]
    'holds exact surfaces (STEP), and slicers take a closed mesh:'
    """
    known = ", ".join(READ)
    for name, suffixes in SOLIDS.items():
        if suffix in suffixes:
            return f"holds exact surfaces ({name}), and slicers take a closed mesh: {EXPORT}"
    for name, suffixes in MESHES.items():
        if suffix in suffixes:
            return f"holds a mesh in a form ({name}) that is not read: convert it to one of {known}"
    if suffix in PROGRAMS:
        return f"is a program, not a part: `ebamcheck verify` checks it; parts are read from {known}"
    return f"unknown suffix {suffix!r}: parts are read from {known}"


def fans(sizes: NDArray[np.int64]) -> NDArray[np.int64]:
    """Triangle fans (T, 3) from the first corner of each polygon, as rows of corners numbered polygon after polygon; `sizes` (P,)
    are 3 or more.

    >>> fans(np.array([3, 4])).tolist()
    [[0, 1, 2], [3, 4, 5], [3, 5, 6]]
    """
    starts = np.concatenate([[0], np.cumsum(sizes)])[:-1].astype(np.int64)
    counts = sizes - 2
    first = np.repeat(starts, counts)
    place = np.arange(int(counts.sum())) - np.repeat(np.cumsum(counts) - counts, counts)
    return np.stack([first, first + place + 1, first + place + 2], axis=1)


def polygon_corners(
    vertices: NDArray[np.float64], index: NDArray[np.int64], sizes: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Corner points (T, 3, 3) of polygons given by rows of vertices, (sum of sizes,)."""
    return vertices[index[fans(sizes)]]


def checked_finite(corners: Corners, name: str, first: int = 0) -> Corners:
    """Return finite corner points (F, 3, 3) unchanged; else :class:`InputError` names the place, counted from facet `first`."""
    wrong = np.argwhere(~np.isfinite(corners))
    if len(wrong):
        facet, corner, axis = wrong[0]
        raise InputError(
            f"{name}: facet {first + facet}, vertex {corner}, {'xyz'[axis]} is {corners[facet, corner, axis]}: coordinates must be finite"
        )
    return corners


def numbers_of(tokens: list[bytes], where: str) -> NDArray[np.float64]:
    """Decimal numbers from tokens; raises :class:`InputError` with the first that is none."""
    try:
        if any(b"_" in token for token in tokens):
            raise ValueError
        return np.array(tokens, dtype=np.bytes_).astype(np.float64) if tokens else np.zeros(0)
    except ValueError:
        bad = next(token for token in tokens if not is_number(token))
        token = bad[:40].decode("ascii", "replace")
        raise InputError(f"{where}: {token!r} is not a number{decimal_comma(token)}") from None


def decimal_comma(token: str) -> str:
    """Say what to do where a number has a comma in place of its point; empty for any other token.

    >>> decimal_comma("1,5"), decimal_comma("1.5x")
    (': it has a decimal comma: export the file with decimal points, or replace the commas', '')
    """
    if not re.fullmatch(r"[-+]?\d*,\d+([eE][-+]?\d+)?", token):
        return ""
    return ": it has a decimal comma: export the file with decimal points, or replace the commas"


def is_number(token: bytes) -> bool:
    """Whether a token is a decimal number; Python would read ``1_0`` as ten."""
    try:
        float(token)
    except ValueError:
        return False
    return b"_" not in token

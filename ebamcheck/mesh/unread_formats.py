"""Formats that are not read, and how to convert each to one that is."""

from __future__ import annotations

READ = (".stl", ".obj", ".ply", ".3mf")
"""Suffixes of the mesh files that are read."""

EXPORT = (
    "export it from your CAD system as STL (binary, in mm) with a chord tolerance of 0.01 mm or less and a fine angle; "
    "a second, four times finer one serves as --reference"
)

SOLIDS = {
    "STEP": (".step", ".stp", ".p21", ".stpz"),
    "IGES": (".iges", ".igs"),
    "ACIS": (".sat", ".sab"),
    "Parasolid": (".x_t", ".x_b", ".xmt_txt", ".xmt_bin"),
    "JT": (".jt",),
    "Rhino": (".3dm",),
    "SolidWorks": (".sldprt", ".sldasm"),
    "Inventor": (".ipt", ".iam"),
    "CATIA": (".catpart", ".catproduct"),
    "NX, Creo or Solid Edge": (".prt", ".asm", ".par", ".psm"),
    "Fusion": (".f3d", ".f3z"),
    "FreeCAD": (".fcstd",),
    "OpenCASCADE": (".brep", ".brp"),
    "DXF or DWG": (".dxf", ".dwg"),
}
"""Suffixes of formats of surfaces and solids, by the names of the formats."""

MESHES = {
    "glTF": (".gltf", ".glb"),
    "AMF": (".amf",),
    "OFF": (".off",),
    "VRML": (".wrl", ".vrml", ".x3d"),
    "Collada": (".dae",),
    "FBX": (".fbx",),
    "Blender": (".blend",),
    "VTK": (".vtp", ".vtu", ".vtk"),
    "Nastran or Abaqus": (".nas", ".bdf", ".inp"),
}
"""Suffixes of mesh formats that are not read, by the names of the formats."""

PROGRAMS = (".gcode", ".g", ".nc", ".mpf", ".spf", ".ngc")
"""Suffixes of NC programs."""


def how_to_read(suffix: str) -> str:
    """Say in one line why a file with this suffix is not read, and how to convert it.

    Examples
    --------
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

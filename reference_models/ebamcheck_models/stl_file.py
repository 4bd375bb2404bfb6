"""Writing a part as binary STL."""

from __future__ import annotations

from pathlib import Path

from ebamcheck.atomic_file import replacing
from ebamcheck.mesh.part import Part
from ebamcheck.mesh.stl import write_triangles


def write_stl(part: Part, path: str | Path) -> None:
    """Write a part as binary STL; the file appears whole or not at all, and equal parts give equal bytes.

    Coordinates become 32-bit floats, which keeps every bit of a tessellated reference model.

    Raises
    ------
    SettingsError
        If the file cannot be written.
    """
    with replacing(path) as temporary:
        write_triangles(part.triangles, temporary, part.name)

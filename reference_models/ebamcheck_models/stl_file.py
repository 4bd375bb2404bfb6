"""Writing a part as binary STL."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ebamcheck.atomic_file import replacing
from ebamcheck.mesh.part import Part

HEADER_BYTES = 80

_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def write_stl(part: Part, path: str | Path) -> None:
    """Write a part as binary STL; the file appears whole or not at all, and equal parts give equal bytes.

    Coordinates become 32-bit floats, which keeps every bit of a tessellated reference model.

    Raises
    ------
    SettingsError
        If the file cannot be written.
    """
    corners = part.triangles
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    facets = np.zeros(len(corners), _FACET)
    facets["normal"] = np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0)
    facets["corners"] = corners
    # A header that begins with "solid" would make readers take the file for text.
    header = f"binary STL: {part.name}, mm".encode("ascii", "replace")[:HEADER_BYTES]
    with replacing(path) as temporary, temporary.open("wb") as file:
        file.write(header.ljust(HEADER_BYTES))
        file.write(np.uint32(len(facets)).astype("<u4").tobytes())
        file.write(facets.tobytes())

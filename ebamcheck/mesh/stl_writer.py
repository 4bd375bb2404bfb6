"""Writer of binary STL, for programs that read nothing better."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ebamcheck.mesh.stl import FACET

HEADER_BYTES = 80


def write_triangles(triangles: NDArray[np.floating], path: Path, name: str = "") -> None:
    """Write triangles, rounded to the 32-bit floats of the format, with their unit normals.

    Equal corners stay equal, and equal parts give equal bytes. The normal of a facet without area is 0.

    Parameters
    ----------
    triangles
        (F, 3, 3) corners, mm.
    path
        File to write.
    name
        Name of the part, for the header.
    """
    facets = np.zeros(len(triangles), FACET)
    facets["corners"] = triangles
    corners = facets["corners"].astype(np.float64)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    facets["normal"] = np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0.0)
    # Readers would take a file whose header begins with "solid" for ASCII.
    header = f"binary STL: {name}, mm" if name else "binary STL, mm"
    with path.open("wb") as file:
        file.write(header.encode("ascii", "replace")[:HEADER_BYTES].ljust(HEADER_BYTES))
        file.write(np.array(len(facets), "<u4").tobytes())
        facets.tofile(file)

"""Noise of a mesh: whether its vertices are farther from the surface than lifting could gain."""

from __future__ import annotations

import numpy as np

from ebamcheck.curves.regions.normals import RegionNormals
from ebamcheck.mesh.topology import Index
from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Bools, Floats

ROUGH = 1.5
"""Ratio of the noise to the sagitta of the edges about from which no lift gains anything. Vertices with an error s leave a
contour point two thirds of s off; their normals lift it by about a quarter of s to a wrong place, and demand such sagittas even
where there are none."""


def rough_rows(vertices: Floats, faces: Index, found: RegionNormals) -> Bools:
    """Rows of normals (rows,) whose noise exceeds what lifting could gain: all of a mesh, or none.

    Medians over the freely curved facets decide: a single residual of few degrees of freedom tells little, and the noise of a
    mesh comes from one scanner.
    """
    told = np.isfinite(found.noise)
    rough = False
    if told.any():
        sagitta = _sagittas(vertices, faces, found.rows, found.normals)[told]
        rough = bool(np.median(found.noise[told]) > ROUGH * np.median(sagitta))
    return np.full(len(found.noise), rough)


@kernel
def _sagittas(vertices: Floats, faces: Index, rows: Index, normals: Floats) -> Floats:
    """Mean sagitta (rows,) of the edges that end at a row, as its normal asks for them, mm."""
    total, count = np.zeros(len(normals)), np.zeros(len(normals))
    for f in range(len(faces)):
        for k in range(3):
            row = rows[f, k]
            for step in (1, 2):
                p, q = vertices[faces[f, (k + step) % 3]], vertices[faces[f, k]]
                off = 0.0
                for axis in range(3):
                    off += (p[axis] - q[axis]) * normals[row, axis]
                total[row] += 0.25 * abs(off)
                count[row] += 1.0
    return total / np.maximum(count, 1.0)

"""Noise of a mesh: where its vertices lie off their surface by more than a lift could win."""

from __future__ import annotations

import numpy as np

from ebamcheck.curves.regions.normals import RegionNormals
from ebamcheck.mesh.topology import Index
from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Bools, Floats

ROUGH = 1.5
"""Noise over the sagitta of the edges about from which no lift wins. Vertices that lie s off their surface leave a point
of a contour two thirds of s off; the normals that they tell lift it by about a quarter of s to a wrong place, and seem to
ask for such sagittas where there are none."""


def rough_rows(vertices: Floats, faces: Index, found: RegionNormals) -> Bools:
    """Rows of normals (rows,) of a part whose noise exceeds what lifting could win: all of them, or none.

    The medians over the freely curved part of the mesh decide: a single residual of few degrees of freedom says little, and
    what noise there is was made by one scanner.
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

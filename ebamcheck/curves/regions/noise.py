"""Noise of a mesh: where its vertices lie off their surface by more than a lift could win."""

from __future__ import annotations

import numpy as np

from ebamcheck.curves.regions.normals import RegionNormals
from ebamcheck.kernels import kernel
from ebamcheck.rings import Bools, Floats
from ebamcheck.topology import Index

ROUGH = 1.5
"""Noise over the sagitta of the edges about from which no lift wins. Vertices that lie s off their surface leave a point
of a contour two thirds of s off; the normals that they tell lift it by about a quarter of s to a wrong place, and seem to
ask for such sagittas where there are none."""

PASSES = 2
"""Rings over which noise and sagitta are averaged: one residual of few degrees of freedom says little."""


def rough_rows(vertices: Floats, faces: Index, found: RegionNormals) -> Bools:
    """Rows of normals (rows,) about which the noise exceeds what lifting could win."""
    noise, sagitta = found.noise.copy(), _sagittas(vertices, faces, found.rows, found.normals)
    for _ in range(PASSES):
        noise, sagitta = _averaged(found.rows, noise), _averaged(found.rows, sagitta)
    rough: Bools = np.nan_to_num(noise) > ROUGH * sagitta
    return rough


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


@kernel
def _averaged(rows: Index, values: Floats) -> Floats:
    """Mean of each row and those of the corners of its facets, of what is not NaN."""
    total, count = np.zeros(len(values)), np.zeros(len(values))
    for f in range(len(rows)):
        for k in range(3):
            for j in range(3):
                value = values[rows[f, j]]
                if not np.isnan(value):
                    total[rows[f, k]] += value
                    count[rows[f, k]] += 1.0
    result = np.full(len(values), np.nan)
    for row in range(len(values)):
        if count[row] > 0.0:
            result[row] = total[row] / count[row]
    return result

"""Told corners: vertices that lie on the surface that a mesh approximates, as far as its facets can tell.

Only vertices at which several planar groups meet smoothly lie on the surface for certain. A vertex inside one group, or at the
outer border of only one, lies in that group's plane, and may be as far from the surface as the facet is: Boolean operations on
meshes leave such vertices. So may a vertex on the line between two of its neighbours, which merely splits an edge.
"""

from __future__ import annotations

import numpy as np

from ebamcheck.mesh.topology import Index
from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Bools, Floats

STRAIGHT_COSINE = 0.99
"""Two edges at a vertex may be one line if the cosine of the angle between them is less than minus this."""


def told_corners(vertices: Floats, faces: Index, label: Index, sectors: Index, tolerance_mm: float) -> Bools:
    """Corners of facets (F, 3) whose vertices lie on the surface.

    Parameters
    ----------
    vertices, faces
        The mesh.
    label
        (F,) planar group of each facet.
    sectors
        (F, 3) smooth fan of each corner.
    tolerance_mm
        How far a vertex may lie from the line of two neighbours, and be on it.
    """
    count = int(sectors.max(initial=-1)) + 1
    several = _meet_groups(label, sectors, count)
    split = _split_edges(vertices, faces, tolerance_mm)
    return np.asarray(several[sectors] & ~split[faces])


@kernel
def _meet_groups(label: Index, sectors: Index, count: int) -> Bools:
    """Fans (count,) in which facets of several groups meet."""
    first = np.full(count, -1, np.int32)
    several = np.zeros(count, np.bool_)
    for f in range(len(sectors)):
        for k in range(3):
            s = sectors[f, k]
            if first[s] < 0:
                first[s] = label[f]
            elif first[s] != label[f]:
                several[s] = True
    return several


@kernel
def _split_edges(vertices: Floats, faces: Index, tolerance: float) -> Bools:
    """Vertices (V,) that lie on the line between two of their neighbours."""
    count = len(vertices)
    starts = np.zeros(count + 1, np.int64)
    for f in range(len(faces)):
        for k in range(3):
            starts[faces[f, k] + 1] += 1
    for i in range(count):
        starts[i + 1] += starts[i]
    fill = starts[:-1].copy()
    neighbours = np.empty(3 * len(faces), np.int32)
    for f in range(len(faces)):
        for k in range(3):
            i = faces[f, k]
            neighbours[fill[i]] = faces[f, (k + 1) % 3]
            fill[i] += 1
    split = np.zeros(count, np.bool_)
    for i in range(count):
        for p in range(starts[i], starts[i + 1]):
            if split[i]:
                break
            for q in range(starts[i], p):
                if _is_between(vertices, neighbours[p], i, neighbours[q], tolerance):
                    split[i] = True
                    break
    return split


@kernel
def _is_between(vertices: Floats, a: int, i: int, b: int, tolerance: float) -> bool:
    ux, uy, uz = (
        vertices[a, 0] - vertices[i, 0],
        vertices[a, 1] - vertices[i, 1],
        vertices[a, 2] - vertices[i, 2],
    )
    vx, vy, vz = (
        vertices[b, 0] - vertices[i, 0],
        vertices[b, 1] - vertices[i, 1],
        vertices[b, 2] - vertices[i, 2],
    )
    to, away = ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz
    ahead = ux * vx + uy * vy + uz * vz
    if ahead >= 0.0 or ahead * ahead < STRAIGHT_COSINE * STRAIGHT_COSINE * to * away:
        return False
    x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    whole = to + away - 2.0 * ahead
    return bool(x * x + y * y + z * z <= tolerance * tolerance * whole)

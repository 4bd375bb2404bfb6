"""Edges of a mesh with the normals at their ends: how the edges bend, and the neighbours behind their ends."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ebamcheck.curves.ends_ahead import EndsAhead
from ebamcheck.mesh.topology import Index
from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Bools, Floats, Ints

LEAST_CREASE = 0.1
"""Sine of the angle between the normals on the two sides of a crease below which its direction is unknown."""

BEHIND_COSINE = 0.3
"""A neighbour lies behind the end of an edge if the cosine of its angle to the edge's extension is greater than this."""

Vector = tuple[float, float, float]


class SurfaceMesh(NamedTuple):
    """What kernels read of a mesh and its normals; the columns are those of the classes from which they come."""

    vertices: Floats
    faces: Index
    sectors: Index
    normals: Floats
    smooth: Bools
    flat: Bools
    kind: NDArray[np.uint8]
    region: Index
    fans: Index
    rough: Bools
    noise: Floats
    corner_starts: Ints
    corners: Index
    mean: Floats
    largest: Floats
    typical: float
    rims: Floats
    ends: EndsAhead
    far_ends_right: bool
    scattered: bool
    share: float
    exact: Index
    """(F,) exact surface of each facet; -1 for none."""
    forms: Floats
    """(S, SIZE) exact surfaces."""


# Vectors are tuples of three numbers: to allocate an array costs more than the arithmetic on it.


@kernel
def vector(rows: Floats, i: int) -> Vector:
    """Row i of three columns."""
    return rows[i, 0], rows[i, 1], rows[i, 2]


@kernel
def minus(a: Vector, b: Vector) -> Vector:
    """Difference of two vectors of space."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@kernel
def dot(a: Vector, b: Vector) -> float:
    """Scalar product of two vectors of space."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel
def scaled(a: Vector, factor: float) -> Vector:
    """A vector times a number."""
    return a[0] * factor, a[1] * factor, a[2] * factor


@kernel
def cross(a: Vector, b: Vector) -> Vector:
    """Vector product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@kernel
def bend_at(chord: Vector, normal: Vector, other: Vector, smooth: bool) -> Vector:
    """Tangent less chord, mm: across the normal on a smooth edge, along both sides on a crease."""
    if smooth:
        return scaled(normal, -dot(chord, normal))
    along = cross(normal, other)
    square = dot(along, along)
    if square < LEAST_CREASE * LEAST_CREASE:
        return 0.0, 0.0, 0.0
    return minus(scaled(along, dot(chord, along) / square), chord)


@kernel
def half_edges(mesh: SurfaceMesh, low: int, high: int) -> tuple[int, int]:
    """Half-edges low -> high and high -> low; -1 for none, or for more than one."""
    up, down = -1, -1
    ups, downs = 0, 0
    for place in range(mesh.corner_starts[low], mesh.corner_starts[low + 1]):
        f, k = mesh.corners[place] // 3, mesh.corners[place] % 3
        if mesh.faces[f, (k + 1) % 3] == high:
            up, ups = 3 * f + k, ups + 1
        if mesh.faces[f, (k + 2) % 3] == high:
            down, downs = 3 * f + (k + 2) % 3, downs + 1
    return (up if ups == 1 else -1), (down if downs == 1 else -1)


@kernel
def normals_of(mesh: SurfaceMesh, half_edge: int) -> tuple[Vector, Vector]:
    """Normals at the tail and the head of a half-edge, on its facet's side."""
    f, k = half_edge // 3, half_edge % 3
    return (
        vector(mesh.normals, mesh.sectors[f, k]),
        vector(mesh.normals, mesh.sectors[f, (k + 1) % 3]),
    )


class Behind(NamedTuple):
    """Neighbours behind the end of an edge, in the same smooth fan."""

    reach: float
    """Mean distance of the neighbours along the edge's extension, mm; 0 if there are none."""
    drop: float
    """Mean sine of the angle by which they lie below the tangent plane."""


@kernel
def behind(mesh: SurfaceMesh, f: int, corner: int, chord: Vector, normal: Vector) -> Behind:
    """Neighbours behind the end of an edge, weighed by the square of the cosine of their angle to its line."""
    fan, vertex = mesh.fans[f, corner], mesh.faces[f, corner]
    here = vector(mesh.vertices, vertex)
    length = np.sqrt(dot(chord, chord))
    weights = reach = drop = 0.0
    for place in range(mesh.corner_starts[vertex], mesh.corner_starts[vertex + 1]):
        e, k = mesh.corners[place] // 3, mesh.corners[place] % 3
        if mesh.fans[e, k] != fan:
            continue
        for step in (1, 2):
            p = minus(vector(mesh.vertices, mesh.faces[e, (k + step) % 3]), here)
            far = np.sqrt(dot(p, p))
            cosine = -dot(p, chord) / max(far * length, 1e-300)
            if cosine > BEHIND_COSINE:
                weight = cosine * cosine
                weights += weight
                reach += weight * cosine * far
                drop -= weight * dot(p, normal) / far
    if weights == 0.0:
        return Behind(0.0, 0.0)
    return Behind(reach / weights, drop / weights)

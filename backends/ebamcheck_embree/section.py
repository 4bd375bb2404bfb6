"""The mesh's own section in float64: the facets that a plane cuts, and the directed segment in each.

Neighbouring facets compute the point on their common edge from the same numbers, so the segments of a closed
mesh meet bit for bit.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ebamcheck.numeric.kernels import kernel
from ebamcheck_embree.scene import Facets, Floats, Ints


class Mesh(NamedTuple):
    """A mesh in coordinates from its centre, mm."""

    vertices: Floats
    faces: Facets


class Sections(NamedTuple):
    """Sections at several heights, facet by facet, so that a facet's segment at a height is found directly."""

    first: Ints
    """(F,) first height at which each facet is cut; its segments are those of consecutive heights from there."""
    starts: Ints
    """(F + 1,) first segment of each facet."""
    segments: Floats
    """(S, 4) start and end of each segment, mm; material on its left."""


@kernel
def part_of(mesh: Mesh, facets: Facets, own: Facets) -> Mesh:
    """Some facets with their vertices alone; `own` (V,) is -1 everywhere, and is so again afterwards."""
    faces = np.empty((facets.size, 3), np.int32)
    used = np.empty(3 * facets.size, np.int32)
    size = 0
    for n in range(facets.size):
        for k in range(3):
            v = mesh.faces[facets[n], k]
            if own[v] < 0:
                own[v] = size
                used[size] = v
                size += 1
            faces[n, k] = own[v]
    vertices = np.empty((size, 3))
    for n in range(size):
        for k in range(3):
            vertices[n, k] = mesh.vertices[used[n], k]
        own[used[n]] = -1
    return Mesh(vertices, faces)


@kernel
def sections_at(mesh: Mesh, z_mm: Floats) -> Sections:
    """Cut a mesh at several ascending heights (L,)."""
    vertices, faces = mesh
    first = np.empty(len(faces), np.int64)
    starts = np.zeros(len(faces) + 1, np.int64)
    for f in range(len(faces)):
        a, b, c = vertices[faces[f, 0], 2], vertices[faces[f, 1], 2], vertices[faces[f, 2], 2]
        first[f] = _first_height_at(z_mm, min(a, b, c))
        starts[f + 1] = starts[f] + _first_height_at(z_mm, max(a, b, c)) - first[f]
    segments = np.empty((starts[-1], 4))
    for f in range(len(faces)):
        for n in range(starts[f], starts[f + 1]):
            z = z_mm[first[f] + n - starts[f]]
            for k in range(3):
                p, q = faces[f, k], faces[f, (k + 1) % 3]
                below = vertices[p, 2] <= z
                if below == (vertices[q, 2] <= z):
                    continue
                low, high, place = (p, q, 2) if below else (q, p, 0)  # where the edge rises, the segment ends
                segments[n, place], segments[n, place + 1] = edge_point(vertices, low, high, z)
    return Sections(first, starts, segments)


@kernel
def _first_height_at(z_mm: Floats, place: float) -> int:
    """First of ascending heights (L,) that is not below `place`."""
    low, high = 0, z_mm.size
    while low < high:
        middle = (low + high) // 2
        if z_mm[middle] < place:
            low = middle + 1
        else:
            high = middle
    return low


@kernel
def edge_point(vertices: Floats, low: int, high: int, z: float) -> tuple[float, float]:
    """Point at height z on the edge from its lower to its upper vertex."""
    t = (z - vertices[low, 2]) / (vertices[high, 2] - vertices[low, 2])
    return (
        vertices[low, 0] + t * (vertices[high, 0] - vertices[low, 0]),
        vertices[low, 1] + t * (vertices[high, 1] - vertices[low, 1]),
    )

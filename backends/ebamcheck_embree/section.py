"""The mesh's own section in float64: which facets a plane cuts, and in which directed segments.

Neighbouring facets compute the point on their common edge from the same numbers, so the segments of a closed
mesh join bit for bit.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ebamcheck.numeric.kernels import kernel
from ebamcheck_embree.scene import Facets, Floats, Ints

MOST_SLABS = 4096


class Mesh(NamedTuple):
    """A mesh about its centre."""

    vertices: Floats
    faces: Facets


class Slabs(NamedTuple):
    """Facets by height: which ones reach into which of equally thick slabs."""

    bottom_mm: float
    per_mm: float
    starts: Ints
    """(S + 1,) first of each slab's facets."""
    facets: Facets


class Sections(NamedTuple):
    """Sections at several heights."""

    starts: Ints
    """(L + 1,) first segment of each height."""
    segments: Floats
    """(S, 4) start and end of each segment, mm; material on its left."""
    owner: Facets
    """(S,) facet of each segment."""


@kernel
def segment_of(mesh: Mesh, facet: int, z: float) -> tuple[bool, float, float, float, float]:
    """Segment in which the plane z = h + 0 cuts a facet: whether it does, and start and end."""
    vertices, faces = mesh
    x0 = y0 = x1 = y1 = 0.0
    cut = False
    for k in range(3):
        a, b = faces[facet, k], faces[facet, (k + 1) % 3]
        below_a, below_b = vertices[a, 2] <= z, vertices[b, 2] <= z
        if below_a and not below_b:
            x1, y1 = edge_point(vertices, a, b, z)
            cut = True
        elif below_b and not below_a:
            x0, y0 = edge_point(vertices, b, a, z)
    return cut, x0, y0, x1, y1


@kernel
def edge_point(vertices: Floats, low: int, high: int, z: float) -> tuple[float, float]:
    """Point at height z on the edge from its lower to its upper vertex."""
    t = (z - vertices[low, 2]) / (vertices[high, 2] - vertices[low, 2])
    return (
        vertices[low, 0] + t * (vertices[high, 0] - vertices[low, 0]),
        vertices[low, 1] + t * (vertices[high, 1] - vertices[low, 1]),
    )


@kernel
def _slab(z: float, bottom_mm: float, per_mm: float, count: int) -> int:
    return int(min(max((z - bottom_mm) * per_mm, 0.0), count - 1.0))


@kernel
def most_segments(slabs: Slabs, z_mm: Floats) -> Ints:
    """Segments that the section at each height (L,) has at most."""
    most = np.empty(z_mm.size, np.int64)
    for layer in range(z_mm.size):
        k = _slab(z_mm[layer], slabs.bottom_mm, slabs.per_mm, slabs.starts.size - 1)
        most[layer] = slabs.starts[k + 1] - slabs.starts[k]
    return most


@kernel
def sections_at(mesh: Mesh, slabs: Slabs, z_mm: Floats) -> Sections:
    """Cut a mesh at several heights (L,)."""
    count = slabs.starts.size - 1
    room = most_segments(slabs, z_mm).sum()
    starts = np.zeros(z_mm.size + 1, np.int64)
    segments = np.empty((room, 4))
    owner = np.empty(room, np.int32)
    size = 0
    for layer in range(z_mm.size):
        k = _slab(z_mm[layer], slabs.bottom_mm, slabs.per_mm, count)
        for facet in slabs.facets[slabs.starts[k] : slabs.starts[k + 1]]:
            cut, x0, y0, x1, y1 = segment_of(mesh, facet, z_mm[layer])
            if cut:
                segments[size, 0], segments[size, 1] = x0, y0
                segments[size, 2], segments[size, 3] = x1, y1
                owner[size] = facet
                size += 1
        starts[layer + 1] = size
    return Sections(starts, segments[:size], owner[:size])


def slabs_of(mesh: Mesh) -> Slabs:
    """Sort the facets of a mesh into slabs."""
    z0, z1, z2 = (mesh.vertices[mesh.faces[:, k], 2] for k in range(3))
    low, high = np.minimum(np.minimum(z0, z1), z2), np.maximum(np.maximum(z0, z1), z2)
    bottom = float(low.min()) if low.size else 0.0
    height = (float(high.max()) if high.size else 0.0) - bottom
    mean = float(np.mean(high - low)) if low.size else 0.0
    # As many slabs as keep each facet in about two of them.
    count = int(min(float(MOST_SLABS), max(1.0, height / mean))) if mean > 0.0 else 1
    per_mm = count / height if height > 0.0 else 0.0
    return Slabs(bottom, per_mm, *_fill_slabs(low, high, bottom, per_mm, count))


@kernel
def _fill_slabs(
    low: Floats, high: Floats, bottom_mm: float, per_mm: float, count: int
) -> tuple[Ints, Facets]:
    """Columns `starts` and `facets` of :class:`Slabs` for facets that reach from `low` to `high`."""
    starts = np.zeros(count + 1, np.int64)
    for f in range(low.size):
        first, last = _slab(low[f], bottom_mm, per_mm, count), _slab(high[f], bottom_mm, per_mm, count)
        for k in range(first, last + 1):
            starts[k + 1] += 1
    for k in range(count):
        starts[k + 1] += starts[k]
    fill = starts[:-1].copy()
    facets = np.empty(starts[-1], np.int32)
    for f in range(low.size):
        first, last = _slab(low[f], bottom_mm, per_mm, count), _slab(high[f], bottom_mm, per_mm, count)
        for k in range(first, last + 1):
            facets[fill[k]] = f
            fill[k] += 1
    return starts, facets

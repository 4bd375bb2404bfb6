"""The mesh's own section in float64: which facets a plane cuts, and in which directed segments.

Neighbouring facets compute the point on their common edge from the same numbers, so the segments of a closed
mesh join bit for bit.
"""

from __future__ import annotations

import numpy as np

from ebamcheck.kernels import kernel
from ebamcheck_embree.scene import Facets, Floats, Ints

MOST_SLABS = 4096


@kernel
def segment_of(
    vertices: Floats, faces: Facets, facet: int, z: float
) -> tuple[bool, float, float, float, float]:
    """Segment in which the plane z = h + 0 cuts a facet: whether it does, and start and end."""
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
def section_segments(vertices: Floats, faces: Facets, candidates: Facets, z: float) -> tuple[Floats, Facets]:
    """Segments (S, 4) in which the plane z = h + 0 cuts some facets, start and end, and the facet of each."""
    segments = np.empty((candidates.size, 4))
    owner = np.empty(candidates.size, np.int32)
    count = 0
    for facet in candidates:
        cut, x0, y0, x1, y1 = segment_of(vertices, faces, facet, z)
        if cut:
            segments[count, 0], segments[count, 1] = x0, y0
            segments[count, 2], segments[count, 3] = x1, y1
            owner[count] = facet
            count += 1
    return segments[:count], owner[:count]


class Slabs:
    """Facets by height: which ones reach into which of equally thick slabs."""

    def __init__(self, vertices: Floats, faces: Facets) -> None:
        z0, z1, z2 = (vertices[faces[:, k], 2] for k in range(3))
        low, high = np.minimum(np.minimum(z0, z1), z2), np.maximum(np.maximum(z0, z1), z2)
        self._bottom = float(low.min(initial=0.0)) if low.size else 0.0
        height = (float(high.max()) if high.size else 0.0) - self._bottom
        mean = float(np.mean(high - low)) if low.size else 0.0
        # As many slabs as keep each facet in about two of them.
        self.count = int(min(float(MOST_SLABS), max(1.0, height / mean))) if mean > 0.0 else 1
        self._per_mm = self.count / height if height > 0.0 else 0.0
        first, last = self._slab(low), self._slab(high)
        self._starts, self._facets = _fill_slabs(first, last, self.count)

    def _slab(self, z: Floats) -> Ints:
        return np.clip((z - self._bottom) * self._per_mm, 0, self.count - 1).astype(np.int64)

    def near(self, z: float) -> Facets:
        """Facets of the slab that holds height z, those cut at z among them."""
        k = int(self._slab(np.array([z]))[0])
        return self._facets[self._starts[k] : self._starts[k + 1]]


@kernel
def _fill_slabs(first: Ints, last: Ints, count: int) -> tuple[Ints, Facets]:
    starts = np.zeros(count + 1, np.int64)
    for f in range(first.size):
        for k in range(first[f], last[f] + 1):
            starts[k + 1] += 1
    for k in range(count):
        starts[k + 1] += starts[k]
    fill = starts[:-1].copy()
    facets = np.empty(starts[-1], np.int32)
    for f in range(first.size):
        for k in range(first[f], last[f] + 1):
            facets[fill[k]] = f
            fill[k] += 1
    return starts, facets

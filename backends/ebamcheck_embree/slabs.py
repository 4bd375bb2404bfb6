"""The mesh in slabs: a thin one has a small tree, and its vertices stay in the processor's cache."""

from __future__ import annotations

from threading import Lock
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ebamcheck.numeric.kernels import kernel
from ebamcheck_embree.scene import Facets, Floats, Ints, Scene
from ebamcheck_embree.section import Mesh, part_of

FACETS_A_SLAB = 8192
"""Least mean number of facets in a slab: a tree of fewer is hardly faster."""

FACETS_THROUGH_A_SLAB = 4.0
"""Least thickness of a slab, over the mean extent of facets across it: a facet then lies in 1.25 slabs on average."""

SLABS_KEPT = 8
"""Slabs that are kept, the latest used: more than parallel threads need at once."""


class Sorted(NamedTuple):
    """Facets by the equally thick slabs across an axis into which they reach."""

    bottom_mm: float
    per_mm: float
    starts: Ints
    """(S + 1,) first of each slab's facets."""
    facets: Facets


class Slab(NamedTuple):
    """The facets that reach into a slab, as a mesh of their own, and the tree over them."""

    mesh: Mesh
    scene: Scene


class _Made:
    """A slab once it is made, and the lock of the thread that makes it."""

    def __init__(self) -> None:
        self.lock = Lock()
        self.slab: Slab | None = None


class Slabs:
    """A mesh in slabs across an axis; each is made on demand, and the latest used are kept."""

    def __init__(self, mesh: Mesh, axis: int) -> None:
        self._mesh = mesh
        self._sorted = _sorted(mesh, axis)
        self._made: dict[int, _Made] = {}
        self._lock = Lock()
        self._spare: list[Facets] = []

    def of(self, places_mm: ArrayLike) -> Ints:
        """Slab (L,) of each place along the axis, mm; it holds every facet that reaches there."""
        return _slabs_at(np.asarray(places_mm, dtype=np.float64), self._sorted)

    def facets_in(self, slab: int) -> int:
        """Number of facets that reach into a slab."""
        return int(self._sorted.starts[slab + 1] - self._sorted.starts[slab])

    def __getitem__(self, slab: int) -> Slab:
        """Return a slab, made by this thread if no other has done so."""
        with self._lock:
            made = self._made.pop(slab, None) or _Made()
            self._made[slab] = made  # as the latest
            if len(self._made) > SLABS_KEPT:
                del self._made[next(iter(self._made))]
        with made.lock:
            if made.slab is None:
                made.slab = self._make(slab)
        return made.slab

    def _make(self, slab: int) -> Slab:
        facets = self._sorted.facets[self._sorted.starts[slab] : self._sorted.starts[slab + 1]]
        try:
            own = self._spare.pop()
        except IndexError:
            own = np.full(len(self._mesh.vertices), -1, np.int32)
        mesh = part_of(self._mesh, facets, own)
        self._spare.append(own)
        return Slab(mesh, Scene(*mesh))


def _sorted(mesh: Mesh, axis: int) -> Sorted:
    """Sort the facets of a mesh into slabs across an axis."""
    low, high = _reaches(mesh, axis)
    bottom = float(low.min()) if low.size else 0.0
    extent = (float(high.max()) if high.size else 0.0) - bottom
    mean = float(np.mean(high - low)) if low.size else 0.0
    most = extent / (FACETS_THROUGH_A_SLAB * mean) if mean > 0.0 else 1.0
    count = int(max(1.0, min(most, low.size / FACETS_A_SLAB)))
    per_mm = count / extent if count > 1 else 0.0
    return Sorted(bottom, per_mm, *_fill(low, high, bottom, per_mm, count))


@kernel
def _slab(place: float, bottom_mm: float, per_mm: float, count: int) -> int:
    return int(min(max((place - bottom_mm) * per_mm, 0.0), count - 1.0))


@kernel
def _slabs_at(places_mm: Floats, slabs: Sorted) -> Ints:
    """Slab of each place (L,)."""
    found = np.empty(places_mm.size, np.int64)
    for n in range(places_mm.size):
        found[n] = _slab(places_mm[n], slabs.bottom_mm, slabs.per_mm, slabs.starts.size - 1)
    return found


@kernel
def _reaches(mesh: Mesh, axis: int) -> tuple[Floats, Floats]:
    """From where to where each facet reaches along an axis, (F,) twice."""
    vertices, faces = mesh
    low, high = np.empty(len(faces)), np.empty(len(faces))
    for f in range(len(faces)):
        a, b, c = vertices[faces[f, 0], axis], vertices[faces[f, 1], axis], vertices[faces[f, 2], axis]
        low[f], high[f] = min(a, b, c), max(a, b, c)
    return low, high


@kernel
def _fill(low: Floats, high: Floats, bottom_mm: float, per_mm: float, count: int) -> tuple[Ints, Facets]:
    """Columns `starts` and `facets` of :class:`Sorted` for facets that reach from `low` to `high`."""
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

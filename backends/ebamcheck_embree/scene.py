"""The part as Embree scenes, one for each slab of heights: a thin slab has a small tree, and its vertices stay in the cache."""

from __future__ import annotations

from collections.abc import Callable
from threading import Lock
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ebamcheck.kernels import Floats, Ints, ShortInts, kernel

Singles = NDArray[np.float32]
Facets = NDArray[np.int32]

FACETS_A_SLAB = 8192  # least mean number of facets in a slab: a tree of fewer is hardly faster
# Least thickness of a slab, over the mean extent of facets across it: a facet then lies in 1.25 slabs on average
FACETS_THROUGH_A_SLAB = 4.0
SLABS_KEPT = 8  # slabs that are kept, the latest used: more than parallel threads need at once


class Mesh(NamedTuple):
    """A mesh in coordinates from its centre, mm."""

    vertices: Floats
    faces: Facets


class UnderWay(NamedTuple):
    """Rays up one axis that have not met all their facets yet."""

    ray: Ints  # (R,) number of each ray
    origin: Singles  # (R, 3) origin of the next cast; at first outside the part
    last: Facets  # (R,) facet that each ray met last, -1 at first
    repeats: ShortInts  # (R,) how often in a row each ray has met that facet again


# Called after a cast with the facet (R,) that each ray met, out of range for none, and its distance (R,): it moves the rays that go
# on to the front, each to its new origin, and returns their number
Take = Callable[[Facets, Singles, UnderWay], int]


class Scene:
    """Embree's tree over the facets, in single precision: it gives candidate facets, never coordinates."""

    def __init__(self, vertices: Floats, faces: Facets) -> None:
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        # What Embree's faster intersection misses is found in float64, so the watertight one is not needed.
        self._scene = EmbreeScene(robust=False)
        self._mesh = TriangleMesh(self._scene, vertices.astype(np.float32), np.ascontiguousarray(faces))
        # The tree is built at the first cast, which must not happen in two threads at once.
        self._scene.run(np.zeros((1, 3), np.float32), np.ones((1, 3), np.float32))

    def follow(self, rays: Ints, origins: Singles, axis: int, take: Take) -> None:
        """Cast rays up an axis until `take` lets none of them go on; Embree reports one facet per cast."""
        direction = np.zeros((1, 3), np.float32)  # of all rays
        direction[0, axis] = 1.0
        count = len(rays)
        last, repeats = np.full(count, -1, np.int32), np.zeros(count, np.int32)
        while count:
            under_way = UnderWay(rays[:count], origins[:count], last[:count], repeats[:count])
            met = self._scene.run(under_way.origin, direction, output=True)
            count = take(met["primID"], met["tfar"], under_way)


class Slab(NamedTuple):
    """The facets that reach into a slab, as a mesh of their own, and the tree over them."""

    mesh: Mesh
    scene: Scene


class Slabs:
    """A mesh in equally thick slabs of height; each is made on demand, and the latest used are kept."""

    def __init__(self, mesh: Mesh) -> None:
        self._mesh = mesh
        # Each with the lock of the thread that makes it.
        self._latest: dict[int, tuple[Lock, list[Slab]]] = {}
        self._lock = Lock()
        self._spare: list[Facets] = []
        a, b, c = mesh.vertices[:, 2][mesh.faces.T]
        low, high = np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)
        self._bottom_mm = float(low.min()) if low.size else 0.0
        extent = (float(high.max()) if high.size else 0.0) - self._bottom_mm
        mean = float(np.mean(high - low)) if low.size else 0.0
        most = extent / (FACETS_THROUGH_A_SLAB * mean) if mean > 0.0 else 1.0
        self._count = int(max(1.0, min(most, low.size / FACETS_A_SLAB)))
        self._per_mm = self._count / extent if self._count > 1 else 0.0
        first = self.of(low)
        sizes = self.of(high) - first + 1
        ends = np.cumsum(sizes)
        row = np.repeat(np.arange(low.size, dtype=np.int32), sizes)
        slab = first[row] + np.arange(row.size) - (ends - sizes)[row]
        # Of short integers numpy's stable sort is a fast one.
        order = np.argsort(slab.astype(np.uint16) if self._count < 2**16 else slab, kind="stable")
        self._facets = row[order]
        self._starts = np.concatenate([[0], np.cumsum(np.bincount(slab, minlength=self._count))])

    def of(self, z_mm: Floats) -> Ints:
        """Slab (L,) of each height, mm; it holds every facet that reaches there."""
        place = (z_mm - self._bottom_mm) * self._per_mm
        return np.clip(place, 0.0, self._count - 1.0).astype(np.int64)

    def facets_in(self, slab: int) -> int:
        """Number of facets that reach into a slab."""
        return int(self._starts[slab + 1] - self._starts[slab])

    def __getitem__(self, slab: int) -> Slab:
        """Return a slab, made by this thread if no other has done so."""
        with self._lock:
            entry = self._latest.pop(slab, None) or (Lock(), [])
            self._latest[slab] = entry  # as the latest
            if len(self._latest) > SLABS_KEPT:
                del self._latest[next(iter(self._latest))]
        lock, made = entry
        with lock:
            if not made:
                facets = self._facets[self._starts[slab] : self._starts[slab + 1]]
                try:
                    own = self._spare.pop()
                except IndexError:
                    own = np.full(len(self._mesh.vertices), -1, np.int32)
                mesh = _submesh(*self._mesh, facets, own)
                self._spare.append(own)
                made.append(Slab(mesh, Scene(*mesh)))
        return made[0]


@kernel
def _submesh(vertices: Floats, faces: Facets, facets: Facets, own: Facets) -> Mesh:
    """Some facets with their vertices alone; `own` (V,) is -1 everywhere, and is so again afterwards."""
    new_faces = np.empty((facets.size, 3), np.int32)
    used = np.empty(3 * facets.size, np.int32)
    size = 0
    for n in range(facets.size):
        for k in range(3):
            v = faces[facets[n], k]
            if own[v] < 0:
                own[v] = size
                used[size] = v
                size += 1
            new_faces[n, k] = own[v]
    new_vertices = np.empty((size, 3))
    for n in range(size):
        for k in range(3):
            new_vertices[n, k] = vertices[used[n], k]
        own[used[n]] = -1
    return Mesh(new_vertices, new_faces)

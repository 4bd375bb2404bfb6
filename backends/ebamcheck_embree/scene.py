"""The part as an Embree scene, and all facets along a ray."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Ints = NDArray[np.int64]
Facets = NDArray[np.int32]

ROBUST = True
"""Watertight intersection: a ray through an edge hits one of its facets."""


class Hits(NamedTuple):
    """Facets that rays hit, grouped by ray."""

    starts: Ints
    """(R + 1,) first hit of each ray."""
    facets: Facets
    """(H,) facets, roughly in order along each ray."""


class Scene:
    """Tree over the facets in single precision; it tells candidates, never places."""

    def __init__(self, vertices: Floats, faces: Facets) -> None:
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        self._scene = EmbreeScene(robust=ROBUST)
        self._mesh = TriangleMesh(self._scene, vertices.astype(np.float32), np.ascontiguousarray(faces))
        # The tree is built at the first cast, which must not happen in two threads at once.
        self._scene.run(np.zeros((1, 3), np.float32), np.ones((1, 3), np.float32))

    def facets_along(self, origins: Singles, axis: int) -> Hits:
        """Find all facets along rays (R, 3) that start outside the part and run up an axis.

        Embree gives the first hit only, so each ray starts again just beyond its last one. A facet met
        twice in a row is passed by steps that double.
        """
        direction = np.zeros_like(origins)
        direction[:, axis] = 1.0
        origins = origins.copy()
        ray = np.arange(len(origins))
        last = np.full(len(origins), -1, np.int32)
        repeats = np.zeros(len(origins), np.int32)
        rays: list[Ints] = []
        facets: list[Facets] = []
        while ray.size:
            found = self._scene.run(origins, direction[: len(origins)], output=True)
            facet, distance = found["primID"], found["tfar"]
            hit = facet >= 0
            ray, facet, origins, last, repeats = ray[hit], facet[hit], origins[hit], last[hit], repeats[hit]
            new = facet != last
            rays.append(ray[new])
            facets.append(facet[new])
            repeats = np.where(new, 0, repeats + 1)
            place = np.maximum(origins[:, axis], origins[:, axis] + distance[hit])
            ulps = np.ldexp(np.spacing(np.abs(place)), np.minimum(repeats, 60))
            origins[:, axis] = np.maximum(np.nextafter(place, np.float32(np.inf)), place + ulps)
            last = facet
        return _grouped(np.concatenate(rays), np.concatenate(facets), len(direction)) if rays else _none()


def _grouped(rays: Ints, facets: Facets, count: int) -> Hits:
    order = np.argsort(rays, kind="stable")
    starts = np.concatenate([[0], np.cumsum(np.bincount(rays, minlength=count))]).astype(np.int64)
    return Hits(starts, facets[order])


def _none() -> Hits:
    return Hits(np.zeros(1, np.int64), np.zeros(0, np.int32))

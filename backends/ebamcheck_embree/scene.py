"""The part as an Embree scene, and the casting of rays from facet to facet."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ebamcheck.numeric.kernels import kernel

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Ints = NDArray[np.int64]
Facets = NDArray[np.int32]
Bools = NDArray[np.bool_]

ROBUST = False
"""Whether Embree uses its watertight intersection. What it misses is found in float64, so the faster one is enough."""

ONE_ULP = np.float32(2.0**-23)
"""Relative step of single precision: a number grown by it is the next one or the one after that."""

LEAST_STEP = np.finfo(np.float32).tiny
"""Least step past a facet, mm: that at coordinate 0."""

LARGEST_STEP_EXPONENT = 60
"""Most doublings of the step past a facet that is met again: by then it is longer than any part."""


class UnderWay(NamedTuple):
    """Rays up one axis that have not met all their facets yet."""

    ray: Ints
    """(R,) number of each ray."""
    origin: Singles
    """(R, 3) origin of the next cast; at first outside the part."""
    last: Facets
    """(R,) facet that each ray met last, -1 at first."""
    repeats: NDArray[np.int32]
    """(R,) how often in a row each ray has met that facet again."""


Take = Callable[[Facets, Singles, UnderWay], int]
"""Callback after a cast, with the facet (R,) that each ray met, out of range for none, and its distance (R,). It moves the rays
that go on to the front, each to its new origin (:func:`go_on`), and returns their number."""


def under_way(rays: Ints, origins: Singles) -> UnderWay:
    """Rays at their start."""
    count = len(rays)
    return UnderWay(rays, origins, np.full(count, -1, np.int32), np.zeros(count, np.int32))


class Scene:
    """Embree's tree over the facets, in single precision: it gives candidate facets, never coordinates."""

    def __init__(self, vertices: Floats, faces: Facets) -> None:
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        self._scene = EmbreeScene(robust=ROBUST)
        self._mesh = TriangleMesh(self._scene, vertices.astype(np.float32), np.ascontiguousarray(faces))
        # The tree is built at the first cast, which must not happen in two threads at once.
        self._scene.run(np.zeros((1, 3), np.float32), np.ones((1, 3), np.float32))

    def follow(self, rays: UnderWay, axis: int, take: Take) -> None:
        """Cast rays up an axis until `take` lets none of them go on; Embree reports one facet per cast."""
        direction = np.zeros((1, 3), np.float32)  # of all rays
        direction[0, axis] = 1.0
        count = len(rays.ray)
        while count:
            rays = UnderWay(rays.ray[:count], rays.origin[:count], rays.last[:count], rays.repeats[:count])
            met = self._scene.run(rays.origin, direction, output=True)
            count = take(met["primID"], met["tfar"], rays)


@kernel
def go_on(rays: UnderWay, n: int, place: int, facet: int, distance: float, axis: int) -> None:
    """Put ray `n` at `place`, just beyond the facet that it met.

    A facet met again in a row is passed by steps that double.
    """
    repeats = rays.repeats[n] + 1 if facet == rays.last[n] else 0
    rays.ray[place] = rays.ray[n]
    rays.last[place] = facet
    rays.repeats[place] = repeats
    for k in range(3):
        rays.origin[place, k] = rays.origin[n, k]
    reached = max(rays.origin[place, axis], np.float32(rays.origin[place, axis] + distance))
    step = max(ONE_ULP * abs(reached), LEAST_STEP)
    if repeats > 0:
        step = np.float32(step * 2.0 ** min(repeats, LARGEST_STEP_EXPONENT))
    rays.origin[place, axis] = reached + step

"""Growing: from some planar groups of facets on an exact surface to all connected groups that lie on it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ebamcheck.kernels import Bools, Floats, kernel
from ebamcheck.mesh.topology import NO_TWIN, Index
from ebamcheck.surface.exact_forms import SIDE, signed_distance

FACES_ALONG = 0.7
"""Least cosine between the normals of a facet and of its surface: some 45 degrees, about the crease angle."""

LEAST_TOLD = 3
"""Fewest told corners of a group, all of which must lie on the surface; one less for a single facet."""


class Ground(NamedTuple):
    """A mesh and its planar groups, in the form that growth reads."""

    vertices: Floats
    faces: Index
    twin: Index
    """(3 F,) opposite half-edge where the surface continues smoothly; else -1."""
    label: Index
    """(F,) group of each facet."""
    starts: Index
    """(G + 1,) first facet of each group in `facets`."""
    facets: Index
    normals: Floats
    """(G, 3) unit normals."""
    told: Bools
    """(F, 3) corners that lie on the surface for certain (:mod:`ebamcheck.surface.exact_surfaces`)."""


@kernel
def grown(
    ground: Ground,
    seeds: Index,
    taken: Bools,
    row: Floats,
    tolerance: float,
    largest: float,
    sagittas: Floats,
) -> int:
    """Count the groups on the surface `row` that are reached from seed groups over groups on it.

    Groups that are `taken` (G,) belong to other surfaces. Told corners may lie off the surface by `tolerance`, and facets stand
    off it by `largest`, mm; `sagittas` (G,) takes how far each group that is found stands off, -1 for others.
    """
    sagittas[:] = -1.0
    stack = np.empty(len(taken), np.int32)
    seen = taken.copy()
    depth = count = 0
    for group in seeds:
        if not seen[group]:
            seen[group] = True
            stack[depth] = group
            depth += 1
    while depth > 0:
        depth -= 1
        group = stack[depth]
        off = _stands_off(ground, group, row, tolerance)
        if not off <= largest or off == np.inf:
            continue
        sagittas[group] = off
        count += 1
        for place in range(ground.starts[group], ground.starts[group + 1]):
            for k in range(3):
                h = ground.twin[3 * ground.facets[place] + k]
                if h != NO_TWIN and not seen[ground.label[h // 3]]:
                    seen[ground.label[h // 3]] = True
                    stack[depth] = ground.label[h // 3]
                    depth += 1
    return count


@kernel
def _stands_off(ground: Ground, group: int, row: Floats, tolerance: float) -> float:
    """How far a group stands off a surface, mm; infinite where its told corners do not lie on it, or it faces elsewhere."""
    told = 0
    farthest = 0.0
    for place in range(ground.starts[group], ground.starts[group + 1]):
        f = ground.facets[place]
        x = y = z = 0.0
        for k in range(3):
            p, q = ground.vertices[ground.faces[f, k]], ground.vertices[ground.faces[f, (k + 1) % 3]]
            off = abs(signed_distance(row, p[0], p[1], p[2])[0])
            if ground.told[f, k]:
                told += 1
                if off > tolerance:
                    return np.inf
            farthest = max(farthest, off)
            middle = signed_distance(row, 0.5 * (p[0] + q[0]), 0.5 * (p[1] + q[1]), 0.5 * (p[2] + q[2]))
            farthest = max(farthest, abs(middle[0]))
            x += p[0] / 3.0
            y += p[1] / 3.0
            z += p[2] / 3.0
        here = signed_distance(row, x, y, z)
        farthest = max(farthest, abs(here[0]))
        facing = (
            here[1] * ground.normals[group, 0]
            + here[2] * ground.normals[group, 1]
            + here[3] * ground.normals[group, 2]
        )
        if facing * row[SIDE] < FACES_ALONG:
            return np.inf
    several = ground.starts[group + 1] - ground.starts[group] > 1
    return farthest if told >= (LEAST_TOLD if several else LEAST_TOLD - 1) else np.inf

"""Growing: from some planar groups of facets on an exact surface to all connected groups that lie on it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ebamcheck.curves.exact.forms import SIDE, signed_distance
from ebamcheck.mesh.topology import NO_TWIN, Index
from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Bools, Floats

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
    """(F, 3) corners that lie on the surface for certain (:mod:`ebamcheck.curves.exact.finding`)."""


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
    """Groups on a surface that are reached from seed groups over groups on it.

    Parameters
    ----------
    ground
        The mesh.
    seeds
        Groups to begin with.
    taken
        (G,) groups that belong to other surfaces.
    row
        The surface.
    tolerance
        How far told corners may lie off it, mm.
    largest
        How far facets may stand off it, mm.
    sagittas
        (G,) takes how far each group that is found stands off, mm; -1 for others.

    Returns
    -------
    int
        How many were found.
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


@kernel
def absorb(
    ground: Ground, across: Index, free: Bools, rows: Floats, sagittas: Floats, tolerance: float, label: Index
) -> int:
    """Give facets beside a surface to it that stand off no farther than its own: slivers, whose normals say nothing.

    Parameters
    ----------
    ground, across
        The mesh, and the half-edge across each (3 F,), at creases too.
    free
        (F,) facets that may be given away.
    rows
        (S, SIZE) surfaces.
    sagittas
        (S,) how far the facets of each stand off at most, mm.
    tolerance
        How far told corners may lie off, mm.
    label
        (F,) surface of each facet, of which those without one take one.

    Returns
    -------
    int
        How many were given.
    """
    count = 0
    for f in range(len(label)):
        if label[f] >= 0 or not free[f]:
            continue
        for k in range(3):
            h = across[3 * f + k]
            if h == NO_TWIN or label[h // 3] < 0:
                continue
            surface = label[h // 3]
            if _is_beside(ground, f, rows[surface], sagittas[surface], tolerance):
                label[f] = surface
                count += 1
                break
    return count


@kernel
def _is_beside(ground: Ground, f: int, row: Floats, largest: float, tolerance: float) -> bool:
    """Whether a facet stands off a surface by no more than `largest`, its told corners by no more than `tolerance`."""
    x = y = z = 0.0
    for k in range(3):
        p, q = ground.vertices[ground.faces[f, k]], ground.vertices[ground.faces[f, (k + 1) % 3]]
        off = abs(signed_distance(row, p[0], p[1], p[2])[0])
        middle = signed_distance(row, 0.5 * (p[0] + q[0]), 0.5 * (p[1] + q[1]), 0.5 * (p[2] + q[2]))
        if off > (tolerance if ground.told[f, k] else largest) or abs(middle[0]) > largest:
            return False
        x, y, z = x + p[0] / 3.0, y + p[1] / 3.0, z + p[2] / 3.0
    return bool(abs(signed_distance(row, x, y, z)[0]) <= largest)


class Beside(NamedTuple):
    """Numbers of edges at which the groups of a surface continue smoothly into other groups."""

    smooth: int
    """All such edges."""
    known: int
    """Those beyond which lies a known surface or a plane."""
    tangent: int
    """Those of the known ones at which that surface or plane is tangent to this one."""


@kernel
def touching(
    ground: Ground, groups: Index, of_group: Index, rows: Floats, planes: Bools, row: Floats, cosine: float
) -> Beside:
    """Count the edges of some groups beyond which known surfaces touch that of the groups.

    Parameters
    ----------
    ground
        The mesh.
    groups
        Groups of the surface.
    of_group
        (G,) known surface of each group; -1 for none.
    rows
        (S, SIZE) known surfaces.
    planes
        (G,) groups that are planes.
    row
        The surface.
    cosine
        Of the angle up to which two surfaces touch.
    """
    mine = np.zeros(len(of_group), np.bool_)
    mine[groups] = True
    smooth = known = tangent = 0
    for group in groups:
        for place in range(ground.starts[group], ground.starts[group + 1]):
            for k in range(3):
                f = ground.facets[place]
                h = ground.twin[3 * f + k]
                if h == NO_TWIN or mine[ground.label[h // 3]]:
                    continue
                smooth += 1
                other = ground.label[h // 3]
                if of_group[other] < 0 and not planes[other]:
                    continue
                known += 1
                least = 1.0
                for end in (k, (k + 1) % 3):
                    p = ground.vertices[ground.faces[f, end]]
                    _, x, y, z = signed_distance(row, p[0], p[1], p[2])
                    u, v, w = ground.normals[other, 0], ground.normals[other, 1], ground.normals[other, 2]
                    side = row[SIDE]
                    if of_group[other] >= 0:
                        beside = rows[of_group[other]]
                        _, u, v, w = signed_distance(beside, p[0], p[1], p[2])
                        side *= beside[SIDE]
                    least = min(least, side * (x * u + y * v + z * w))
                if least >= cosine:
                    tangent += 1
    return Beside(smooth, known, tangent)

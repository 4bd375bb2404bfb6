"""Forms of exact surfaces as rows of numbers: signed distances from them, and the gradients of these.

Their facets are found by growing over a mesh. A row holds the kind, a reference point, the parameters of the kind, and last the
sign of the side on which there is no solid."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ebamcheck.kernels import Bools, Floats, kernel
from ebamcheck.mesh.topology import NO_TWIN, Index

SPHERE, CYLINDER, CONE, TORUS, QUADRIC, FLAT = range(6)

NAMES = ("sphere", "cylinder", "cone", "torus", "quadric", "plane")  # Kinds by number
SIZE = 15  # Numbers in a row: kind, reference point (3), parameters of the kind (10), side

KIND, PLACE, OWN, SIDE = 0, 1, 4, 14
"""Indices within a row: of the kind, the reference point, the first parameter and the side.

Parameters are, of a sphere, its radius; of a cylinder, its axis (3) and radius; of a cone, whose reference point is its tip,
its axis (3) and the cosine and sine of its half angle; of a torus, its axis (3) and the radii of its ring and its tube; of a
quadric, in coordinates from the reference point, the coefficients of x^2, y^2, z^2, xy, xz, yz, x, y, z and 1; of a plane, its
normal (3).
"""

LEAST = 1e-300

Signed = tuple[float, float, float, float]  # Signed distance, mm, and its gradient, a unit vector


@kernel
def signed_distance(row: Floats, x: float, y: float, z: float) -> Signed:
    """Signed distance of a point from a surface, and its gradient; of a quadric to first order."""
    kind = int(row[KIND])
    x, y, z = x - row[PLACE], y - row[PLACE + 1], z - row[PLACE + 2]
    if kind == SPHERE:
        away = max(np.sqrt(x * x + y * y + z * z), LEAST)
        return away - row[OWN], x / away, y / away, z / away
    if kind == QUADRIC:
        own = row[OWN:SIDE]
        gx = 2.0 * own[0] * x + own[3] * y + own[4] * z + own[6]
        gy = 2.0 * own[1] * y + own[3] * x + own[5] * z + own[7]
        gz = 2.0 * own[2] * z + own[4] * x + own[5] * y + own[8]
        value = 0.5 * (x * (gx + own[6]) + y * (gy + own[7]) + z * (gz + own[8])) + own[9]
        slope = max(np.sqrt(gx * gx + gy * gy + gz * gz), LEAST)
        return value / slope, gx / slope, gy / slope, gz / slope
    u, v, w = row[OWN], row[OWN + 1], row[OWN + 2]
    along = x * u + y * v + z * w
    if kind == FLAT:
        return along, u, v, w
    x, y, z = x - along * u, y - along * v, z - along * w
    across = max(np.sqrt(x * x + y * y + z * z), LEAST)
    x, y, z = x / across, y / across, z / across
    if kind == CYLINDER:
        return across - row[OWN + 3], x, y, z
    if kind == CONE:
        cosine, sine = row[OWN + 3], row[OWN + 4]
        x, y, z = x * cosine - u * sine, y * cosine - v * sine, z * cosine - w * sine
        return across * cosine - along * sine, x, y, z
    off = across - row[OWN + 3]
    away = max(np.sqrt(off * off + along * along), LEAST)
    off, along = off / away, along / away
    return away - row[OWN + 4], x * off + u * along, y * off + v * along, z * off + w * along


@kernel
def signed_distances(rows: Floats, points: Floats) -> Floats:
    """Signed distances of points (n, 3) from a surface each, mm, and their gradients, (n, 4); one row of surfaces serves all."""
    found = np.empty((len(points), 4))
    for i in range(len(points)):
        row = rows[i if len(rows) > 1 else 0]
        found[i] = signed_distance(row, points[i, 0], points[i, 1], points[i, 2])
    return found


# -- growing: from some planar groups of facets on a surface to all connected groups that lie on it ---------------


class Ground(NamedTuple):
    """A mesh and its planar groups, in the form that growth reads."""

    vertices: Floats
    faces: Index
    twin: Index  # (3 F,) opposite half-edge where the surface continues smoothly; else -1
    label: Index  # (F,) group of each facet
    starts: Index  # (G + 1,) first facet of each group in facets
    facets: Index
    normals: Floats  # (G, 3) unit normals
    told: Bools  # (F, 3) corners that lie on the surface for certain (exact_surfaces)


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
    place = np.empty(3)
    while depth > 0:
        depth -= 1
        group = stack[depth]
        told = 0
        off = 0.0
        first, last = ground.starts[group], ground.starts[group + 1]
        for at in range(first, last):
            f = ground.facets[at]
            # Of each facet the corners, the middles of its edges, and its own.
            for k in range(7):
                a, b = ground.faces[f, k % 3], ground.faces[f, (k + 1) % 3]
                for axis in range(3):
                    p, q = ground.vertices[a, axis], ground.vertices[b, axis]
                    place[axis] = p if k < 3 else 0.5 * (p + q)
                    if k == 6:
                        place[axis] = (p + q + ground.vertices[ground.faces[f, 2], axis]) / 3.0
                found = signed_distance(row, place[0], place[1], place[2])
                away = abs(found[0])
                if k < 3 and ground.told[f, k]:
                    told += 1
                    away = away if away <= tolerance else np.inf
                elif k == 6:
                    n = ground.normals[group]
                    facing = (found[1] * n[0] + found[2] * n[1] + found[3] * n[2]) * row[SIDE]
                    away = away if facing >= 0.7 else np.inf  # some 45 degrees, about the crease angle
                off = max(off, away)
            if not off <= largest:
                break
        # Three corners of a group must be told, of a single facet two.
        if not off <= largest or off == np.inf or told < (3 if last - first > 1 else 2):
            continue
        sagittas[group] = off
        count += 1
        for at in range(first, last):
            for k in range(3):
                h = ground.twin[3 * ground.facets[at] + k]
                if h != NO_TWIN and not seen[ground.label[h // 3]]:
                    seen[ground.label[h // 3]] = True
                    stack[depth] = ground.label[h // 3]
                    depth += 1
    return count

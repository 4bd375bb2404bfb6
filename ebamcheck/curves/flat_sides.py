"""Flat sides of a mesh: groups of coplanar facets, and which of them keep their plane where they meet a rounding.

The estimated normal at a vertex between a flat side and a rounding lies between those of their facets, and would bend the
flat side. A flat side is told from a facet of the rounding by its greater width.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ebamcheck.mesh.topology import NO_TWIN, Index
from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Bools, Floats

ROUNDING = 2.0**-22
"""Distance from a plane that 32-bit rounding can give a point of it, over the coordinates: two steps of these."""

FLAT_RAD = 1e-3
"""Facets of a flat side differ by less than this from its normal; a group that differs more was joined in many small steps
and is curved."""

SEVERAL = 2**31 - 1
"""Mark of a vertex at which several flat sides would keep their planes: none does."""

WIDTH_RATIO = 3.0
"""A flat side is this many times wider than what it meets smoothly."""


class FlatSides(NamedTuple):
    """Facets in coplanar groups."""

    groups: Index
    """(F,) group of each facet."""
    normals: Floats
    """(G, 3) unit normal of each group, weighted by area."""
    sizes: Floats
    """(G, 3) extents of each group's box, mm."""
    flat: Bools
    """(G,) whether the group has more than one facet, all of them in one plane."""


def flat_sides(vertices: Floats, faces: Index, facet_normals: Floats, twin: Index) -> FlatSides:
    """Group the facets that are coplanar with their neighbours."""
    groups, count = _groups(vertices, faces, facet_normals, twin)
    return _measured(vertices, faces, facet_normals, groups, count)


@kernel
def _in_plane(vertices: Floats, faces: Index, facet_normals: Floats, f: int, half_edge: int) -> bool:
    """Whether the third corner of the facet of a half-edge lies in the plane of facet f, to rounding."""
    e, k = half_edge // 3, half_edge % 3
    p, q = vertices[faces[e, (k + 2) % 3]], vertices[faces[f, 0]]
    off = rounding = 0.0
    for axis in range(3):
        off += (p[axis] - q[axis]) * facet_normals[f, axis]
        rounding += max(abs(p[axis]), abs(q[axis])) * abs(facet_normals[f, axis])
    return abs(off) <= ROUNDING * rounding


@kernel
def _cosine(n: Floats, m: Floats) -> float:
    return float(n[0] * m[0] + n[1] * m[1] + n[2] * m[2])


@kernel
def _root(root: Index, f: int) -> int:
    while root[f] != f:
        root[f] = root[root[f]]
        f = root[f]
    return f


@kernel
def _groups(vertices: Floats, faces: Index, facet_normals: Floats, twin: Index) -> tuple[Index, int]:
    """Join facets with the neighbours in their plane; group of each facet, and the number of groups."""
    count = len(faces)
    root = np.arange(count).astype(np.int32)
    for h in range(3 * count):
        g = twin[h]
        f, e = h // 3, g // 3
        if g == NO_TWIN or g < h or _cosine(facet_normals[f], facet_normals[e]) <= 0.0:
            continue
        if _in_plane(vertices, faces, facet_normals, f, g) and _in_plane(
            vertices, faces, facet_normals, e, h
        ):
            a, b = _root(root, f), _root(root, e)
            root[max(a, b)] = min(a, b)
    label = np.full(count, -1, np.int32)
    groups = 0
    for f in range(count):
        r = _root(root, f)
        if label[r] < 0:
            label[r] = groups
            groups += 1
        label[f] = label[r]
    return label, groups


@kernel
def _measured(vertices: Floats, faces: Index, facet_normals: Floats, groups: Index, count: int) -> FlatSides:
    normals = np.zeros((count, 3))
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    sizes = np.zeros(count, np.int64)
    for f in range(len(faces)):
        a, b, c = vertices[faces[f, 0]], vertices[faces[f, 1]], vertices[faces[f, 2]]
        u, v = b - a, c - a
        x, y, z = u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]
        g = groups[f]
        sizes[g] += 1
        normals[g] += facet_normals[f] * (0.5 * np.sqrt(x * x + y * y + z * z))
        for axis in range(3):
            low[g, axis] = min(low[g, axis], min(a[axis], min(b[axis], c[axis])))
            high[g, axis] = max(high[g, axis], max(a[axis], max(b[axis], c[axis])))
    for g in range(count):
        length = np.sqrt(np.sum(normals[g] * normals[g]))
        if length > 0.0:
            normals[g] /= length
    flat = sizes > 1
    least = np.cos(FLAT_RAD)
    for f in range(len(faces)):
        g = groups[f]
        if _cosine(facet_normals[f], normals[g]) < least:
            flat[g] = False
    return FlatSides(groups, normals, high - low, flat)


@kernel
def _width(sides: FlatSides, g: int, along: Floats) -> float:
    """Extent of a group across an edge of its border, by its box: exact where the box fits it."""
    n = sides.normals[g]
    x, y, z = (
        n[1] * along[2] - n[2] * along[1],
        n[2] * along[0] - n[0] * along[2],
        n[0] * along[1] - n[1] * along[0],
    )
    length = np.sqrt(x * x + y * y + z * z)
    if length == 0.0:
        return 0.0
    size = sides.sizes[g]
    return float((abs(x) * size[0] + abs(y) * size[1] + abs(z) * size[2]) / length)


@kernel
def _is_far_wider(vertices: Floats, faces: Index, sides: FlatSides, h: int, g: int) -> bool:
    """Whether the group of half-edge h is a flat side beside that of its twin g."""
    along = vertices[faces[h // 3, (h % 3 + 1) % 3]] - vertices[faces[h // 3, h % 3]]
    mine, other = sides.groups[h // 3], sides.groups[g // 3]
    return sides.flat[mine] and _width(sides, mine, along) >= WIDTH_RATIO * _width(sides, other, along)


@kernel
def keep_flat(
    vertices: Floats, faces: Index, twin: Index, sectors: Index, sides: FlatSides, normals: Floats
) -> None:
    """Give the normals (S, 3) of sectors at the border of a flat side and a rounding the flat side's own.

    A side keeps its plane at a vertex where it is far wider than all that it meets smoothly there; a strip of a
    cylinder has its like beside it. `twin` lacks those across creases.
    """
    side = np.full(len(normals), -1, np.int32)
    for vetoes in (False, True):
        for h in range(twin.size):
            g = twin[h]
            mine = sides.groups[h // 3]
            if g == NO_TWIN or mine == sides.groups[g // 3] or not sides.flat[mine]:
                continue
            wider = _is_far_wider(vertices, faces, sides, h, g)
            for corner in (h % 3, (h % 3 + 1) % 3):
                s = sectors[h // 3, corner]
                if wider and not vetoes:
                    side[s] = max(side[s], mine) if side[s] < 0 or side[s] == mine else SEVERAL
                elif vetoes and not wider and side[s] == mine:
                    side[s] = -1
    for s in range(len(normals)):
        if side[s] >= 0 and side[s] != SEVERAL:
            normals[s] = sides.normals[side[s]]

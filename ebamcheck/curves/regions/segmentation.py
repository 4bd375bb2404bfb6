"""Segmentation of a mesh into regions: what is a plane, what a strip with straight rulings, and what is freely curved."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ebamcheck.curves.regions.borders import (
    HALF_TURN,
    LIKE,
    MOST_BORDERS,
    Borders,
    edge_direction,
    find_borders,
    flat_against,
    part_bends,
)
from ebamcheck.curves.regions.planes import PlanarGroups, planar_groups
from ebamcheck.curves.regions.rounding import plane_tolerance_mm
from ebamcheck.kernels import kernel
from ebamcheck.part import Part
from ebamcheck.rings import Bools, Floats
from ebamcheck.topology import NO_TWIN, Index

FREEFORM, PLANE, STRIP = 0, 1, 2
"""Kinds of region: freely curved, flat, and flat between straight rulings across which the surface goes on turning."""

Kinds = NDArray[np.uint8]

RULING_COSINE = 0.9
"""Rulings of one strip differ by less than this cosine's angle, 26 degrees: those of a cone of few strips converge."""


class Regions(NamedTuple):
    """Regions of a mesh."""

    groups: PlanarGroups
    """Facets in groups of one plane."""
    borders: Borders
    """Where groups go over into each other."""
    kind: Kinds
    """(G,) kind of each group."""
    tolerance_mm: float
    """How far a vertex may lie from its plane."""


def find_regions(
    part: Part, twin: Index, crease_angle_deg: float, polygon_angle_deg: float
) -> Regions:
    """Find the regions of a part; `twin` (3 F,) loses the half-edges at which the surface is sharp.

    Parameters
    ----------
    part
        The mesh.
    twin
        Half-edge across each half-edge.
    crease_angle_deg
        Edges whose planes differ by at least this angle are sharp. So is any edge between two planes that no third
        strip goes on from.
    polygon_angle_deg
        Strips that turn by more than this from one to the next, with nothing but their two rims to tell whether they are
        the sides of a polygon or of a cylinder, are sides of a polygon; a flat side that such a row of strips touches as
        the tangent plane of a rounding would is evidence for the cylinder.
    """
    tolerance_mm = plane_tolerance_mm(part)
    vertices, faces = part.vertices, part.faces
    groups = planar_groups(vertices, faces, twin, tolerance_mm)
    borders = find_borders(vertices, faces, twin, groups, float(np.cos(np.deg2rad(crease_angle_deg))))
    _make_sharp(twin, part_bends(vertices, faces, twin, groups, borders))
    kind = _kinds(vertices, faces, twin, groups, borders)
    polygons = _polygon_edges(vertices, faces, twin, groups, borders, kind, np.deg2rad(polygon_angle_deg))
    if polygons.any():
        _make_sharp(twin, polygons)
        kind = _kinds(vertices, faces, twin, groups, borders)
    _make_sharp(twin, _between_planes(twin, groups.label, kind))
    return Regions(groups, borders, kind, tolerance_mm)


def _make_sharp(twin: Index, sharp: Bools) -> None:
    twin[sharp] = NO_TWIN


@kernel
def _between_planes(twin: Index, label: Index, kind: Kinds) -> Bools:
    """Half-edges between two different planes: whatever their angle, they meet in a bend."""
    result = np.zeros(twin.size, np.bool_)
    for h in range(twin.size):
        if twin[h] != NO_TWIN:
            a, b = label[h // 3], label[twin[h] // 3]
            result[h] = a != b and kind[a] == PLANE and kind[b] == PLANE
    return result


@kernel
def _kinds(
    vertices: Floats, faces: Index, twin: Index, groups: PlanarGroups, borders: Borders
) -> Kinds:
    """Kind of each group (G,) by its borders.

    A plane is flat up to each. A strip is flat but for borders that run alike, its rulings; a single facet is no strip.
    """
    count = len(groups.normals)
    kind = np.zeros(count, np.uint8)
    for group in range(count):
        first, last = borders.starts[group], borders.starts[group + 1]
        if last - first > MOST_BORDERS:
            kind[group] = PLANE
            continue
        links = 0
        parallel = True
        x = y = z = 0.0
        for place in range(first, last):
            h = borders.half_edges[place]
            if twin[h] == NO_TWIN or flat_against(vertices, faces, twin, groups, borders, h):
                continue
            u, v, w = edge_direction(vertices, faces, h)
            if links == 0:
                x, y, z = u, v, w
            parallel = parallel and abs(x * u + y * v + z * w) >= RULING_COSINE
            links += 1
            if groups.sizes[group] < 2 or not parallel:
                break
        if links == 0:
            kind[group] = PLANE
        elif groups.sizes[group] > 1 and parallel:
            kind[group] = STRIP
    return kind


@kernel
def is_link(twin: Index, label: Index, kind: Kinds, borders: Borders, h: int) -> bool:
    """Whether a half-edge of a strip is one of its rulings: what lies beyond is no plane end, and not far narrower."""
    g = twin[h]
    if g == NO_TWIN or label[h // 3] == label[g // 3]:
        return False
    other = kind[label[g // 3]]
    return bool(other == STRIP or other == PLANE or borders.width[h] < LIKE * borders.width[g])


@kernel
def _root(root: Index, i: int) -> int:
    while root[i] != i:
        root[i] = root[root[i]]
        i = root[i]
    return i


@kernel
def _polygon_edges(
    vertices: Floats,
    faces: Index,
    twin: Index,
    groups: PlanarGroups,
    borders: Borders,
    kind: Kinds,
    largest_turn: float,
) -> Bools:
    """Half-edges between strips that are the sides of a polygon: they turn far, and no tangent plane speaks for a rounding."""
    count = len(kind)
    root = np.arange(count).astype(np.int32)
    rounding = np.zeros(count, np.bool_)
    for h in range(twin.size):
        g = twin[h]
        if g == NO_TWIN:
            continue
        a, b = groups.label[h // 3], groups.label[g // 3]
        if a == b or kind[a] != STRIP:
            continue
        if kind[b] == STRIP:
            r, s = _root(root, a), _root(root, b)
            root[max(r, s)] = min(r, s)
        elif kind[b] == PLANE and not rounding[a]:
            rounding[a] = _is_tangent(vertices, faces, twin, groups, borders, h)
    for group in range(count):
        if rounding[group]:
            rounding[_root(root, group)] = True
    result = np.zeros(twin.size, np.bool_)
    for h in range(twin.size):
        g = twin[h]
        if g == NO_TWIN:
            continue
        a, b = groups.label[h // 3], groups.label[g // 3]
        if a != b and kind[a] == STRIP and kind[b] == STRIP and abs(borders.turn[h]) > largest_turn:
            result[h] = not rounding[_root(root, a)]
    return result


@kernel
def _is_tangent(
    vertices: Floats, faces: Index, twin: Index, groups: PlanarGroups, borders: Borders, h: int
) -> bool:
    """Whether a strip meets the plane across half-edge h in half of the turn that it takes to the strip on its other side."""
    group, plane = groups.label[h // 3], groups.label[twin[h] // 3]
    along = edge_direction(vertices, faces, h)
    for place in range(borders.starts[group], borders.starts[group + 1]):
        k = borders.half_edges[place]
        if twin[k] == NO_TWIN or groups.label[twin[k] // 3] == plane:
            continue
        other = edge_direction(vertices, faces, k)
        parallel = abs(along[0] * other[0] + along[1] * other[1] + along[2] * other[2])
        mine, beyond = borders.width[k], borders.width[twin[k]]
        if parallel < RULING_COSINE or beyond >= LIKE * mine or mine >= LIKE * beyond:
            continue
        expected = borders.turn[k] * mine / (mine + beyond)
        if expected * borders.turn[h] > 0.0:
            ratio = borders.turn[h] / expected
            return bool(HALF_TURN[0] <= ratio <= HALF_TURN[1])
    return False

"""Segmentation of a mesh into planes, strips with straight rulings, and freely curved facets."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ebamcheck.geometry.rings import stable_order
from ebamcheck.kernels import Bools, Floats, kernel
from ebamcheck.mesh.part import Part
from ebamcheck.mesh.topology import NO_TWIN, Index
from ebamcheck.settings.stages import CurveSettings
from ebamcheck.surface.borders import (
    HALF_TURN,
    LIKE,
    MOST_BORDERS,
    Borders,
    edge_direction,
    find_borders,
    flat_against,
    part_bends,
)
from ebamcheck.surface.planes import PlanarGroups, planar_groups, plane_tolerance_mm

FREEFORM, PLANE, STRIP = 0, 1, 2
"""Kinds of region: freely curved; flat; flat between straight rulings at which the surface continues to turn."""

PROVEN = 1.5
"""Strips with a sagitta up to this many times that of a certain rounding of the part are a rounding, too, and no polygon."""

MUCH = 0.25
"""Share of a part's surface from which its freely curved facets show how coarse the mesh is; the rounded rims of a polygon have
less."""

Kinds = NDArray[np.uint8]

RULING_COSINE = 0.9
"""Least cosine between the rulings of one strip, 26 degrees: those of a cone of few strips converge."""


class Regions(NamedTuple):
    """Regions of a mesh."""

    groups: PlanarGroups
    """Facets in coplanar groups."""
    borders: Borders
    """Where groups meet smoothly."""
    kind: Kinds
    """(G,) kind of each group."""
    tolerance_mm: float
    """How far a vertex may lie from its plane."""


def find_regions(part: Part, twin: Index, settings: CurveSettings) -> Regions:
    """Find the regions of a part; sets `twin` (3 F,) to -1 at the half-edges at which the surface is sharp.

    Edges whose planes differ by at least the crease angle are sharp, and any edge between two planes from which no third strip
    continues the turn. Strips that turn by more than the polygon angle and leave a cylinder by more than the polygon sagitta are
    sides of a polygon, as two rims of vertices do not show which is meant. Evidence for the cylinder is a flat side tangent to
    the row of strips, or an equally coarse mesh of certain roundings, or of freely curved surfaces if these are much of the part.
    """
    tolerance_mm = plane_tolerance_mm(part)
    vertices, faces = part.vertices, part.faces
    groups = planar_groups(vertices, faces, twin, tolerance_mm)
    borders = find_borders(
        vertices, faces, twin, groups, float(np.cos(np.deg2rad(settings.crease_angle_deg)))
    )
    twin[part_bends(vertices, faces, twin, groups, borders)] = NO_TWIN
    kind = _kinds(vertices, faces, twin, groups, borders)
    polygons = _polygon_edges(
        vertices, faces, twin, groups, borders, kind,
        np.deg2rad(settings.polygon_angle_deg), settings.polygon_sagitta_mm,
    )  # fmt: skip
    if polygons.any():
        twin[polygons] = NO_TWIN
        kind = _kinds(vertices, faces, twin, groups, borders)
    # Whatever their angle, two planes meet in a bend.
    a, b = np.repeat(groups.label, 3), groups.label[twin // 3]
    twin[(a != b) & (kind[a] == PLANE) & (kind[b] == PLANE)] = NO_TWIN
    return Regions(groups, borders, kind, tolerance_mm)


@kernel
def _kinds(vertices: Floats, faces: Index, twin: Index, groups: PlanarGroups, borders: Borders) -> Kinds:
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
    angle: float,
    sagitta: float,
) -> Bools:
    """Half-edges between strips that are the sides of a polygon: they turn far, and nothing speaks for a rounding."""
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
    proven = 0.0
    for h in range(twin.size):
        if _joins_strips(twin, groups.label, kind, h) and rounding[_root(root, groups.label[h // 3])]:
            proven = max(proven, _sagitta(twin, borders, h))
    proven = max(proven, _curved_sagitta(twin, groups, borders, kind))
    result = np.zeros(twin.size, np.bool_)
    for h in range(twin.size):
        if _joins_strips(twin, groups.label, kind, h) and not rounding[_root(root, groups.label[h // 3])]:
            turn = abs(borders.turn[h])
            allowed = max(sagitta * (angle / turn) ** 2, PROVEN * proven)
            result[h] = turn > angle and _sagitta(twin, borders, h) > allowed
    return result


@kernel
def _curved_sagitta(twin: Index, groups: PlanarGroups, borders: Borders, kind: Kinds) -> float:
    """Median sagitta of freely curved facets, mm, where they are much of the part: what is curved both ways is no polygon."""
    curved = 0.0
    for group in range(len(kind)):
        if kind[group] == FREEFORM:
            curved += groups.areas[group]
    if curved < MUCH * np.sum(groups.areas):
        return 0.0
    sagittas = np.empty(twin.size)
    count = 0
    for h in range(twin.size):
        if twin[h] < h or groups.label[h // 3] == groups.label[twin[h] // 3]:
            continue
        if kind[groups.label[h // 3]] == FREEFORM and kind[groups.label[twin[h] // 3]] == FREEFORM:
            sagittas[count] = _sagitta(twin, borders, h)
            count += 1
    if not count:
        return 0.0
    order = stable_order(sagittas[:count])
    return float(0.5 * (sagittas[order[(count - 1) // 2]] + sagittas[order[count // 2]]))


@kernel
def _joins_strips(twin: Index, label: Index, kind: Kinds, h: int) -> bool:
    """Whether two strips meet smoothly at a half-edge."""
    if twin[h] == NO_TWIN:
        return False
    a, b = label[h // 3], label[twin[h] // 3]
    return bool(a != b and kind[a] == STRIP and kind[b] == STRIP)


@kernel
def _sagitta(twin: Index, borders: Borders, h: int) -> float:
    """Height of the arc over strips as wide as the two at a half-edge, mm."""
    return float(abs(borders.turn[h]) * (borders.width[h] + borders.width[twin[h]]) / 16.0)


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

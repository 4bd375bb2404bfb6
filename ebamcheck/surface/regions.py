"""Segmentation of a mesh into planes, strips with straight rulings, and freely curved facets."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from ebamcheck.kernels import Bools, Ints
from ebamcheck.mesh.part import Part
from ebamcheck.mesh.topology import NO_TWIN, Index
from ebamcheck.settings.stages import CurveSettings
from ebamcheck.surface.borders import (
    HALF_TURN,
    LIKE,
    MOST_BORDERS,
    Borders,
    find_borders,
    flat_against,
    part_bends,
)
from ebamcheck.surface.planes import PlanarGroups, planar_groups, plane_tolerance_mm

FREEFORM, PLANE, STRIP = 0, 1, 2
"""Kinds of region: freely curved; flat; flat between straight rulings at which the surface continues to turn."""

Kinds = NDArray[np.uint8]

RULING_COSINE = 0.9
"""Least cosine between the rulings of one strip, 26 degrees: those of a cone of few strips converge."""


class Regions(NamedTuple):
    """Regions of a mesh."""

    groups: PlanarGroups  # Facets in coplanar groups
    borders: Borders  # Where groups meet smoothly
    kind: Kinds  # (G,) kind of each group
    tolerance_mm: float  # How far a vertex may lie from its plane


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
    least_cosine = float(np.cos(np.deg2rad(settings.crease_angle_deg)))
    borders = find_borders(vertices, faces, twin, groups, least_cosine)
    twin[part_bends(twin, groups, borders)] = NO_TWIN
    kind = _kinds(twin, groups, borders)
    angle, sagitta_mm = np.deg2rad(settings.polygon_angle_deg), settings.polygon_sagitta_mm
    polygons = _polygon_edges(twin, groups, borders, kind, float(angle), sagitta_mm)
    if polygons.size:
        twin[polygons] = NO_TWIN
        kind = _kinds(twin, groups, borders)
    # Whatever their angle, two planes meet in a bend.
    a, b = np.repeat(groups.label, 3), groups.label[twin // 3]
    twin[(a != b) & (kind[a] == PLANE) & (kind[b] == PLANE)] = NO_TWIN
    return Regions(groups, borders, kind, tolerance_mm)


def _kinds(twin: Index, groups: PlanarGroups, borders: Borders) -> Kinds:
    """Kind of each group (G,) by its borders.

    A plane is flat up to each. A strip is flat but for borders that run alike, its rulings; a single facet is no strip.
    """
    count = len(groups.normals)
    few = np.diff(borders.starts) <= MOST_BORDERS
    h = borders.half_edges.astype(np.int64)
    h = h[(twin[h] != NO_TWIN) & few[groups.label[h // 3]]]
    links = h[~flat_against(twin, groups.label, groups.sizes, borders, h)]
    group = groups.label[links // 3]
    first = np.zeros(count, np.int64)
    first[group[::-1]] = links[::-1]
    cosine = np.abs((borders.along[links] * borders.along[first[group]]).sum(axis=1))
    linked, ruled = np.zeros(count, np.bool_), groups.sizes > 1
    linked[group] = True
    ruled[group[cosine < RULING_COSINE]] = False
    return np.where(linked, np.where(ruled, STRIP, FREEFORM), PLANE).astype(np.uint8)


def _polygon_edges(
    twin: Index, groups: PlanarGroups, borders: Borders, kind: Kinds, angle: float, sagitta_mm: float
) -> Ints:
    """Half-edges between strips that are the sides of a polygon: they turn far, and nothing speaks for a rounding."""
    h = borders.half_edges[twin[borders.half_edges] != NO_TWIN].astype(np.int64)
    a, b = groups.label[h // 3], groups.label[twin[h] // 3]
    sagitta = (
        np.abs(borders.turn) * (borders.width + borders.width[twin]) / 16.0
    )  # of an arc over both strips
    strips = (kind[a] == STRIP) & (kind[b] == STRIP)
    links = coo_matrix((np.ones(strips.sum()), (a[strips], b[strips])), (len(kind), len(kind)))
    row = connected_components(links, directed=False)[1]
    onto_plane = h[(kind[a] == STRIP) & (kind[b] == PLANE)]
    rounding = np.zeros(len(kind), np.bool_)
    rounding[row[groups.label[onto_plane[_is_tangent(twin, groups.label, borders, onto_plane)] // 3]]] = True
    free = h[(kind[a] == FREEFORM) & (kind[b] == FREEFORM) & (h < twin[h])]
    # What is curved both ways is no polygon. It shows how coarse the mesh is if it is a quarter of the surface; the rounded rims of
    # a polygon are less.
    much = free.size and groups.areas[kind == FREEFORM].sum() >= 0.25 * groups.areas.sum()
    proven = float(np.median(sagitta[free])) if much else 0.0
    edge, round_ = h[strips], rounding[row[a[strips]]]
    proven = max(proven, float(sagitta[edge[round_]].max(initial=0.0)))
    edge = edge[~round_]
    turn = np.abs(borders.turn[edge])
    # Up to one and a half times the sagitta of a certain rounding strips are a rounding, too.
    allowed = np.maximum(sagitta_mm * (angle / np.maximum(turn, 1e-300)) ** 2, 1.5 * proven)
    return np.asarray(edge[(turn > angle) & (sagitta[edge] > allowed)])


def _is_tangent(twin: Index, label: Index, borders: Borders, onto_plane: Ints) -> Bools:
    """Whether strips meet the planes across half-edges in half of the turn that they take to the strips on their other side."""
    place, k = borders.of_groups(label[onto_plane // 3])
    h = onto_plane[place]
    cosine = np.abs((borders.along[h] * borders.along[k]).sum(axis=1))
    mine, beyond = borders.width[k], borders.width[twin[k]]
    like = (beyond < LIKE * mine) & (mine < LIKE * beyond)
    other = (twin[k] != NO_TWIN) & (label[twin[k] // 3] != label[twin[h] // 3])
    expected = borders.turn[k] * mine / np.maximum(mine + beyond, 1e-300)
    alike = other & like & (cosine >= RULING_COSINE) & (expected * borders.turn[h] > 0.0)
    asked = np.flatnonzero(alike)[::-1]
    found = np.zeros(onto_plane.size)
    found[place[asked]] = borders.turn[h[asked]] / expected[asked]
    return np.asarray((HALF_TURN[0] <= found) & (found <= HALF_TURN[1]))

"""Segmentation of a mesh into planes, strips with straight rulings, and freely curved facets, by the turns at their borders."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ebamcheck.kernels import Bools, Floats, Ints, kernel
from ebamcheck.mesh.part import Part
from ebamcheck.mesh.topology import NO_TWIN, Index
from ebamcheck.settings.stages import CurveSettings
from ebamcheck.surface.planes import PlanarGroups, connected, planar_groups, plane_tolerance_mm

FREEFORM, PLANE, STRIP = 0, 1, 2
"""Kinds of region: freely curved; flat; flat between straight rulings at which the surface continues to turn."""

Kinds = NDArray[np.uint8]

RULING_COSINE = 0.9
"""Least cosine between the rulings of one strip, 26 degrees: those of a cone of few strips converge."""

LIKE = 3.0  # Strips of one tessellation differ by less than this factor in width; a flat side beside a rounding by more

HALF_TURN = (0.6, 1.6)
"""Range of the turn from a flat side onto the first strip of a rounding, over that strip's share of the next turn."""

MOST_BORDERS = (
    4096  # A group with more borders is no strip; comparing each border with all others would take quadratic time
)


class Borders(NamedTuple):
    """Half-edges at which two groups meet by less than the crease angle."""

    turn: Floats  # (3 F,) angle between the groups' normals, rad, positive where the surface is convex; 0 off borders
    width: Floats
    """(3 F,) extent of the half-edge's own group perpendicular to it, mm; cut short once far beyond that of the other group."""
    along: Floats  # (3 F, 3) unit vector along every half-edge; 0 where it has no length
    length: Floats  # (3 F,) length of every half-edge, mm
    starts: Index  # (G + 1,) first of each group's borders in half_edges
    half_edges: Index  # Border half-edges by group

    def of_groups(self, groups: Index) -> tuple[Ints, Index]:
        """The borders of some groups (n,): the place of the group among them, and the half-edge, of each."""
        sizes = (self.starts[groups + 1] - self.starts[groups]).astype(np.int64)
        place = np.repeat(np.arange(groups.size), sizes)
        skipped = np.concatenate([[0], np.cumsum(sizes)[:-1]]).astype(np.int64)
        return place, self.half_edges[(self.starts[groups] - skipped)[place] + np.arange(place.size)]


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
    borders = _find_borders(vertices, faces, twin, groups, least_cosine)
    twin[_part_bends(twin, groups, borders)] = NO_TWIN
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
    links = h[~_flat_against(twin, groups.label, groups.sizes, borders, h)]
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
    # Of an arc over both strips.
    sagitta = np.abs(borders.turn) * (borders.width + borders.width[twin]) / 16.0
    strips = (kind[a] == STRIP) & (kind[b] == STRIP)
    row = connected(a[strips], b[strips], len(kind))
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


# -- borders of planar groups -------------------------------------------------------------------------------


def _find_borders(vertices: Floats, faces: Index, twin: Index, groups: PlanarGroups, least_cosine: float) -> Borders:
    """Measure the borders of groups; removes from `twin` those that are sharp by their angle or run in the same direction."""
    corners, label = faces.reshape(-1), np.repeat(groups.label, 3)
    along = (vertices[np.roll(faces, -1, axis=1)] - vertices[faces]).reshape(-1, 3)
    length = np.sqrt((along * along).sum(axis=1))
    along /= np.where(length > 0.0, length, 1.0)[:, None]
    h = np.flatnonzero(twin > np.arange(twin.size))
    g = twin[h]
    n, m = groups.normals[label[h]], groups.normals[label[g]]
    cosine = (n * m).sum(axis=1)
    two = label[h] != label[g]
    out = (corners[h] == corners[g]) | (two & (cosine <= least_cosine))
    twin[h[out]] = twin[g[out]] = NO_TWIN
    two &= ~out
    h, g, cosine, across = h[two], g[two], cosine[two], np.cross(n[two], m[two])
    turn, width = np.zeros(twin.size), np.zeros(twin.size)
    # The facet runs up the edge with its normal to the outside: the next one bends away from it where convex.
    bends = (across * along[h]).sum(axis=1)
    turn[h] = turn[g] = np.copysign(np.arctan2(np.linalg.norm(across, axis=1), cosine), bends)
    lesser = np.where(groups.sizes[label[h]] <= groups.sizes[label[g]], h, g)
    greater = np.where(lesser == h, g, h)
    width[lesser] = _widths(vertices, faces, groups, along, lesser, np.full(h.size, np.inf))
    width[greater] = _widths(vertices, faces, groups, along, greater, 2.0 * LIKE * width[lesser])
    counts = np.bincount(label[np.concatenate([h, g])], minlength=len(groups.normals))
    starts = np.concatenate([[0], np.cumsum(counts)]).astype(np.int32)
    half_edges = np.sort(np.concatenate([h, g]))
    by_group = np.argsort(label[half_edges], kind="stable")
    return Borders(turn, width, along, length, starts, half_edges[by_group].astype(np.int32))


@kernel
def _widths(
    vertices: Floats, faces: Index, groups: PlanarGroups, along: Floats, half_edges: Ints, enough: Floats
) -> Floats:
    """Extents (n,) of the groups of half-edges across these, in the groups' planes; none is sought beyond `enough`."""
    found = np.zeros(half_edges.size)
    for i in range(half_edges.size):
        h = half_edges[i]
        group = groups.label[h // 3]
        n, a = groups.normals[group], vertices[faces[h // 3, h % 3]]
        x, y, z = along[h, 0], along[h, 1], along[h, 2]
        u, v, w = n[1] * z - n[2] * y, n[2] * x - n[0] * z, n[0] * y - n[1] * x
        for place in range(groups.starts[group], groups.starts[group + 1]):
            f = groups.facets[place]
            for k in range(3):
                p = vertices[faces[f, k]]
                found[i] = max(found[i], (p[0] - a[0]) * u + (p[1] - a[1]) * v + (p[2] - a[2]) * w)
            if found[i] >= enough[i]:
                break
    return found


def _part_bends(twin: Index, groups: PlanarGroups, borders: Borders) -> Bools:
    """Half-edges (3 F,) at which two planes meet in a bend and not in a rounding: no third strip goes on turning.

    Asked where a plane of several facets meets another, or something far narrower, or at the end of a long strip; two single
    facets are pieces of a freely curved surface up to the crease angle.
    """
    h = borders.half_edges[borders.half_edges < twin[borders.half_edges]]
    g = twin[h]
    several = groups.sizes[groups.label[h // 3]] > 1, groups.sizes[groups.label[g // 3]] > 1
    mine, theirs, length = borders.width[h], borders.width[g], borders.length[h]
    uneven = (mine >= LIKE * theirs) | (theirs >= LIKE * mine)
    rim = (several[0] & (mine >= LIKE * length)) | (several[1] & (theirs >= LIKE * length))
    asked = (several[0] & several[1]) | ((several[0] | several[1]) & uneven) | rim
    h, g = h[asked], g[asked]
    ahead, back = (_supports(twin, groups.label, borders, e.astype(np.int64)) for e in (g, h))
    support = np.maximum(ahead, back)
    turn = np.abs(borders.turn[h])
    # A bend stands out by five times the turns on the same side. At an inflection a surface turns by less than half of those around.
    bends = (turn > 5.0 * support[:, 0]) & (turn > 0.5 * support.max(axis=1, initial=0.0))
    bend = np.zeros(twin.size, np.bool_)
    bend[h[bends]] = bend[g[bends]] = True
    return bend


@kernel
def _supports(twin: Index, label: Index, borders: Borders, asked: Ints) -> Floats:
    """Greatest turns (n, 2), rad, beyond the groups of half-edges onto strips like them: to the same side, and to the other.

    The strip is also asked for by a flat side that it touches, where it is the last of a rounding.
    """
    found = np.zeros((asked.size, 2))
    turns, width, along = borders.turn, borders.width, borders.along
    for i in range(asked.size):
        g = asked[i]
        group, from_group = label[g // 3], label[twin[g] // 3]
        if borders.starts[group + 1] - borders.starts[group] > MOST_BORDERS:
            continue
        for place in range(borders.starts[group], borders.starts[group + 1]):
            h = borders.half_edges[place]
            if twin[h] == NO_TWIN or label[twin[h] // 3] == from_group:
                continue
            parallel = abs(along[g, 0] * along[h, 0] + along[g, 1] * along[h, 1] + along[g, 2] * along[h, 2])
            if parallel < 0.45:  # up to the angle of an equilateral triangle one border lies beyond the other
                continue
            mine, theirs, before = width[h], width[twin[h]], width[twin[g]]
            if not (mine < LIKE * theirs and theirs < LIKE * mine):
                if theirs < LIKE * mine or before >= LIKE * mine or mine >= LIKE * before:
                    continue
                expected = turns[g] * mine / (mine + before)
                if not expected * turns[h] > 0.0:
                    continue
                if not HALF_TURN[0] * abs(expected) <= abs(turns[h]) <= HALF_TURN[1] * abs(expected):
                    continue
            turn = turns[h] * parallel
            side = 0 if turn * turns[g] > 0.0 else 1
            found[i, side] = max(found[i, side], abs(turn))
    return found


@kernel
def _flat_against(twin: Index, label: Index, sizes: Index, borders: Borders, asked: Ints) -> Bools:
    """Whether the group of each half-edge is flat up to this border, and only what lies beyond is curved.

    It is where it is far wider than what it meets. Else the turns tell: from a tangent plane onto the first strip of a
    rounding the surface turns by half of that strip's own share, from one strip onto the next by both halves.
    """
    flat = np.zeros(asked.size, np.bool_)
    turns, width, along = borders.turn, borders.width, borders.along
    for i in range(asked.size):
        h = asked[i]
        mine, theirs = width[h], width[twin[h]]
        group, from_group = label[twin[h] // 3], label[h // 3]
        flat[i] = mine >= LIKE * theirs
        # A narrower group cannot be distinguished by the turns from another strip.
        if flat[i] or sizes[group] < 2 or mine < 0.8 * theirs:
            continue
        for place in range(borders.starts[group], borders.starts[group + 1]):
            k = borders.half_edges[place]
            if twin[k] == NO_TWIN or label[twin[k] // 3] == from_group:
                continue
            parallel = abs(along[h, 0] * along[k, 0] + along[h, 1] * along[k, 1] + along[h, 2] * along[k, 2])
            near, beyond = width[k], width[twin[k]]
            if parallel < 0.9 or beyond >= LIKE * near or near >= LIKE * beyond:
                continue
            ratio = turns[h] * (near + beyond) / (turns[k] * theirs)
            flat[i] = turns[k] * turns[h] > 0.0 and ratio * ratio < 1.0 + mine / theirs
            flat[i] = flat[i] and sizes[label[twin[k] // 3]] >= 2
            if not flat[i]:
                break
    return flat

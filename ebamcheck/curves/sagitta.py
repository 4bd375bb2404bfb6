"""Sagittas: how far the surface that a mesh approximates can leave its edges and facets, from the mesh alone.

A chord of length l over which a curve turns by phi leaves it by l / 2 tan(phi / 4). How much of the turn between two
chords belongs to each of them follows from what lies beyond: on a curve of even curvature a joint turns by half of what
both of its chords span, so that a chord spans twice the turn at its end less what the neighbour spans, and that follows
from the joint beyond it. A flat side beside a fillet spans nothing by that; the chord of a circle all of its arc. Both
ends of a chord tell a span, and the greater counts: a flat side spans nothing by either.

For an edge of the mesh the chords are those in which a plane through the edge and across the facets cuts them: straight
ahead over the facets beyond each end. For a crease they are the creases beyond its ends. None of this uses the normals
by which contours are lifted, so it is independent evidence.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ebamcheck.curves.per_part import once_a_part
from ebamcheck.curves.ways_ahead import Surface, Way, along_crease, dot, no_way, norm, walk
from ebamcheck.mesh.part import Part
from ebamcheck.mesh.topology import NO_TWIN, Index, edge_groups, split_corners, twins
from ebamcheck.numeric.kernels import kernel, run_blocks
from ebamcheck.numeric.rings import Bools, Floats

WIDTH_RATIO = 3.0
"""A chord this many times longer than its neighbour is a flat side beside a rounding; see `curves.straight_run_mm`. A chord
that many times shorter than both of its neighbours is a rounding of a single chord: both turns at its ends are its own."""

LARGEST_SPAN_RAD = np.deg2rad(160.0)
"""Largest span of a chord; the sagitta of a larger one means nothing."""

LEAST_APART = 0.25
"""Least distance of the middles of chords, over a chord's length, from which a curvature can be taken."""

FLAT_MM = 2e-5
"""Chords whose joint lies this near to the line over both are one: the 32-bit rounding of a plane some hundred mm wide."""

UNKNOWN = -1.0
"""Mark of an edge from crease to crease, whose ends tell nothing. Inside a plane it gets the sagitta of the plane's border,
elsewhere 0."""

EDGES_A_BLOCK = 4096


class Sagittas(NamedTuple):
    """How far the surface can leave the edges of a mesh, mm."""

    of_edge: Floats
    """(3 F,) sagitta of the edge of each half-edge: how far a contour point on it may move."""
    of_side: Floats
    """(3 F,) the part of it perpendicular to the half-edge's own facet: how far the facet's points may move."""
    plane: Bools
    """(F,) whether the facet is part of a plane: of several facets that the surface does not leave, to rounding."""
    rounding_mm: float
    """Distance from a plane that the rounding of the mesh's file can give its points."""


@once_a_part
def sagittas(part: Part, crease_angle_deg: float) -> Sagittas:
    """Bound how far the surface that a mesh stands for leaves its edges.

    Parameters
    ----------
    part
        The mesh.
    crease_angle_deg
        Edges whose facets differ by this angle or more are sharp.
    """
    surface = surface_of(part, np.cos(np.deg2rad(crease_angle_deg)))
    count = 3 * len(part.faces)
    flat = flat_mm(part.vertices)
    plane = np.zeros(len(part.faces), np.bool_)
    found = Sagittas(np.zeros(count), np.zeros(count), plane, flat)

    def work(first: int, last: int) -> None:
        _of_edges(surface, flat, first, last, found.of_edge, found.of_side)

    run_blocks(work, count, EDGES_A_BLOCK)
    _limit_in_planes(surface, flat, found.of_edge, found.of_side, plane)
    return found


def flat_mm(vertices: Floats) -> float:
    """Largest distance of the joint of two chords from the line over both for them to be one, mm, given the file's rounding."""
    return max(FLAT_MM, 4.0 * coordinate_rounding_mm(vertices))


def surface_of(part: Part, least_cosine: float) -> Surface:
    """The mesh in the form that walks read; edges are sharp if their facets' normals have a cosine below `least_cosine`."""
    vertices, faces = part.vertices, part.faces
    groups = edge_groups(faces, len(vertices))
    twin = twins(vertices, faces, groups.half_edges, groups.starts)
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    sizes = np.linalg.norm(normals, axis=1)
    normals /= np.where(sizes > 0.0, sizes, 1.0)[:, None]
    other = np.where(twin == NO_TWIN, 0, twin)
    mine = np.arange(twin.size)
    level = np.einsum("ij,ij->i", normals[mine // 3], normals[other // 3])
    same_way = faces[mine // 3, mine % 3] == faces[other // 3, other % 3]
    sharp = (twin == NO_TWIN) | same_way | (level <= least_cosine)
    corners = np.argsort(faces.reshape(-1), kind="stable").astype(np.int32)
    starts = np.concatenate([[0], np.cumsum(np.bincount(faces.reshape(-1), minlength=len(vertices)))])
    sectors = split_corners(faces, np.where(sharp, np.int32(NO_TWIN), twin))
    return Surface(vertices, faces, twin, sharp, sectors, normals, starts.astype(np.int32), corners)


def coordinate_rounding_mm(vertices: Floats) -> float:
    """Greatest rounding error of a coordinate, mm: that of the file's decimals, else of 32-bit, else of 64-bit numbers."""
    largest = float(np.abs(vertices).max(initial=0.0))
    if not np.array_equal(vertices, vertices.astype(np.float32)):
        return largest * 2.0**-53
    single = largest * 2.0**-24
    for decimals in range(7):
        rounding = 0.5 * 10.0**-decimals
        if rounding <= single:
            break
        if np.abs(vertices - np.round(vertices, decimals)).max(initial=0.0) <= single:
            return rounding
    return single


# -- edges -------------------------------------------------------------------------------------------------


@kernel
def _of_edges(surface: Surface, flat: float, first: int, last: int, of_edge: Floats, of_side: Floats) -> None:
    """Sagittas of edges, each by the lesser of its half-edges."""
    way = no_way()
    for h in range(first, last):
        g = surface.twin[h]
        if g == NO_TWIN or g < h:
            continue
        a, b = surface.faces[h // 3, h % 3], surface.faces[h // 3, (h % 3 + 1) % 3]
        along = surface.vertices[b] - surface.vertices[a]
        length = norm(along)
        if length == 0.0:
            continue
        along /= length
        way.turns[:], way.centres[:], way.lengths[:], way.joints[:] = 0.0, 0.0, 0.0, 0
        if surface.sharp[h]:
            bend = along_crease(surface, a, b, along, way)
            of_edge[h] = of_edge[g] = max(_sagitta(length, way), 0.0)
            of_side[h] = of_edge[h] * abs(dot(bend, surface.normals[h // 3]))
            of_side[g] = of_edge[h] * abs(dot(bend, surface.normals[g // 3]))
            continue
        up = surface.normals[h // 3] + surface.normals[g // 3]
        up = up - along * dot(up, along)
        size = norm(up)
        if size == 0.0:
            continue
        up /= size
        walk(surface, h, b, along, up, length, flat, 0, way)
        walk(surface, h, a, -along, up, length, flat, 1, way)
        of_edge[h] = of_edge[g] = of_side[h] = of_side[g] = _sagitta(length, way)


@kernel
def _sagitta(length: float, way: Way) -> float:
    """Height of the arc over an edge by the greater of the spans that its two ends tell.

    0 where there is one turn alone, which is a bend and no curve; :data:`UNKNOWN` where both ends are at creases.
    """
    if way.joints[0] + way.joints[1] == 0:
        return UNKNOWN
    if way.joints[0] + way.joints[1] == 1:
        return 0.0
    chord = length + way.lengths[0, 0] + way.lengths[1, 0]
    span = 0.0
    for end in range(2):
        if way.joints[end] > 0:
            span = max(span, _span(chord, end, way))
    return float(0.5 * chord * np.tan(0.25 * min(span, LARGEST_SPAN_RAD)))


@kernel
def sagitta_of_end(chord: float, end: int, way: Way) -> float:
    """Height of the arc over an edge by the span that one end tells, mm, positive to the outside."""
    height = 0.5 * chord * np.tan(0.25 * min(_span(chord, end, way), LARGEST_SPAN_RAD))
    return float(height if way.turns[end, 0] > 0.0 else -height)


@kernel
def _span(chord: float, end: int, way: Way) -> float:
    """What a chord spans: twice the turn at its end less what the surface beyond turns from there to its first middle.

    A far longer chord beyond is a flat side, and turns nothing: where it did, it would turn many times as much.
    """
    own, centre, near = way.turns[end, 0], way.centres[end, 0], way.lengths[end, 1]
    if near >= WIDTH_RATIO * chord:
        return float(2.0 * abs(own))
    side = 1.0 if own > 0.0 else -1.0
    bend = turned = 0.0
    for k in range(1, way.joints[end]):
        if k > 1 and way.lengths[end, k + 1] >= WIDTH_RATIO * near:
            break  # the rounding ends here
        turned += way.turns[end, k]
        apart = way.centres[end, k] - centre
        if apart >= LEAST_APART * near:
            bend = side * turned / apart
    beside = min(max(bend * centre, 0.0), abs(own))
    if way.joints[end] > 1 and min(chord, way.lengths[end, 2]) >= WIDTH_RATIO * near:
        beside = max(beside, min(0.5 * side * (own + way.turns[end, 1]), abs(own)))
    return float(2.0 * (abs(own) - beside))


# -- planes ------------------------------------------------------------------------------------------------


@kernel
def _limit_in_planes(surface: Surface, flat: float, of_edge: Floats, of_side: Floats, plane: Bools) -> None:
    """Edges inside of a plane leave it by no more than the edges of its border do; mark planes that none leaves."""
    count = len(surface.faces)
    root = np.arange(count).astype(np.int32)
    inner = np.zeros(3 * count, np.bool_)
    for h in range(3 * count):
        g = surface.twin[h]
        if g == NO_TWIN or g < h or surface.sharp[h]:
            continue
        if _off_plane(surface, h, g) <= flat or _off_plane(surface, g, h) <= flat:
            inner[h] = inner[g] = True
            p, q = _root(root, h // 3), _root(root, g // 3)
            root[max(p, q)] = min(p, q)
    largest = np.zeros(count)
    for h in range(3 * count):
        if not inner[h]:
            r = _root(root, h // 3)
            largest[r] = max(largest[r], of_side[h])
    for h in range(3 * count):
        if inner[h]:
            limit = largest[_root(root, h // 3)]
            of_edge[h] = of_side[h] = limit if of_edge[h] < 0.0 else min(of_edge[h], limit)
            plane[h // 3] = plane[h // 3] or limit <= flat
        elif of_edge[h] < 0.0:
            of_edge[h] = of_side[h] = 0.0


@kernel
def _off_plane(surface: Surface, h: int, g: int) -> float:
    """Distance of the corner that the facet of g has off their edge from the plane of the facet of h."""
    f, e, k = h // 3, g // 3, g % 3
    if dot(surface.normals[f], surface.normals[e]) <= 0.0:
        return np.inf
    v = surface.vertices[surface.faces[e, (k + 2) % 3]] - surface.vertices[surface.faces[f, h % 3]]
    return float(abs(dot(v, surface.normals[f])))


@kernel
def _root(root: Index, f: int) -> int:
    while root[f] != f:
        root[f] = root[root[f]]
        f = root[f]
    return f

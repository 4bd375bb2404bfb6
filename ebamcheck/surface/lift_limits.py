"""Lift limits: how high a surface may stand over each edge of a mesh, by half-edge, and which limit acts there.

Tessellation and decimation keep to a chord error. If the normals of an edge demand many times the sagitta that the facets about
its ends have by their dihedral angles, it is a long side that borders on a fine rounding, whose normals it has, or its ends were
moved. Its lift is then made smaller the more the normals demand. Meshes of scattered points keep to no chord error: there the
long edges do need a larger lift. On a mesh that is no tessellator's, an edge far longer than the chords ahead of it is lifted
by no more than the turns there tell (:mod:`ebamcheck.surface.turns_ahead`). Where the normals are noise nothing is lifted.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ebamcheck.geometry.raster import each_of
from ebamcheck.kernels import Bools, Floats, Ints
from ebamcheck.mesh.topology import NO_TWIN
from ebamcheck.surface.jets import corners_by
from ebamcheck.surface.part_surface import PartSurface
from ebamcheck.surface.regions import FREEFORM, PLANE, STRIP
from ebamcheck.surface.turns_ahead import EndsAhead, Ground, circumcentres, ends_ahead

IN_PLANE, OF_MESH, NEAR, SCATTERED, AHEAD = range(5)
"""What limits a lift: a plane, the median sagitta of the mesh, the sagittas near, those of scattered points, the turns ahead."""


class LiftLimits(NamedTuple):
    """How far contour points may be lifted over the edge of each half-edge."""

    plausible_mm: Floats
    """(3 F,) height of the surface over the edge, by sagittas, beyond which a lift grows less; infinite where nothing is known."""
    most_mm: Floats  # (3 F,) largest height, by the turns ahead, too
    acts: NDArray[np.uint8]  # (3 F,) what limits the height
    share: Floats  # (3,) share of a lift that is made, by the kind of region; 0 where the normals are noise


def lift_limits(surface: PartSurface, flat_mm: float) -> LiftLimits:
    """Judge a mesh with its normals, and limit the lifts over its edges; chords are one to `flat_mm`."""
    typical = surface.sagittas.typical
    tail, head = surface.faces.reshape(-1), np.roll(surface.faces, -1, axis=1).reshape(-1)
    mean, largest = surface.sagittas.mean, surface.sagittas.largest
    # By the end with the smaller of the largest sagittas, and by that with the greater mean, which flat neighbours lower. Twice the
    # median is plausible whatever lies near, as slivers have no sagitta of their own; four times at most.
    least_of_largest, greater_mean = (
        np.minimum(largest[tail], largest[head]),
        np.maximum(mean[tail], mean[head]),
    )
    near = np.minimum(4.0 * least_of_largest, 6.0 * greater_mean)
    height = np.minimum(np.maximum(near, 2.0 * typical), 4.0 * typical)
    acts = np.where(height == near, NEAR, OF_MESH).astype(np.uint8)
    edges = _bent_edges(surface)
    bends = judge_bends(surface, edges)
    in_rows = surface.offsets.is_in_rows
    # A tessellator's mesh is only checked for noise: the edges of some 5,000 facets tell.
    ends = ends_ahead(_ground(surface), flat_mm, max(-(-len(surface.faces) // 5_000), 1) if in_rows else 1)
    far = judge_far_ends(edges, ends, height)
    if bends.are_scattered and (in_rows or far.are_right):
        height[:], acts[:] = 25.0 * typical, SCATTERED
    kind = surface.kind
    other = np.where(surface.across == NO_TWIN, np.arange(tail.size), surface.across) // 3
    flat = np.repeat(kind == PLANE, 3) & (kind[other] == PLANE)
    height[flat], acts[flat] = 0.0, IN_PLANE
    most = height
    if not in_rows:
        most = np.minimum(height, _most_ahead(surface, ends, far.are_right))
        acts[most < height] = AHEAD
    share = np.ones(3)
    share[FREEFORM] = surface.offsets.lift_share
    if bends.are_rough or far.are_noise or share[FREEFORM] == 0.0:
        share[FREEFORM] = 0.0
        # So few strips are facets of a decimated mesh, coplanar by chance.
        if np.count_nonzero(kind == STRIP) <= 0.1 * np.count_nonzero(kind == FREEFORM):
            share[STRIP] = 0.0
    return LiftLimits(height, most, acts, share)


# -- bends: what the normals at both ends of the edges of freely curved facets demand ---------------------------

COHERENT_SHARE = 0.85
"""A mesh is rough if less than this share of its bent edges bend to the same side at both ends: half do in noise, nineteen of
twenty on surfaces, saddles included, however meshed."""

SCATTERED_SHARE = 0.8
"""A mesh is one of scattered points if at least this share of the edges that demand much are curved like their neighbours behind
both ends; on decimated meshes the share is below three fifths."""

SCATTERED_ASKED = 0.08
"""Least share of the bent edges that demand much on a mesh of scattered points. Such a mesh has edges of all lengths, and the
share is an eighth to a quarter. Where it is less, these edges are outliers."""


class _Edges(NamedTuple):
    """Bent smooth edges between freely curved facets, each once."""

    half_edge: Ints
    chord: Floats  # (n, 3) from tail to head, mm
    lift_mm: Floats  # (n,) height that the lesser of both ends asks for
    coherent: Bools  # (n,) whether both ends ask for the same side
    outward: Bools  # (n,) whether that is the outer one


class Bends(NamedTuple):
    """Verdicts from the bends at both ends of edges."""

    are_scattered: (
        bool  # The mesh is one of scattered points of a smooth surface: its long edges are curved like its short ones
    )
    are_rough: bool  # The freely curved facets determine no surface: too many edges would bend to both sides, or too few are bent


def _leaning(surface: PartSurface, h: Ints) -> tuple[Floats, Floats, Floats, Floats]:
    """Chords (n, 3) of half-edges, their parts along the normals at tail and head, mm, and the cosine between these normals."""
    corners, rows, following = surface.faces.reshape(-1), surface.sectors.reshape(-1), _following(h)
    chord = surface.vertices[corners[following]] - surface.vertices[corners[h]]
    n, m = surface.normals[rows[h]], surface.normals[rows[following]]
    return chord, _dot(chord, n), _dot(chord, m), _dot(n, m)


def _following(h: Ints, step: int = 1) -> Ints:
    """Half-edges that follow others in their facets."""
    return 3 * (h // 3) + (h + step) % 3


def _bent_edges(surface: PartSurface) -> _Edges:
    twin, free = surface.twin, surface.kind == FREEFORM
    h = np.flatnonzero(twin > np.arange(twin.size))
    h = h[free[h // 3] & free[twin[h] // 3]]
    chord, low, high, cosine = _leaning(surface, h)
    lift = 0.25 * np.minimum(np.abs(low), np.abs(high))
    bent = lift >= 0.25 * surface.sagittas.typical  # below that the side of a bend is unknown
    coherent = low * high * cosine < 0.0
    return _Edges(h[bent], chord[bent], lift[bent], coherent[bent], (low < 0.0)[bent])


def judge_bends(surface: PartSurface, edges: _Edges | None = None) -> Bends:
    """Judge a mesh by the normals at both ends of each edge."""
    typical = surface.sagittas.typical
    if not np.isfinite(typical):
        return Bends(True, False)
    edges = _bent_edges(surface) if edges is None else edges
    told = edges.half_edge.size
    # Where no edge bends the surface is ruled, as a cone is of single facets: noise would bend some. With fewer than 20 a surface may
    # be only what a decimation left of one.
    rough = 0 < told < 20 or np.count_nonzero(edges.coherent) < COHERENT_SHARE * told
    asked = np.flatnonzero(edges.coherent & (edges.lift_mm >= 3.0 * typical))
    if rough or asked.size < max(100, SCATTERED_ASKED * told):
        return Bends(False, bool(rough))
    h, chord = edges.half_edge[asked], edges.chord[asked]
    alike = _is_alike(surface, h, chord) & _is_alike(surface, _following(h), -chord)
    return Bends(bool(np.count_nonzero(alike) >= SCATTERED_SHARE * asked.size), False)


def _is_alike(surface: PartSurface, corner: Ints, chord: Floats) -> Bools:
    """Whether edges (n, 3) from corners and the neighbours behind these, in the same smooth fans, are of one curvature each."""
    by_fan = corners_by(surface.vertices, surface.faces, surface.fans)
    fan = surface.fans.reshape(-1)[corner]
    edge, place = each_of(np.diff(by_fan.starts)[fan])
    around = by_fan.corners[by_fan.starts[fan][edge] + place]
    edge = np.tile(edge, 2)
    other = np.concatenate([_following(around, step) for step in (1, 2)])
    vertex, normal = surface.faces.reshape(-1), surface.normals[surface.sectors.reshape(-1)[corner]]
    p = surface.vertices[vertex[other]] - surface.vertices[vertex[corner]][edge]
    far, length = np.linalg.norm(p, axis=1), np.linalg.norm(chord, axis=1)
    cosine = -_dot(p, chord[edge]) / np.maximum(far * length[edge], 1e-300)
    # Behind the end of an edge lies what is within 73 degrees of its extension.
    weight = np.where(cosine > 0.3, cosine * cosine, 0.0)
    reach = np.bincount(edge, weight * cosine * far, minlength=corner.size)
    drop = -np.bincount(edge, weight * _dot(p, normal[edge]) / np.maximum(far, 1e-300), minlength=corner.size)
    # Both are sums over the same weights; only their ratio matters, up to four to one.
    ahead = -_dot(chord, normal) / length
    ratio = ahead * reach / np.where(drop != 0.0, drop * length, np.inf)
    return np.asarray((reach > 0.0) & (ahead * drop > 0.0) & (ratio > 0.25) & (ratio < 4.0))


# -- turns ahead of the ends of edges ----------------------------------------------------------------------------

FAR = 3.0  # An end is *far* if the edge is this many times longer than the chord ahead of it, like a flat side beside a rounding

RIGHT_SHARE = 0.6
"""Share, by length, of such edges that the turns ahead must confirm, else none is believed. It is 0.6 or more on meshes of
scattered points and decimated meshes of surfaces that are curved all over, and below 0.5 where flat sides run into roundings."""

NOISE_SHARE = 0.7
"""Share, by length, of all bent edges that far ends contradict from which a mesh is noise; on others it is at most half."""


class FarEnds(NamedTuple):
    """Whether the turns ahead confirm the normals at edges far longer than the chords ahead of them."""

    are_right: (
        bool  # They do, as on meshes of scattered points and of surfaces curved all over; also where such edges are few
    )
    are_noise: bool  # They contradict the normals over most of the length of all bent edges, as on no surface


def judge_far_ends(edges: _Edges, ends: EndsAhead, height_mm: Floats) -> FarEnds:
    """Judge a mesh by the edges that are far longer than the chords ahead of them; contours meet an edge by its length."""
    h = edges.half_edge
    asked = edges.coherent & (ends.turns[h] >= 0)
    far = asked & (ends.ratio[h].max(axis=1, initial=0.0) > FAR)
    if np.count_nonzero(far) < 10:
        return FarEnds(True, False)
    length = np.linalg.norm(edges.chord, axis=1)
    lift = edges.lift_mm * plausible_share(edges.lift_mm, height_mm[h])
    right = far & (lift <= _most_free(ends, h, edges.outward, np.inf))
    every, told, borne_out = (float(length[which].sum()) for which in (asked, far, right))
    return FarEnds(borne_out >= RIGHT_SHARE * told, told - borne_out >= NOISE_SHARE * every)


def plausible_share(height: Floats, plausible: Floats) -> Floats:
    """Share of a lift that is left: all of a plausible one, and less in total the more is asked for beyond that."""
    return np.minimum(plausible / np.maximum(height, 1e-300), 1.0) ** 2


def _most_free(ends: EndsAhead, h: Ints, outward: Bools, typical: float) -> Floats:
    """How far edges between freely curved facets may be lifted to the outside, or to the inside, mm.

    By twice the height told by a far end, which scatters by as much where the normals are right. At six times the chord ahead an
    error of the turn is magnified so much that it tells little. A single turn ahead of both ends is a bend, not a curve.
    """
    told = np.where(outward[:, None], 1.0, -1.0) * ends.told[h]
    ratio = ends.ratio[h]
    most = np.where(ratio > FAR, np.maximum(2.0 * told, 0.0), np.inf)
    most = np.where(ratio > 6.0, np.minimum(most, 0.5 * typical), most)
    return np.where(ends.turns[h] < 2, 0.0, most.min(axis=1))


def _most_ahead(surface: PartSurface, ends: EndsAhead, far_ends_right: bool) -> Floats:
    """How far the turns ahead let each edge be lifted, (3 F,) mm; infinite where they say nothing.

    An edge inside of a strip is not lifted at all if a far end tells that the surface stands on its other side by more.
    """
    twin, kind = surface.twin, surface.kind
    most = np.full(twin.size, np.inf)
    h = np.flatnonzero(twin != NO_TWIN)
    _, low, high, _ = _leaning(surface, h)
    outward = low < 0.0
    strips = (kind[h // 3] == STRIP) & (kind[twin[h] // 3] == STRIP)
    side = np.where(outward, 1.0, -1.0)[:, None]
    lift = 0.25 * np.maximum(np.abs(low), np.abs(high))[:, None]
    against = ((ends.ratio[h] > FAR) & (side * ends.told[h] < -lift)).any(axis=1)
    most[h[strips & against]] = 0.0
    if not far_ends_right:
        free = h[~strips]
        most[free] = _most_free(ends, free, outward[~strips], surface.sagittas.typical)
    return most


def _ground(surface: PartSurface) -> Ground:
    by_fan = corners_by(surface.vertices, surface.faces, surface.fans)
    normals, centres = (
        np.ascontiguousarray(surface.facet_normals),
        circumcentres(surface.vertices[surface.faces]),
    )
    mesh = surface.vertices, surface.faces, surface.twin, surface.fans
    return Ground(*mesh, normals, by_fan.starts, by_fan.corners, centres)


def _dot(a: Floats, b: Floats) -> Floats:
    return np.asarray(np.einsum("ij,ij->i", a, b))

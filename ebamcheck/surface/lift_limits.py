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

from ebamcheck.kernels import Bools, Floats, Ints
from ebamcheck.mesh.topology import NO_TWIN
from ebamcheck.surface.part_surface import PartSurface
from ebamcheck.surface.regions import FREEFORM, PLANE, STRIP
from ebamcheck.surface.turns_ahead import EndsAhead, Ground, circumcentres, ends_ahead

LIMITS = ("plane", "sagitta of the mesh", "sagittas near", "scattered points", "turns ahead")
"""What limits the lift of an edge, by number."""

IN_PLANE, OF_MESH, NEAR, SCATTERED, AHEAD = range(len(LIMITS))

OF_TYPICAL = 4.0  # Largest plausible lift, over the median sagitta of the mesh
ANYWHERE = 2.0  # Lift that is plausible whatever lies near, over the median sagitta: slivers have no sagitta of their own
OF_LARGEST_NEAR = 4.0
"""Largest plausible lift, over the largest sagitta at that end of an edge where this is smaller."""

OF_MEAN_NEAR = 6.0
"""Largest plausible lift, over the mean sagitta at that end of an edge where this is greater; flat neighbours lower the mean."""

MOST_SCATTERED = 25.0  # Largest plausible lift on a mesh of scattered points, over the median sagitta
BY_CHANCE = 0.1  # Ratio of strips to freely curved facets up to which the strips are facets of a decimated mesh, coplanar by chance


class LiftLimits(NamedTuple):
    """How far contour points may be lifted over the edge of each half-edge."""

    plausible_mm: Floats
    """(3 F,) height of the surface over the edge, by sagittas, beyond which a lift grows less; infinite where nothing is known."""
    most_mm: Floats  # (3 F,) largest height, by the turns ahead, too
    acts: NDArray[np.uint8]  # (3 F,) which of LIMITS limits the height
    share: Floats  # (3,) share of a lift that is made, by the kind of region; 0 where the normals are noise


def lift_limits(surface: PartSurface, flat_mm: float) -> LiftLimits:
    """Judge a mesh with its normals, and limit the lifts over its edges; chords are one to `flat_mm`."""
    typical = surface.sagittas.typical
    tail, head = surface.faces.reshape(-1), np.roll(surface.faces, -1, axis=1).reshape(-1)
    mean, largest = surface.sagittas.mean, surface.sagittas.largest
    near = np.minimum(
        OF_LARGEST_NEAR * np.minimum(largest[tail], largest[head]),
        OF_MEAN_NEAR * np.maximum(mean[tail], mean[head]),
    )
    height = np.minimum(np.maximum(near, ANYWHERE * typical), OF_TYPICAL * typical)
    acts = np.where(height == near, NEAR, OF_MESH).astype(np.uint8)
    edges = _bent_edges(surface)
    bends = judge_bends(surface, edges)
    in_rows = surface.offsets.is_in_rows
    step = max(-(-len(surface.faces) // MOST_ASKED), 1) if in_rows else 1
    ends = ends_ahead(_ground(surface), flat_mm, step)
    far = judge_far_ends(edges, ends, typical, height)
    if bends.are_scattered and (in_rows or far.are_right):
        height[:], acts[:] = MOST_SCATTERED * typical, SCATTERED
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
        if np.count_nonzero(kind == STRIP) <= BY_CHANCE * np.count_nonzero(kind == FREEFORM):
            share[STRIP] = 0.0
    return LiftLimits(height, most, acts, share)


# -- bends: what the normals at both ends of the edges of freely curved facets demand ---------------------------

TELLS = 0.25  # Lift over the median sagitta from which an edge counts as bent, to a known side

COHERENT_SHARE = 0.85
"""A mesh is rough if less than this share of its bent edges bend to the same side at both ends: half do in noise, nineteen of
twenty on surfaces, saddles included, however meshed."""

LEAST_TOLD = 20
"""Fewest bent edges for that share to mean something: with fewer, a surface may be only what a decimation left of one."""

ASKS_MUCH = 3.0  # Lift over the median sagitta from which an edge demands much: its curvature is compared with that behind its ends
ALIKE = 4.0  # Largest ratio of two curvatures that still belong to one surface, on a mesh of scattered points

SCATTERED_SHARE = 0.8
"""A mesh is one of scattered points if at least this share of the edges that demand much are curved like their neighbours behind
both ends; on decimated meshes the share is below three fifths."""

SCATTERED_ASKED = 0.08
"""Least share of the bent edges that demand much on a mesh of scattered points. Such a mesh has edges of all lengths, and the
share is an eighth to a quarter. Where it is less, these edges are outliers."""

LEAST_ASKED = 100  # Fewest edges that demand much for that share to mean something

BEHIND_COSINE = 0.3
"""A neighbour lies behind the end of an edge if the cosine of its angle to the edge's extension is greater than this."""


class _Edges(NamedTuple):
    """Bent smooth edges between freely curved facets, each once."""

    half_edge: Ints
    chord: Floats  # (n, 3) from tail to head, mm
    lift_mm: Floats  # (n,) height that the lesser of both ends asks for
    coherent: Bools  # (n,) whether both ends ask for the same side
    outward: Bools  # (n,) whether that is the outer one


class Bends(NamedTuple):
    """Verdicts from the bends at both ends of edges."""

    are_scattered: bool  # The mesh is one of scattered points of a smooth surface: its long edges are curved like its short ones
    are_rough: bool
    """The freely curved facets determine no surface: too many edges would bend to opposite sides at their two ends, or too few
    are bent."""


def _bent_edges(surface: PartSurface) -> _Edges:
    twin, free = surface.twin, surface.kind == FREEFORM
    h = np.flatnonzero(twin > np.arange(twin.size))
    h = h[free[h // 3] & free[twin[h] // 3]]
    following = 3 * (h // 3) + (h + 1) % 3
    corners, rows = surface.faces.reshape(-1), surface.sectors.reshape(-1)
    chord = surface.vertices[corners[following]] - surface.vertices[corners[h]]
    n, m = surface.normals[rows[h]], surface.normals[rows[following]]
    low, high = _dot(chord, n), _dot(chord, m)
    lift = 0.25 * np.minimum(np.abs(low), np.abs(high))
    bent = lift >= TELLS * surface.sagittas.typical
    coherent = low * high * _dot(n, m) < 0.0
    return _Edges(h[bent], chord[bent], lift[bent], coherent[bent], (low < 0.0)[bent])


def judge_bends(surface: PartSurface, edges: _Edges | None = None) -> Bends:
    """Judge a mesh by the normals at both ends of each edge."""
    typical = surface.sagittas.typical
    if not np.isfinite(typical):
        return Bends(True, False)
    edges = _bent_edges(surface) if edges is None else edges
    told = edges.half_edge.size
    # Where no edge bends the surface is ruled, as a cone is of single facets: noise would bend some.
    rough = 0 < told < LEAST_TOLD or np.count_nonzero(edges.coherent) < COHERENT_SHARE * told
    asked = np.flatnonzero(edges.coherent & (edges.lift_mm >= ASKS_MUCH * typical))
    if rough or asked.size < max(LEAST_ASKED, SCATTERED_ASKED * told):
        return Bends(False, bool(rough))
    h, chord = edges.half_edge[asked], edges.chord[asked]
    following = 3 * (h // 3) + (h + 1) % 3
    alike = _is_alike(surface, h, chord) & _is_alike(surface, following, -chord)
    return Bends(bool(np.count_nonzero(alike) >= SCATTERED_SHARE * asked.size), False)


def _is_alike(surface: PartSurface, corner: Ints, chord: Floats) -> Bools:
    """Whether edges (n, 3) from corners and the neighbours behind these, in the same smooth fans, are of one curvature each."""
    starts, by_fan = corners_by(surface.fans)
    fan = surface.fans.reshape(-1)[corner]
    sizes = starts[fan + 1] - starts[fan]
    edge = np.repeat(np.arange(corner.size), sizes)
    first = np.repeat(starts[fan] - np.concatenate([[0], np.cumsum(sizes)[:-1]]), sizes)
    around = by_fan[first + np.arange(edge.size)]
    edge = np.tile(edge, 2)
    other = np.concatenate([3 * (around // 3) + (around + step) % 3 for step in (1, 2)])
    vertex, normal = surface.faces.reshape(-1), surface.normals[surface.sectors.reshape(-1)[corner]]
    p = surface.vertices[vertex[other]] - surface.vertices[vertex[corner]][edge]
    far, length = np.linalg.norm(p, axis=1), np.linalg.norm(chord, axis=1)
    cosine = -_dot(p, chord[edge]) / np.maximum(far * length[edge], 1e-300)
    weight = np.where(cosine > BEHIND_COSINE, cosine * cosine, 0.0)
    reach = np.bincount(edge, weight * cosine * far, minlength=corner.size)
    drop = -np.bincount(edge, weight * _dot(p, normal[edge]) / np.maximum(far, 1e-300), minlength=corner.size)
    # Both are sums over the same weights; only their ratio matters.
    ahead = -_dot(chord, normal) / length
    ratio = ahead * reach / np.where(drop != 0.0, drop * length, np.inf)
    return np.asarray((reach > 0.0) & (ahead * drop > 0.0) & (ratio > 1.0 / ALIKE) & (ratio < ALIKE))


def corners_by(numbers: NDArray[np.int32]) -> tuple[Ints, Ints]:
    """Corners 3 f + i by their number (F, 3): first of each number, one more for the end, and the corners."""
    flat = numbers.reshape(-1)
    starts = np.concatenate([[0], np.cumsum(np.bincount(flat))]).astype(np.int64)
    return starts, np.argsort(flat, kind="stable")


# -- turns ahead of the ends of edges ----------------------------------------------------------------------------

MOST_ASKED = 5_000  # Facets of a tessellator's mesh whose edges are checked for noise, evenly spread: more would add nothing
FAR = 3.0  # An end is *far* if the edge is this many times longer than the chord ahead of it, like a flat side beside a rounding
VERY_FAR = 6.0  # From this ratio of the edge to the chord ahead on, an error of the turn is magnified so much that it tells little
MOST_OF_TYPICAL = 0.5  # Largest lift of such a very long edge, over the mesh's median sagitta

MOST_OF_TOLD = 2.0
"""Largest lift of an edge, over the height told by a far end: that height scatters by as much where the normals are right."""

FEWEST_TURNS = 2  # Fewest turns ahead of both ends together: a single one is a bend, not a curve
LEAST_FAR = 10  # Fewest edges with a far end for the share that is confirmed to mean something

RIGHT_SHARE = 0.6
"""Share, by length, of such edges that the turns ahead must confirm, else none is believed. It is 0.6 or more on meshes of
scattered points and decimated meshes of surfaces that are curved all over, and below 0.5 where flat sides run into roundings."""

NOISE_SHARE = 0.7
"""Share, by length, of all bent edges that far ends contradict from which a mesh is noise; on others it is at most half."""


class FarEnds(NamedTuple):
    """Whether the turns ahead confirm the normals at edges far longer than the chords ahead of them."""

    are_right: bool
    """The turns confirm the normals, as on meshes of scattered points and decimated meshes of a surface that is curved all
    over; also if there are too few such edges."""
    are_noise: (
        bool  # The turns contradict the normals over most of the length of all bent edges, as on no surface
    )


def judge_far_ends(edges: _Edges, ends: EndsAhead, typical: float, height_mm: Floats) -> FarEnds:
    """Judge a mesh by the edges that are far longer than the chords ahead of them; contours meet an edge by its length."""
    h = edges.half_edge
    asked = edges.coherent & (ends.turns[h] >= 0)
    far = asked & (ends.ratio[h].max(axis=1, initial=0.0) > FAR)
    if np.count_nonzero(far) < LEAST_FAR:
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
    """How far edges between freely curved facets may be lifted to the outside, or to the inside, mm."""
    told = np.where(outward[:, None], 1.0, -1.0) * ends.told[h]
    ratio = ends.ratio[h]
    most = np.where(ratio > FAR, np.maximum(MOST_OF_TOLD * told, 0.0), np.inf)
    most = np.where(ratio > VERY_FAR, np.minimum(most, MOST_OF_TYPICAL * typical), most)
    return np.where(ends.turns[h] < FEWEST_TURNS, 0.0, most.min(axis=1))


def _most_ahead(surface: PartSurface, ends: EndsAhead, far_ends_right: bool) -> Floats:
    """How far the turns ahead let each edge be lifted, (3 F,) mm; infinite where they say nothing.

    An edge inside of a strip is not lifted at all if a far end tells that the surface stands on its other side by more.
    """
    twin, kind = surface.twin, surface.kind
    most = np.full(twin.size, np.inf)
    h = np.flatnonzero(twin != NO_TWIN)
    following = 3 * (h // 3) + (h + 1) % 3
    corners, rows = surface.faces.reshape(-1), surface.sectors.reshape(-1)
    chord = surface.vertices[corners[following]] - surface.vertices[corners[h]]
    low, high = (_dot(chord, surface.normals[rows[c]]) for c in (h, following))
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
    starts, corners = corners_by(surface.fans)
    return Ground(
        surface.vertices,
        surface.faces,
        surface.twin,
        surface.fans,
        np.ascontiguousarray(surface.facet_normals),
        starts.astype(np.int32),
        corners.astype(np.int32),
        circumcentres(surface.vertices[surface.faces]),
    )


def _dot(a: Floats, b: Floats) -> Floats:
    return np.asarray(np.einsum("ij,ij->i", a, b))

"""Plausible lifts: no facet stands many times farther from the surface of its mesh than the facets about it.

Who tessellates or decimates a part keeps to a chord error. An edge whose normals ask for many times the sagitta that the
facets about its ends have, by their turns, is a long side that borders on a fine rounding, or one whose ends were moved:
its normals are the rounding's, and it is left by so much less the more it asks for. Meshes of scattered points have no such
chord error; there long edges do ask for more, by as much as what lies behind their ends bears out.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ebamcheck.curves.ends_ahead import is_far, most_of_free
from ebamcheck.curves.regions import FREEFORM, PLANE
from ebamcheck.curves.surface_edges import (
    SurfaceMesh,
    Vector,
    behind,
    bend_at,
    dot,
    half_edges,
    minus,
    normals_of,
    scaled,
    vector,
)
from ebamcheck.mesh.topology import NO_TWIN, Index
from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Floats

OF_TYPICAL = 4.0
"""Times the median sagitta of the mesh that a plausible lift may be."""

ANYWHERE = 2.0
"""Times the median sagitta that is plausible whatever lies near: slivers have no sagitta, and stand where others do."""

OF_LARGEST_NEAR = 4.0
"""Times the largest sagitta at that end of an edge that has less of it."""

OF_MEAN_NEAR = 6.0
"""Times the mean sagitta at that end of an edge that has more of it: flat neighbours count."""

ASKS_MUCH = 3.0
"""Times the median sagitta from which an edge is asked whether what lies behind its ends is curved alike."""

ALIKE = 4.0
"""Ratio of two curvatures up to which they are one surface's, of scattered points."""

SCATTERED_SHARE = 0.8
"""Share of edges that ask for much, and lie in one curvature with what is behind both of their ends, from which a mesh is one
of scattered points: there are under three fifths of them in decimated meshes."""

SCATTERED_ASKED = 0.08
"""Share of the edges that tell a bend that ask for much on a mesh of scattered points, whose edges are of all lengths: it is an
eighth to a quarter there. Where fewer do, they stand out."""

MOST_SCATTERED = 25.0
"""Times the median sagitta that a plausible lift may be on a mesh of scattered points."""

LEAST_ASKED = 100
"""Edges from which such a share means something."""

TELLS = 0.25
"""Times the median sagitta from which an edge tells to which side it bends."""

COHERENT_SHARE = 0.85
"""Share of such edges that bend to one side at both ends, under which a mesh is rough: half do in noise, nineteen of twenty
on surfaces, saddles among them, however meshed."""

LEAST_TOLD = 20
"""Edges from which that share means something: fewer do not tell a surface from what a decimation has left of one."""

LEAST_FAR = 10
"""Edges with a far end from which it means something how many of them are borne out."""

RIGHT_SHARE = 0.6
"""Share of such edges that are borne out, under which none is believed: it is 0.6 or more on meshes of scattered points and on
decimated ones of surfaces that are curved all over, and under 0.5 where flat sides run into roundings."""

NOISE_SHARE = 0.7
"""Of the length of all edges that tell a bend, that far ends contradict, from which it is noise: half at most in others."""

LEAST_SAGITTA_MM = 1e-6
"""Facets that turn by less do not count among those that tell the median."""


class Sagittas(NamedTuple):
    """How far facets stand from their surface by their turns, mm."""

    mean: Floats
    """(V,) mean over the edges at a vertex, by their length."""
    largest: Floats
    """(V,) the largest of them."""
    typical: float
    """Median over the facets that are of no plane, by area; infinite where nothing is known."""


def no_sagittas(vertex_count: int) -> Sagittas:
    """Where nothing is known, any lift is plausible."""
    return Sagittas(np.full(vertex_count, np.inf), np.full(vertex_count, np.inf), np.inf)


def mesh_sagittas(
    vertices: Floats, faces: Index, twin: Index, normals: Floats, kind: NDArray[np.uint8]
) -> Sagittas:
    """Sagittas at the vertices of a mesh; `twin` lacks those across creases, `normals` (F, 3) are one for each plane."""
    edge = np.zeros(twin.size)
    areas = np.zeros(len(faces))
    mean, largest = np.zeros(len(vertices)), np.zeros(len(vertices))
    _find_sagittas(vertices, faces, twin, normals, edge, areas, mean, largest)
    of_facet = edge.reshape(-1, 3).max(axis=1, initial=0.0)
    told = (kind != PLANE) & (of_facet > LEAST_SAGITTA_MM)
    if not told.any():
        return no_sagittas(len(vertices))
    order = np.argsort(of_facet[told], kind="stable")
    below = np.cumsum(areas[told][order])
    typical = of_facet[told][order][np.searchsorted(below, 0.5 * below[-1])]
    return Sagittas(mean, largest, float(typical))


@kernel
def _find_sagittas(
    vertices: Floats,
    faces: Index,
    twin: Index,
    normals: Floats,
    edge: Floats,
    areas: Floats,
    mean: Floats,
    largest: Floats,
) -> None:
    """Sagittas of chords across edges: of an arc over the lower of the two facets that turns by what they turn."""
    heights = np.zeros(twin.size)
    lengths = np.zeros(twin.size)
    for f in range(len(faces)):
        a, b, c = (
            vector(vertices, faces[f, 0]),
            vector(vertices, faces[f, 1]),
            vector(vertices, faces[f, 2]),
        )
        u, v = minus(b, a), minus(c, a)
        x, y, z = u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]
        areas[f] = 0.5 * np.sqrt(x * x + y * y + z * z)
        w = minus(c, b)
        lengths[3 * f], lengths[3 * f + 1], lengths[3 * f + 2] = (
            np.sqrt(dot(u, u)),
            np.sqrt(dot(w, w)),
            np.sqrt(dot(v, v)),
        )
        for k in range(3):
            heights[3 * f + k] = 2.0 * areas[f] / max(lengths[3 * f + k], 1e-300)
    weights = np.zeros(len(vertices))
    for h in range(twin.size):
        g = twin[h]
        if g == NO_TWIN:
            continue
        n, m = vector(normals, h // 3), vector(normals, g // 3)
        d = minus(n, m)
        turn = 2.0 * np.arcsin(min(0.5 * np.sqrt(dot(d, d)), 1.0))
        edge[h] = turn * min(heights[h], heights[g]) / 8.0
        for corner in (h % 3, (h % 3 + 1) % 3):
            i = faces[h // 3, corner]
            mean[i] += lengths[h] * edge[h]
            weights[i] += lengths[h]
            largest[i] = max(largest[i], edge[h])
    for i in range(len(vertices)):
        if weights[i] > 0.0:
            mean[i] /= weights[i]


@kernel
def plausible_height(mesh: SurfaceMesh, a: int, b: int) -> float:
    """How high a surface plausibly stands over an edge from vertex a to b, mm."""
    if mesh.scattered:
        return MOST_SCATTERED * mesh.typical
    near = min(
        OF_LARGEST_NEAR * min(mesh.largest[a], mesh.largest[b]),
        OF_MEAN_NEAR * max(mesh.mean[a], mesh.mean[b]),
    )
    return float(min(max(near, ANYWHERE * mesh.typical), OF_TYPICAL * mesh.typical))


@kernel
def plausible_share(height: float, plausible: float) -> float:
    """Share of a lift that is left: all of a plausible one, and less in total the more is asked for beyond that."""
    if height <= plausible:
        return 1.0
    return float((plausible / height) ** 2)


class FarEnds(NamedTuple):
    """What the turns ahead say of what the normals ask for, at edges that are far longer than the chords ahead of them."""

    are_right: bool
    """They bear it out, as on meshes of scattered points and on decimated ones of a surface that is curved all over; a
    tessellator's mesh has next to no such edges."""
    are_noise: bool
    """They contradict it, at most of all edges: no surface is so."""


def judge_far_ends(mesh: SurfaceMesh) -> FarEnds:
    """Judge a mesh by the edges that are far longer than the chords ahead of them."""
    count, told, right, every = _count_far(mesh)
    if count < LEAST_FAR:
        return FarEnds(True, False)
    return FarEnds(bool(right >= RIGHT_SHARE * told), bool(told - right >= NOISE_SHARE * every))


@kernel
def _count_far(mesh: SurfaceMesh) -> tuple[int, float, float, float]:
    """Smooth edges between freely curved facets that tell a bend and have a far end; lengths of them, of those borne out, and
    of all that tell a bend. Contours meet an edge by its length.
    """
    count, told, right, every = 0, 0.0, 0.0, 0.0
    for h in range(mesh.smooth.size):
        f, k = h // 3, h % 3
        if not mesh.smooth[h] or mesh.kind[f] != FREEFORM or mesh.ends.turns[h] < 0:
            continue
        low, high = mesh.faces[f, k], mesh.faces[f, (k + 1) % 3]
        if low > high:
            continue
        up, down = half_edges(mesh, low, high)
        if up < 0 or down < 0 or mesh.kind[down // 3] != FREEFORM:
            continue
        chord = minus(vector(mesh.vertices, high), vector(mesh.vertices, low))
        n, m = normals_of(mesh, up)
        p, q = bend_at(chord, n, n, True), bend_at(chord, m, m, True)
        height = 0.25 * np.sqrt(min(dot(p, p), dot(q, q)))
        if height < TELLS * mesh.typical or dot(p, q) >= 0.0:
            continue
        length = np.sqrt(dot(chord, chord))
        every += length
        if not is_far(mesh.ends, h):
            continue
        count += 1
        told += length
        height *= plausible_share(height, plausible_height(mesh, low, high))
        if height <= most_of_free(mesh.ends, h, dot(p, n) > 0.0, np.inf):
            right += length
    return count, told, right, every


class Ends(NamedTuple):
    """What the two ends of the smooth edges of a mesh's freely curved facets say of each other."""

    is_scattered: bool
    """The mesh is one of scattered points of a smooth surface: its long edges are curved as its short ones."""
    is_rough: bool
    """At too many edges the surface would bend to one side at one end and to the other at the other, or too few tell: there
    is no surface of the freely curved facets to be told."""


def judge_ends(mesh: SurfaceMesh) -> Ends:
    """Judge a mesh by the normals at both ends of each edge."""
    if not np.isfinite(mesh.typical):
        return Ends(True, False)
    told, coherent, asked, alike = _count_ends(mesh)
    # Where no edge bends the surface is ruled, as a cone is of single facets: noise would bend some.
    rough = 0 < told < LEAST_TOLD or coherent < COHERENT_SHARE * told
    several = asked >= max(LEAST_ASKED, SCATTERED_ASKED * told)
    scattered = not rough and several and alike >= SCATTERED_SHARE * asked
    return Ends(bool(scattered), bool(rough))


@kernel
def _count_ends(mesh: SurfaceMesh) -> tuple[int, int, int, int]:
    """Edges that tell a bend, and those that bend to one side; edges that ask for much, and those that may."""
    told = coherent = asked = alike = 0
    for h in range(mesh.smooth.size):
        f, k = h // 3, h % 3
        low, high = mesh.faces[f, k], mesh.faces[f, (k + 1) % 3]
        if low > high or not mesh.smooth[h] or mesh.kind[f] != FREEFORM:
            continue
        up, down = half_edges(mesh, low, high)
        if up < 0 or down < 0 or mesh.kind[down // 3] != FREEFORM:
            continue
        chord = minus(vector(mesh.vertices, high), vector(mesh.vertices, low))
        n, m = normals_of(mesh, up)
        p, q = bend_at(chord, n, n, True), bend_at(chord, m, m, True)
        height = 0.25 * np.sqrt(min(dot(p, p), dot(q, q)))
        if height < TELLS * mesh.typical:
            continue
        told += 1
        if dot(p, q) >= 0.0:
            continue
        coherent += 1
        if height < ASKS_MUCH * mesh.typical:
            continue
        asked += 1
        if _is_alike(mesh, up, k, chord, n) and _is_alike(mesh, up, (k + 1) % 3, scaled(chord, -1.0), m):
            alike += 1
    return told, coherent, asked, alike


@kernel
def _is_alike(mesh: SurfaceMesh, up: int, corner: int, chord: Vector, normal: Vector) -> bool:
    """Whether an edge and what lies behind its end are of one curvature; so they are where nothing lies there."""
    found = behind(mesh, up // 3, corner, chord, normal)
    if found.reach == 0.0:
        return False
    length = np.sqrt(dot(chord, chord))
    ahead = -dot(chord, normal) / length
    if ahead * found.drop <= 0.0:
        return False
    ratio = (ahead * found.reach) / (found.drop * length)
    return bool(1.0 / ALIKE < ratio < ALIKE)

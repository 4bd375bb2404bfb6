"""Plausible lifts: no facet is many times farther from the surface than the facets around it.

Tessellation and decimation keep to a chord error. If the normals of an edge demand many times the sagitta that the facets about
its ends have by their dihedral angles, it is a long side that borders on a fine rounding, whose normals it has, or its ends were
moved. Its lift is then made smaller the more the normals demand. Meshes of scattered points keep to no chord error: there the
long edges do need a larger lift, up to what the neighbours behind their ends confirm.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ebamcheck.curves.ends_ahead import is_contradicted, is_far, most_of_free
from ebamcheck.curves.regions import FREEFORM, PLANE, STRIP
from ebamcheck.curves.regions.segmentation import INWARD, OUTWARD
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
"""Largest plausible lift, over the median sagitta of the mesh."""

ANYWHERE = 2.0
"""Lift that is plausible whatever lies near, over the median sagitta: slivers have no sagitta of their own."""

OF_LARGEST_NEAR = 4.0
"""Largest plausible lift, over the largest sagitta at that end of an edge where this is smaller."""

OF_MEAN_NEAR = 6.0
"""Largest plausible lift, over the mean sagitta at that end of an edge where this is greater; flat neighbours lower the mean."""

ASKS_MUCH = 3.0
"""Lift over the median sagitta from which an edge demands much: its curvature is compared with that behind its ends."""

ALIKE = 4.0
"""Largest ratio of two curvatures that still belong to one surface, on a mesh of scattered points."""

SCATTERED_SHARE = 0.8
"""A mesh is one of scattered points if at least this share of the edges that demand much are curved like their neighbours behind
both ends; on decimated meshes the share is below three fifths."""

SCATTERED_ASKED = 0.08
"""Least share of the bent edges that demand much on a mesh of scattered points. Such a mesh has edges of all lengths, and the
share is an eighth to a quarter. Where it is less, these edges are outliers."""

MOST_SCATTERED = 25.0
"""Largest plausible lift on a mesh of scattered points, over the median sagitta."""

LEAST_ASKED = 100
"""Fewest edges that demand much for that share to mean something."""

TELLS = 0.25
"""Lift over the median sagitta from which an edge counts as bent, to a known side."""

COHERENT_SHARE = 0.85
"""A mesh is rough if less than this share of its bent edges bend to the same side at both ends: half do in noise, nineteen of
twenty on surfaces, saddles included, however meshed."""

LEAST_TOLD = 20
"""Fewest bent edges for that share to mean something: with fewer, a surface may be only what a decimation left of one."""

LEAST_FAR = 10
"""Fewest edges with a far end (:data:`ebamcheck.curves.ends_ahead.FAR`) for the share that is confirmed to mean something."""

RIGHT_SHARE = 0.6
"""Share, by length, of such edges that the turns ahead must confirm, else none is believed. It is 0.6 or more on meshes of
scattered points and decimated meshes of surfaces that are curved all over, and below 0.5 where flat sides run into roundings."""

NOISE_SHARE = 0.7
"""Share, by length, of all bent edges that far ends contradict from which a mesh is noise; on others it is at most half."""

LEAST_SAGITTA_MM = 1e-6
"""Facets with a smaller sagitta are left out of the median."""


class Sagittas(NamedTuple):
    """Sagittas of facets, by their dihedral angles, mm."""

    mean: Floats
    """(V,) mean over the edges at a vertex, weighted by their lengths."""
    largest: Floats
    """(V,) largest at a vertex."""
    typical: float
    """Median over the facets outside of planes, weighted by area; infinite where nothing is known."""


def no_sagittas(vertex_count: int) -> Sagittas:
    """Sagittas of a mesh of which nothing is known: any lift is plausible."""
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
    """Whether the turns ahead confirm the normals at edges far longer than the chords ahead of them."""

    are_right: bool
    """The turns confirm the normals, as on meshes of scattered points and decimated meshes of a surface that is curved all
    over; also if there are too few such edges, as on a tessellator's mesh."""
    are_noise: bool
    """The turns contradict the normals over most of the length of all bent edges, as on no surface."""


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
    """Verdicts from the bends at the two ends of the smooth edges of freely curved facets."""

    is_scattered: bool
    """The mesh is one of scattered points of a smooth surface: its long edges are curved like its short ones."""
    is_rough: bool
    """The freely curved facets determine no surface: too many edges would bend to opposite sides at their two ends, or too few
    are bent."""


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
    """Whether an edge and the neighbours behind its end are of one curvature; False where there are none."""
    found = behind(mesh, up // 3, corner, chord, normal)
    if found.reach == 0.0:
        return False
    length = np.sqrt(dot(chord, chord))
    ahead = -dot(chord, normal) / length
    if ahead * found.drop <= 0.0:
        return False
    ratio = (ahead * found.reach) / (found.drop * length)
    return bool(1.0 / ALIKE < ratio < ALIKE)


# -- Sure lifts: the share of a lift that the turns ahead of an edge and the bends beside it support, apart
# from its normals.


OF_ROUNDING = 4.0
"""Largest sagitta of a bend beside a strip, over the median of the mesh, that may be a coarse rounding's: a tessellator keeps to
one chord error."""


@kernel
def told_share(mesh: SurfaceMesh, up: int, down: int, height: float, outward: bool) -> float:
    """Share of a lift that the turns ahead of the ends of its edge let be."""
    if mesh.kind[up // 3] == STRIP and mesh.kind[down // 3] == STRIP:
        return 0.0 if is_contradicted(mesh.ends, up, outward, height) else 1.0
    if mesh.far_ends_right:
        return 1.0
    return float(min(1.0, most_of_free(mesh.ends, up, outward, mesh.typical) / height))


@kernel
def sure_share(mesh: SurfaceMesh, up: int, down: int, height: float, outward: bool) -> float:
    """Share of a lift inside of a strip that leaves it no farther from the surface, be the bends at its sides a rounding's or not.

    If they are, the surface is the rim's sagitta off to the other side: the error without a lift is the difference of both.
    """
    if mesh.kind[up // 3] != STRIP or mesh.kind[down // 3] != STRIP:
        return 1.0
    rim = max(
        mesh.rims[mesh.region[up // 3], INWARD if outward else OUTWARD],
        mesh.rims[mesh.region[down // 3], INWARD if outward else OUTWARD],
    )
    if rim > OF_ROUNDING * mesh.typical:
        return 1.0
    return float(min(max(2.0 * (1.0 - rim / height), 0.0), 1.0))

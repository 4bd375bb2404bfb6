"""Normals of the surface that a mesh approximates, at its vertices, separately on the two sides of a crease.

A *sector* is a set of facet corners about one vertex that no crease separates: a smooth vertex has one, a
vertex on a sharp edge two, the corner of a cube three. Each sector has a normal of its own: that of a flat
side that ends there; else that of a quadric through the vertex fitted to its neighbours, if there are enough to
determine one; else the mean of the facets' normals weighted by their angles.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ebamcheck.curves.exact import ExactSurfaces, exact_surfaces, no_surfaces
from ebamcheck.curves.flat_sides import flat_sides, keep_flat
from ebamcheck.curves.per_part import once_a_part
from ebamcheck.curves.plausible import Sagittas, mesh_sagittas, no_sagittas
from ebamcheck.curves.regions import FREEFORM, PLANE, find_regions
from ebamcheck.curves.regions.noise import rough_rows
from ebamcheck.curves.regions.normals import region_normals
from ebamcheck.curves.regions.offsets import NOTHING_TOLD, Offsets, vertex_offsets
from ebamcheck.curves.regions.rims import rim_sagittas
from ebamcheck.mesh.part import Part
from ebamcheck.mesh.topology import NO_TWIN, Index, edge_groups, split_corners, twins
from ebamcheck.numeric.elimination import eliminated
from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Bools, Floats
from ebamcheck.settings.stages import CurveSettings

COEFFICIENTS = 5
"""Of a quadric through the vertex: two slopes and three curvatures."""

LEAST_PIVOT = 1e-5
"""Least pivot of the normal equations, scaled to a unit diagonal, for neighbours that determine a quadric: below it they
lie on one conic, or are too few."""


class SurfaceNormals(NamedTuple):
    """Normals of the smooth surface at the corners of facets."""

    sectors: Index
    """(F, 3) row of the normal of each corner of each facet."""
    normals: Floats
    """(S, 3) unit normals."""
    smooth: Bools
    """(3 F,) whether the surface continues across half-edge ``3 f + i`` without a crease."""
    flat: Bools
    """(F,) whether the facet is coplanar with a neighbour: in a strip of a cylinder, or a flat side."""
    kind: NDArray[np.uint8]
    """(F,) kind of region of the facet; all :data:`FREEFORM` without regions."""
    region: Index
    """(F,) planar group of the facet; its own number without regions."""
    fans: Index
    """(F, 3) smooth fan about the vertex that each corner belongs to, whatever the regions in it."""
    rough: Bools
    """(S,) whether the noise of the vertices about exceeds what lifting could gain there."""
    noise: Floats
    """(S,) residual of the fitted surface at the vertices about, mm; infinite where it is unknown."""
    with_regions: bool
    """Whether the mesh was segmented."""
    sagittas: Sagittas
    """How far facets are from the surface, by their dihedral angles."""
    offsets: Offsets
    """Whether the vertices lie on the surface; :data:`NOTHING_TOLD` without regions."""
    rims: Floats
    """(G, 2) how far a surface would stand off the strip of each region, mm, if the bends at its sides were a rounding's."""
    crease_angle_deg: float
    """Crease angle with which the normals were estimated."""
    exact: ExactSurfaces
    """Surfaces that are known by formula; none without regions."""


@once_a_part
def surface_normals(part: Part, settings: CurveSettings) -> SurfaceNormals:
    """Estimate the normals of the surface that a mesh approximates.

    Parameters
    ----------
    part
        The mesh.
    settings
        Edges whose facets' normals differ by at least the crease angle are sharp; so are edges with only one facet, or with
        facets that do not run in opposite directions along it. With regions, so is every bend between two planes.
    """
    groups = edge_groups(part.faces, len(part.vertices))
    twin = twins(part.vertices, part.faces, groups.half_edges, groups.starts)
    if settings.regions == "off":
        return _plain_normals(part, twin, settings.crease_angle_deg)
    whole = twin.copy()
    regions = find_regions(part, twin, settings)
    label = regions.groups.label
    found = region_normals(part, twin, regions)
    smooth, kind = twin != NO_TWIN, regions.kind[label]
    stands_off = mesh_sagittas(part.vertices, part.faces, twin, regions.groups.normals[label], kind)
    rims = rim_sagittas(twin, whole, label, regions.borders, regions.kind)
    return SurfaceNormals(
        found.rows,
        found.normals,
        smooth,
        kind == PLANE,
        kind,
        label,
        found.fans,
        rough_rows(part.vertices, part.faces, found),
        np.nan_to_num(found.noise, nan=np.inf),
        True,
        stands_off,
        vertex_offsets(part.vertices, part.faces, smooth, found.fans, kind == FREEFORM),
        rims,
        settings.crease_angle_deg,
        exact_surfaces(part, twin, whole, regions, rims, stands_off.typical),
    )


def _plain_normals(part: Part, twin: Index, crease_angle_deg: float) -> SurfaceNormals:
    """Normals without regions: by quadrics and widths of flat sides."""
    vertices, faces = part.vertices, part.faces
    facet_normals = _facet_normals(vertices, faces)
    sides = flat_sides(vertices, faces, facet_normals, twin)
    _part_at_creases(faces, facet_normals, twin, np.cos(np.deg2rad(crease_angle_deg)))
    sectors = split_corners(faces, twin)
    count = int(sectors.max(initial=-1)) + 1
    means, scales = _means(vertices, faces, facet_normals, sectors, count)
    normals = means.copy()
    equations = _equations(vertices, faces, sectors, means, scales)
    _tilt_by_quadrics(means, equations, _least_cosines(facet_normals, sectors, means), normals)
    keep_flat(vertices, faces, twin, sectors, sides, normals)
    return SurfaceNormals(
        sectors,
        normals,
        twin != NO_TWIN,
        sides.flat[sides.groups],
        np.full(len(faces), FREEFORM, np.uint8),
        np.arange(len(faces), dtype=np.int32),
        sectors,
        np.zeros(count, np.bool_),
        np.zeros(count),
        False,
        no_sagittas(len(vertices)),
        NOTHING_TOLD,
        np.zeros((0, 2)),
        crease_angle_deg,
        no_surfaces(len(faces)),
    )


@kernel
def _facet_normals(vertices: Floats, faces: Index) -> Floats:
    """Unit normals (F, 3); zero for a facet without area."""
    result = np.zeros((len(faces), 3))
    for f in range(len(faces)):
        a, b, c = vertices[faces[f, 0]], vertices[faces[f, 1]], vertices[faces[f, 2]]
        x, y, z = _cross(b - a, c - a)
        length = np.sqrt(x * x + y * y + z * z)
        if length > 0.0:
            result[f, 0], result[f, 1], result[f, 2] = x / length, y / length, z / length
    return result


@kernel
def _cross(a: Floats, b: Floats) -> tuple[float, float, float]:
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


@kernel
def _dot(a: Floats, b: Floats) -> float:
    return float(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


@kernel
def _part_at_creases(faces: Index, facet_normals: Floats, twin: Index, least_cosine: float) -> None:
    """Take the twins from half-edges at which the surface is sharp."""
    for h in range(twin.size):
        g = twin[h]
        if g < h:
            continue
        f, e = h // 3, g // 3
        same_way = faces[f, h % 3] == faces[e, g % 3]
        if same_way or _dot(facet_normals[f], facet_normals[e]) <= least_cosine:
            twin[h] = twin[g] = NO_TWIN


@kernel
def _means(
    vertices: Floats, faces: Index, facet_normals: Floats, sectors: Index, count: int
) -> tuple[Floats, Floats]:
    """Mean normals (S, 3) weighed by angle, and mean squared distances (S,) of the neighbours, mm2."""
    means, scales = np.zeros((count, 3)), np.zeros(count)
    corners = np.zeros(count)
    for f in range(len(faces)):
        for k in range(3):
            s = sectors[f, k]
            here = vertices[faces[f, k]]
            p, q = vertices[faces[f, (k + 1) % 3]] - here, vertices[faces[f, (k + 2) % 3]] - here
            x, y, z = _cross(p, q)
            angle = np.arctan2(np.sqrt(x * x + y * y + z * z), _dot(p, q))
            means[s] += facet_normals[f] * angle
            scales[s] += 0.5 * (_dot(p, p) + _dot(q, q))
            corners[s] += 1.0
    for s in range(count):
        length = np.sqrt(_dot(means[s], means[s]))
        if length > 0.0:
            means[s] /= length
        scales[s] /= max(corners[s], 1.0)
    return means, scales


@kernel
def _least_cosines(facet_normals: Floats, sectors: Index, means: Floats) -> Floats:
    """Cosine of the greatest angle between a sector's mean normal and that of one of its facets, (S,)."""
    result = np.ones(len(means))
    for f in range(len(sectors)):
        for k in range(3):
            s = sectors[f, k]
            result[s] = min(result[s], _dot(facet_normals[f], means[s]))
    return result


@kernel
def _frame(n: Floats) -> tuple[Floats, Floats]:
    """Two unit vectors that span the plane across a unit normal."""
    u = np.zeros(3)
    u[np.argmin(np.abs(n))] = 1.0
    u -= n * _dot(u, n)
    u /= np.sqrt(_dot(u, u))
    x, y, z = _cross(n, u)
    return u, np.array([x, y, z])


@kernel
def _equations(vertices: Floats, faces: Index, sectors: Index, means: Floats, scales: Floats) -> Floats:
    """Normal equations (S, 5, 6) of the quadric of each sector, in units of its mean distance.

    z = a x + b y + c x^2 / 2 + d x y + e y^2 / 2 over the plane across the mean normal, each neighbour weighed by
    one over its squared distance.
    """
    result = np.zeros((len(means), COEFFICIENTS, COEFFICIENTS + 1))
    row = np.empty(COEFFICIENTS + 1)
    for f in range(len(faces)):
        for k in range(3):
            s = sectors[f, k]
            if scales[s] == 0.0:
                continue
            unit = np.sqrt(scales[s])
            u, w = _frame(means[s])
            for step in (1, 2):
                d = (vertices[faces[f, (k + step) % 3]] - vertices[faces[f, k]]) / unit
                square = _dot(d, d)
                if square == 0.0:
                    continue
                x, y = _dot(d, u), _dot(d, w)
                row[0], row[1], row[2], row[3], row[4] = x, y, 0.5 * x * x, x * y, 0.5 * y * y
                row[5] = _dot(d, means[s])
                for i in range(COEFFICIENTS):
                    for j in range(COEFFICIENTS + 1):
                        result[s, i, j] += row[i] * row[j] / square
    return result


@kernel
def _tilt_by_quadrics(means: Floats, equations: Floats, least_cosines: Floats, normals: Floats) -> None:
    """Tilt mean normals to those of the quadrics, where there is one and it lies among the facets' normals."""
    for s in range(len(means)):
        if not eliminated(equations[s], COEFFICIENTS, LEAST_PIVOT):
            continue
        u, w = _frame(means[s])
        n = means[s] - equations[s, 0, COEFFICIENTS] * u - equations[s, 1, COEFFICIENTS] * w
        n /= np.sqrt(_dot(n, n))
        if _dot(n, means[s]) >= least_cosines[s]:
            normals[s] = n


def corners_of_vertices(faces: Index, vertex_count: int) -> tuple[NDArray[np.int64], Index]:
    """Corners ``3 f + i`` by vertex: first of each vertex (V + 1,), and the corners (3 F,)."""
    flat = faces.reshape(-1)
    starts = np.concatenate([[0], np.cumsum(np.bincount(flat, minlength=vertex_count))]).astype(np.int64)
    return starts, np.argsort(flat, kind="stable").astype(np.int32)

"""Normals of the surface that a mesh approximates, at its vertices, separately on the two sides of a crease.

A *sector* is a set of facet corners about one vertex that no crease separates: a smooth vertex has one, a
vertex on a sharp edge two, the corner of a cube three. Each sector has a normal of its own, by the regions of the mesh
(:mod:`ebamcheck.curves.regions.normals`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ebamcheck.curves.exact import ExactSurfaces, exact_surfaces
from ebamcheck.curves.per_part import once_a_part
from ebamcheck.curves.plausible import Sagittas, mesh_sagittas
from ebamcheck.curves.regions import FREEFORM, PLANE, find_regions
from ebamcheck.curves.regions.normals import region_normals, rough_rows
from ebamcheck.curves.regions.offsets import Offsets, vertex_offsets
from ebamcheck.curves.regions.segmentation import rim_sagittas
from ebamcheck.mesh.part import Part
from ebamcheck.mesh.topology import NO_TWIN, Index, edge_groups, twins
from ebamcheck.numeric.rings import Bools, Floats
from ebamcheck.settings.stages import CurveSettings


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
    """(F,) kind of region of the facet."""
    region: Index
    """(F,) planar group of the facet."""
    fans: Index
    """(F, 3) smooth fan about the vertex that each corner belongs to, whatever the regions in it."""
    rough: Bools
    """(S,) whether the noise of the vertices about exceeds what lifting could gain there."""
    noise: Floats
    """(S,) residual of the fitted surface at the vertices about, mm; infinite where it is unknown."""
    sagittas: Sagittas
    """How far facets are from the surface, by their dihedral angles."""
    offsets: Offsets
    """Whether the vertices lie on the surface."""
    rims: Floats
    """(G, 2) how far a surface would stand off the strip of each region, mm, if the bends at its sides were a rounding's."""
    crease_angle_deg: float
    """Crease angle with which the normals were estimated."""
    exact: ExactSurfaces
    """Surfaces that are known by formula."""


@once_a_part
def surface_normals(part: Part, settings: CurveSettings) -> SurfaceNormals:
    """Estimate the normals of the surface that a mesh approximates.

    Parameters
    ----------
    part
        The mesh.
    settings
        Edges whose facets' normals differ by at least the crease angle are sharp; so are edges with only one facet, or with
        facets that do not run in opposite directions along it, and every bend between two planes.
    """
    groups = edge_groups(part.faces, len(part.vertices))
    twin = twins(part.vertices, part.faces, groups.half_edges, groups.starts)
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
        stands_off,
        vertex_offsets(part.vertices, part.faces, smooth, found.fans, kind == FREEFORM),
        rims,
        settings.crease_angle_deg,
        exact_surfaces(part, twin, whole, regions, rims, stands_off.typical),
    )


def corners_of_vertices(faces: Index, vertex_count: int) -> tuple[NDArray[np.int64], Index]:
    """Corners ``3 f + i`` by vertex: first of each vertex (V + 1,), and the corners (3 F,)."""
    flat = faces.reshape(-1)
    starts = np.concatenate([[0], np.cumsum(np.bincount(flat, minlength=vertex_count))]).astype(np.int64)
    return starts, np.argsort(flat, kind="stable").astype(np.int32)

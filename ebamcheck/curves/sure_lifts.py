"""Sure lifts: the share of a lift that the turns ahead of an edge and the bends beside it support, apart from its normals."""

from __future__ import annotations

from ebamcheck.curves.ends_ahead import is_contradicted, most_of_free
from ebamcheck.curves.regions import STRIP
from ebamcheck.curves.regions.rims import INWARD, OUTWARD
from ebamcheck.curves.surface_edges import SurfaceMesh
from ebamcheck.numeric.kernels import kernel

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

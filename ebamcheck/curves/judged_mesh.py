"""Judged mesh: a mesh with its estimated normals, and whether the mesh itself supports them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ebamcheck.curves.ends_ahead import ends_ahead, nothing_asked
from ebamcheck.curves.plausible import judge_ends, judge_far_ends
from ebamcheck.curves.regions import FREEFORM, STRIP
from ebamcheck.curves.sagitta import surface_of
from ebamcheck.curves.surface_edges import SurfaceMesh
from ebamcheck.curves.vertex_normals import SurfaceNormals, corners_of_vertices
from ebamcheck.mesh.part import Part
from ebamcheck.numeric.rings import Bools

BY_CHANCE = 0.1
"""Ratio of strips to freely curved facets up to which the strips are facets of a decimated mesh, coplanar by chance."""

MOST_ASKED = 5_000
"""Facets of a tessellator's mesh whose edges are checked for noise, evenly spread: more would add nothing."""


def judged_mesh(part: Part, normals: SurfaceNormals) -> SurfaceMesh:
    """Put mesh and normals together, and judge them.

    Parameters
    ----------
    part
        The mesh that was cut.
    normals
        Its normals.
    """
    starts, corners = corners_of_vertices(part.faces, len(part.vertices))
    mesh = SurfaceMesh(
        part.vertices,
        part.faces,
        normals.sectors,
        normals.normals,
        normals.smooth,
        normals.flat,
        normals.kind,
        normals.region,
        normals.fans,
        normals.rough,
        normals.noise,
        starts,
        corners,
        *normals.sagittas,
        normals.rims,
        nothing_asked(),
        True,
        False,
        1.0,
        *normals.exact,
    )
    mesh, noisy = _with_ends(mesh, part, normals)
    ends = judge_ends(mesh)
    rough = mesh.rough.copy()
    share = normals.offsets.lift_share
    if ends.is_rough or noisy or share == 0.0:
        rough[mesh.sectors[_nothing_to_tell(mesh.kind)]] = True
    scattered = ends.is_scattered and mesh.far_ends_right
    return mesh._replace(scattered=scattered, rough=rough, share=share)


def _nothing_to_tell(kind: NDArray[np.uint8]) -> Bools:
    """Facets (F,) to leave unlifted if the freely curved ones show no surface: these, and strips that are few enough for chance."""
    free, strip = kind == FREEFORM, kind == STRIP
    by_chance = np.count_nonzero(strip) <= BY_CHANCE * np.count_nonzero(free)
    return np.asarray(free | strip if by_chance else free)


def _with_ends(mesh: SurfaceMesh, part: Part, normals: SurfaceNormals) -> tuple[SurfaceMesh, bool]:
    """The mesh with the turns ahead of its edges, if its normals need that check, and whether they show noise.

    A sample of edges is enough to find noise. The normals of a tessellator's mesh need no further check; on any other mesh all
    edges are checked, and the result is kept.
    """
    in_rows = normals.offsets.is_in_rows
    surface = surface_of(part, np.cos(np.deg2rad(normals.crease_angle_deg)))
    mesh = mesh._replace(ends=ends_ahead(surface, -(-len(part.faces) // MOST_ASKED) if in_rows else 1))
    found = judge_far_ends(mesh)
    if in_rows:
        return mesh._replace(ends=nothing_asked()), found.are_noise
    return mesh._replace(far_ends_right=found.are_right), found.are_noise

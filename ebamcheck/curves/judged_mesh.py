"""Judged mesh: a mesh with its normals, and what it says itself of whether they may be believed."""

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
"""Strips over freely curved facets, up to which two facets of a decimated mesh lie in one plane by chance."""

MOST_ASKED = 5_000
"""Facets of a tessellator's mesh whose edges are asked, evenly spread over it: more would tell no better of noise."""


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
        normals.with_regions,
        *normals.sagittas,
        normals.rims,
        nothing_asked(),
        True,
        False,
        1.0,
        *normals.exact,
    )
    noisy = False
    if normals.with_regions:
        mesh, noisy = _with_ends(mesh, part, normals)
    ends = judge_ends(mesh)
    rough = mesh.rough.copy()
    share = normals.offsets.lift_share
    if ends.is_rough or noisy or share == 0.0:
        rough[mesh.sectors[_nothing_to_tell(mesh.kind)]] = True
    scattered = ends.is_scattered and mesh.far_ends_right
    return mesh._replace(scattered=scattered, rough=rough, share=share)


def _nothing_to_tell(kind: NDArray[np.uint8]) -> Bools:
    """Facets (F,) of which nothing is told where freely curved ones do not tell a surface: these, and the few strips beside."""
    free, strip = kind == FREEFORM, kind == STRIP
    by_chance = np.count_nonzero(strip) <= BY_CHANCE * np.count_nonzero(free)
    return np.asarray(free | strip if by_chance else free)


def _with_ends(mesh: SurfaceMesh, part: Part, normals: SurfaceNormals) -> tuple[SurfaceMesh, bool]:
    """The mesh with what lies ahead of its edges, as far as that has a say, and whether it speaks of noise.

    Some edges tell of noise. All are asked where the mesh is no tessellator's; the normals of one's need no such witness.
    """
    in_rows = normals.offsets.is_in_rows
    surface = surface_of(part, np.cos(np.deg2rad(normals.crease_angle_deg)))
    mesh = mesh._replace(ends=ends_ahead(surface, -(-len(part.faces) // MOST_ASKED) if in_rows else 1))
    found = judge_far_ends(mesh)
    if in_rows:
        return mesh._replace(ends=nothing_asked()), found.are_noise
    return mesh._replace(far_ends_right=found.are_right), found.are_noise

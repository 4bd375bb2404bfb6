"""Whether sections times heights of layers have the volume that the part is said to have.

That volume comes from facets and from the union of bodies by manifold3d; the sections come from slicers, which unite bodies layer by
layer. The sections of the mesh itself are known in closed form, with every body counted, so that what the slicers' lack of them is
the metal that would count twice. Only that is summed over layers, and only its surface bounds the error of the sum.
"""

from __future__ import annotations

import numpy as np

from ebamcheck.checks.mesh_checks import layer_borders
from ebamcheck.layers.layer_rule import section_areas
from ebamcheck.mesh.bodies import MOST_LISTED, bodies_of
from ebamcheck.mesh.part import Part
from ebamcheck.numeric.rings import Floats
from ebamcheck.settings.config import Config


def volume_off(part: Part, cuts: Floats, areas: Floats, config: Config) -> str:
    """Say how far the volume of the part is off that of its sections; empty where they agree, or the layers are not all of the part.

    Parameters
    ----------
    part
        The part as placed, closed and the right way out.
    cuts, areas
        Heights (L,), mm, of the layers from below, and areas (L,), mm2, of their sections by one slicer.
    config
        Its `process.mass_tolerance` is the share by which a mass may be off.

    Notes
    -----
    Between two heights a section of the metal that counts twice changes by no more than its surface seen from above, P. Cut at the
    middles of layers of height h, it is summed to within h P / 2.
    """
    if len(cuts) < 2 or config.layers.heights_mm or config.base_mm > 0.0:
        return ""
    found = bodies_of(part)
    heights = np.diff(layer_borders(part, cuts, config))
    twice = section_areas(part, cuts) - areas
    of_sections = found.signed_mm3 - float((heights * twice).sum())
    bound = 0.5 * float(heights.max()) * _seen_from_above(part)
    allowed = bound + config.process.mass_tolerance * found.volume_mm3
    off = abs(of_sections - found.volume_mm3)
    if off <= allowed:
        return ""
    return (
        f"its sections times heights of layers are {of_sections:.6g} mm3, its volume is {found.volume_mm3:.6g} mm3: {off:.4g} mm3 apart, "
        f"over {allowed:.4g} mm3; facets of one body cut each other, or bodies do in a way that was not found: unite them in the model"
    )


def _seen_from_above(part: Part) -> float:
    """Area seen from above, up and down, of the facets where bodies lie in each other or overlap, mm2."""
    relations = bodies_of(part).relations
    if not relations:
        return 0.0
    corners: Floats = part.triangles
    low, high = corners.min(axis=1), corners.max(axis=1)
    near = np.full(len(corners), len(relations) > MOST_LISTED)
    for relation in relations[:MOST_LISTED]:
        near |= ((low <= relation.upper_mm) & (high >= relation.lower_mm)).all(axis=1)
    a, b, c = np.moveaxis(corners[near, :, :2], 1, 0)
    u, v = b - a, c - a
    return 0.5 * float(np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]).sum())

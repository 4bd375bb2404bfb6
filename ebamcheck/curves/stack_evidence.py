"""Evidence over a whole stack of curves: layers against their neighbours, and against the mesh between them.

The mean lift of a layer is the area that its curves enclose beyond its contours, over their length. It may differ between two
layers by no more than the mesh allows there: a layer that stands out was lifted the wrong way. The volume between two layers
is known exactly from the mesh. The volume by the areas of the curves must agree with it, up to the error that the areas of the
contours themselves make, and up to how far curves may lie outside or inside their contours.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ebamcheck.curves.columns import Curves, Evidence
from ebamcheck.curves.evidence import ring_areas
from ebamcheck.layers.stack import Layers
from ebamcheck.mesh.bodies import volumes_between
from ebamcheck.mesh.part import Part
from ebamcheck.numeric.rings import Floats

VOLUME_ROUNDING = 1e-9
"""Relative rounding error allowed in the sum of a volume."""


class StackEvidence(NamedTuple):
    """How layers agree with each other and with the mesh."""

    lift_mm: Floats
    """(L,) mean lift of each layer; 0 without contours."""
    allowed_mm: Floats
    """(L,) mean limit along the contours, by the mesh and the tolerance."""
    jump_excess_mm: Floats
    """(L,) difference of the lift from that of the layer below, less the allowed one; 0 or less is within the limit."""
    volume_excess_mm3: Floats
    """(L,) difference between the volumes, above the layer below, by the curves and of the mesh, less the allowed one."""

    @property
    def accepted(self) -> bool:
        """Whether no layer stands out."""
        return bool((self.jump_excess_mm <= 0.0).all() and (self.volume_excess_mm3 <= 0.0).all())


def stack_evidence(curves: Curves, layers: Layers, part: Part, found: Evidence) -> StackEvidence:
    """Compare the layers of curves, and the volume between them with that of the mesh.

    Parameters
    ----------
    curves, layers
        Curves and the contours that they were fitted to, from below.
    part
        The mesh that was cut.
    found
        Evidence of the rings.
    """
    count = len(layers)
    of_ring = curves.ring_layer
    length = np.bincount(of_ring, layers.ring_lengths, minlength=count)
    weight = np.where(length > 0.0, length, 1.0)
    gain = np.bincount(of_ring, ring_areas(curves) - layers.ring_areas, minlength=count)
    may = np.bincount(of_ring, found.mean_limit_mm * layers.ring_lengths, minlength=count) / weight
    lift = gain / weight
    jumps, volumes = np.zeros(count), np.zeros(count)
    if count > 1 and (np.diff(layers.heights) > 0.0).all():
        jumps[1:] = np.abs(np.diff(lift)) - (may[1:] + may[:-1])
        step = np.diff(layers.heights)
        mesh = volumes_between(part, layers.heights)
        areas = layers.areas()
        plain = 0.5 * step * (areas[1:] + areas[:-1])
        curved = plain + 0.5 * step * (gain[1:] + gain[:-1])
        allowed = np.abs(mesh - plain) + 0.5 * step * (may[1:] * length[1:] + may[:-1] * length[:-1])
        volumes[1:] = np.abs(mesh - curved) - allowed - VOLUME_ROUNDING * np.abs(mesh)
    return StackEvidence(lift, may, jumps, volumes)

"""Evidence over a whole stack of curves: layers against their neighbours, and against the mesh between them.

The mean lift of a layer is the area that its curves enclose beyond its contours, over their length. It may differ between two
layers by no more than the mesh allows there: a layer that stands out was lifted the wrong way. The volume between two layers
is known exactly from the mesh. The volume by the areas of the curves must agree with it, up to the error that the areas of the
contours themselves make, and up to how far curves may lie outside or inside their contours.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ebamcheck.curves.columns import Curves
from ebamcheck.curves.evidence import Evidence, ring_areas
from ebamcheck.layers.stack import Layers
from ebamcheck.mesh.part import Part
from ebamcheck.mesh.topology import Index
from ebamcheck.numeric.kernels import kernel
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


def volumes_between(part: Part, heights: Floats) -> Floats:
    """Exact volume of a mesh between consecutive ones of increasing heights, (L - 1,) mm3."""
    volumes = np.zeros(max(len(heights) - 1, 0))
    _add_volumes(part.vertices, part.faces, np.ascontiguousarray(heights), volumes)
    return volumes


@kernel
def _add_volumes(vertices: Floats, faces: Index, heights: Floats, volumes: Floats) -> None:
    """Area is the integral of (x dy - y dx) / 2 along the sections of facets, which is quadratic in z between corners."""
    z = np.empty(3)
    for f in range(len(faces)):
        for k in range(3):
            z[k] = vertices[faces[f, k], 2]
        z.sort()
        if z[2] <= heights[0] or z[0] >= heights[-1] or z[0] == z[2]:
            continue
        first = max(np.searchsorted(heights, z[0], side="right") - 1, 0)
        for layer in range(first, len(volumes)):
            if heights[layer] >= z[2]:
                break
            for piece in range(2):
                low = max(heights[layer], z[piece])
                high = min(heights[layer + 1], z[piece + 1])
                if high <= low:
                    continue
                middle = 0.5 * (low + high)
                # Simpson's rule is exact; at the ends of a piece its limits are taken from inside.
                total = _swept(vertices, faces, f, low, middle) + _swept(vertices, faces, f, high, middle)
                total += 4.0 * _swept(vertices, faces, f, middle, middle)
                volumes[layer] += (high - low) / 6.0 * total


@kernel
def _swept(vertices: Floats, faces: Index, f: int, z: float, inside: float) -> float:
    """(x dy - y dx) / 2 along the section of a facet at z, over the edges that a height inside of its piece cuts."""
    ax = ay = bx = by = 0.0
    for k in range(3):
        p, q = vertices[faces[f, k]], vertices[faces[f, (k + 1) % 3]]
        if (p[2] <= inside) == (q[2] <= inside):
            continue
        t = (z - p[2]) / (q[2] - p[2])
        x, y = p[0] + t * (q[0] - p[0]), p[1] + t * (q[1] - p[1])
        # A facet is left by its rising edge and entered by its falling one: solid lies to the left.
        if p[2] <= inside:
            ax, ay = x, y
        else:
            bx, by = x, y
    return float(0.5 * (bx * ay - by * ax))

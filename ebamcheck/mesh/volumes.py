"""Exact volume of a mesh between heights."""

from __future__ import annotations

import numpy as np

from ebamcheck.mesh.part import Part
from ebamcheck.mesh.topology import Index
from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Floats


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
        a, b, c = vertices[faces[f, 0], 2], vertices[faces[f, 1], 2], vertices[faces[f, 2], 2]
        z[0], z[1], z[2] = min(a, b, c), max(min(a, b), min(max(a, b), c)), max(a, b, c)
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

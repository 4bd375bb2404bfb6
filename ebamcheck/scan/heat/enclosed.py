"""Enclosed share: how much of a Gaussian around a point lies in the metal that the point sees."""

from __future__ import annotations

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from ebamcheck.numeric.kernels import kernel, run_blocks
from ebamcheck.numeric.rings import Floats

DIRECTIONS = 32
"""Rays from each point to the outline."""

SIGMAS = 3.0
"""The outline farther away than so many standard deviations takes nothing."""

LEAST_SHARE = 0.05
"""Least share, that of a wedge of 18 degrees: a point on a tip holds its heat."""

ON_OUTLINE_MM = 1e-6
"""Crossings nearer than this are the outline on which the point lies, not what its ray meets."""

FEWEST_POINTS = 64
"""Points that a thread is worth."""


def enclosed_share(section: BaseGeometry, points: Floats, variance_mm2: Floats) -> Floats:
    """Share of Gaussians around points that lies in the metal in sight, (P, Q).

    Along a ray the Gaussian has the share 1 - exp(-r^2 / (2 variance)) up to its first crossing of the outline; the
    mean over all directions is exact for what is in sight. Heat does not pass a gap, and what is out of sight behind
    a bend is far.

    Parameters
    ----------
    section
        Polygon or multi-polygon.
    points
        (P, 2) mm.
    variance_mm2
        (P, Q) along each axis.
    """
    outline = shapely.boundary(section)
    shapely.prepare(outline)
    reach = SIGMAS * np.sqrt(variance_mm2.max(initial=0.0))
    near = np.flatnonzero(shapely.dwithin(outline, shapely.points(points), reach))
    share = np.ones(variance_mm2.shape)
    rings = [shapely.get_coordinates(line) for line in shapely.get_parts(outline)]
    segments = np.concatenate([np.hstack([ring[:-1], ring[1:]]) for ring in rings])
    seen, variance = points[near], variance_mm2[near]
    share[near] = np.concatenate(
        run_blocks(lambda a, b: in_sight(seen[a:b], variance[a:b], segments), len(near), FEWEST_POINTS)
    )
    return np.maximum(share, LEAST_SHARE)


@kernel
def in_sight(points: Floats, variance: Floats, segments: Floats) -> Floats:
    """See :func:`enclosed_share`; `segments` (S, 4) make up the outline."""
    share, count = np.zeros(variance.shape), len(segments)
    ax, ay, bx, by = np.empty(count), np.empty(count), np.empty(count), np.empty(count)
    # What is crossed is marked by itself, which the processor does for several segments at once, and looked for by words.
    crossed = np.zeros(8 * (count // 8 + 1), np.uint8)
    words = crossed.view(np.uint64)
    for p in range(len(points)):
        for s in range(count):
            ax[s], ay[s] = segments[s, 0] - points[p, 0], segments[s, 1] - points[p, 1]
            bx[s], by[s] = segments[s, 2] - points[p, 0], segments[s, 3] - points[p, 1]
        for direction in range(DIRECTIONS):
            angle = 2.0 * np.pi * (direction + 0.5) / DIRECTIONS
            dx, dy = np.cos(angle), np.sin(angle)
            nearest = np.inf
            for s in range(count):
                crossed[s] = (dx * ay[s] - dy * ax[s] > 0.0) != (dx * by[s] - dy * bx[s] > 0.0)
            for word in range(len(words)):
                if words[word] == 0:
                    continue
                for s in range(8 * word, min(8 * word + 8, count)):
                    if crossed[s] == 0:
                        continue
                    left, right = dx * ay[s] - dy * ax[s], dx * by[s] - dy * bx[s]
                    part = left / (left - right)
                    reach = dx * (ax[s] + part * (bx[s] - ax[s])) + dy * (ay[s] + part * (by[s] - ay[s]))
                    if ON_OUTLINE_MM < reach < nearest:
                        nearest = reach
            for q in range(variance.shape[1]):
                share[p, q] -= np.expm1(-0.5 * nearest * nearest / variance[p, q]) / DIRECTIONS
    return share

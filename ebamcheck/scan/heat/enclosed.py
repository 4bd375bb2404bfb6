"""Enclosed share: how much of a Gaussian around a point lies in the metal that the point sees."""

from __future__ import annotations

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from ebamcheck.numeric.kernels import kernel, run_blocks
from ebamcheck.numeric.rings import Bools, Floats
from ebamcheck.scan.heat.falling import falling

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
    points_of, goes_on = (
        np.concatenate(rings),
        np.concatenate([np.arange(1, len(r) + 1) < len(r) for r in rings]),
    )
    seen, variance = points[near], variance_mm2[near]
    share[near] = np.concatenate(
        run_blocks(
            lambda a, b: in_sight(seen[a:b], variance[a:b], points_of, goes_on), len(near), FEWEST_POINTS
        )
    )
    return np.maximum(share, LEAST_SHARE)


@kernel
def in_sight(points: Floats, variance: Floats, outline: Floats, goes_on: Bools) -> Floats:
    """See :func:`enclosed_share`; from each of the points (S, 2) of the `outline` to the next goes a segment, or none."""
    nearest, angle = np.empty(DIRECTIONS), 2.0 * np.pi * (np.arange(DIRECTIONS) + 0.5) / DIRECTIONS
    dx, dy = np.cos(angle), np.sin(angle)
    share, parts = np.zeros(variance.shape), np.empty((DIRECTIONS, variance.shape[1]))
    count = len(outline)
    x, y, left = np.empty(count), np.empty(count), np.empty(count, np.uint8)
    # What is crossed is marked by itself, which the processor does for several segments at once, and looked for by words.
    crossed = np.zeros(8 * (count // 8 + 1), np.uint8)
    words = crossed.view(np.uint64)
    for p in range(len(points)):
        for s in range(count):
            x[s], y[s] = outline[s, 0] - points[p, 0], outline[s, 1] - points[p, 1]
        for n in range(DIRECTIONS):
            for s in range(count):
                left[s] = dx[n] * y[s] - dy[n] * x[s] > 0.0
            for s in range(count - 1):
                crossed[s] = goes_on[s] & (left[s] ^ left[s + 1])
            nearest[n] = np.inf
            for word in range(len(words)):
                if words[word] == 0:
                    continue
                for s in range(8 * word, min(8 * word + 8, count)):
                    if crossed[s] == 0:
                        continue
                    ahead, behind = dx[n] * y[s] - dy[n] * x[s], dx[n] * y[s + 1] - dy[n] * x[s + 1]
                    part = ahead / (ahead - behind)
                    reach = dx[n] * (x[s] + part * (x[s + 1] - x[s])) + dy[n] * (
                        y[s] + part * (y[s + 1] - y[s])
                    )
                    if ON_OUTLINE_MM < reach < nearest[n]:
                        nearest[n] = reach
        for n in range(DIRECTIONS):
            for q in range(variance.shape[1]):
                parts[n, q] = np.true_divide(-0.5 * nearest[n] * nearest[n], variance[p, q])
        flat = parts.ravel()
        for m in range(len(flat)):
            flat[m] = (1.0 - falling(flat[m])) / DIRECTIONS
        for n in range(DIRECTIONS):
            for q in range(variance.shape[1]):
                share[p, q] += parts[n, q]
    return share

"""Enclosed share: how much of a Gaussian around a point lies in the metal that the point sees."""

from __future__ import annotations

import numpy as np
import shapely
from numpy.typing import NDArray
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

SECTOR_BINS, SECTOR_ROUNDING = 1024, 1e-9
"""Bins in a quarter turn by which sectors between rays are looked up: so fine that few hold a ray; and the rounding, in
sectors, that is allowed for at their edges, far more than there is."""

DOUBTFUL = 64
"""Added to the sector of a bin that holds a ray."""

FELT = 38.0
"""Exponent from which on what a Gaussian has beyond the outline is nothing beside 1, not even by rounding."""

STRETCH = 64
"""Segments of the outline that are passed over together where all of them are too far away to be felt; whole words of marks."""

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
    count, sectors, boxes = len(outline), sector_table(), _stretches(outline)
    x, y, sector = np.empty(STRETCH + 1), np.empty(STRETCH + 1), np.empty(STRETCH + 1, np.uint8)
    # What may be crossed is marked by itself, which the processor does for several segments at once, and looked for by words.
    marked = np.zeros(STRETCH, np.uint8)
    words = marked.view(np.uint64)
    for p in range(len(points)):
        nearest[:] = np.inf
        px, py, felt = points[p, 0], points[p, 1], 2.0 * FELT * variance[p].max()
        for b in range(len(boxes)):
            beside = max(boxes[b, 0] - px, px - boxes[b, 1], 0.0)
            above = max(boxes[b, 2] - py, py - boxes[b, 3], 0.0)
            if beside * beside + above * above > felt:
                continue
            first = b * STRETCH
            length = min(STRETCH, count - 1 - first)
            for s in range(length + 1):
                x[s], y[s] = outline[first + s, 0] - px, outline[first + s, 1] - py
            for s in range(length + 1):
                sector[s] = sectors[int(SECTOR_BINS * diamond(x[s], y[s]))]
            marked[length:] = 0
            for s in range(length):
                marked[s] = goes_on[first + s] & ((sector[s] != sector[s + 1]) | (sector[s] >= DOUBTFUL))
            for word in range(len(words)):
                if words[word] != 0:
                    for s in range(8 * word, 8 * word + 8):
                        if marked[s] != 0:
                            _cross(nearest, dx, dy, x[s], y[s], x[s + 1], y[s + 1], sector[s], sector[s + 1])
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


@kernel
def _stretches(outline: Floats) -> Floats:
    """Boxes (B, 4), least and greatest x, then y, around each :data:`STRETCH` segments of an outline (S, 2)."""
    boxes = np.empty((max(0, len(outline) - 2 + STRETCH) // STRETCH, 4))
    for b in range(len(boxes)):
        part = outline[b * STRETCH : b * STRETCH + STRETCH + 1]
        boxes[b, 0], boxes[b, 1] = part[:, 0].min(), part[:, 0].max()
        boxes[b, 2], boxes[b, 3] = part[:, 1].min(), part[:, 1].max()
    return boxes


@kernel
def _cross(
    nearest: Floats, dx: Floats, dy: Floats, ax: float, ay: float, bx: float, by: float, start: int, end: int
) -> None:
    """Note how far the rays go to a segment from `start` to `end`, sectors as of :func:`sector_table`.

    Only rays between the two, and those behind them, can have its ends on two sides; each is asked itself.
    """
    first, last = int(start) % DOUBTFUL, int(end) % DOUBTFUL
    rays = (last - first) % DIRECTIONS
    if rays > DIRECTIONS // 2:
        first, rays = last, DIRECTIONS - rays
    if start >= DOUBTFUL or end >= DOUBTFUL:
        rays = min(rays + 1, DIRECTIONS // 2)
    for m in range(2 * rays):
        n = (first + m // 2 + (m % 2) * (DIRECTIONS // 2)) % DIRECTIONS
        ahead, behind = dx[n] * ay - dy[n] * ax, dx[n] * by - dy[n] * bx
        if (ahead > 0.0) == (behind > 0.0):
            continue
        part = ahead / (ahead - behind)
        reach = dx[n] * (ax + part * (bx - ax)) + dy[n] * (ay + part * (by - ay))
        if ON_OUTLINE_MM < reach < nearest[n]:
            nearest[n] = reach


@kernel
def diamond(x: float, y: float) -> float:
    """Stand-in for the angle of a point, from 0 to 4, which grows with it: the way along a square on its corner."""
    around = abs(x) + abs(y)
    up = np.true_divide(y, around if around > 0.0 else 1.0)
    ahead = up if up >= 0.0 else 4.0 + up
    return float(ahead if x >= 0.0 else 2.0 - up)


@kernel
def sector_table() -> NDArray[np.uint8]:
    """Sector between rays by even bins of :func:`diamond`; :data:`DOUBTFUL` more where it may be the next one, too.

    Sector n lies before ray n. Beyond the last bin is that of an angle that was rounded up to a whole turn.
    """
    count = 4 * SECTOR_BINS
    edge = np.empty(count + 1)
    for n in range(count + 1):
        a = n / SECTOR_BINS
        x = 1.0 - a if a < 2.0 else a - 3.0
        y = a if a < 1.0 else 2.0 - a if a < 3.0 else a - 4.0
        turn = np.arctan2(y, x) / (2.0 * np.pi)
        edge[n] = turn if turn >= 0.0 and n < count else turn + 1.0
    table = np.empty(count + 1, np.uint8)
    for n in range(count):
        low = int(np.floor(edge[n] * DIRECTIONS + 0.5 - SECTOR_ROUNDING))
        high = int(np.floor(edge[n + 1] * DIRECTIONS + 0.5 + SECTOR_ROUNDING))
        table[n] = low % DIRECTIONS + (DOUBTFUL if high > low else 0)
    table[count] = 0
    return table

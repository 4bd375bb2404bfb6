"""Signed distances from contours given as segments in any order, with the solid on their left."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ebamcheck.comparison.causes import MeshFlaws
from ebamcheck.comparison.outline import Outline
from ebamcheck.geometry.nearest import SegmentTree, nearest_segment, tree_over
from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Bools, Floats, Ints

STEEPEST = 1e4
"""Largest movement of a contour per mm of height: at a level facet it would be infinite."""

MOST_SEGMENTS = 4000
"""Most segments for which the winding number on both sides is computed, which takes quadratic time."""

ASIDE = 1e-6
"""Distance beside a segment, over its length, at which the winding number is computed."""


class Near(NamedTuple):
    """Distances of places from contours."""

    distance_mm: Floats
    """(N,) distance from the contours, negative inside the solid."""
    normal: Floats
    """(N, 2) outward direction, the gradient of the distance."""
    segment: Ints
    """(N,) nearest segment."""


def contours_of(outline: Outline) -> SegmentTree:
    """Closed rings of an outline."""
    if int(outline.rings) == len(outline.paths) - 1:
        return outline.tree
    return contours_over(outline.segments[: outline.paths[outline.rings]])


def contours_over(segments: Floats) -> SegmentTree:
    """Contours of segments (S, 4) that lie in any order."""
    return tree_over(np.ascontiguousarray(segments, np.float64).reshape(-1, 4))


def mesh_contours(
    flaws: MeshFlaws, height_mm: float, origin_mm: tuple[float, float]
) -> tuple[SegmentTree, Floats]:
    """Section of the mesh, and the outward movement of each segment per mm of height, (S,)."""
    segments = np.ascontiguousarray(flaws.section(height_mm) - np.array([*origin_mm, *origin_mm]))
    a, b, c = np.moveaxis(flaws.part.triangles[flaws.crossing(height_mm)], 1, 0)
    normal = np.cross(b - a, c - a)
    flat = np.hypot(normal[:, 0], normal[:, 1])
    rate = -normal[:, 2] / np.maximum(flat, np.finfo(np.float64).tiny)
    rate = np.clip(np.where(flat > 0.0, rate, 0.0), -STEEPEST, STEEPEST)
    if flaws.bodies > 1 and len(segments) <= MOST_SEGMENTS:
        # Where bodies overlap, segments inside the solid of another body are no contour.
        shown = _between_solid_and_not(segments)
        segments, rate = segments[shown], rate[shown]
    return contours_over(segments), rate


def along(contours: SegmentTree, count: int) -> tuple[Floats, float]:
    """Places (N, 2) at equal steps along all contours, and the length that each represents, mm."""
    segments = contours.segments
    ends = segments[:, 2:] - segments[:, :2]
    extent = np.hypot(ends[:, 0], ends[:, 1])
    reach = np.cumsum(extent)
    total = float(reach[-1]) if reach.size else 0.0
    if not total > 0.0:
        return np.zeros((0, 2)), 0.0
    at = (np.arange(count) + 0.5) / count * total
    s = np.minimum(np.searchsorted(reach, at, side="right"), len(segments) - 1)
    t = 1.0 - (reach[s] - at) / np.maximum(extent[s], np.finfo(np.float64).tiny)
    return segments[s, :2] + t[:, None] * ends[s], total / count


def beside(contours: SegmentTree, places: Floats) -> Near:
    """Distances of places (N, 2) from contours."""
    distance, normal, segment = _beside(contours, np.ascontiguousarray(places))
    return Near(distance, normal, segment)


@kernel
def _beside(contours: SegmentTree, places: Floats) -> tuple[Floats, Floats, Ints]:
    """Distances, normals and nearest segments; see :class:`Near`."""
    segments, count = contours.segments, len(places)
    distance, normal, near = np.full(count, np.inf), np.zeros((count, 2)), np.full(count, -1)
    if len(segments) == 0:
        return distance, normal, near
    guess = -1
    for i in range(count):
        x, y = places[i, 0], places[i, 1]
        square, guess = nearest_segment(contours, x, y, guess)
        away, near[i] = math.sqrt(square), guess
        inside = winding_of(segments, x, y) > 0
        distance[i] = -away if inside else away
        ax, ay, bx, by = segments[guess, 0], segments[guess, 1], segments[guess, 2], segments[guess, 3]
        ux, uy = bx - ax, by - ay
        square = ux * ux + uy * uy
        t = 0.0
        if square > 0.0:
            t = min(max(((x - ax) * ux + (y - ay) * uy) / square, 0.0), 1.0)
        if 0.0 < t < 1.0 or away == 0.0:
            long = np.sqrt(square) if square > 0.0 else 1.0
            normal[i, 0], normal[i, 1] = uy / long, -ux / long
        else:
            sign = -1.0 if inside else 1.0
            normal[i, 0] = sign * (x - ax - t * ux) / away
            normal[i, 1] = sign * (y - ay - t * uy) / away
    return distance, normal, near


@kernel
def winding_of(segments: Floats, x: float, y: float) -> int:
    """Winding number of closed segments about (x, y), in whatever order they lie."""
    total = 0
    for i in range(len(segments)):
        if (segments[i, 1] <= y) != (segments[i, 3] <= y):
            rises = segments[i, 1] <= y
            low, high = (0, 2) if rises else (2, 0)
            across = (segments[i, high] - segments[i, low]) * (y - segments[i, low + 1])
            across -= (x - segments[i, low]) * (segments[i, high + 1] - segments[i, low + 1])
            if across < 0.0:
                total += -1 if rises else 1
    return total


@kernel
def windings(segments: Floats, places: Floats) -> Ints:
    """Winding number of closed segments about each of some places (N, 2)."""
    found = np.zeros(len(places), np.int64)
    for i in range(len(places)):
        found[i] = winding_of(segments, places[i, 0], places[i, 1])
    return found


def _between_solid_and_not(segments: Floats) -> Bools:
    """Whether each segment has solid on only one side."""
    middle, along_it = 0.5 * (segments[:, :2] + segments[:, 2:]), segments[:, 2:] - segments[:, :2]
    aside = ASIDE * np.column_stack([-along_it[:, 1], along_it[:, 0]])
    left, right = windings(segments, middle + aside) > 0, windings(segments, middle - aside) > 0
    return np.asarray(left != right)

"""All figures of one pair of outlines: areas, distances, and the depth of their difference."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ebamcheck.comparison.depth import FINE_SHARE, enough_mm, search
from ebamcheck.comparison.depth import FINEST_DEPTH_MM as FINEST_DEPTH_MM
from ebamcheck.comparison.distance import Directed, directed
from ebamcheck.comparison.outline import Outline, nearest, winding
from ebamcheck.comparison.overlap import Deepest, overlap
from ebamcheck.kernels import kernel


class Figures(NamedTuple):
    """What is measured between two outlines; lengths in mm, areas in mm2."""

    area_a: float
    area_b: float
    symmetric_difference: float
    hausdorff_ab: float
    hausdorff_ba: float
    p95_ab: float
    p95_ba: float
    depth: float
    depth_x: float
    depth_y: float
    sound: float
    """0 where the sweep gave up and the areas are to be found in another way."""


@kernel
def measure(a: Outline, b: Outline, limit_mm: float, exact_a: bool, exact_b: bool) -> Figures:
    """Measure two outlines against each other; `limit_mm` sets how finely depth is resolved.

    Depth is the greatest distance of a point of the symmetric difference from the contours of the exact one
    of the two; from those of the one that has any where the other is empty; from the nearer contour where
    neither is exact; and the lesser of both depths where both are exact.
    """
    resolution = max(FINEST_DEPTH_MM, FINE_SHARE * limit_mm)
    ab, ba = directed(a, b), directed(b, a)
    if len(a.edges) == 0 or len(b.edges) == 0:
        from_a, from_b = len(a.edges) > 0, len(b.edges) > 0
    elif exact_a or exact_b:
        from_a, from_b = exact_a, not exact_a
    else:
        from_a, from_b = True, True
    known = Deepest(0.0, np.nan, np.nan)
    if from_a != from_b:
        known = _reached(b, ba, resolution) if from_a else _reached(a, ab, resolution)
    else:
        known = _halfway(a, b, ab, _halfway(b, a, ba, known))
    swept = overlap(a, b, from_a, from_b, enough_mm(known.depth_mm, limit_mm))
    deepest = search(a, b, from_a, from_b, swept.suspects, known, limit_mm)
    both = exact_a and exact_b and len(a.edges) > 0 and len(b.edges) > 0
    if both and deepest.depth_mm > resolution:
        known = _reached(a, ab, resolution)
        again = overlap(a, b, False, True, enough_mm(known.depth_mm, limit_mm))
        other = search(a, b, False, True, again.suspects, known, limit_mm)
        if other.depth_mm < deepest.depth_mm:
            deepest = other
    return Figures(
        swept.area_a_mm2, swept.area_b_mm2, swept.symmetric_difference_mm2,
        ab.most_mm, ba.most_mm, ab.p95_mm, ba.p95_mm,
        deepest.depth_mm, deepest.x_mm, deepest.y_mm, 1.0 if swept.sound else 0.0,
    )  # fmt: skip


@kernel
def _reached(o: Outline, farthest: Directed, resolution_mm: float) -> Deepest:
    """Depth that the point of `o` farthest from the other contours proves, if `o` bounds its region there.

    Next to such a point the other region does not change but this one does, so one side of it belongs to
    the symmetric difference.
    """
    nothing = Deepest(0.0, np.nan, np.nan)
    s = farthest.segment
    if s < 0 or s >= o.enclosing or not 0.0 < farthest.most_mm < np.inf:
        return nothing
    ux, uy = o.segments[s, 2] - o.segments[s, 0], o.segments[s, 3] - o.segments[s, 1]
    length = math.hypot(ux, uy)
    aside = min(0.01 * farthest.most_mm, 0.1 * resolution_mm, 0.01 * length) / length
    # A little towards the middle of the segment, so that a corner's other side is out of the way.
    towards = 2.0 * aside
    middle_x, middle_y = o.segments[s, 0] + 0.5 * ux, o.segments[s, 1] + 0.5 * uy
    ahead = ux * (middle_x - farthest.x_mm) + uy * (middle_y - farthest.y_mm) > 0.0
    sign = towards if ahead else -towards
    x, y = farthest.x_mm + sign * ux, farthest.y_mm + sign * uy
    left = winding(o, x - aside * uy, y + aside * ux) > 0
    right = winding(o, x + aside * uy, y - aside * ux) > 0
    return Deepest(farthest.most_mm, farthest.x_mm, farthest.y_mm) if left != right else nothing


@kernel
def _halfway(o: Outline, other: Outline, farthest: Directed, known: Deepest) -> Deepest:
    """Depth that is proved halfway from the point of `o` farthest from the other contours to the nearest one."""
    if farthest.segment < 0 or len(o.edges) == 0 or len(other.edges) == 0:
        return known
    i = nearest(other, farthest.x_mm, farthest.y_mm, -1)[1]
    ax, ay = other.segments[i, 0], other.segments[i, 1]
    ux, uy = other.segments[i, 2] - ax, other.segments[i, 3] - ay
    square = ux * ux + uy * uy
    t = ((farthest.x_mm - ax) * ux + (farthest.y_mm - ay) * uy) / square if square > 0.0 else 0.0
    t = min(1.0, max(0.0, t))
    x, y = 0.5 * (farthest.x_mm + ax + t * ux), 0.5 * (farthest.y_mm + ay + t * uy)
    depth = min(nearest(o, x, y, -1)[0], nearest(other, x, y, -1)[0])
    if depth > known.depth_mm and (winding(o, x, y) > 0) != (winding(other, x, y) > 0):
        return Deepest(depth, x, y)
    return known

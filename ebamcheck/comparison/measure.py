"""All figures of one pair of outlines: areas, distances, and the depth of their difference."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ebamcheck.comparison.depth import FINEST_DEPTH_MM as FINEST_DEPTH_MM
from ebamcheck.comparison.depth import Deepest, enough_mm, resolution_mm, search
from ebamcheck.comparison.hausdorff import Directed, directed
from ebamcheck.comparison.outline import Outline, winding
from ebamcheck.comparison.sweep import Overlap, overlap
from ebamcheck.geometry.nearest import nearest_segment, square_between
from ebamcheck.kernels import Ints, kernel


class Figures(NamedTuple):
    """Measures of two outlines; lengths in mm, areas in mm2."""

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
    sound: float  # 0 if the sweep gave up, and the areas must be found in another way; else 1


@kernel
def measure(a: Outline, b: Outline, limit_mm: float, exact_a: bool, exact_b: bool) -> Figures:
    """Measure two outlines against each other; `limit_mm` sets how finely depth is resolved.

    Depth is the greatest distance of a point of the symmetric difference from the contours of the exact outline; from the only
    contours where one outline is empty; from the nearer contour where neither is exact; the lesser of both where both are exact.
    """
    ab, ba = directed(a, b), directed(b, a)
    is_a, is_b = a.chains.steps.size > 0, b.chains.steps.size > 0
    if not (is_a and is_b):
        from_a, from_b = is_a, is_b
    else:
        from_a, from_b = exact_a or not exact_b, not exact_a
    swept, deepest = _swept(a, b, ab, ba, from_a, from_b, limit_mm)
    if exact_a and exact_b and is_a and is_b and swept.sound and deepest.depth_mm > resolution_mm(limit_mm):
        _, other = _swept(a, b, ab, ba, not from_a, not from_b, limit_mm)
        if other.depth_mm < deepest.depth_mm:
            deepest = other
    return Figures(
        swept.area_a_mm2, swept.area_b_mm2, swept.symmetric_difference_mm2,
        ab.most_mm, ba.most_mm, ab.p95_mm, ba.p95_mm,
        deepest.depth_mm, deepest.x_mm, deepest.y_mm, 1.0 if swept.sound else 0.0,
    )  # fmt: skip


@kernel
def _swept(
    a: Outline, b: Outline, ab: Directed, ba: Directed, from_a: bool, from_b: bool, limit_mm: float
) -> tuple[Overlap, Deepest]:
    """Areas, and the greatest depth; it is not searched for where links prove that nothing is deeper than a known place."""
    if from_a != from_b:
        known = _reached(b if from_a else a, ba if from_a else ab, resolution_mm(limit_mm))
    else:
        known = _halfway(a, b, ab, _halfway(b, a, ba, Deepest(0.0, np.nan, np.nan)))
    # Of a link, no point is farther from its nearer end than half of it.
    reach = enough_mm(known.depth_mm, limit_mm) * (2.0 if from_a and from_b else 1.0)
    proved = (from_a and ba.most_mm <= reach and linked_within(a, b, ba.near, reach)) or (
        (from_b or not from_a) and ab.most_mm <= reach and linked_within(b, a, ab.near, reach)
    )
    swept = overlap(a, b, not proved)
    return swept, known if proved else search(a, b, from_a, from_b, swept.difference, known, limit_mm)


@kernel
def _reached(o: Outline, farthest: Directed, resolution_mm: float) -> Deepest:
    """Depth that the point of `o` farthest from the other contours proves, if `o` bounds its region there: one side of it is in one
    region only."""
    nothing = Deepest(0.0, np.nan, np.nan)
    s = farthest.segment
    if s < 0 or s >= o.paths[o.rings] or not 0.0 < farthest.most_mm < np.inf:
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
    rings = o.segments[: o.paths[o.rings]]
    left = winding(rings, x - aside * uy, y + aside * ux) > 0
    right = winding(rings, x + aside * uy, y - aside * ux) > 0
    return Deepest(farthest.most_mm, farthest.x_mm, farthest.y_mm) if left != right else nothing


@kernel
def _halfway(o: Outline, other: Outline, farthest: Directed, known: Deepest) -> Deepest:
    """Depth that is proved halfway from the point of `o` farthest from the other contours to the nearest one."""
    if farthest.segment < 0 or o.chains.steps.size == 0 or other.chains.steps.size == 0:
        return known
    guess = farthest.near[0]
    i = nearest_segment(other.tree, farthest.x_mm, farthest.y_mm, guess)[1]
    ax, ay = other.segments[i, 0], other.segments[i, 1]
    ux, uy = other.segments[i, 2] - ax, other.segments[i, 3] - ay
    square = ux * ux + uy * uy
    t = ((farthest.x_mm - ax) * ux + (farthest.y_mm - ay) * uy) / square if square > 0.0 else 0.0
    t = min(1.0, max(0.0, t))
    x, y = 0.5 * (farthest.x_mm + ax + t * ux), 0.5 * (farthest.y_mm + ay + t * uy)
    square = min(nearest_segment(o.tree, x, y, farthest.segment)[0], nearest_segment(other.tree, x, y, i)[0])
    depth = math.sqrt(square)
    if depth > known.depth_mm:
        in_o = winding(o.segments[: o.paths[o.rings]], x, y) > 0
        if in_o != (winding(other.segments[: other.paths[other.rings]], x, y) > 0):
            return Deepest(depth, x, y)
    return known


# -- Matching of contours: a cheap upper bound on the depth of the symmetric difference of two regions ---------
#
# Let a point run along a ring of one region, linked to the nearest point of the other's contours. Where that point passes a vertex,
# or jumps ahead to another segment, the link is led along the contour between, vertex by vertex, from the nearest place of the piece
# just passed. So the first ring is drawn over, along links, onto a closed path on the second's rings. A place that no link passes
# over has the same winding number about both of these paths; and if the path goes around one ring of the second region once, and
# every such ring has its partner, then both regions agree there. Hence all of the symmetric difference lies on links: no point of it
# is farther from the second region's contours than the longest link, nor farther than half of that from the nearer contours.


MOST_STEPS = 8  # most vertices passed per segment and sample, on average: links that run back and forth prove nothing


@kernel
def linked_within(a: Outline, b: Outline, near: Ints, reach_mm: float) -> bool:
    """Whether links no longer than the reach draw each ring of `b`, all of which lies within it, onto another ring of `a`.

    `near` (M,) is the segment of `a` nearest to each sample of `b`. The contour between two links is led along vertex by vertex.
    """
    if a.rings != b.rings:
        return False
    ring_of = np.empty(a.paths[a.rings], np.int64)
    for r in range(a.rings):
        for s in range(a.paths[r], a.paths[r + 1]):
            ring_of[s] = r
    taken = np.zeros(a.rings, np.bool_)
    places, lengths = b.samples.places, b.samples.lengths
    segments = a.segments
    budget = MOST_STEPS * (len(ring_of) + len(places))
    start = b.paths[0]
    for _ in range(b.rings):
        stop = start
        while lengths[stop] >= 0.0:
            stop += 1
        if near[start] >= ring_of.size or taken[ring_of[near[start]]]:
            return False
        ring = ring_of[near[start]]
        taken[ring] = True
        first, size = a.paths[ring], a.paths[ring + 1] - a.paths[ring]
        turns = 0
        for k in range(start, stop):
            # The last sample is the first place again.
            s, there = near[k], near[k + 1] if k + 1 < stop else near[start]
            if s == there:
                continue
            if not first <= there < first + size:
                return False
            ahead = there - s if there > s else there - s + size
            steps = ahead if 2 * ahead <= size else ahead - size
            turns += steps
            budget -= abs(steps)
            if budget < 0:
                return False
            x0, y0, x1, y1 = places[k, 0], places[k, 1], places[k + 1, 0], places[k + 1, 1]
            for _ in range(abs(steps)):
                # On: the starts of the segments after this one. Back: its own start, and those before.
                if steps > 0:
                    s = s + 1 if s + 1 < first + size else first
                if square_between(segments[s, 0], segments[s, 1], x0, y0, x1, y1) > reach_mm * reach_mm:
                    return False
                if steps < 0:
                    s = s - 1 if s > first else first + size - 1
        if turns != size:
            return False
        start = stop + 1
    return True

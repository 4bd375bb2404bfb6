"""Matching of contours: a cheap upper bound on the depth of the symmetric difference of two regions.

Let a point run along a ring of one region, linked to the nearest point of the other's contours. Where that
point passes a vertex, or jumps ahead to another segment, the link is led along the contour between, vertex
by vertex, from the nearest place of the piece just passed. So the first ring is drawn over, along links,
onto a closed path on the second's rings. A place that no link passes over has the same winding number about
both of these paths; and if the path goes around one ring of the second region once, and every such ring
has its partner, then both regions agree there. Hence all of the symmetric difference lies on links: no
point of it is farther from the second region's contours than the longest link is long, nor farther
than half of that from the nearer contours.
"""

from __future__ import annotations

import numpy as np

from ebamcheck.comparison.outline import Outline
from ebamcheck.geometry.nearest import square_between
from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Bools, Floats, Ints

MOST_STEPS = 8
"""Most vertices passed per segment and sample, on average: links that run back and forth prove nothing."""


@kernel
def linked_within(a: Outline, b: Outline, near: Ints, reach_mm: float) -> bool:
    """Whether links no longer than this draw all rings of `b` onto those of `a`.

    Parameters
    ----------
    near
        (M,) segment of `a` nearest to each sample of `b`.
    reach_mm
        Longest link; all samples of `b`, and the contours between them, are known to be as near as that.
    """
    if a.rings != b.rings:
        return False
    ring_of = _ring_of(a.paths, a.rings)
    taken = np.zeros(a.rings, np.bool_)
    places, lengths = b.samples.places, b.samples.lengths
    budget = MOST_STEPS * (len(ring_of) + len(places))
    start = 0
    for _ in range(b.rings):
        stop = start
        while lengths[stop] >= 0.0:
            stop += 1
        budget = _link_ring(a, places, near, start, stop, ring_of, taken, reach_mm, budget)
        if budget < 0:
            return False
        start = stop + 1
    return True


@kernel
def _ring_of(paths: Ints, rings: int) -> Ints:
    """Ring of each segment of the closed rings."""
    ring_of = np.empty(paths[rings], np.int64)
    for r in range(rings):
        ring_of[paths[r] : paths[r + 1]] = r
    return ring_of


@kernel
def _link_ring(
    a: Outline, places: Floats, near: Ints, start: int, stop: int, ring_of: Ints, taken: Bools, reach_mm: float,
    budget: int,
) -> int:  # fmt: skip
    """Link the ring with samples ``start .. stop`` to a ring not taken yet; steps left, or -1 without luck.

    The contour between two links is led along vertex by vertex: none may be farther from the piece than allowed.
    """
    if near[start] >= ring_of.size or taken[ring_of[near[start]]]:
        return -1
    ring = ring_of[near[start]]
    taken[ring] = True
    first, size = a.paths[ring], a.paths[ring + 1] - a.paths[ring]
    segments = a.segments
    turns = 0
    for k in range(start, stop):
        # The last sample is the first place again.
        here, there = near[k], near[k + 1] if k + 1 < stop else near[start]
        if here == there:
            continue
        if not first <= there < first + size:
            return -1
        ahead = there - here if there > here else there - here + size
        steps = ahead if 2 * ahead <= size else ahead - size
        turns += steps
        budget -= abs(steps)
        if budget < 0:
            return -1
        s = here
        for _ in range(abs(steps)):
            # On: the starts of the segments after this one. Back: its own start, and those before.
            if steps > 0:
                s = s + 1 if s + 1 < first + size else first
            x0, y0, x1, y1 = places[k, 0], places[k, 1], places[k + 1, 0], places[k + 1, 1]
            if square_between(segments[s, 0], segments[s, 1], x0, y0, x1, y1) > reach_mm * reach_mm:
                return -1
            if steps < 0:
                s = s - 1 if s > first else first + size - 1
    return budget if turns == size else -1

"""Runs of contours: needless points are removed, and what is left is split into straight and curved runs (paper, section 3.2)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ebamcheck.columns_file import starts_of
from ebamcheck.geometry.raster import each_of
from ebamcheck.kernels import Bools, Floats, Ints, kernel
from ebamcheck.threads import run_blocks

LINE, SPLINE, ARC = 0, 1, 2
"""Kinds of piece: the polyline of its control points, a cubic B-spline, a circular arc through three points."""

STRAIGHT_RATIO = 3.0
"""A straight run is this many times longer than any of the two segments on either side of it.

Length alone does not decide: the chords of a large radius are long, too, but so are their neighbours."""


class CleanRings(NamedTuple):
    """Contours without needless points."""

    rows: Ints  # (K,) rows of the contour points that are kept, ring by ring
    starts: Ints  # (R + 1,) first entry of each ring in rows
    collapsed: Bools  # (R,) rings smaller than the tolerances; they keep all their points and are not fitted


def clean(points: Floats, ring_starts: Ints, closed: Bools, near_point_mm: float, collinear_mm: float) -> CleanRings:
    """Remove the points of rings, as columns of :class:`~ebamcheck.layers.stack.Layers`, that carry no shape.

    A point goes if it repeats or lies nearer than `near_point_mm` to the last one kept. Of a run of
    points, the inner ones go if every one of them lies within `collinear_mm` of the chord that takes
    their place, so that the error does not grow along the run; points of a path that turns back on
    itself stay. Closed rings are swept from the point farthest from their middle, which cannot lie
    inside a straight run; open paths keep both ends. A tolerance of 0 counts rounding alone.
    """
    count = ring_starts.size - 1
    sweep = np.empty(len(points), dtype=np.int64)
    sizes = np.zeros(count, dtype=np.int64)
    collapsed = np.zeros(count, dtype=np.bool_)

    tolerances = float(near_point_mm), float(collinear_mm)

    def work(first: int, last: int) -> None:
        _clean_rings(points, ring_starts, closed, tolerances, first, last, sweep, sizes, collapsed)

    run_blocks(work, count, 64)
    ring, place = each_of(sizes)
    return CleanRings(sweep[ring_starts[ring] + place], starts_of(sizes), collapsed)


@kernel
def _clean_rings(
    points: Floats,
    ring_starts: Ints,
    closed: Bools,
    tolerances: tuple[float, float],
    first: int,
    last: int,
    sweep: Ints,
    sizes: Ints,
    collapsed: Bools,
) -> None:
    near, collinear = tolerances
    for r in range(first, last):
        a, b = ring_starts[r], ring_starts[r + 1]
        rows = sweep[a:b]
        x = y = 0.0
        for i in range(a, b):
            x += (points[i, 0] - points[a, 0]) / (b - a)
            y += (points[i, 1] - points[a, 1]) / (b - a)
        begin, farthest = a, -1.0
        for i in range(a, b):
            d = np.hypot(points[i, 0] - points[a, 0] - x, points[i, 1] - points[a, 1] - y)
            if closed[r] and d > farthest:
                begin, farthest = i, d
        # What lies nearer than `near` to the last one kept is left out, but for the end of an open path.
        kept = 0
        for k in range(b - a):
            i = begin + k if begin + k < b else begin + k - (b - a)
            j = rows[kept - 1] if kept else i
            d = np.hypot(points[i, 0] - points[j, 0], points[i, 1] - points[j, 1])
            if kept == 0 or (d > 0.0 and d >= near):
                rows[kept] = i
                kept += 1
            elif k == b - a - 1 and not closed[r] and kept > 1:
                rows[kept - 1] = i
        while closed[r] and kept > 1:
            i, j = rows[0], rows[kept - 1]
            d = np.hypot(points[i, 0] - points[j, 0], points[i, 1] - points[j, 1])
            if d > 0.0 and d >= near:
                break
            kept -= 1
        kept = _drop_collinear(points, rows, kept, closed[r], collinear)
        if kept < (3 if closed[r] else 2):
            collapsed[r] = True
            kept = b - a
            for i in range(kept):
                rows[i] = a + i
        sizes[r] = kept


@kernel
def _drop_collinear(points: Floats, rows: Ints, size: int, closed: bool, tolerance: float) -> int:
    """Keep, in place, the ends of the longest chords that stay within `tolerance`; return how many.

    From an anchor, each point passed narrows the wedge of directions in which a chord lies within the
    tolerance of it; a chord may end at the next point while that lies in the wedge and no nearer to
    the anchor than those passed.
    """
    if size < 3:
        return size
    kept = 1
    anchor = rows[0]
    final = rows[0] if closed else rows[size - 1]
    open_wedge = True
    base_x, base_y, low, high, reach = 1.0, 0.0, 0.0, 0.0, 0.0
    i = 1
    end = size if closed else size - 1
    while i < end:
        here = rows[i]
        ahead = rows[i + 1] if i + 1 < size else final
        x, y = points[here, 0] - points[anchor, 0], points[here, 1] - points[anchor, 1]
        r = np.hypot(x, y)
        if r > tolerance:
            half = np.arcsin(tolerance / r)
            if open_wedge:
                open_wedge, base_x, base_y, low, high = False, x, y, -half, half
            else:
                turn = np.arctan2(base_x * y - base_y * x, base_x * x + base_y * y)
                low, high = max(low, turn - half), min(high, turn + half)
        reach = max(reach, r)
        x, y = points[ahead, 0] - points[anchor, 0], points[ahead, 1] - points[anchor, 1]
        passes = np.hypot(x, y) >= reach
        if passes and not open_wedge:
            turn = np.arctan2(base_x * y - base_y * x, base_x * x + base_y * y)
            passes = low <= turn <= high
        if not passes:
            rows[kept] = here
            kept += 1
            anchor, open_wedge, reach = here, True, 0.0
        i += 1
    if not closed:
        rows[kept] = final
        kept += 1
    return kept


class Runs(NamedTuple):
    """Straight and curved runs of contours, as columns over pieces (P) and their points (D)."""

    points: Floats  # (D, 2) points of each run; neighbouring runs share, and repeat, the point between them
    starts: Ints  # (P + 1,) first row of each run in points
    ring_starts: Ints  # (R + 1,) first run of each ring
    kind: NDArray[np.uint8]  # (P,) LINE or SPLINE
    periodic: Bools  # (P,) whether the run is a whole closed ring without a split
    tangents: Floats  # (P, 2, 2) unit directions at the two ends of a run, NaN where they are free


def split(points: Floats, cleaned: CleanRings, closed: Bools, corner_angle_deg: float, straight_run_mm: float) -> Runs:
    """Split clean rings at their corners and at the ends of straight segments.

    A corner is a point whose interior angle is under `corner_angle_deg`. A segment is straight if it
    stands alone between two corners, or is at least `straight_run_mm` long and :data:`STRAIGHT_RATIO`
    times longer than those beside it. (That inner points were cleaned from it proves nothing: the
    two facets of each flat strip of a cylinder's mesh leave one.) What lies between is a curved run;
    next to a straight segment (where there is no corner) it takes that segment's direction as its
    tangent.
    """
    rows, starts, collapsed = cleaned
    ring, following, previous = around(starts)
    chord = points[rows[following]] - points[rows]
    length, back = np.hypot(*chord.T), chord[previous]
    turn = np.abs(angles(back, chord))
    at = np.arange(rows.size)
    first, last = at <= previous, following <= at
    has_segment = (closed[ring] | ~last) & (following != at)
    whole = collapsed[ring]
    # Angles within 1e-9 degrees of the corner angle count as equal to it, so that rotating a part changes nothing.
    corner = turn > np.deg2rad(180.0 - corner_angle_deg + 1e-9)
    corner |= ~closed[ring] & (first | last)
    alone = corner & corner[following]
    longest = longest_beside(length, corner, following, previous)
    straight = alone | ((length >= straight_run_mm) & (length >= STRAIGHT_RATIO * longest))
    straight &= has_segment & ~whole
    corner &= ~whole
    order = from_a_split(corner | straight | straight[previous], starts, closed)
    corner, straight, whole = corner[order], straight[order], whole[order]
    split_at = corner | straight | straight[previous] | first
    segment = np.flatnonzero(has_segment)
    begin = np.flatnonzero(split_at[segment])
    sizes = np.diff(begin, append=segment.size)
    head, end = segment[begin], following[segment[begin + sizes - 1]]
    run_starts = starts_of(sizes + 1)
    of_runs = np.empty((int(run_starts[-1]), 2))
    kept = points[rows[order]]
    of_runs[np.arange(segment.size) + each_of(sizes)[0]] = kept[segment]
    of_runs[run_starts[1:] - 1] = kept[end]
    counts = np.bincount(ring[head], minlength=closed.size)
    ring_starts = starts_of(counts)
    curved = ~whole[head] & ~straight[head]
    single = counts[ring[head]] == 1
    runs = Runs(
        points=of_runs,
        starts=run_starts,
        ring_starts=ring_starts,
        kind=np.where(curved, np.uint8(SPLINE), np.uint8(LINE)),
        periodic=curved & closed[ring[head]] & single & ~corner[head] & ~straight[head],
        tangents=np.full((head.size, 2, 2), np.nan),
    )
    # A curved run takes the directions of the straight ones beside it, where there is no corner.
    _, after, before = around(ring_starts)
    for side, beside, free in ((0, before, ~corner[head]), (1, after, ~corner[end])):
        runs_on = np.flatnonzero(curved & ~single & free & (runs.kind[beside] == LINE))
        line = run_starts[beside[runs_on]]
        way = of_runs[line + 1] - of_runs[line]
        runs.tangents[runs_on, side] = way / np.hypot(*way.T)[:, None]
    return runs


# -- rows of rings ---------------------------------------------------------------------------------------


def around(starts: Ints) -> tuple[Ints, Ints, Ints]:
    """Of the rows of rings that begin at `starts`: the ring, the row after it and the row before it, around the ring."""
    sizes = np.diff(starts)
    filled = sizes > 0
    following = np.arange(1, int(starts[-1]) + 1)
    following[starts[1:][filled] - 1] = starts[:-1][filled]
    previous = np.empty_like(following)
    previous[following] = np.arange(following.size)
    return np.repeat(np.arange(sizes.size), sizes), following, previous


def longest_beside(length: Floats, corner: Bools, following: Ints, previous: Ints) -> Floats:
    """The longest of two segments on either side of each, up to a corner; that of a row begins at it."""
    ahead = np.where(corner[following[following]], 0.0, length[following[following]])
    behind = np.where(corner[previous], 0.0, length[previous[previous]])
    ahead = np.where(corner[following], 0.0, np.maximum(length[following], ahead))
    behind = np.where(corner, 0.0, np.maximum(length[previous], behind))
    return np.maximum(ahead, behind)


def from_a_split(split_at: Bools, starts: Ints, closed: Bools) -> Ints:
    """Order of rows in which closed rings start at the first of their splits, where they have one."""
    sizes = np.diff(starts)
    ring, place = each_of(sizes)
    first = np.full(closed.size, np.iinfo(np.int64).max)
    np.minimum.at(first, ring[split_at], place[split_at])
    first[(first >= sizes) | ~closed] = 0
    return np.asarray(starts[ring] + (place + first[ring]) % np.maximum(sizes[ring], 1))


def angles(a: Floats, b: Floats) -> Floats:
    """Signed angles from vectors (..., 2) to others, rad."""
    x, y, u, v = a[..., 0], a[..., 1], b[..., 0], b[..., 1]
    return np.asarray(np.arctan2(x * v - y * u, x * u + y * v))

"""Cleaning of contours before a fit: near, repeated and collinear points are removed (paper, section 3.2)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ebamcheck.columns_file import starts_of
from ebamcheck.geometry.raster import each_of
from ebamcheck.kernels import Bools, Floats, Ints, kernel
from ebamcheck.threads import run_blocks


class CleanRings(NamedTuple):
    """Contours without needless points."""

    rows: Ints  # (K,) rows of the contour points that are kept, ring by ring
    starts: Ints  # (R + 1,) first entry of each ring in rows
    collapsed: Bools  # (R,) rings smaller than the tolerances; they keep all their points and are not fitted


def clean(
    points: Floats, ring_starts: Ints, closed: Bools, near_point_mm: float, collinear_mm: float
) -> CleanRings:
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

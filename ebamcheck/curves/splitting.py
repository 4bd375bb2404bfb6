"""Splitting of clean contours into straight and curved runs (paper, section 3.2)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ebamcheck.curves.cleaning import RINGS_A_BLOCK, CleanRings
from ebamcheck.geometry.rings import rotate_to
from ebamcheck.kernels import Bools, Floats, Ints, kernel
from ebamcheck.threads import run_blocks

LINE, SPLINE, ARC = 0, 1, 2
"""Kinds of piece: the polyline of its control points, a cubic B-spline, a circular arc through three points."""

ANGLE_ROUNDING_DEG = 1e-9
"""Angles this near to the corner angle count as equal to it, so that rotating a part changes nothing."""

STRAIGHT_RATIO = 3.0
"""A straight run is this many times longer than any of the two segments on either side of it.

Length alone does not decide: the chords of a large radius are long, too, but so are their neighbours."""

STRAIGHT_NEIGHBOURS = 2
"""Segments on either side, up to a corner, with which a straight run is compared."""


class Runs(NamedTuple):
    """Straight and curved runs of contours, as columns over pieces (P) and their points (D)."""

    points: Floats
    """(D, 2) points of each run; neighbouring runs share, and repeat, the point between them."""
    starts: Ints
    """(P + 1,) first row of each run in `points`."""
    ring_starts: Ints
    """(R + 1,) first run of each ring."""
    kind: NDArray[np.uint8]
    """(P,) :data:`LINE` or :data:`SPLINE`."""
    periodic: Bools
    """(P,) whether the run is a whole closed ring without a split."""
    tangents: Floats
    """(P, 2, 2) unit directions at the two ends of a run, NaN where they are free."""


class _Marked(NamedTuple):
    """Clean rings with their corners and straight segments."""

    points: Floats
    cleaned: CleanRings
    closed: Bools
    corners: Bools
    """(K,) whether a kept point is a corner."""
    straight: Bools
    """(K,) whether the segment after it is straight."""


def split(
    points: Floats,
    cleaned: CleanRings,
    closed: Bools,
    corner_angle_deg: float,
    straight_run_mm: float,
) -> Runs:
    """Split clean rings at their corners and at the ends of straight segments.

    A corner is a point whose interior angle is under `corner_angle_deg`. A segment is straight if it
    stands alone between two corners, or is at least `straight_run_mm` long and :data:`STRAIGHT_RATIO`
    times longer than those beside it. (That inner points were cleaned from it proves nothing: the
    two facets of each flat strip of a cylinder's mesh leave one.) What lies between is a curved run;
    next to a straight segment (where there is no corner) it takes that segment's direction as its
    tangent.
    """
    ring_count, size = closed.size, cleaned.rows.size
    marked = _Marked(
        points,
        cleaned._replace(rows=cleaned.rows.copy()),
        closed,
        np.zeros(size, np.bool_),
        np.zeros(size, np.bool_),
    )
    largest_turn = np.deg2rad(180.0 - corner_angle_deg + ANGLE_ROUNDING_DEG)
    pieces = np.zeros(ring_count, dtype=np.int64)
    sizes = np.zeros(ring_count, dtype=np.int64)

    def mark(first: int, last: int) -> None:
        _mark(marked, largest_turn, straight_run_mm, first, last, pieces, sizes)

    run_blocks(mark, ring_count, RINGS_A_BLOCK)
    ring_starts = np.concatenate([[0], np.cumsum(pieces)]).astype(np.int64)
    piece_count = int(ring_starts[-1])
    places = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
    runs = Runs(
        points=np.empty((int(places[-1]), 2)),
        starts=np.zeros(piece_count + 1, dtype=np.int64),
        ring_starts=ring_starts,
        kind=np.zeros(piece_count, dtype=np.uint8),
        periodic=np.zeros(piece_count, dtype=np.bool_),
        tangents=np.full((piece_count, 2, 2), np.nan),
    )

    def fill(first: int, last: int) -> None:
        _fill(marked, first, last, places, runs)

    run_blocks(fill, ring_count, RINGS_A_BLOCK)
    return runs


@kernel
def _turn(points: Floats, i: int, j: int, k: int) -> float:
    """Angle between the segments i-j and j-k, rad, from 0 (straight on) to pi (straight back)."""
    ax, ay = points[j, 0] - points[i, 0], points[j, 1] - points[i, 1]
    bx, by = points[k, 0] - points[j, 0], points[k, 1] - points[j, 1]
    return float(abs(np.arctan2(ax * by - ay * bx, ax * bx + ay * by)))


@kernel
def _mark(
    marked: _Marked,
    largest_turn: float,
    straight_run: float,
    first_ring: int,
    last_ring: int,
    pieces: Ints,
    sizes: Ints,
) -> None:
    """Mark corners and straight segments, turn closed rings to start at a split, count the pieces.

    ``corners[k]`` belongs to the k-th kept point and ``straight[k]`` to the segment after it;
    `sizes` counts the points of all pieces of a ring, shared ones twice.
    """
    points, (rows, starts, collapsed), closed, corners, straight = marked
    for ring in range(first_ring, last_ring):
        a, b = starts[ring], starts[ring + 1]
        n = b - a
        if n < 2:
            continue
        segments = n if closed[ring] else n - 1
        if collapsed[ring]:
            pieces[ring] = 1
            sizes[ring] = segments + 1
            continue
        for i in range(n):
            before, after = rows[a + (i - 1) % n], rows[a + (i + 1) % n]
            end = not closed[ring] and (i == 0 or i == n - 1)
            corners[a + i] = end or _turn(points, before, rows[a + i], after) > largest_turn
        _mark_long(points, rows[a:b], corners[a:b], segments, straight_run, straight[a:b])
        splits = 0
        first = -1
        for i in range(n):
            if corners[a + i] or straight[a + i] or straight[a + (i - 1) % n]:
                splits += 1
                if first < 0:
                    first = i
        if closed[ring]:
            pieces[ring] = max(splits, 1)
            if first > 0:
                rotate_to(rows[a:b], first)
                rotate_to(corners[a:b], first)
                rotate_to(straight[a:b], first)
        else:
            pieces[ring] = splits - 1
        sizes[ring] = segments + pieces[ring]


@kernel
def _mark_long(
    points: Floats, rows: Ints, corners: Bools, segments: int, straight_run: float, straight: Bools
) -> None:
    """Mark the segments between two corners and those far longer than their neighbours."""
    n = rows.size
    lengths = np.empty(segments)
    for i in range(segments):
        p, q = rows[i], rows[(i + 1) % n]
        lengths[i] = np.hypot(points[q, 0] - points[p, 0], points[q, 1] - points[p, 1])
    for i in range(segments):
        longest = 0.0
        for step in range(1, STRAIGHT_NEIGHBOURS + 1):
            if corners[(i + step) % n]:
                break
            longest = max(longest, lengths[(i + step) % n])
        for step in range(1, STRAIGHT_NEIGHBOURS + 1):
            if corners[(i - step + 1) % n]:
                break
            longest = max(longest, lengths[(i - step) % n])
        alone = corners[i] and corners[(i + 1) % n]
        straight[i] = alone or (lengths[i] >= straight_run and lengths[i] >= STRAIGHT_RATIO * longest)


@kernel
def _fill(marked: _Marked, first_ring: int, last_ring: int, places: Ints, runs: Runs) -> None:
    """Write the points, kinds and tangents of all runs, ring by ring."""
    points, (rows, starts, collapsed), closed, corners, straight = marked
    for ring in range(first_ring, last_ring):
        place = places[ring]
        a, n = starts[ring], starts[ring + 1] - starts[ring]
        first, last = runs.ring_starts[ring], runs.ring_starts[ring + 1]
        if last == first:
            continue
        segments = n if closed[ring] else n - 1
        runs.starts[first] = place  # the ring before may be another thread's, and not there yet
        piece = first
        for i in range(segments):
            j = (i + 1) % n
            runs.points[place] = points[rows[a + i]]
            place += 1
            splits = not collapsed[ring] and (corners[a + j] or straight[a + i] or straight[a + j])
            if i < segments - 1 and not splits:
                continue
            runs.points[place] = points[rows[a + j]]
            place += 1
            runs.starts[piece + 1] = place
            curved = not collapsed[ring] and not straight[a + i]
            runs.kind[piece] = SPLINE if curved else LINE
            runs.periodic[piece] = (
                curved and closed[ring] and last - first == 1 and not corners[a] and not straight[a]
            )
            piece += 1
        _set_tangents(runs, rows[a : a + n], corners[a : a + n], first, last)


@kernel
def _set_tangents(runs: Runs, rows: Ints, corners: Bools, first: int, last: int) -> None:
    """Give curved runs of one ring the direction of the straight segment beside them."""
    at = 0  # kept point at which the run starts
    for p in range(first, last):
        size = runs.starts[p + 1] - runs.starts[p]
        end = (at + size - 1) % rows.size
        if runs.kind[p] == SPLINE and last - first > 1:
            before = p - 1 if p > first else last - 1
            after = p + 1 if p + 1 < last else first
            if not corners[at] and runs.kind[before] == LINE:
                _direction(runs, before, p, 0)
            if not corners[end] and runs.kind[after] == LINE:
                _direction(runs, after, p, 1)
        at = end


@kernel
def _direction(runs: Runs, line: int, p: int, end: int) -> None:
    """Write the direction of the two-point run `line` as the tangent of run `p` at one end."""
    i = runs.starts[line]
    x, y = runs.points[i + 1, 0] - runs.points[i, 0], runs.points[i + 1, 1] - runs.points[i, 1]
    length = np.hypot(x, y)
    runs.tangents[p, end, 0] = x / length
    runs.tangents[p, end, 1] = y / length

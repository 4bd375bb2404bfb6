"""Reduction: the fewest lines, arcs and cubics that stay within a tolerance of a curve through many points.

Each goes as far as it can, from a point and direction of the contour to another point and its direction, so
the pieces join without a kink. A circle stays a circle: an arc is taken if it fits within half of the tolerance.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ebamcheck.curves.one_segment import (
    LARGEST_SWEEP_RAD,
    Path,
    arc_end,
    fit_arc,
    fit_cubic,
    length_of,
    own_cubic,
    path_of,
)
from ebamcheck.curves.oriented_contours import OrientedContours
from ebamcheck.curves.segments import Segments, set_cubic
from ebamcheck.curves.splitting import ARC, LINE, SPLINE
from ebamcheck.kernels import Bools, Floats, Ints, kernel
from ebamcheck.threads import run_blocks

SHARE_OF_BULGE = 0.1
"""Share of the greatest bulge of a ring's smooth curve that the reduction may give away. The tolerance is the lesser of this and
the setting, lest what lifting gained be lost again."""

LEAST_TOLERANCE_MM = 0.0005
"""Least tolerance, however small the bulges: half of the least distance of contour points."""


class _Written(NamedTuple):
    """Columns into which segments are written."""

    points: Floats
    """(n, 4, 2) Bezier points."""
    kind: NDArray[np.uint8]
    """(n,) kind of segment."""
    corner: Bools
    """(n,) whether the segment starts at a corner."""


def smooth_segments(contours: OrientedContours, closed: Bools) -> Segments:
    """One cubic or line for each segment of the contours."""
    return _blocks(contours, closed, -1.0)


def reduced_segments(contours: OrientedContours, closed: Bools, tolerance_mm: float) -> Segments:
    """Lines, arcs and cubics, as few as the tolerance allows."""
    return _blocks(contours, closed, tolerance_mm)


def _blocks(contours: OrientedContours, closed: Bools, tolerance_mm: float) -> Segments:
    def work(first: int, last: int) -> tuple[Floats, NDArray[np.uint8], Bools, Ints]:
        return _segments_of_rings(contours, closed, tolerance_mm, first, last)

    blocks = run_blocks(work, closed.size)
    counts = np.concatenate([block[3] for block in blocks])
    return Segments(
        np.concatenate([block[0] for block in blocks]),
        np.concatenate([block[1] for block in blocks]),
        np.concatenate([block[2] for block in blocks]),
        np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
    )


@kernel
def _segments_of_rings(
    contours: OrientedContours, closed: Bools, tolerance: float, first: int, last: int
) -> tuple[Floats, NDArray[np.uint8], Bools, Ints]:
    """Bezier points, kinds, corners, and number of segments a ring; a negative tolerance keeps every segment."""
    total = contours.starts[last] - contours.starts[first]
    found = _Written(np.empty((total, 4, 2)), np.empty(total, np.uint8), np.empty(total, np.bool_))
    counts = np.zeros(last - first, np.int64)
    n = 0
    for r in range(first, last):
        a, size = contours.starts[r], contours.starts[r + 1] - contours.starts[r]
        segments = size if closed[r] and size > 1 else size - 1
        at = n
        k = 0
        while k < segments:
            if contours.straight[a + k]:
                found.points[n, 0] = contours.points[a + k]
                found.points[n, 3] = contours.points[a + (k + 1) % size]
                found.points[n, 1], found.points[n, 2] = found.points[n, 0], found.points[n, 3]
                found.kind[n] = LINE
                found.corner[n] = contours.corner[a + k]
                n += 1
                k += 1
                continue
            end = k + 1
            while end < segments and not (contours.corner[a + end] or contours.straight[a + end]):
                end += 1
            n = _chain(contours, a, size, k, end, tolerance, found, n)
            k = end
        counts[r - first] = n - at
    return found.points[:n].copy(), found.kind[:n].copy(), found.corner[:n].copy(), counts


@kernel
def _chain(
    contours: OrientedContours,
    a: int,
    size: int,
    k: int,
    end: int,
    tolerance: float,
    found: _Written,
    n: int,
) -> int:
    """Write the segments of one smooth chain, from its segment k up to `end`; returns the place after them."""
    count = end - k
    cubics = np.empty((count, 4, 2))
    bulge = 0.0
    for i in range(count):
        p, q = a + k + i, a + (k + i + 1) % size
        set_cubic(cubics[i], contours.points[p], contours.points[q], contours.after[p], contours.before[q])
        chord = length_of(contours.points[q] - contours.points[p])
        bulge = max(bulge, 0.25 * chord * max(abs(contours.after[p]), abs(contours.before[q])))
    if tolerance < 0.0:
        for i in range(count):
            found.points[n], found.kind[n], found.corner[n] = (
                cubics[i],
                SPLINE,
                i == 0 and contours.corner[a + k],
            )
            n += 1
        return n
    allowed = min(tolerance, max(SHARE_OF_BULGE * bulge, LEAST_TOLERANCE_MM))
    path = path_of(cubics)
    found.corner[n] = contours.corner[a + k]
    return _reduce(path, allowed, found, n)


@kernel
def _reduce(
    path: Path,
    tolerance: float,
    found: _Written,
    n: int,
) -> int:
    """Write the fewest segments along a path, each as long as can be; returns the place after them."""
    last = len(path.points) - 1
    begin = n
    direction = path.directions[0].copy()
    i = 0
    guess = 1
    B = np.empty((4, 2))
    while i < last:
        reached = _farthest(path, direction, i, guess, tolerance, False, B)
        round_ = _farthest(path, direction, i, max(reached - i, 1), tolerance, True, B)
        is_arc = round_ - i > 1 and (
            round_ >= reached or abs(path.turns[round_] - path.turns[i]) > 0.9 * LARGEST_SWEEP_RAD
        )
        j = round_ if is_arc else reached
        if is_arc:
            fit_arc(path, direction, i, j, tolerance, B)
        elif not fit_cubic(path, direction, i, j, tolerance, B):
            own_cubic(path, direction, i, B)  # a single segment is what it is
        found.points[n], found.kind[n] = B, ARC if is_arc else SPLINE
        if n > begin:
            found.corner[n] = False
        direction[:] = arc_end(B) if is_arc else path.directions[j]
        n += 1
        guess = j - i
        i = j
    return n


@kernel
def _farthest(
    path: Path, direction: Floats, i: int, guess: int, tolerance: float, round_: bool, B: Floats
) -> int:
    """Farthest joint that one segment from joint i reaches within the tolerance; i + 1 at least."""
    last = len(path.points) - 1
    low, step = 1, max(guess, 1)
    high = last - i + 1
    while low < high - 1:  # from the guess outward, then by halves
        size = min(low + step, high - 1) if step > 0 else (low + high) // 2
        fits = (
            fit_arc(path, direction, i, i + size, tolerance, B)
            if round_
            else fit_cubic(path, direction, i, i + size, tolerance, B)
        )
        if fits:
            low = size
            step *= 2
        else:
            high = size
            step = 0
    return i + low

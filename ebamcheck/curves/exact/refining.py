"""Refinement: points are inserted into a contour, on the section of its exact surface, where a cubic would not follow that."""

from __future__ import annotations

import numpy as np

from ebamcheck.curves.exact.sections import on_one, set_along
from ebamcheck.curves.sides import NO_FORM, NO_PLANE, Sides
from ebamcheck.numeric.kernels import kernel, run_blocks
from ebamcheck.numeric.rings import Bools, Floats, Ints

FOLLOWED, TOO_LONG, LOST = range(3)
"""Results for a segment divided into parts."""

LARGEST_SPAN_RAD = np.deg2rad(20.0)
"""Largest turn of a section along one cubic, which then follows it to some 1e-5 of its length."""

LEAST_SPAN_RAD = np.deg2rad(1.0)
"""Turn of a section below which it is as good as straight."""

UNEVEN = 0.05
"""Largest difference between the angles at the two ends of a segment, over their sum, for one as good as circular."""

MOST_PARTS = 32
"""Most parts into which a segment is divided."""

RINGS_A_BLOCK = 16


def refined(
    forms: Floats, sides: Sides, heights: Floats, ring_starts: Ints, closed: Bools
) -> tuple[Sides, Ints]:
    """Contours with points inserted on exact surfaces, and the new starts of their rings.

    Parameters
    ----------
    forms
        (S, SIZE) exact surfaces.
    sides
        Points of the contours.
    heights
        (R,) height of each ring, mm.
    ring_starts, closed
        (R + 1,), (R,) rings of the points.
    """
    parts = np.ones(len(sides.points), np.int64)

    def count(first: int, last: int) -> None:
        _count_parts(forms, sides, heights, ring_starts, closed, first, last, parts)

    run_blocks(count, closed.size, RINGS_A_BLOCK)
    if (parts == 1).all():
        return sides, ring_starts
    at = np.concatenate([[0], np.cumsum(parts)]).astype(np.int64)
    more = Sides._make(np.repeat(column, parts, axis=0) for column in sides)
    rings = np.repeat(np.arange(closed.size), np.diff(ring_starts))
    _fill(forms, sides, heights[rings], at, _following(ring_starts), more)
    return more, at[ring_starts]


def _following(ring_starts: Ints) -> Ints:
    """Index of the point after each point, around its ring."""
    following = np.arange(1, int(ring_starts[-1]) + 1)
    filled = np.diff(ring_starts) > 0
    following[ring_starts[1:][filled] - 1] = ring_starts[:-1][filled]
    return following


@kernel
def _count_parts(
    forms: Floats,
    sides: Sides,
    heights: Floats,
    ring_starts: Ints,
    closed: Bools,
    first: int,
    last: int,
    parts: Ints,
) -> None:
    """Parts that the segments of some rings are to be divided into, so that a cubic follows each."""
    direction = np.empty(2)
    for r in range(first, last):
        a, b = ring_starts[r], ring_starts[r + 1]
        for i in range(a, b):
            j = i + 1 if i + 1 < b else a
            form = sides.form_after[i]
            if form == NO_FORM or form != sides.form_before[j] or (j == a and not closed[r]):
                continue
            count, told = 1, TOO_LONG
            while told == TOO_LONG and count < MOST_PARTS:
                told = _told(forms[form], sides, i, j, heights[r], count, direction)
                if told == TOO_LONG:
                    count *= 2
            if told == TOO_LONG:
                told = _told(forms[form], sides, i, j, heights[r], count, direction)
            parts[i] = 1 if told == LOST else count


@kernel
def _told(row: Floats, sides: Sides, i: int, j: int, z: float, parts: int, direction: Floats) -> int:
    """Whether cubics follow so many parts of a segment, one is too long for that, or the section is lost."""
    x, y = sides.points[i, 0], sides.points[i, 1]
    dx, dy = sides.points[j, 0] - x, sides.points[j, 1] - y
    ux, uy = sides.after[i, 0], sides.after[i, 1]
    u, v = x, y
    told = FOLLOWED
    for k in range(1, parts + 1):
        s, t, known = sides.points[j, 0], sides.points[j, 1], True
        direction[:] = sides.before[j]
        if k < parts:
            known, s, t = on_one(row, x + dx * k / parts, y + dy * k / parts, z)
            if not known or not set_along(row, s, t, z, direction):
                return LOST
        ax, ay = s - u, t - v
        start = np.arctan2(ux * ay - uy * ax, ux * ax + uy * ay)
        end = np.arctan2(ax * direction[1] - ay * direction[0], ax * direction[0] + ay * direction[1])
        span = abs(start) + abs(end)
        if span > LARGEST_SPAN_RAD or (span > LEAST_SPAN_RAD and abs(start - end) > UNEVEN * span):
            told = TOO_LONG
        ux, uy = direction[0], direction[1]
        u, v = s, t
    return told


@kernel
def _fill(forms: Floats, sides: Sides, heights: Floats, at: Ints, following: Ints, more: Sides) -> None:
    """Set the points that were put in between, and what is known of their sides."""
    for i in range(len(sides.points)):
        parts = at[i + 1] - at[i]
        if parts == 1:
            continue
        j = following[i]
        form = sides.form_after[i]
        x, y = sides.points[i, 0], sides.points[i, 1]
        dx, dy = sides.points[j, 0] - x, sides.points[j, 1] - y
        for k in range(1, parts):
            n = at[i] + k
            _, more.points[n, 0], more.points[n, 1] = on_one(
                forms[form], x + dx * k / parts, y + dy * k / parts, heights[i]
            )
            set_along(forms[form], more.points[n, 0], more.points[n, 1], heights[i], more.after[n])
            more.before[n] = more.after[n]
            more.smooth[n], more.flat[n], more.rough[n] = True, False, False
            more.plane_before[n] = more.plane_after[n] = NO_PLANE
            more.form_before[n] = more.form_after[n] = form
            more.share[n], more.plausible[n] = 1.0, np.inf

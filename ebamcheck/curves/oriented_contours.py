"""Oriented contours: contours with a direction at every point, ready to be fitted.

Corners and straight segments divide a contour. In between, the direction at a point lies between those of its two
chords; so a curve in these directions deviates from a chord by no more than the contour turns there.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ebamcheck.curves.bends import (
    Ring,
    find_corners,
    keep_near,
    keep_plausible,
    keep_rough,
    limit_at_corners,
    mark_straight,
    set_angles,
    spare_long_segments,
    start_at_a_split,
    without_flat,
    without_near,
)
from ebamcheck.curves.sides import Sides
from ebamcheck.numeric.kernels import kernel, run_blocks
from ebamcheck.numeric.rings import Bools, Floats, Ints
from ebamcheck.settings.stages import CurveSettings

RINGS_A_BLOCK = 16


class OrientedContours(NamedTuple):
    """Points of rings with their directions, as columns."""

    points: Floats
    """(K, 2) mm."""
    starts: Ints
    """(R + 1,) first point of each ring; a closed ring's last segment goes from its last point to its first."""
    before: Floats
    """(K,) angle from the chord of the segment before the point to the contour's direction at its end, rad; positive to the
    left."""
    after: Floats
    """(K,) angle from the contour's direction at the start of the segment after the point to its chord, rad. On a circle
    both angles of a segment are half of the angle that it spans."""
    corner: Bools
    """(K,) whether the point is a corner, or the end of an open path."""
    straight: Bools
    """(K,) whether the segment after the point is a straight line."""


class _Limits(NamedTuple):
    """Settings of the orientation, in the units of the kernels."""

    near_mm: float
    largest_turn_rad: float
    straight_run_mm: float
    largest_bulge_mm: float


def orient(
    sides: Sides, ring_starts: Ints, closed: Bools, settings: CurveSettings, largest_bulge_mm: float = np.inf
) -> OrientedContours:
    """Give contours a direction at every point.

    Parameters
    ----------
    sides
        Points and directions; unknown directions (NaN) are estimated from the chords.
    ring_starts, closed
        (R + 1,), (R,) rings of the points.
    settings
        Corner angle, smallest distance of points, least length of a straight run.
    largest_bulge_mm
        A segment that would leave its chord by more stays straight, between corners: a contour alone does not show
        whether the part is curved there.
    """
    total = len(sides.points)
    turn = float(np.deg2rad(180.0 - settings.corner_angle_deg))
    limits = _Limits(settings.near_point_mm, turn, settings.straight_run_mm, largest_bulge_mm)
    sizes = np.zeros(closed.size, np.int64)
    columns = Ring(
        np.empty(total, np.int64),
        np.zeros(total),
        np.zeros(total),
        np.zeros(total, np.bool_),
        np.zeros(total, np.bool_),
    )

    def work(first: int, last: int) -> None:
        _orient_rings(sides, ring_starts, closed, limits, columns, sizes, first, last)

    run_blocks(work, closed.size, RINGS_A_BLOCK)
    starts = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
    kept = np.arange(starts[-1]) + np.repeat(ring_starts[:-1] - starts[:-1], sizes)
    rows, *angles_and_flags = (column[kept] for column in columns)
    return OrientedContours(sides.points[rows], starts, *angles_and_flags)


@kernel
def _orient_rings(
    sides: Sides,
    ring_starts: Ints,
    closed: Bools,
    limits: _Limits,
    columns: Ring,
    sizes: Ints,
    first: int,
    last: int,
) -> None:
    """Orient the rings from `first` up to `last`: fill their columns, and how many points each keeps."""
    for r in range(first, last):
        a, b = ring_starts[r], ring_starts[r + 1]
        n = without_near(sides, a, b, closed[r], limits.near_mm, columns.rows)
        n = without_flat(sides, columns.rows[a : a + n], closed[r])
        sizes[r] = n
        ring = Ring(
            columns.rows[a : a + n],
            columns.before[a : a + n],
            columns.after[a : a + n],
            columns.corner[a : a + n],
            columns.straight[a : a + n],
        )
        if n < 3:
            ring.corner[:] = True
            ring.straight[:] = True
            continue
        find_corners(sides, ring, closed[r], limits.largest_turn_rad)
        set_angles(sides, ring, closed[r])
        limit_at_corners(sides, ring)
        spare_long_segments(sides, ring)
        keep_plausible(sides, ring, closed[r])
        mark_straight(sides, ring, closed[r], limits.straight_run_mm)
        keep_rough(sides, ring, closed[r])
        keep_near(sides.points, ring, closed[r], limits.largest_bulge_mm)
        if closed[r]:
            start_at_a_split(ring)

"""Oriented contours: contours with a direction at every point, ready to be fitted.

Corners and straight segments divide a contour. In between, the direction at a point lies between those of its two
chords; so a curve in these directions deviates from a chord by no more than the contour turns there. Where the mesh supports
only a smaller bend, segments bend less.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ebamcheck.columns_file import starts_of
from ebamcheck.curves.runs import STRAIGHT_RATIO, angles, around, from_a_split, longest_beside
from ebamcheck.geometry.raster import each_of
from ebamcheck.kernels import Bools, Floats, Ints, kernel
from ebamcheck.mesh.topology import Index
from ebamcheck.settings.stages import CurveSettings
from ebamcheck.threads import run_blocks

FLAT_MM = 2e-5
"""A smooth point this near to the chord of its neighbours, in place and direction, is removed: facets of one flat side meet
there. It is the 32-bit rounding of coordinates of some hundred mm."""

NO_PLANE = -1  # Number of the plane of a segment that is in none
NO_FORM = -1  # Number of the exact surface of a segment that is on none


class Sides(NamedTuple):
    """Points of contours (N), and what is known of the segments that end (`before`) and begin (`after`) at each."""

    points: Floats  # (N, 2) mm
    before: Floats  # (N, 2) unit direction in which the contour arrives; NaN where unknown
    after: Floats  # (N, 2) unit direction in which it leaves; NaN where unknown
    smooth: Bools  # (N,) whether the contour has no corner at the point
    unknown: Bools  # (N,) whether nothing is known of the segment after the point: no facet
    plane_before: Index  # (N,) plane in which the segment lies; NO_PLANE for none
    plane_after: Index
    share: Floats  # (N,) share, 0 .. 1, of lift and bend that is made at the point; 0 where the normals are noise
    plausible: Floats  # (N,) plausible height of the surface over the facets, over their sine of slope, mm
    form_before: Index  # (N,) exact surface whose section the segment follows; NO_FORM for none
    form_after: Index


def as_they_are(points: Floats) -> Sides:
    """Sides of points (N, 2) of which nothing but their places is known."""
    count = len(points)
    unknown, none = np.full((count, 2), np.nan), np.full(count, -1, np.int32)
    no, yes = np.zeros(count, np.bool_), np.ones(count, np.bool_)
    ones, infinite = np.ones(count), np.full(count, np.inf)
    planes, forms = (none, none.copy()), (none.copy(), none.copy())
    return Sides(points, unknown, unknown.copy(), no, yes, *planes, ones, infinite, *forms)


class OrientedContours(NamedTuple):
    """Points of rings with their directions, as columns."""

    points: Floats  # (K, 2) mm
    starts: (
        Ints  # (R + 1,) first point of each ring; a closed ring's last segment goes from its last point to its first
    )
    # On a circle both angles of a segment are half of what it spans; positive to the left.
    before: Floats  # (K,) angle from the chord before the point to the contour's direction at its end, rad
    after: Floats  # (K,) angle from the contour's direction at the start of the chord after the point to that, rad
    corner: Bools  # (K,) whether the point is a corner, or the end of an open path
    straight: Bools  # (K,) whether the segment after the point is a straight line


def orient(
    sides: Sides, ring_starts: Ints, closed: Bools, settings: CurveSettings, largest_bulge_mm: float = np.inf
) -> OrientedContours:
    """Give contours a direction at every point; unknown ones (NaN) are estimated from the chords.

    A segment that would leave its chord by more than `largest_bulge_mm` stays straight, between corners: a contour alone does
    not show whether the part is curved there.
    """
    rows = np.empty(len(sides.points), np.int64)
    sizes = np.zeros(closed.size, np.int64)

    def work(first: int, last: int) -> None:
        _thin_rings(sides, ring_starts, closed, settings.near_point_mm, first, last, rows, sizes)

    run_blocks(work, closed.size, 16)
    starts = starts_of(sizes)
    ring, place = each_of(sizes)
    bends = _Bends(sides, rows[ring_starts[ring] + place], starts, closed)
    bends.find_corners(float(np.deg2rad(180.0 - settings.corner_angle_deg)))
    bends.set_angles()
    bends.keep_plausible()
    bends.mark_straight(settings.straight_run_mm)
    share = sides.share[bends.rows]
    # A curve through noise is noisier than its chords.
    bends.straighten((share == 0.0) & (share[bends.next] == 0.0))
    bends.straighten(bends.bulges() > largest_bulge_mm)
    few = sizes[ring] < 3
    corner, straight = bends.corner | few, bends.straight | few
    order = from_a_split(corner | straight | straight[bends.previous], starts, closed)
    points, before, after = sides.points[bends.rows[order]], bends.before[order], bends.after[order]
    return OrientedContours(points, starts, before, after, corner[order], straight[order])


class _Bends:
    """Points of rings and the bends at them, as columns; the angles are those of :class:`OrientedContours`."""

    def __init__(self, sides: Sides, rows: Ints, starts: Ints, closed: Bools) -> None:
        self.sides, self.rows = sides, rows
        sizes = np.diff(starts)
        _, self.next, self.previous = around(starts)
        open_ = (sizes > 0) & ~closed
        self.last = np.zeros(rows.size, np.bool_)  # points after which an open path has no segment
        self.last[starts[1:][open_] - 1] = True
        self.end = self.last.copy()
        self.end[starts[:-1][open_]] = True
        self.chord = sides.points[rows[self.next]] - sides.points[rows]
        self.length = np.hypot(*self.chord.T)
        self.turn = angles(self.chord[self.previous], self.chord)
        form = sides.form_after[rows]
        # Whether the segment after each point lies on an exact surface at both of its ends.
        self.sure = (form != NO_FORM) & (form == sides.form_before[rows[self.next]])
        self.corner = np.zeros(rows.size, np.bool_)
        self.straight = np.zeros(rows.size, np.bool_)

    def find_corners(self, largest_turn: float) -> None:
        """Creases are corners; so are points of unknown direction that turn far, and the ends of open paths."""
        smooth, turn = self.sides.smooth[self.rows], np.abs(self.turn)
        sharp = ~smooth & ~np.isnan(self.sides.before[self.rows, 0])
        # A smooth mesh edge at which the contour turns by more than 60 degrees is the tip of a thin feature.
        self.corner = np.where(smooth, turn > np.deg2rad(60.0), sharp | (turn > largest_turn)) | self.end

    def set_angles(self) -> None:
        """Angles between chords and directions; a segment whose direction at a corner is unknown bends as at its other end."""
        sides, rows, turn = self.sides, self.rows, self.turn
        to, away = self.length[self.previous], self.length
        told = angles(self.chord[self.previous], sides.before[rows])
        known = sides.smooth[rows] & ~np.isnan(sides.before[rows, 0])
        # Else the circle through the three points.
        ahead = np.where(known, told, turn * to / np.maximum(to + away, 1e-300))
        # Between the two chords: a direction beyond them would bend the curve out and back.
        between = np.minimum(np.maximum(ahead, np.minimum(turn, 0.0)), np.maximum(turn, 0.0))
        on_forms = (sides.form_before[rows] != NO_FORM) & (sides.form_after[rows] != NO_FORM)
        ahead = np.where(on_forms, ahead, between)
        back = angles(sides.after[rows], self.chord)
        self.before = np.where(self.corner, np.where(self.end, np.nan, told), ahead)
        self.after = np.where(self.corner, np.where(self.end, np.nan, back), turn - ahead)
        start, end = self.after, self.before[self.next]
        start = np.where(np.isnan(start), end, start)
        end = np.where(np.isnan(end), start, end)
        self._set(np.nan_to_num(start, nan=0.0), np.nan_to_num(end, nan=0.0), ~self.sure)

    def _set(self, start: Floats | float, end: Floats | float, which: Bools) -> None:
        """Set the angles at both ends of some segments."""
        start, end = np.broadcast_to(start, which.shape), np.broadcast_to(end, which.shape)
        self.after[which] = start[which]
        self.before[self.next[which]] = end[which]

    def bulges(self) -> Floats:
        """How far each segment would leave its chord, mm."""
        largest = np.maximum(np.abs(self.after), np.abs(self.before[self.next]))
        return np.where(self.last, 0.0, 0.25 * self.length * largest)

    def keep_plausible(self) -> None:
        """Bend segments less that would leave their chords by more than the surface plausibly does.

        What such a segment turns less at an end, its neighbour turns more, unless that then bends too much itself or lies on an
        exact surface: there is a kink then, as the contour has.
        """
        rows, follow, back = self.rows, self.next, self.previous
        plausible, share = self.sides.plausible[rows], self.sides.share[rows]
        plausible = np.maximum(plausible, plausible[follow])
        less = np.minimum(plausible / np.maximum(self.bulges(), 1e-300), 1.0) ** 2
        share = less * np.maximum(share, share[follow])
        share[self.sure | self.last] = 1.0
        beside = share[back]
        turn, before, after = self.before + self.after, self.before * beside, self.after * share
        changed = ~self.corner & ((share < 1.0) | (beside < 1.0))
        kinked = np.where(share == 1.0, self.sure, self.sure[back]) | ((share < 1.0) & (beside < 1.0))
        one = changed & ~kinked
        given = (
            (one & (share < 1.0), turn - after, self.length[back], plausible[back]),
            (one & (share == 1.0), turn - before, self.length, plausible),
        )
        for column, (which, angle, length, most) in zip((before, after), given, strict=True):
            much = which & (0.25 * length * np.abs(angle) > most)
            column[which] = angle[which]
            column[much] = np.copysign(4.0 * most[much] / length[much], angle[much])
            self.corner |= much
        self.corner |= changed & kinked
        self.before, self.after = before, after

    def mark_straight(self, straight_run: float) -> None:
        """Mark straight segments, and turn what lies beside them to their direction.

        A segment is straight if it lies in a plane, or does not bend between two corners. One of which nothing is known is, too,
        if it is long and far longer than those beside it.
        """
        sides, rows, follow, back, corner = self.sides, self.rows, self.next, self.previous, self.corner
        lengths = np.where(self.last, 0.0, self.length)
        longest = longest_beside(lengths, corner, follow, back)
        long = sides.unknown[rows] & (lengths >= straight_run) & (lengths >= STRAIGHT_RATIO * longest)
        plane = sides.plane_after[rows]
        in_plane = (plane != NO_PLANE) & (plane == sides.plane_before[rows[follow]])
        alone = corner & corner[follow] & (self.bulges() < FLAT_MM)
        self.straight = straight = (in_plane | alone | long) & ~self.last
        beside = straight[back]
        self.corner = corner = corner | (straight & self.sure[back]) | (beside & self.sure)
        self.before = np.where(straight & ~beside & ~corner, self.before + self.after, self.before)
        self.after = np.where(beside & ~straight & ~corner, self.after + self.before, self.after)
        self._set(0.0, 0.0, straight)

    def straighten(self, which: Bools) -> None:
        """Make some segments straight, between corners."""
        which = which & ~self.last
        self.straight |= which
        self.corner |= which
        self.corner[self.next[which]] = True
        self._set(0.0, 0.0, which)


# -- Thinning: contour points that carry no shape are removed, those too near to others and those inside straight sides.


IN_PLANE_MM = 1e-3
"""A point inside a plane is removed if it lies this near to the chord of its neighbours: the rounding of a file's decimals, and
the least distance of contour points. Not every point in a plane is: around a level one the contour turns."""


@kernel
def _thin_rings(
    sides: Sides,
    ring_starts: Ints,
    closed: Bools,
    near: float,
    first: int,
    last: int,
    rows: Ints,
    sizes: Ints,
) -> None:
    """Write the rows of the points that are kept of each ring, from its start on, and how many there are.

    Of points nearer than `near` to the one before, that on a crease stays. A ring keeps three points.
    """
    points = sides.points
    for r in range(first, last):
        a, b = ring_starts[r], ring_starts[r + 1]
        n = 0
        for i in range(a, b):
            if n:
                j = rows[a + n - 1]
                if np.hypot(points[i, 0] - points[j, 0], points[i, 1] - points[j, 1]) < near:
                    sharp = not sides.smooth[i] and not np.isnan(sides.before[i, 0])
                    if sharp and n > 1 and (sides.smooth[j] or np.isnan(sides.before[j, 0])):
                        rows[a + n - 1] = i
                    continue
            rows[a + n] = i
            n += 1
        while closed[r] and n > 3:
            i, j = rows[a + n - 1], rows[a]
            if np.hypot(points[i, 0] - points[j, 0], points[i, 1] - points[j, 1]) >= near:
                break
            n -= 1
        if n < 3 <= b - a:
            n = b - a
            for i in range(a, b):
                rows[i] = i
        elif not closed[r] and n > 1:
            rows[a + n - 1] = b - 1
        size, n = n, 0
        for k in range(size):
            i = rows[a + k]
            inner = closed[r] or 0 < k < size - 1
            p, q = rows[a + (n - 1 if n else size - 1)], rows[a + (k + 1) % size]
            flat = False
            in_plane = sides.plane_after[i] != NO_PLANE and sides.plane_before[i] == sides.plane_after[i]
            smooth = sides.smooth[i] and not np.isnan(sides.before[i, 0])
            if inner and n + size - k > 3 and (in_plane or smooth):
                # In a plane, or smooth and on the chord of its neighbours in place and direction.
                x, y = points[q, 0] - points[p, 0], points[q, 1] - points[p, 1]
                u, v = points[i, 0] - points[p, 0], points[i, 1] - points[p, 1]
                long, off = np.hypot(x, y), abs(x * v - y * u)
                tilt = abs(x * sides.before[i, 1] - y * sides.before[i, 0])
                flat = 0.0 < x * u + y * v < long * long
                flat = flat and off < (IN_PLANE_MM if in_plane else FLAT_MM) * long
                flat = flat and (in_plane or 0.25 * tilt < FLAT_MM)
            if not flat:
                rows[a + n] = i
                n += 1
        sizes[r] = n

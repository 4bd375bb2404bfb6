"""Where in-plane rays cross the contour: decided and placed in float64 from the facets that Embree names.

A plane cuts each facet in a directed segment, material on its left. A ray crosses a segment whose ends lie
on both sides of it, ends on the ray counting as below. Both decisions compare float64 numbers that
neighbouring facets share bit for bit, so a closed mesh gives closed answers whatever Embree rounds.

Embree gives the first hit of a ray only, so of facets that lie in one place (walls of shells that touch or
overlap) it names one. The crossings that a ray must have are therefore counted from the segments; a ray on
which Embree did not name just so many is measured against the segments themselves.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ebamcheck.kernels import kernel
from ebamcheck_embree.scene import Facets, Floats, Hits, Ints
from ebamcheck_embree.section import Slabs, section_segments, segment_of

Bools = NDArray[np.bool_]

RECENT_HITS = 16
"""A facet that Embree names twice on a ray comes again within this many hits."""

SORT_BY_INSERTION = 48
"""Hits come nearly in order; beyond this many a ray is sorted by a general method first."""


class Borders(NamedTuple):
    """Where rays pass between winding <= 0 and winding > 0, grouped by ray: in, out, in, out."""

    starts: Ints
    along: Floats
    facet: Facets
    paired: Bools
    """(R,) whether borders come in pairs; false where a facet is missing."""
    sound: Bools
    """(R,) whether the winding ends at 0, as it does on a closed mesh whose facets all face out."""
    simple: bool
    """Whether the winding is 0 or 1 everywhere on these rays."""


@kernel
def _crossing(u0: float, w0: float, u1: float, w1: float, line: float) -> tuple[int, float]:
    """Where the line w = `line` crosses a segment: 1 up, -1 down, 0 not at all; and the u of it."""
    if w0 <= line < w1:
        return 1, u0 + (line - w0) / (w1 - w0) * (u1 - u0)
    if w1 <= line < w0:
        return -1, u1 + (line - w1) / (w0 - w1) * (u0 - u1)
    return 0, 0.0


@kernel
def _crossing_turn(axis: int) -> int:
    """Sign of a segment that rises across a ray: an exit from a row's ray, an entry to a column's."""
    return -1 if axis == 0 else 1


@kernel
def _lines_across(segments: Floats, axis: int, n: int, lines: Floats) -> tuple[int, int]:
    """First ray that crosses segment `n`, and the first beyond it that does not."""
    w0, w1 = segments[n, 1 - axis], segments[n, 3 - axis]
    return np.searchsorted(lines, min(w0, w1)), np.searchsorted(lines, max(w0, w1))


@kernel
def _crossing_counts(segments: Floats, axis: int, lines: Floats) -> Ints:
    """Segments that each ray crosses, (R,)."""
    change = np.zeros(lines.size + 1, np.int64)
    for n in range(len(segments)):
        first, past = _lines_across(segments, axis, n, lines)
        change[first] += 1
        change[past] -= 1
    return np.cumsum(change)[:-1]


@kernel
def repeated_hit(facets: Facets, n: int, first: int) -> bool:
    """Whether hit `n` names a facet that the same ray, whose hits begin at `first`, was given just before."""
    repeated = False
    for m in range(max(first, n - RECENT_HITS), n):
        repeated = repeated or facets[m] == facets[n]
    return repeated


@kernel
def _measure(
    vertices: Floats,
    faces: Facets,
    z: float,
    axis: int,
    lines: Floats,
    starts: Ints,
    facets: Facets,
    wanted: Ints,
) -> tuple[Floats, Ints, Bools]:
    """Place the hits of rays along `axis`, and tell on which rays they are not the `wanted` number.

    A hit that float64 does not confirm has the sign 0.
    """
    along = np.zeros(facets.size)
    sign = np.zeros(facets.size, np.int64)
    doubtful = np.zeros(lines.size, np.bool_)
    turn = _crossing_turn(axis)
    for r in range(lines.size):
        confirmed = 0
        for n in range(starts[r], starts[r + 1]):
            if repeated_hit(facets, n, starts[r]):
                continue
            cut, x0, y0, x1, y1 = segment_of(vertices, faces, facets[n], z)
            if not cut:
                continue
            if axis == 0:
                way, place = _crossing(x0, y0, x1, y1, lines[r])
            else:
                way, place = _crossing(y0, x0, y1, x1, lines[r])
            along[n], sign[n] = place, turn * way
            confirmed += abs(way)
        doubtful[r] = confirmed != wanted[r]
    return along, sign, doubtful


@kernel
def _recast(
    segments: Floats,
    owner: Facets,
    axis: int,
    lines: Floats,
    doubtful: Bools,
    wanted: Ints,
    hits: tuple[Ints, Floats, Ints, Facets],
) -> tuple[Ints, Floats, Ints, Facets]:
    """Replace the hits of doubtful rays by their crossings with the segments."""
    old_starts, old_along, old_sign, old_facet = hits
    starts = np.zeros(lines.size + 1, np.int64)
    for r in range(lines.size):
        size = wanted[r] if doubtful[r] else old_starts[r + 1] - old_starts[r]
        starts[r + 1] = starts[r] + size
    along = np.empty(starts[-1])
    sign = np.empty(starts[-1], np.int64)
    facet = np.empty(starts[-1], np.int32)
    for r in range(lines.size):
        if not doubtful[r]:
            a, b, first, past = starts[r], starts[r + 1], old_starts[r], old_starts[r + 1]
            along[a:b], sign[a:b] = old_along[first:past], old_sign[first:past]
            facet[a:b] = old_facet[first:past]
    fill = starts[:-1].copy()
    turn = _crossing_turn(axis)
    for n in range(len(segments)):
        first, past = _lines_across(segments, axis, n, lines)
        for r in range(first, past):
            if doubtful[r]:
                way, place = _crossing(
                    segments[n, axis], segments[n, 1 - axis], segments[n, 2 + axis], segments[n, 3 - axis],
                    lines[r],
                )  # fmt: skip
                along[fill[r]], sign[fill[r]], facet[fill[r]] = place, turn * way, owner[n]
                fill[r] += 1
    return starts, along, sign, facet


@kernel
def _before(a: float, sign_a: int, b: float, sign_b: int) -> bool:
    """Order along a ray; where two shells touch, the entry comes first, so that they unite."""
    return bool(a < b or (a == b and sign_a > sign_b))


@kernel
def borders(
    starts: Ints, along: Floats, sign: Ints, facet: Facets
) -> tuple[Ints, Floats, Facets, Bools, Bools, bool]:
    """Sort each ray's crossings and keep those between winding <= 0 and winding > 0.

    Crossings of sign 0 are passed over. A ray whose winding does not end at 0 but that has an even number
    of crossings met a facet that is turned over; all its crossings are borders then. Columns are those of :class:`Borders`.
    """
    count = starts.size - 1
    kept_starts = np.zeros(count + 1, np.int64)
    kept_along = np.empty(along.size)
    kept_facet = np.empty(along.size, np.int32)
    paired = np.ones(count, np.bool_)
    sound = np.ones(count, np.bool_)
    simple = True
    out = 0
    longest = 0
    for r in range(count):
        longest = max(longest, starts[r + 1] - starts[r])
    order = np.empty(longest, np.int64)
    for r in range(count):
        a, b = starts[r], starts[r + 1]
        size = b - a
        if size > SORT_BY_INSERTION:
            order[:size] = a + np.argsort(along[a:b], kind="mergesort")
        else:
            for n in range(size):
                order[n] = a + n
        for n in range(1, size):
            k = order[n]
            m = n
            while m > 0 and _before(along[k], sign[k], along[order[m - 1]], sign[order[m - 1]]):
                order[m] = order[m - 1]
                m -= 1
            order[m] = k
        winding = crossed = 0
        first = out
        for n in range(size):
            k = order[n]
            after = winding + sign[k]
            crossed += abs(sign[k])
            if (after > 0) != (winding > 0):
                kept_along[out], kept_facet[out] = along[k], facet[k]
                out += 1
            winding = after
            simple = simple and 0 <= winding <= 1
        sound[r] = winding == 0
        paired[r] = crossed % 2 == 0
        if paired[r] and not sound[r]:
            out = first
            for n in range(size):
                k = order[n]
                if sign[k] != 0:
                    kept_along[out], kept_facet[out] = along[k], facet[k]
                    out += 1
        kept_starts[r + 1] = out
    return kept_starts, kept_along[:out], kept_facet[:out], paired, sound, simple


class RayBorders:
    """Turns the hits of a layer's rays into borders, with what it needs to check them."""

    def __init__(self, vertices: Floats, faces: Facets) -> None:
        self._mesh = (vertices, faces)
        self._slabs = Slabs(vertices, faces)

    def of_layer(
        self, z: float, rows: Floats, along_x: Hits, columns: Floats, along_y: Hits
    ) -> tuple[Borders, Borders]:
        """Borders on the rays along x at the ordinates `rows` and along y at the abscissas `columns`, mm."""
        segments, owner = section_segments(*self._mesh, self._slabs.near(z), z)

        def borders_along(axis: int, lines: Floats, hits: Hits) -> Borders:
            wanted = _crossing_counts(segments, axis, lines)
            along, sign, doubtful = _measure(*self._mesh, z, axis, lines, hits.starts, hits.facets, wanted)
            found = (hits.starts, along, sign, hits.facets)
            if doubtful.any():
                found = _recast(segments, owner, axis, lines, doubtful, wanted, found)
            return Borders(*borders(*found))

        return borders_along(0, rows, along_x), borders_along(1, columns, along_y)

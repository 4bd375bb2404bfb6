"""Where in-plane rays cross the contour: decided and placed in float64 from the facets that Embree names.

A plane cuts each facet in a directed segment, material on its left. A ray crosses a segment whose ends lie
on both sides of it, ends on the ray counting as below. Both decisions compare float64 numbers that
neighbouring facets share bit for bit, so a closed mesh gives closed answers whatever Embree rounds.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ebamcheck.kernels import kernel
from ebamcheck_embree.scene import Facets, Floats, Hits, Ints

Bools = NDArray[np.bool_]

RECENT_HITS = 16
"""A facet that Embree names twice on a ray comes again within this many hits."""

SORT_BY_INSERTION = 48
"""Hits come nearly in order; beyond this many a ray is sorted by a general method first."""


class Crossings(NamedTuple):
    """Crossings of rays with section segments, grouped by ray."""

    starts: Ints
    along: Floats
    """(C,) place along the ray, mm."""
    sign: Ints
    """(C,) +1 where the ray enters, -1 where it leaves."""
    facet: Facets


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
def segment_of(
    vertices: Floats, faces: Facets, facet: int, z: float
) -> tuple[bool, float, float, float, float]:
    """Segment in which the plane z = h + 0 cuts a facet: whether it does, and start and end."""
    x0 = y0 = x1 = y1 = 0.0
    cut = False
    for k in range(3):
        a, b = faces[facet, k], faces[facet, (k + 1) % 3]
        below_a, below_b = vertices[a, 2] <= z, vertices[b, 2] <= z
        if below_a and not below_b:
            x1, y1 = edge_point(vertices, a, b, z)
            cut = True
        elif below_b and not below_a:
            x0, y0 = edge_point(vertices, b, a, z)
    return cut, x0, y0, x1, y1


@kernel
def edge_point(vertices: Floats, low: int, high: int, z: float) -> tuple[float, float]:
    """Point at height z on the edge from its lower to its upper vertex."""
    t = (z - vertices[low, 2]) / (vertices[high, 2] - vertices[low, 2])
    return (
        vertices[low, 0] + t * (vertices[high, 0] - vertices[low, 0]),
        vertices[low, 1] + t * (vertices[high, 1] - vertices[low, 1]),
    )


@kernel
def _crossing(u0: float, w0: float, u1: float, w1: float, line: float) -> tuple[int, float]:
    """Where the line w = `line` crosses a segment: 1 up, -1 down, 0 not at all; and the u of it."""
    if w0 <= line < w1:
        return 1, u0 + (line - w0) / (w1 - w0) * (u1 - u0)
    if w1 <= line < w0:
        return -1, u1 + (line - w1) / (w0 - w1) * (u0 - u1)
    return 0, 0.0


@kernel
def _measure(
    vertices: Floats, faces: Facets, z: float, axis: int, lines: Floats, starts: Ints, facets: Facets
) -> tuple[Floats, Ints, Bools]:
    """Place the hits of rays along `axis` and tell which rays are in doubt.

    In doubt is a ray with a hit that float64 does not confirm, or whose signs do not sum to 0.
    """
    along = np.zeros(facets.size)
    sign = np.zeros(facets.size, np.int64)
    doubtful = np.zeros(lines.size, np.bool_)
    turn = -1 if axis == 0 else 1  # a segment that rises across a row is an exit, across a column an entry
    for r in range(lines.size):
        winding = 0
        for n in range(starts[r], starts[r + 1]):
            repeated = False
            for m in range(max(starts[r], n - RECENT_HITS), n):
                repeated = repeated or facets[m] == facets[n]
            if repeated:
                continue
            cut, x0, y0, x1, y1 = segment_of(vertices, faces, facets[n], z)
            if axis == 0:
                way, place = _crossing(x0, y0, x1, y1, lines[r])
            else:
                way, place = _crossing(y0, x0, y1, x1, lines[r])
            if not cut or way == 0:
                doubtful[r] = True
                continue
            along[n], sign[n] = place, turn * way
            winding += sign[n]
        doubtful[r] = doubtful[r] or winding != 0
    return along, sign, doubtful


@kernel
def _recast(
    vertices: Floats,
    faces: Facets,
    z: float,
    axis: int,
    lines: Floats,
    doubtful: Bools,
    nearby: Facets,
    hits: tuple[Ints, Floats, Ints, Facets],
) -> tuple[Ints, Floats, Ints, Facets]:
    """Cast doubtful rays again in float64, against every facet of `nearby` that the plane cuts."""
    old_starts, old_along, old_sign, old_facet = hits
    segments = np.empty((nearby.size, 4))
    owner = np.empty(nearby.size, np.int32)
    count = 0
    for n in range(nearby.size):
        cut, x0, y0, x1, y1 = segment_of(vertices, faces, nearby[n], z)
        if cut:
            segments[count, 0], segments[count, 2] = (x0, x1) if axis == 0 else (y0, y1)
            segments[count, 1], segments[count, 3] = (y0, y1) if axis == 0 else (x0, x1)
            owner[count] = nearby[n]
            count += 1
    turn = -1 if axis == 0 else 1
    starts = np.zeros(lines.size + 1, np.int64)
    for r in range(lines.size):
        total = old_starts[r + 1] - old_starts[r]
        if doubtful[r]:
            total = 0
            for n in range(count):
                total += (segments[n, 1] <= lines[r]) != (segments[n, 3] <= lines[r])
        starts[r + 1] = starts[r] + total
    along = np.empty(starts[-1])
    sign = np.empty(starts[-1], np.int64)
    facet = np.empty(starts[-1], np.int32)
    for r in range(lines.size):
        out = starts[r]
        if not doubtful[r]:
            size = starts[r + 1] - out
            first = old_starts[r]
            along[out : out + size] = old_along[first : first + size]
            sign[out : out + size] = old_sign[first : first + size]
            facet[out : out + size] = old_facet[first : first + size]
            continue
        for n in range(count):
            way, place = _crossing(segments[n, 0], segments[n, 1], segments[n, 2], segments[n, 3], lines[r])
            if way != 0:
                along[out], sign[out], facet[out] = place, turn * way, owner[n]
                out += 1
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
        self.vertices = vertices
        self.faces = faces
        self._slabs = Slabs(vertices, faces)

    def along(self, axis: int, lines: Floats, z: float, hits: Hits) -> Borders:
        """Borders on rays along x (axis 0) or y (axis 1) at height z, mm."""
        mesh = (self.vertices, self.faces, z, axis, lines)
        along, sign, doubtful = _measure(*mesh, hits.starts, hits.facets)
        found = (hits.starts, along, sign, hits.facets)
        if doubtful.any():
            found = _recast(*mesh, doubtful, self._slabs.near(z), found)
        return Borders(*borders(*found))


class Slabs:
    """Facets by height: which ones reach into which of equally thick slabs."""

    def __init__(self, vertices: Floats, faces: Facets) -> None:
        z0, z1, z2 = (vertices[faces[:, k], 2] for k in range(3))
        low, high = np.minimum(np.minimum(z0, z1), z2), np.maximum(np.maximum(z0, z1), z2)
        self._bottom = float(low.min(initial=0.0)) if low.size else 0.0
        height = (float(high.max()) if high.size else 0.0) - self._bottom
        mean = float(np.mean(high - low)) if low.size else 0.0
        # As many slabs as keep each facet in about two of them.
        self.count = int(min(4096.0, max(1.0, height / mean))) if mean > 0.0 else 1
        self._per_mm = self.count / height if height > 0.0 else 0.0
        first, last = self._slab(low), self._slab(high)
        self._starts, self._facets = _fill_slabs(first, last, self.count)

    def _slab(self, z: Floats) -> Ints:
        return np.clip((z - self._bottom) * self._per_mm, 0, self.count - 1).astype(np.int64)

    def near(self, z: float) -> Facets:
        """Facets of the slab that holds height z, those cut at z among them."""
        k = int(self._slab(np.array([z]))[0])
        return self._facets[self._starts[k] : self._starts[k + 1]]


@kernel
def _fill_slabs(first: Ints, last: Ints, count: int) -> tuple[Ints, Facets]:
    starts = np.zeros(count + 1, np.int64)
    for f in range(first.size):
        for k in range(first[f], last[f] + 1):
            starts[k + 1] += 1
    for k in range(count):
        starts[k + 1] += starts[k]
    fill = starts[:-1].copy()
    facets = np.empty(starts[-1], np.int32)
    for f in range(first.size):
        for k in range(first[f], last[f] + 1):
            facets[fill[k]] = f
            fill[k] += 1
    return starts, facets

"""Where in-plane rays cross the contour: decided and located in float64 on the facets that Embree reports.

A plane cuts each facet in a directed segment, material on its left. A ray crosses a segment whose ends lie
on both sides of it, ends on the ray counting as below. Both decisions compare float64 numbers that
neighbouring facets share bit for bit, so a closed mesh gives closed answers whatever Embree rounds.

The crossings that a ray must have are counted from the segments first: a ray without any is not cast, and one
that has found all of its crossings is not cast again. Embree reports only the first hit of a ray, so of coincident
facets (walls of shells that touch or overlap) it reports one; a ray that lacks crossings afterwards is intersected
with the segments themselves.
"""

from __future__ import annotations

import numpy as np

from ebamcheck.numeric.kernels import kernel
from ebamcheck_embree.hits import Hits, add, is_among
from ebamcheck_embree.scene import Bools, Facets, Floats, Ints, Singles, UnderWay, go_on
from ebamcheck_embree.section import Sections


@kernel
def _crossing(u0: float, w0: float, u1: float, w1: float, line: float) -> tuple[int, float]:
    """Where the line w = `line` crosses a segment: 1 up, -1 down, 0 not at all; and the u of it."""
    if w0 <= line < w1:
        return 1, u0 + (line - w0) / (w1 - w0) * (u1 - u0)
    if w1 <= line < w0:
        return -1, u1 + (line - w1) / (w0 - w1) * (u0 - u1)
    return 0, 0.0


@kernel
def _sign_and_place(segments: Floats, n: int, axis: int, line: float) -> tuple[int, float]:
    """Sign (+1 where a ray along `axis` enters, -1 where it leaves, 0) and place of its crossing with segment `n`."""
    # One number at a time: to unpack a row costs more than all the rest.
    x0, y0, x1, y1 = segments[n, 0], segments[n, 1], segments[n, 2], segments[n, 3]
    if axis == 0:  # a segment that rises across a row's ray has the material before it
        way, place = _crossing(x0, y0, x1, y1, line)
        return -way, place
    return _crossing(y0, x0, y1, x1, line)


@kernel
def _first_line_at(lines: Floats, place: float) -> int:
    """First of equally spaced lines (R,), R > 1, that is not before `place`."""
    spacing = lines[1] - lines[0]
    k = int(min(max((place - lines[0]) / spacing, 0.0), float(lines.size)))
    while k > 0 and lines[k - 1] >= place:
        k -= 1
    while k < lines.size and lines[k] < place:
        k += 1
    return k


@kernel
def _across(segments: Floats, axis: int, n: int) -> tuple[float, float]:
    """From where to where segment `n` reaches across the rays along an axis."""
    w0, w1 = segments[n, 1 - axis], segments[n, 3 - axis]
    return min(w0, w1), max(w0, w1)


@kernel
def crossing_counts(sections: Sections, heights: int, axis: int, lines: Floats) -> Ints:
    """Segments that each ray crosses, (heights * R,): those of the first height's R lines, then the next one's."""
    counts = np.zeros(heights * lines.size, np.int64)
    for f in range(sections.first.size):
        base = sections.first[f] * lines.size
        for n in range(sections.starts[f], sections.starts[f + 1]):
            low, high = _across(sections.segments, axis, n)
            r = _first_line_at(lines, low)
            while r < lines.size and lines[r] < high:
                counts[base + r] += 1
                r += 1
            base += lines.size
    return counts


@kernel
def take_crossings(
    sections: Sections, axis: int, lines: Floats, met: Facets, distance: Singles, rays: UnderWay, hits: Hits
) -> int:
    """File the crossings that float64 confirms; rays that have not met all of theirs go on."""
    going_on = 0
    for n in range(met.size):
        facet = met[n]
        if not 0 <= facet < sections.first.size:
            continue
        r = rays.ray[n]
        if facet != rays.last[n] and not is_among(hits.facet, hits.starts[r], hits.known[r], facet):
            layer = r // lines.size
            k = sections.starts[facet] + layer - sections.first[facet]
            if sections.starts[facet] <= k < sections.starts[facet + 1]:
                sign, place = _sign_and_place(sections.segments, k, axis, lines[r - layer * lines.size])
                if sign != 0:
                    add(hits, r, facet, place, sign)
        if hits.known[r] < hits.starts[r + 1] - hits.starts[r]:
            go_on(rays, n, going_on, facet, distance[n], axis)
            going_on += 1
    return going_on


@kernel
def take_from_segments(sections: Sections, axis: int, lines: Floats, short: Bools, hits: Hits) -> None:
    """Fill the hits of rays that fell short of their number from the segments that they cross."""
    for f in range(sections.first.size):
        base = sections.first[f] * lines.size
        for n in range(sections.starts[f], sections.starts[f + 1]):
            low, high = _across(sections.segments, axis, n)
            r = _first_line_at(lines, low)
            while r < lines.size and lines[r] < high:
                if short[base + r]:
                    sign, place = _sign_and_place(sections.segments, n, axis, lines[r])
                    add(hits, base + r, f, place, sign)
                r += 1
            base += lines.size

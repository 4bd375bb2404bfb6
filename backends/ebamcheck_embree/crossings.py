"""Where in-plane rays cross the contour: decided and located in float64 on the facets that Embree reports.

A plane cuts each facet in a directed segment, material on its left; the segments of a closed mesh meet bit for bit. A ray crosses a
segment whose ends lie on both sides of it, ends on the ray counting as below. The crossings that a ray must have are counted from
the segments: it is cast until it has them, and where Embree reports one of coincident facets alone, intersected with the segments.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ebamcheck.kernels import Bools, Floats, Ints, kernel
from ebamcheck_embree.scene import Facets, Mesh, Singles, UnderWay

_LEAST_STEP = np.finfo(np.float32).tiny  # past a facet at coordinate 0, mm


class Sections(NamedTuple):
    """Sections at several heights, facet by facet, so that a facet's segment at a height is found directly."""

    first: (
        Ints  # (F,) first height at which each facet is cut; its segments are those of consecutive heights from there
    )
    starts: Ints  # (F + 1,) first segment of each facet
    segments: Floats  # (S, 4) start and end of each segment, mm; material on its left


class Hits(NamedTuple):
    """Facets that rays pass, with place and direction; each ray has as many rows as it must have hits."""

    starts: Ints  # (R + 1,) first row of each ray
    known: Ints  # (R,) number of hits of each ray so far
    along: Floats  # (H,) place on the ray, mm
    sign: Ints  # (H,) +1 where the ray enters, -1 where it leaves
    facet: Facets  # (H,) facet


class Borders(NamedTuple):
    """Where rays pass between winding <= 0 and winding > 0, grouped by ray: in, out, in, out."""

    starts: Ints
    along: Floats
    facet: Facets
    paired: Bools  # (R,) whether borders come in pairs; false where a facet is missing
    sound: Bools  # (R,) whether the winding ends at 0, as it does on a closed mesh whose facets all face out
    simple: Bools  # (R,) whether the winding is 0 or 1 everywhere on the ray


@kernel
def sections_at(mesh: Mesh, z_mm: Floats) -> Sections:
    """Cut a mesh at several ascending heights (L,)."""
    vertices, faces = mesh
    first = np.empty(len(faces), np.int64)
    starts = np.zeros(len(faces) + 1, np.int64)
    for f in range(len(faces)):
        a, b, c = vertices[faces[f, 0], 2], vertices[faces[f, 1], 2], vertices[faces[f, 2], 2]
        begin = 0
        # `np.searchsorted` takes one and a half times as long.
        for place in (min(a, b, c), max(a, b, c)):
            low, high = begin, z_mm.size  # the first height that is not below the place
            while low < high:
                middle = (low + high) // 2
                if z_mm[middle] < place:
                    low = middle + 1
                else:
                    high = middle
            first[f], begin = begin, low
        starts[f + 1] = starts[f] + begin - first[f]
    segments = np.empty((starts[-1], 4))
    for f in range(len(faces)):
        for n in range(starts[f], starts[f + 1]):
            z = z_mm[first[f] + n - starts[f]]
            for k in range(3):
                p, q = faces[f, k], faces[f, (k + 1) % 3]
                below = vertices[p, 2] <= z
                if below == (vertices[q, 2] <= z):
                    continue
                low, high, at = (p, q, 2) if below else (q, p, 0)  # where the edge rises, the segment ends
                t = (z - vertices[low, 2]) / (vertices[high, 2] - vertices[low, 2])
                segments[n, at] = vertices[low, 0] + t * (vertices[high, 0] - vertices[low, 0])
                segments[n, at + 1] = vertices[low, 1] + t * (vertices[high, 1] - vertices[low, 1])
    return Sections(first, starts, segments)


@kernel
def rays_across(sections: Sections, axis: int, lines: Floats) -> tuple[Ints, Ints]:
    """First ray, on equally spaced lines (R,), that each segment crosses, and the one after the last, (S,) each; numbered by
    height."""
    segments, spacing = sections.segments, lines[1] - lines[0]
    begins, ends = np.empty(len(segments), np.int64), np.empty(len(segments), np.int64)
    for f in range(sections.first.size):
        base = sections.first[f] * lines.size
        for n in range(sections.starts[f], sections.starts[f + 1]):
            a, b = segments[n, 1 - axis], segments[n, 3 - axis]
            low, high = min(a, b), max(a, b)
            k = int(min(max((low - lines[0]) / spacing, 0.0), float(lines.size)))
            while k > 0 and lines[k - 1] >= low:
                k -= 1
            while k < lines.size and lines[k] < low:
                k += 1
            begins[n] = base + k
            while k < lines.size and lines[k] < high:
                k += 1
            ends[n] = base + k
            base += lines.size
    return begins, ends


@kernel
def take_crossings(
    sections: Sections, axis: int, lines: Floats, met: Facets, distance: Singles, rays: UnderWay, hits: Hits
) -> int:
    """File the crossings that float64 confirms; rays that have not met all of theirs go on."""
    segments = sections.segments
    going_on = 0
    for n in range(met.size):
        facet = met[n]
        if not 0 <= facet < sections.first.size:
            continue
        r = rays.ray[n]
        new = facet != rays.last[n]
        for k in range(hits.starts[r], hits.starts[r] + hits.known[r]):
            new = new and hits.facet[k] != facet
        layer = r // lines.size
        at = sections.starts[facet] + layer - sections.first[facet]
        if new and sections.starts[facet] <= at < sections.starts[facet + 1]:
            line = lines[r - layer * lines.size]
            # One number at a time: to unpack a row costs more than all the rest.
            u0, w0 = segments[at, axis], segments[at, 1 - axis]
            u1, w1 = segments[at, 2 + axis], segments[at, 3 - axis]
            k = hits.starts[r] + hits.known[r]
            if w0 <= line < w1 or w1 <= line < w0:
                # A segment that rises across a row's ray has the material before it.
                hits.sign[k] = 1 if (w0 < w1) == (axis == 1) else -1
                if w0 < w1:
                    hits.along[k] = u0 + (line - w0) / (w1 - w0) * (u1 - u0)
                else:
                    hits.along[k] = u1 + (line - w1) / (w0 - w1) * (u0 - u1)
                hits.facet[k] = facet
                hits.known[r] += 1
        if hits.known[r] < hits.starts[r + 1] - hits.starts[r]:
            # On from just beyond the facet; one that is met again in a row is passed by steps that double.
            repeats = rays.repeats[n] + 1 if facet == rays.last[n] else 0
            reached = max(rays.origin[n, axis], np.float32(rays.origin[n, axis] + distance[n]))
            step = max(np.float32(2.0**-23) * abs(reached), _LEAST_STEP)
            if repeats > 0:
                step = np.float32(step * 2.0 ** min(repeats, 60))
            rays.ray[going_on], rays.last[going_on], rays.repeats[going_on] = r, facet, repeats
            for k in range(3):
                rays.origin[going_on, k] = rays.origin[n, k]
            rays.origin[going_on, axis] = reached + step
            going_on += 1
    return going_on


def hits_of_rays(begins: Ints, ends: Ints, count: int) -> Hits:
    """Room for the hits of `count` rays, by the rays that the segments cross."""
    passed = np.bincount(begins, minlength=count + 1) - np.bincount(ends, minlength=count + 1)
    starts = np.concatenate([[0], np.cumsum(np.cumsum(passed[:count]))])
    size = int(starts[-1])
    return Hits(starts, np.zeros(count, np.int64), np.empty(size), np.empty(size, np.int64), np.empty(size, np.int32))


def fill_short_rays(hits: Hits, sections: Sections, axis: int, lines: Floats, begins: Ints, ends: Ints) -> None:
    """Take the hits of rays that fell short of their number from the segments that they cross."""
    short = hits.known < np.diff(hits.starts)
    if not short.any():
        return
    before = np.concatenate([[0], np.cumsum(short)])
    segment = np.flatnonzero(before[ends] > before[begins])
    sizes = (ends - begins)[segment]
    segment = np.repeat(segment, sizes)
    ray = begins[segment] + np.arange(segment.size) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    segment, ray = segment[short[ray]], ray[short[ray]]
    order = np.argsort(ray, kind="stable")
    segment, ray = segment[order], ray[order]
    line = lines[ray % lines.size]
    u0, w0, u1, w1 = sections.segments[segment][:, [axis, 1 - axis, 2 + axis, 3 - axis]].T
    rising = w0 < w1
    rows = np.flatnonzero(np.repeat(short, np.diff(hits.starts)))
    hits.along[rows] = np.where(
        rising, u0 + (line - w0) / (w1 - w0) * (u1 - u0), u1 + (line - w1) / (w0 - w1) * (u0 - u1)
    )
    hits.sign[rows] = np.where(rising == (axis == 1), 1, -1)
    hits.facet[rows] = np.searchsorted(sections.starts, segment, side="right") - 1


def borders(starts: Ints, along: Floats, sign: Ints, facet: Facets) -> Borders:
    """Sort each ray's crossings and keep those between winding <= 0 and winding > 0."""
    first = np.zeros(along.size + 1, np.bool_)
    first[starts] = True
    if not (first[1:-1] | (along[1:] > along[:-1])).all():
        # Where two shells touch, the entry comes first, so that they unite.
        order = np.lexsort((-sign, along, np.repeat(np.arange(starts.size - 1), np.diff(starts))))
        along, sign, facet = along[order], sign[order], facet[order]
    return _borders(starts, along, sign, facet)


@kernel
def _borders(starts: Ints, along: Floats, sign: Ints, facet: Facets) -> Borders:
    """Borders of crossings in their order along each ray; all are, where a facet is turned over: of an even number whose winding
    does not end at 0."""
    count = starts.size - 1
    kept_starts = np.zeros(count + 1, np.int64)
    kept_along, kept_facet = np.empty(along.size), np.empty(along.size, np.int32)
    paired, sound, simple = np.empty(count, np.bool_), np.empty(count, np.bool_), np.empty(count, np.bool_)
    out = 0
    for r in range(count):
        winding = 0
        first, is_simple = out, True
        for k in range(starts[r], starts[r + 1]):
            after = winding + sign[k]
            if (after > 0) != (winding > 0):
                kept_along[out], kept_facet[out] = along[k], facet[k]
                out += 1
            winding = after
            is_simple = is_simple and 0 <= winding <= 1
        sound[r], simple[r] = winding == 0, is_simple
        paired[r] = (starts[r + 1] - starts[r]) % 2 == 0
        if paired[r] and not sound[r]:
            out = first
            for k in range(starts[r], starts[r + 1]):
                kept_along[out], kept_facet[out] = along[k], facet[k]
                out += 1
        kept_starts[r + 1] = out
    return Borders(kept_starts, kept_along[:out], kept_facet[:out], paired, sound, simple)

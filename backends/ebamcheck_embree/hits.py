"""Hits of rays, in a range of rows for each ray, and the borders of the material that follow from them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.sorting import stable_order
from ebamcheck_embree.scene import Bools, Facets, Floats, Ints

SORT_BY_INSERTION = 48
"""Most hits of a ray that are sorted by insertion, as they come nearly in order; more are sorted by a general method."""


class Hits(NamedTuple):
    """Facets that rays pass, with place and direction; each ray has as many rows as it must have hits."""

    starts: Ints
    """(R + 1,) first row of each ray."""
    known: Ints
    """(R,) number of hits of each ray so far."""
    along: Floats
    """(H,) place on the ray, mm."""
    sign: Ints
    """(H,) +1 where the ray enters, -1 where it leaves, 0 if it only passes an edge."""
    facet: Facets
    """(H,) facet."""


class Borders(NamedTuple):
    """Where rays pass between winding <= 0 and winding > 0, grouped by ray: in, out, in, out."""

    starts: Ints
    along: Floats
    facet: Facets
    paired: Bools
    """(R,) whether borders come in pairs; false where a facet is missing."""
    sound: Bools
    """(R,) whether the winding ends at 0, as it does on a closed mesh whose facets all face out."""
    simple: Bools
    """(R,) whether the winding is 0 or 1 everywhere on the ray."""


def room_for(counts: Ints) -> Hits:
    """Room for the hits of rays of which the numbers (R,) are known."""
    starts = np.zeros(len(counts) + 1, np.int64)
    np.cumsum(counts, out=starts[1:])
    total = int(starts[-1])
    return Hits(
        starts,
        np.zeros(len(counts), np.int64),
        np.empty(total),
        np.empty(total, np.int64),
        np.empty(total, np.int32),
    )


def short_rays(hits: Hits) -> Bools:
    """Rays (R,) of which hits are missing; what they have is forgotten."""
    short: Bools = hits.known < np.diff(hits.starts)
    hits.known[short] = 0
    return short


@kernel
def is_among(facets: Facets, first: int, count: int, facet: int) -> bool:
    """Whether a facet is among `count` others from `first` on."""
    for k in range(first, first + count):  # noqa: SIM110 - kernels have no generators
        if facets[k] == facet:
            return True
    return False


@kernel
def add(hits: Hits, ray: int, facet: int, along: float, sign: int) -> None:
    """File a hit."""
    k = hits.starts[ray] + hits.known[ray]
    hits.along[k], hits.sign[k], hits.facet[k] = along, sign, facet
    hits.known[ray] += 1


@kernel
def _before(a: float, sign_a: int, b: float, sign_b: int) -> bool:
    """Order along a ray; where two shells touch, the entry comes first, so that they unite."""
    return bool(a < b or (a == b and sign_a > sign_b))


@kernel
def _is_ascending(along: Floats, start: int, stop: int) -> bool:
    """Whether the hits ``start .. stop - 1`` lie one after the other along their ray."""
    for k in range(start + 1, stop):  # noqa: SIM110 - kernels have no generators
        if not along[k - 1] < along[k]:
            return False
    return True


@kernel
def _sort(along: Floats, sign: Ints, start: int, stop: int, order: Ints) -> None:
    """Write the order of the hits ``start .. stop - 1`` along their ray to the front of `order`."""
    size = stop - start
    if size > SORT_BY_INSERTION:
        nth = stable_order(along[start:stop])
        for n in range(size):
            order[n] = start + nth[n]
    else:
        for n in range(size):
            order[n] = start + n
    for n in range(1, size):
        k = order[n]
        m = n
        while m > 0 and _before(along[k], sign[k], along[order[m - 1]], sign[order[m - 1]]):
            order[m] = order[m - 1]
            m -= 1
        order[m] = k


@kernel
def borders(starts: Ints, along: Floats, sign: Ints, facet: Facets) -> Borders:
    """Sort each ray's crossings and keep those between winding <= 0 and winding > 0.

    Crossings of sign 0 are passed over. A ray whose winding does not end at 0 but that has an even number
    of crossings met a facet that is turned over; all its crossings are borders then.
    """
    count = starts.size - 1
    kept_starts = np.zeros(count + 1, np.int64)
    kept_along = np.empty(along.size)
    kept_facet = np.empty(along.size, np.int32)
    paired = np.ones(count, np.bool_)
    sound = np.ones(count, np.bool_)
    simple = np.ones(count, np.bool_)
    out = 0
    order = np.empty(np.diff(starts).max() if count else 0, np.int64)
    for r in range(count):
        size = starts[r + 1] - starts[r]
        if _is_ascending(along, starts[r], starts[r + 1]):  # nearly always
            for n in range(size):
                order[n] = starts[r] + n
        else:
            _sort(along, sign, starts[r], starts[r + 1], order)
        winding = crossed = 0
        first = out
        for k in order[:size]:
            after = winding + sign[k]
            crossed += abs(sign[k])
            if (after > 0) != (winding > 0):
                kept_along[out], kept_facet[out] = along[k], facet[k]
                out += 1
            winding = after
            simple[r] = simple[r] and 0 <= winding <= 1
        sound[r] = winding == 0
        paired[r] = crossed % 2 == 0
        if paired[r] and not sound[r]:
            out = first
            for k in order[:size]:
                if sign[k] != 0:
                    kept_along[out], kept_facet[out] = along[k], facet[k]
                    out += 1
        kept_starts[r + 1] = out
    return Borders(kept_starts, kept_along[:out], kept_facet[:out], paired, sound, simple)

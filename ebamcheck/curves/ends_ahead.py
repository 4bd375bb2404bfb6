"""Ends ahead: what the turns straight ahead of each end of an edge tell of the surface over it, end by end.

The normals at the ends of an edge far longer than what lies ahead of it are those of a rounding there, and lift it to where
no surface is: a flat side that runs into roundings by as much as the roundings turn, to the wrong side where they bend the
other way. The turns ahead tell such a side from a curved one, each end for itself (:mod:`ebamcheck.curves.sagitta`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ebamcheck.curves.sagitta import EDGES_A_BLOCK, flat_mm, sagitta_of_end
from ebamcheck.curves.ways_ahead import Surface, dot, no_way, norm, walk
from ebamcheck.mesh.topology import NO_TWIN
from ebamcheck.numeric.kernels import kernel, run_blocks

Rows = NDArray[np.float32]
"""Half of the memory of other columns: these only limit."""

FAR = 3.0
"""An end is far from what lies ahead where the edge is this many times longer than the chord there, as a flat side beside a
rounding is; see :data:`ebamcheck.curves.sagitta.WIDTH_RATIO`."""

VERY_FAR = 6.0
"""An edge this many times longer than the chord ahead: an error of a turn counts for so much there that it tells little."""

MOST_OF_TYPICAL = 0.5
"""Times the mesh's median sagitta that such an edge is lifted at most."""

MOST_OF_TOLD = 2.0
"""Times what a far end tells, that an edge is lifted at most: it scatters by as much where the normals are right."""

FEWEST_TURNS = 2
"""A single turn ahead of both ends is a bend, and no curve."""


class EndsAhead(NamedTuple):
    """What is told at the ends of the edges of half-edges (3 F, 2); none of it where the rows are empty."""

    told: Rows
    """How far the surface stands over the edge by one end and by the other, mm, positive to the outside; NaN at a crease."""
    ratio: Rows
    """Length of the edge over that of the chord ahead; 0 at a crease."""
    turns: NDArray[np.int8]
    """(3 F,) turns that were met ahead of both ends; -1 where nothing was asked."""


def nothing_asked() -> EndsAhead:
    """Of a mesh whose edges need no such witness."""
    return EndsAhead(np.zeros((0, 2), np.float32), np.zeros((0, 2), np.float32), np.zeros(0, np.int8))


def ends_ahead(surface: Surface, step: int = 1) -> EndsAhead:
    """Ask the ends of the smooth edges of a mesh.

    Parameters
    ----------
    surface
        The mesh as walks read it.
    step
        Every so many facets are asked, with their neighbours: a sample tells of the whole mesh.
    """
    count = 3 * len(surface.faces)
    found = EndsAhead(
        np.full((count, 2), np.nan, np.float32), np.zeros((count, 2), np.float32), np.full(count, -1, np.int8)
    )
    flat = flat_mm(surface.vertices)

    def work(first: int, last: int) -> None:
        _ask(surface, flat, step, first, last, found)

    run_blocks(work, count, EDGES_A_BLOCK)
    return found


@kernel
def _ask(surface: Surface, flat: float, step: int, first: int, last: int, found: EndsAhead) -> None:
    way = no_way()
    for h in range(first, last):
        g = surface.twin[h]
        if h // 3 % step or g == NO_TWIN or surface.sharp[h] or (g < h and g // 3 % step == 0):
            continue
        a, b = surface.faces[h // 3, h % 3], surface.faces[h // 3, (h % 3 + 1) % 3]
        along = surface.vertices[b] - surface.vertices[a]
        length = norm(along)
        if length == 0.0:
            continue
        along /= length
        up = surface.normals[h // 3] + surface.normals[g // 3]
        up = up - along * dot(up, along)
        size = norm(up)
        if size == 0.0:
            continue
        up /= size
        way.turns[:], way.centres[:], way.lengths[:], way.joints[:] = 0.0, 0.0, 0.0, 0
        walk(surface, h, b, along, up, length, flat, 0, way)
        walk(surface, h, a, -along, up, length, flat, 1, way)
        chord = length + way.lengths[0, 0] + way.lengths[1, 0]
        found.turns[h] = found.turns[g] = way.joints[0] + way.joints[1]
        for end in range(2):
            if way.joints[end] > 0:
                found.told[h, end] = found.told[g, end] = sagitta_of_end(chord, end, way)
                found.ratio[h, end] = found.ratio[g, end] = chord / max(way.lengths[end, 1], 1e-9)


@kernel
def most_of_free(ends: EndsAhead, half_edge: int, outward: bool, typical: float) -> float:
    """How far an edge between freely curved facets may be lifted to the outside, or to the inside, mm."""
    if ends.turns[half_edge] < FEWEST_TURNS:
        return 0.0
    side = 1.0 if outward else -1.0
    most = np.inf
    for end in range(2):
        ratio = ends.ratio[half_edge, end]
        if ratio > FAR:
            most = min(most, max(MOST_OF_TOLD * side * ends.told[half_edge, end], 0.0))
        if ratio > VERY_FAR:
            most = min(most, MOST_OF_TYPICAL * typical)
    return float(most)


@kernel
def is_far(ends: EndsAhead, half_edge: int) -> bool:
    """Whether an end of an edge is far from what lies ahead."""
    return bool(max(ends.ratio[half_edge, 0], ends.ratio[half_edge, 1]) > FAR)


@kernel
def is_contradicted(ends: EndsAhead, half_edge: int, outward: bool, height: float) -> bool:
    """Whether a far end of an edge tells that the surface stands on the other side by more than a lift to this one."""
    side = 1.0 if outward else -1.0
    for end in range(2):
        if ends.ratio[half_edge, end] > FAR and side * ends.told[half_edge, end] < -height:
            return True
    return False

"""Ends ahead: the height of the surface over an edge, estimated at each end from the turns of the mesh straight ahead of it.

If an edge is far longer than the facets ahead of it, the normals at its ends may be those of a rounding there. They would lift
a flat side that runs into roundings by as much as the roundings turn, and to the wrong side where these bend the other way. The
turns ahead, each end on its own, distinguish such a side from a curved one (:mod:`ebamcheck.curves.sagitta`).
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
"""Half the memory of other columns: these values are only limits, for which 32 bits are enough."""

FAR = 3.0
"""An end is *far* if the edge is this many times longer than the chord ahead of it, like a flat side beside a rounding; see
:data:`ebamcheck.curves.sagitta.WIDTH_RATIO`."""

VERY_FAR = 6.0
"""From this ratio of the edge to the chord ahead on, an error of the turn is magnified so much that it tells little."""

MOST_OF_TYPICAL = 0.5
"""Largest lift of such a very long edge, over the mesh's median sagitta."""

MOST_OF_TOLD = 2.0
"""Largest lift of an edge, over the height told by a far end: that height scatters by as much where the normals are right."""

FEWEST_TURNS = 2
"""Fewest turns ahead of both ends together: a single one is a bend, not a curve."""


class EndsAhead(NamedTuple):
    """Estimates at the two ends of the edge of each half-edge; arrays without rows if nothing was asked."""

    told: Rows
    """(3 F, 2) height of the surface over the edge by each of its ends, mm, positive to the outside; NaN at a crease."""
    ratio: Rows
    """(3 F, 2) length of the edge over that of the chord ahead; 0 at a crease."""
    turns: NDArray[np.int8]
    """(3 F,) number of turns met ahead of both ends together; -1 where nothing was asked."""


def nothing_asked() -> EndsAhead:
    """Empty result, for a mesh whose edges need no such check."""
    return EndsAhead(np.zeros((0, 2), np.float32), np.zeros((0, 2), np.float32), np.zeros(0, np.int8))


def ends_ahead(surface: Surface, step: int = 1) -> EndsAhead:
    """Estimate the surface's height over the smooth edges of a mesh.

    Parameters
    ----------
    surface
        The mesh, in the form that walks read.
    step
        Take every `step`-th facet, with its neighbours: a sample stands for the whole mesh.
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

"""Ends ahead: the height of the surface over an edge, estimated at each end from the turns of the mesh straight ahead of it.

If an edge is far longer than the facets ahead of it, the normals at its ends may be those of a rounding there. They would lift
a flat side that runs into roundings by as much as the roundings turn, and to the wrong side where these bend the other way. The
turns ahead, each end on its own, distinguish such a side from a curved one.

A chord of length l over which a curve turns by phi leaves it by l / 2 tan(phi / 4). How much of the turn between two
chords belongs to each of them follows from what lies beyond: on a curve of even curvature a joint turns by half of what
both of its chords span, so that a chord spans twice the turn at its end less what the neighbour spans, and that follows
from the joint beyond it. A flat side beside a fillet spans nothing by that; the chord of a circle all of its arc. The chords
are those in which a plane through the edge and across the facets cuts them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ebamcheck.kernels import Floats, kernel
from ebamcheck.mesh.topology import NO_TWIN, Index
from ebamcheck.threads import run_blocks

SNAP = 0.02  # A path that passes within this share of the crossed edge of a vertex continues from the vertex
MOST_JOINTS = 4  # Most turns noted beyond an end of an edge

WIDTH_RATIO = 3.0
"""A chord this many times longer than its neighbour is a flat side beside a rounding. A chord that many times shorter than both
of its neighbours is a rounding of a single chord: both turns at its ends are its own."""

Rows = NDArray[np.float32]  # Half the memory of other columns; these values are only limits


class Ground(NamedTuple):
    """What paths over a mesh read of it."""

    vertices: Floats
    faces: Index
    twin: Index  # (3 F,) half-edge across each; NO_TWIN at creases
    fans: Index  # (F, 3) smooth fan of each corner
    normals: Floats  # (F, 3) unit normals of the facets
    starts: Index  # (fans + 1,) first corner of each fan in corners
    corners: Index  # Corners 3 f + i by fan
    centres: Floats
    """(F, 3) circumcentres of the facets, of slivers their middles: there the surface has the facet's direction, on a sphere."""


class EndsAhead(NamedTuple):
    """Estimates at the two ends of the edge of each half-edge."""

    told: Rows  # (3 F, 2) height of the surface over the edge by each of its ends, mm, positive to the outside; NaN at a crease
    ratio: Rows  # (3 F, 2) length of the edge over that of the chord ahead; 0 at a crease
    turns: NDArray[np.int8]  # (3 F,) number of turns ahead of both ends together; -1 where nothing was asked


def ends_ahead(ground: Ground, flat_mm: float, step: int = 1) -> EndsAhead:
    """Estimate the surface's height over the smooth edges of a mesh.

    Chords whose joint lies within `flat_mm` of the line over both are one. Every `step`-th facet is taken, with its
    neighbours: a sample stands for the whole mesh.
    """
    count = 3 * len(ground.faces)
    told, ratio = np.full((count, 2), np.nan, np.float32), np.zeros((count, 2), np.float32)
    found = EndsAhead(told, ratio, np.full(count, -1, np.int8))

    def work(first: int, last: int) -> None:
        _ask(ground, flat_mm, step, first, last, found)

    run_blocks(work, count, 4096)
    return found


@kernel
def _ask(ground: Ground, flat: float, step: int, first: int, last: int, found: EndsAhead) -> None:
    # By end of an edge: turns and, ahead of the end, middles of the chords after them; how far the edge itself goes on without
    # a turn, and the lengths of these chords.
    ways = np.empty((2, 3, MOST_JOINTS + 1))
    turns, centres, lengths = ways[:, 0], ways[:, 1], ways[:, 2]
    joints = np.empty(2, np.int64)
    for h in range(first, last):
        g = ground.twin[h]
        if h // 3 % step or g == NO_TWIN or (g < h and g // 3 % step == 0):
            continue
        a, b = ground.faces[h // 3, h % 3], ground.faces[h // 3, (h % 3 + 1) % 3]
        along = ground.vertices[b] - ground.vertices[a]
        length = np.sqrt(np.sum(along * along))
        up = ground.normals[h // 3] + ground.normals[g // 3]
        along /= max(length, 1e-300)
        up = up - along * np.sum(along * up)
        size = np.sqrt(np.sum(up * up))
        if length == 0.0 or size == 0.0:
            continue
        up /= size
        for end in range(2):
            way = along if end == 0 else -along
            joints[end] = _walk(ground, h, b if end == 0 else a, way, up, length, flat, ways[end])
        chord = length + lengths[0, 0] + lengths[1, 0]
        found.turns[h] = found.turns[g] = joints[0] + joints[1]
        for end in range(2):
            if joints[end] == 0:
                continue
            # What the chord spans: twice the turn at its end less what the surface beyond turns from there to its first
            # middle. A far longer chord beyond is a flat side, and turns nothing: it would turn many times as much.
            own, near = turns[end, 0], lengths[end, 1]
            beside = 0.0
            if near < WIDTH_RATIO * chord:
                side = 1.0 if own > 0.0 else -1.0
                bend = turned = 0.0
                for k in range(1, joints[end]):
                    if k > 1 and lengths[end, k + 1] >= WIDTH_RATIO * near:
                        break  # the rounding ends here
                    turned += turns[end, k]
                    apart = centres[end, k] - centres[end, 0]
                    if apart >= 0.25 * near:  # nearer middles tell no curvature
                        bend = side * turned / apart
                beside = min(max(bend * centres[end, 0], 0.0), abs(own))
                if joints[end] > 1 and min(chord, lengths[end, 2]) >= WIDTH_RATIO * near:
                    beside = max(beside, min(0.5 * side * (own + turns[end, 1]), abs(own)))
            span = min(2.0 * (abs(own) - beside), np.deg2rad(160.0))  # beyond that a height means nothing
            height = np.copysign(0.5 * chord * np.tan(0.25 * span), own)
            found.told[h, end] = found.told[g, end] = height
            found.ratio[h, end] = found.ratio[g, end] = chord / max(near, 1e-9)


@kernel
def _walk(ground: Ground, h: int, vertex: int, d: Floats, up: Floats, length: float, flat: float, way: Floats) -> int:
    """Go straight ahead from the end of an edge, in the plane of a direction and an upward one, and note the turns; how many.

    Where the way does not turn, to rounding, a chord goes on: so a flat side is one chord however it is cut up.
    """
    m = np.array([d[1] * up[2] - d[2] * up[1], d[2] * up[0] - d[0] * up[2], d[0] * up[1] - d[1] * up[0]])
    here, start = ground.vertices[vertex].copy(), ground.vertices[vertex]
    turns, centres, lengths = way[0], way[1], way[2]
    lengths[0] = 0.0
    f, fan = h // 3, 0
    for k in range(3):
        if ground.faces[f, k] == vertex:
            fan = ground.fans[f, k]
    at_vertex, edge, n = True, -1, 0
    x, y, chord = 1.0, 0.0, length
    for _ in range(24):  # facets crossed
        from_vertex = at_vertex
        if from_vertex:
            edge = _through_fan(ground, fan, here, d, m)
        elif ground.twin[edge] == NO_TWIN:
            return n
        else:
            entry = ground.twin[edge]
            f, k = entry // 3, (entry % 3 + 2) % 3
            side = 0.0
            for axis in range(3):
                side += (ground.vertices[ground.faces[f, k], axis] - here[axis]) * m[axis]
            edge = 3 * f + (k if side > 0.0 else (k + 2) % 3)
        if edge < 0:
            return n
        f, k = edge // 3, edge % 3
        p, q = ground.faces[f, k], ground.faces[f, (k + 1) % 3]
        right = left = 0.0
        for axis in range(3):
            right += (ground.vertices[p, axis] - here[axis]) * m[axis]
            left += (ground.vertices[q, axis] - here[axis]) * m[axis]
        s = right / (right - left) if right > left else 0.5
        at_vertex = s < SNAP or s > 1.0 - SNAP
        if at_vertex:
            fan = ground.fans[f, k if s < SNAP else (k + 1) % 3]
            s = 0.0 if s < SNAP else 1.0
        u = v = ahead = 0.0
        for axis in range(3):
            there = (1.0 - s) * ground.vertices[p, axis] + s * ground.vertices[q, axis]
            u += (there - here[axis]) * d[axis]
            v += (there - here[axis]) * up[axis]
            middle = 0.5 * (there + here[axis]) if from_vertex and at_vertex else ground.centres[f, axis]
            ahead += (middle - start[axis]) * d[axis]
            here[axis] = there
        size = np.hypot(u, v)
        if size == 0.0:
            continue
        turn = np.arctan2(y * u - x * v, x * u + y * v)
        if abs(turn) * chord * size / (chord + size) < flat:
            lengths[n] += size
            chord += size
            continue
        if n == MOST_JOINTS:
            return n
        turns[n], centres[n] = turn, ahead
        n += 1
        lengths[n] = chord = size
        x, y = u / size, v / size
    return n


@kernel
def _through_fan(ground: Ground, fan: int, here: Floats, d: Floats, m: Floats) -> int:
    """Half-edge by which the way leaves the facets around a vertex; -1 where they end at a crease before."""
    best, chosen = 0.0, -1
    for place in range(ground.starts[fan], ground.starts[fan + 1]):
        f, k = ground.corners[place] // 3, ground.corners[place] % 3
        p, q = ground.faces[f, (k + 1) % 3], ground.faces[f, (k + 2) % 3]
        right = left = ahead_p = ahead_q = wide = 0.0
        for axis in range(3):
            x, y = ground.vertices[p, axis] - here[axis], ground.vertices[q, axis] - here[axis]
            right += x * m[axis]
            left += y * m[axis]
            ahead_p += x * d[axis]
            ahead_q += y * d[axis]
            wide += (x - y) * (x - y)
        near = 1e-9 * np.sqrt(wide)
        if right < -near or left > near or right - left <= 0.0:
            continue
        s = min(max(right / (right - left), 0.0), 1.0)
        ahead = (1.0 - s) * ahead_p + s * ahead_q
        if ahead > best:
            best, chosen = ahead, 3 * f + (k + 1) % 3
    return chosen


def circumcentres(corners: Floats) -> Floats:
    """Circumcentres of triangles (F, 3, 3), mm; of slivers their middles."""
    opposite = np.roll(corners, -1, axis=1) - np.roll(corners, -2, axis=1)
    square = (opposite * opposite).sum(axis=2)
    total = square.sum(axis=1, keepdims=True)
    weights = square * (total - 2.0 * square)
    whole = weights.sum(axis=1, keepdims=True)
    # This is 16 times the square of the area, over the square of the sum of the squared sides.
    weights = np.where(whole <= 1e-6 * total * total, 1.0, weights)
    return np.asarray((weights[:, :, None] * corners).sum(axis=1) / weights.sum(axis=1)[:, None])

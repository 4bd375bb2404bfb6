"""Paths straight ahead over a mesh: how the surface turns beyond the two ends of an edge."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ebamcheck.mesh.topology import Index
from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Bools, Floats, Ints

MOST_STEPS = 24
"""Most facets crossed beyond an end of an edge; coplanar ones make one chord, however many they are."""

SNAP = 0.02
"""A path that passes within this share of the crossed edge of a vertex continues from the vertex."""

MOST_JOINTS = 4
"""Most turns noted beyond an end of an edge."""

LEAST_SHAPE = 1e-6
"""Least 16 A^2 / (a^2 + b^2 + c^2)^2 of a facet with area A and sides a, b, c for its circumcentre to be usable."""


class Surface(NamedTuple):
    """What paths over a mesh read of it."""

    vertices: Floats
    faces: Index
    twin: Index
    sharp: Bools
    sectors: Index
    normals: Floats
    corner_starts: Index
    corners: Index


class Way(NamedTuple):
    """Turns and chords met straight ahead of each end of an edge."""

    turns: Floats
    """(2, MOST_JOINTS) turns, the first at the end of the edge; positive towards the side that the edge bends to."""
    centres: Floats
    """(2, MOST_JOINTS) distance from the end of the edge to the middle of the chord after each turn, mm."""
    lengths: Floats
    """(2, MOST_JOINTS + 1) how far the edge itself goes on without a turn, and the chord after each turn, mm."""
    joints: Ints
    """(2,) number of turns met."""


@kernel
def no_way() -> Way:
    """Room for what is met; nothing yet."""
    return Way(
        np.zeros((2, MOST_JOINTS)),
        np.zeros((2, MOST_JOINTS)),
        np.zeros((2, MOST_JOINTS + 1)),
        np.zeros(2, np.int64),
    )


@kernel
def dot(a: Floats, b: Floats) -> float:
    """Scalar product of two vectors of space."""
    return float(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


@kernel
def norm(a: Floats) -> float:
    """Length of a vector of space."""
    return float(np.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2]))


@kernel
def walk(
    surface: Surface,
    h: int,
    vertex: int,
    d: Floats,
    up: Floats,
    length: float,
    flat: float,
    end: int,
    way: Way,
) -> None:
    """Go straight ahead from the end of an edge, in the plane of a direction and an upward one, and note the turns.

    Where the way does not turn, to rounding, a chord goes on: so a flat side is one chord however it is cut up.
    """
    m = np.array([d[1] * up[2] - d[2] * up[1], d[2] * up[0] - d[0] * up[2], d[0] * up[1] - d[1] * up[0]])
    here, start = surface.vertices[vertex].copy(), surface.vertices[vertex]
    there = np.empty(3)
    sector = _sector(surface, h // 3, vertex)
    at_vertex, edge, n = vertex, -1, 0
    x, y, chord = 1.0, 0.0, length
    for _ in range(MOST_STEPS):
        if at_vertex >= 0:
            following = _through_fan(surface, at_vertex, sector, here, d, m)
        else:
            following = -1 if surface.sharp[edge] else _through_facet(surface, surface.twin[edge], here, m)
        if following < 0:
            return
        from_vertex = at_vertex >= 0
        edge = following
        at_vertex = _exit(surface, edge, here, m, there)
        if at_vertex >= 0:
            sector = _sector(surface, edge // 3, at_vertex)
        u = v = ahead = 0.0
        for axis in range(3):
            step = there[axis] - here[axis]
            u += step * d[axis]
            v += step * up[axis]
            ahead += (0.5 * (there[axis] + here[axis]) - start[axis]) * d[axis]
        here[:] = there
        size = np.hypot(u, v)
        if size == 0.0:
            continue
        turn = np.arctan2(y * u - x * v, x * u + y * v)
        if abs(turn) * chord * size / (chord + size) < flat:
            way.lengths[end, n] += size
            chord += size
            continue
        if n == MOST_JOINTS:
            return
        if not (from_vertex and at_vertex >= 0):
            ahead = _centre_ahead(surface, edge // 3, start, d)
        way.turns[end, n], way.centres[end, n] = turn, ahead
        n += 1
        way.joints[end] = n
        way.lengths[end, n] = chord = size
        x, y = u / size, v / size


@kernel
def _exit(surface: Surface, edge: int, here: Floats, m: Floats, there: Floats) -> int:
    """Where the way crosses an edge; the vertex that is near to it, or -1."""
    f, k = edge // 3, edge % 3
    p, q = surface.faces[f, k], surface.faces[f, (k + 1) % 3]
    right = left = 0.0
    for axis in range(3):
        right += (surface.vertices[p, axis] - here[axis]) * m[axis]
        left += (surface.vertices[q, axis] - here[axis]) * m[axis]
    s = right / (right - left) if right > left else 0.5
    vertex = -1
    if s < SNAP:
        s, vertex = 0.0, p
    elif s > 1.0 - SNAP:
        s, vertex = 1.0, q
    for axis in range(3):
        there[axis] = (1.0 - s) * surface.vertices[p, axis] + s * surface.vertices[q, axis]
    return vertex


@kernel
def _centre_ahead(surface: Surface, f: int, start: Floats, d: Floats) -> float:
    """How far ahead of a place a facet's circumcentre lies: there the surface has the facet's direction, on a sphere."""
    a, b, c = (
        surface.vertices[surface.faces[f, 0]],
        surface.vertices[surface.faces[f, 1]],
        surface.vertices[surface.faces[f, 2]],
    )
    p, q, r = b - c, c - a, a - b
    pp, qq, rr = dot(p, p), dot(q, q), dot(r, r)
    wa, wb, wc = pp * (qq + rr - pp), qq * (rr + pp - qq), rr * (pp + qq - rr)
    total = wa + wb + wc
    if total <= LEAST_SHAPE * (pp + qq + rr) ** 2:
        wa, wb, wc, total = 1.0, 1.0, 1.0, 3.0
    ahead = 0.0
    for axis in range(3):
        ahead += ((wa * a[axis] + wb * b[axis] + wc * c[axis]) / total - start[axis]) * d[axis]
    return ahead


@kernel
def _sector(surface: Surface, f: int, vertex: int) -> int:
    for k in range(3):
        if surface.faces[f, k] == vertex:
            return int(surface.sectors[f, k])
    return -1


@kernel
def _through_fan(surface: Surface, vertex: int, sector: int, here: Floats, d: Floats, m: Floats) -> int:
    """Half-edge by which the way leaves the facets around a vertex; -1 where they end at a crease before."""
    best, chosen = 0.0, -1
    for place in range(surface.corner_starts[vertex], surface.corner_starts[vertex + 1]):
        f, k = surface.corners[place] // 3, surface.corners[place] % 3
        if surface.sectors[f, k] != sector:
            continue
        p, q = surface.faces[f, (k + 1) % 3], surface.faces[f, (k + 2) % 3]
        right = left = ahead_p = ahead_q = wide = 0.0
        for axis in range(3):
            x, y = surface.vertices[p, axis] - here[axis], surface.vertices[q, axis] - here[axis]
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


@kernel
def _through_facet(surface: Surface, entry: int, here: Floats, m: Floats) -> int:
    """Half-edge by which the way leaves the facet that it enters by a half-edge."""
    f, k = entry // 3, entry % 3
    r = surface.faces[f, (k + 2) % 3]
    side = 0.0
    for axis in range(3):
        side += (surface.vertices[r, axis] - here[axis]) * m[axis]
    return int(3 * f + ((k + 2) % 3 if side > 0.0 else (k + 1) % 3))


@kernel
def along_crease(surface: Surface, a: int, b: int, along: Floats, way: Way) -> Floats:
    """Note the turns of the creases that go on at both ends; returns the unit vector towards which they bend."""
    bend = np.zeros(3)
    for end in range(2):
        vertex, before = (b, a) if end == 0 else (a, b)
        u = along.copy() if end == 0 else -along
        ahead = 0.0
        for n in range(MOST_JOINTS):
            following = _next_crease(surface, vertex, before)
            if following < 0:
                break
            step = surface.vertices[following] - surface.vertices[vertex]
            size = norm(step)
            if size == 0.0:
                break
            w = step / size
            change = w - u
            turn = 2.0 * np.arcsin(min(0.5 * norm(change), 1.0))
            if n == 0:
                bend += change
            way.turns[end, n] = turn if dot(change, bend) >= 0.0 else -turn
            way.centres[end, n] = ahead + 0.5 * size
            ahead += size
            way.joints[end] = n + 1
            way.lengths[end, n + 1] = size
            u = w
            before, vertex = vertex, following
    size = norm(bend)
    return np.asarray(bend / size) if size > 0.0 else bend


@kernel
def _next_crease(surface: Surface, vertex: int, before: int) -> int:
    """The vertex at the end of the one other crease at a vertex; -1 where there is none, or more than one."""
    found = -1
    for place in range(surface.corner_starts[vertex], surface.corner_starts[vertex + 1]):
        f, k = surface.corners[place] // 3, surface.corners[place] % 3
        for side in range(2):
            h = 3 * f + k if side == 0 else 3 * f + (k + 2) % 3
            other = surface.faces[f, (k + 1) % 3] if side == 0 else surface.faces[f, (k + 2) % 3]
            if surface.sharp[h] and other != before and other != found:
                if found >= 0:
                    return -1
                found = other
    return found

"""Borders of planar groups: by how much the surface turns across each, how wide the group is there, and what lies beyond."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ebamcheck.kernels import Bools, Floats, kernel
from ebamcheck.mesh.topology import NO_TWIN, Index
from ebamcheck.surface.planes import PlanarGroups

LIKE = 3.0
"""Strips of one tessellation differ by less than this factor in width; a flat side beside a rounding by more."""

BEYOND_COSINE = 0.45
"""Least cosine between two borders of a group for one to lie beyond the other: up to the angle of an equilateral triangle."""

SUPPORTED = 5.0
"""A turn this many times the greatest one onto a like strip beside it stands out, and is a bend."""

INFLECTION = 0.5
"""At an inflection a surface turns by less than this share of the turns around it."""

HALF_TURN = (0.6, 1.6)
"""Range of the turn from a flat side onto the first strip of a rounding, over that strip's share of the next turn."""


LEAST_SHARE = 0.8
"""Width over that of the strip beside it below which the turns do not distinguish a flat side from another strip."""

MOST_BORDERS = 4096
"""A group with more borders is no strip; comparing each border with all others would take quadratic time."""


class Borders(NamedTuple):
    """Half-edges at which two groups meet by less than the crease angle."""

    turn: Floats
    """(3 F,) angle between the groups' normals, rad, positive where the surface is convex; 0 off borders."""
    width: Floats
    """(3 F,) extent of the half-edge's own group perpendicular to it, mm; cut short once far beyond that of the other group."""
    starts: Index
    """(G + 1,) first of each group's borders in `half_edges`."""
    half_edges: Index
    """Border half-edges by group."""


def find_borders(
    vertices: Floats, faces: Index, twin: Index, groups: PlanarGroups, least_cosine: float
) -> Borders:
    """Measure the borders of groups; removes from `twin` those that are sharp by their angle or run in the same direction."""
    turn, width = np.zeros(twin.size), np.zeros(twin.size)
    counts = np.zeros(len(groups.normals) + 1, np.int32)
    _measure(vertices, faces, twin, groups, least_cosine, turn, width, counts)
    starts = np.cumsum(counts).astype(np.int32)
    label = np.repeat(groups.label, 3)
    half_edges = np.flatnonzero((twin != NO_TWIN) & (label != groups.label[twin // 3]))
    by_group = np.argsort(label[half_edges], kind="stable")
    return Borders(turn, width, starts, half_edges[by_group].astype(np.int32))


@kernel
def edge_direction(vertices: Floats, faces: Index, h: int) -> tuple[float, float, float]:
    """Unit vector along a half-edge; 0 where it has no length."""
    p, q = vertices[faces[h // 3, h % 3]], vertices[faces[h // 3, (h % 3 + 1) % 3]]
    x, y, z = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    length = np.sqrt(x * x + y * y + z * z)
    if length == 0.0:
        return 0.0, 0.0, 0.0
    return x / length, y / length, z / length


@kernel
def edge_length(vertices: Floats, faces: Index, h: int) -> float:
    """Length of a half-edge, mm."""
    p, q = vertices[faces[h // 3, h % 3]], vertices[faces[h // 3, (h % 3 + 1) % 3]]
    return float(np.sqrt((p[0] - q[0]) ** 2 + (p[1] - q[1]) ** 2 + (p[2] - q[2]) ** 2))


@kernel
def _measure(
    vertices: Floats,
    faces: Index,
    twin: Index,
    groups: PlanarGroups,
    least_cosine: float,
    turn: Floats,
    width: Floats,
    counts: Index,
) -> None:
    for h in range(twin.size):
        g = twin[h]
        if g == NO_TWIN or g < h:
            continue
        mine, other = groups.label[h // 3], groups.label[g // 3]
        n, m = groups.normals[mine], groups.normals[other]
        cosine = n[0] * m[0] + n[1] * m[1] + n[2] * m[2]
        same_way = faces[h // 3, h % 3] == faces[g // 3, g % 3]
        if same_way or (mine != other and cosine <= least_cosine):
            twin[h] = twin[g] = NO_TWIN
        if same_way or mine == other or cosine <= least_cosine:
            continue
        x, y, z = n[1] * m[2] - n[2] * m[1], n[2] * m[0] - n[0] * m[2], n[0] * m[1] - n[1] * m[0]
        along = edge_direction(vertices, faces, h)
        # The facet runs up the edge with its normal to the outside: the next one bends away from it where convex.
        bends = x * along[0] + y * along[1] + z * along[2]
        turn[h] = turn[g] = np.copysign(np.arctan2(np.sqrt(x * x + y * y + z * z), cosine), bends)
        if groups.sizes[mine] <= groups.sizes[other]:
            width[h] = _width(vertices, faces, groups, h, np.inf)
            width[g] = _width(vertices, faces, groups, g, 2.0 * LIKE * width[h])
        else:
            width[g] = _width(vertices, faces, groups, g, np.inf)
            width[h] = _width(vertices, faces, groups, h, 2.0 * LIKE * width[g])
        counts[mine + 1] += 1
        counts[other + 1] += 1


@kernel
def _width(vertices: Floats, faces: Index, groups: PlanarGroups, h: int, enough: float) -> float:
    """Extent of a half-edge's group across it, in the group's plane; not beyond `enough`."""
    group = groups.label[h // 3]
    n = groups.normals[group]
    a = vertices[faces[h // 3, h % 3]]
    x, y, z = edge_direction(vertices, faces, h)
    u, v, w = n[1] * z - n[2] * y, n[2] * x - n[0] * z, n[0] * y - n[1] * x
    widest = 0.0
    for place in range(groups.starts[group], groups.starts[group + 1]):
        f = groups.facets[place]
        for k in range(3):
            p = vertices[faces[f, k]]
            widest = max(widest, (p[0] - a[0]) * u + (p[1] - a[1]) * v + (p[2] - a[2]) * w)
        if widest >= enough:
            break
    return float(widest)


@kernel
def part_bends(vertices: Floats, faces: Index, twin: Index, groups: PlanarGroups, borders: Borders) -> Bools:
    """Half-edges (3 F,) at which two planes meet in a bend and not in a rounding: no third strip goes on turning.

    Asked where a plane of several facets meets another, or something far narrower, or at the end of a long strip; two single
    facets are pieces of a freely curved surface up to the crease angle.
    """
    bend = np.zeros(twin.size, np.bool_)
    for h in range(twin.size):
        g = twin[h]
        if g == NO_TWIN or g < h:
            continue
        mine, other = groups.label[h // 3], groups.label[g // 3]
        if mine == other:
            continue
        several = groups.sizes[mine] > 1, groups.sizes[other] > 1
        uneven = borders.width[h] >= LIKE * borders.width[g] or borders.width[g] >= LIKE * borders.width[h]
        length = edge_length(vertices, faces, h)
        rim = (several[0] and borders.width[h] >= LIKE * length) or (
            several[1] and borders.width[g] >= LIKE * length
        )
        if not ((several[0] and several[1]) or ((several[0] or several[1]) and uneven) or rim):
            continue
        ahead = _support(vertices, faces, twin, groups, borders, g)
        back = _support(vertices, faces, twin, groups, borders, h)
        turn = abs(borders.turn[h])
        same, either = max(ahead[0], back[0]), max(max(ahead[0], back[0]), max(ahead[1], back[1]))
        bend[h] = bend[g] = not (turn <= SUPPORTED * same or turn <= INFLECTION * either)
    return bend


@kernel
def _support(
    vertices: Floats, faces: Index, twin: Index, groups: PlanarGroups, borders: Borders, g: int
) -> tuple[float, float]:
    """Greatest turn, rad, beyond the group of half-edge g onto a strip like it: to the same side, and to the other."""
    group, from_group = groups.label[g // 3], groups.label[twin[g] // 3]
    along = edge_direction(vertices, faces, g)
    same = opposite = 0.0
    if borders.starts[group + 1] - borders.starts[group] > MOST_BORDERS:
        return same, opposite
    for place in range(borders.starts[group], borders.starts[group + 1]):
        h = borders.half_edges[place]
        if twin[h] == NO_TWIN or groups.label[twin[h] // 3] == from_group:
            continue
        other = edge_direction(vertices, faces, h)
        parallel = abs(along[0] * other[0] + along[1] * other[1] + along[2] * other[2])
        if parallel < BEYOND_COSINE:
            continue
        mine, theirs = borders.width[h], borders.width[twin[h]]
        like = mine < LIKE * theirs and theirs < LIKE * mine
        if not like and not _runs_out(borders, twin, g, h):
            continue
        turn = borders.turn[h] * parallel
        if turn * borders.turn[g] > 0.0:
            same = max(same, abs(turn))
        else:
            opposite = max(opposite, abs(turn))
    return same, opposite


@kernel
def _runs_out(borders: Borders, twin: Index, g: int, h: int) -> bool:
    """Whether beyond half-edge h lies a flat side that the strip of g and h, the last of a rounding, touches."""
    mine, theirs, before = borders.width[h], borders.width[twin[h]], borders.width[twin[g]]
    if theirs < LIKE * mine or before >= LIKE * mine or mine >= LIKE * before:
        return False
    expected = borders.turn[g] * mine / (mine + before)
    return bool(
        expected * borders.turn[h] > 0.0
        and HALF_TURN[0] * abs(expected) <= abs(borders.turn[h]) <= HALF_TURN[1] * abs(expected)
    )


@kernel
def flat_against(
    vertices: Floats, faces: Index, twin: Index, groups: PlanarGroups, borders: Borders, h: int
) -> bool:
    """Whether the group of half-edge h is flat up to this border, and only what lies beyond is curved.

    It is where it is far wider than what it meets. Else the turns tell: from a tangent plane onto the first strip of a
    rounding the surface turns by half of that strip's own share, from one strip onto the next by both halves.
    """
    g = twin[h]
    mine, theirs = borders.width[h], borders.width[g]
    if mine >= LIKE * theirs:
        return True
    if groups.sizes[groups.label[g // 3]] < 2 or mine < LEAST_SHARE * theirs:
        return False
    group, from_group = groups.label[g // 3], groups.label[h // 3]
    along = edge_direction(vertices, faces, h)
    flat = False
    for place in range(borders.starts[group], borders.starts[group + 1]):
        k = borders.half_edges[place]
        if twin[k] == NO_TWIN or groups.label[twin[k] // 3] == from_group:
            continue
        other = edge_direction(vertices, faces, k)
        parallel = abs(along[0] * other[0] + along[1] * other[1] + along[2] * other[2])
        beyond = borders.width[twin[k]]
        near = borders.width[k]
        if parallel < 0.9 or beyond >= LIKE * near or near >= LIKE * beyond:
            continue
        if groups.sizes[groups.label[twin[k] // 3]] < 2 or borders.turn[k] * borders.turn[h] <= 0.0:
            return False
        ratio = borders.turn[h] * (near + beyond) / (borders.turn[k] * theirs)
        if ratio * ratio >= 1.0 + mine / theirs:
            return False
        flat = True
    return flat

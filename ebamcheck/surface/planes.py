"""Planar groups of facets, grown from the largest facet over neighbours whose vertices lie in the group's plane.

Vertices are tested, not normals: rounding tilts the normal of a sliver far, but hardly moves its vertices.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from ebamcheck.kernels import Floats, Ints, kernel
from ebamcheck.mesh.part import Part, rotation_to_z
from ebamcheck.mesh.topology import NO_TWIN, Index
from ebamcheck.settings.base import UNITS_MM

MOST_REACH = 10.0
"""Largest distance, in tolerances, at which a vertex is taken while its group grows: the plane of a small group is uncertain
far away. The vertex is tested again once the group is complete."""

SURE_HEIGHT = 8.0
"""Height of a facet, in tolerances, from which its normal shows which way it faces: rounding tilts it by only a few degrees."""


class PlanarGroups(NamedTuple):
    """Facets in coplanar groups; a facet that is coplanar with no neighbour is a group of its own."""

    label: Index  # (F,) group of each facet
    normals: Floats  # (G, 3) unit normal of each group, from the sum of its facets' area vectors
    sizes: Index  # (G,) number of facets
    areas: Floats  # (G,) mm2
    starts: Index  # (G + 1,) first facet of each group in facets
    facets: Index  # (F,) facets by group


def planar_groups(vertices: Floats, faces: Index, twin: Index, tolerance_mm: float) -> PlanarGroups:
    """Group the facets that are coplanar with their neighbours, within the tolerance."""
    corners = vertices[faces]
    vectors = area_vectors(corners)
    areas = np.linalg.norm(vectors, axis=1)
    longest = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2).max(axis=1, initial=0.0)
    facets = _Facets(vertices, faces, twin, vectors, areas, longest, corners.mean(axis=1))
    label, count = _grow(facets, np.argsort(-areas, kind="stable").astype(np.int32), tolerance_mm)
    normals, group_areas, offsets = _measured(corners, vectors, areas, label, count)
    # A vertex may be off the plane of its complete group by two tolerances: one for itself, one for the plane.
    count = _put_out(corners, label, normals, offsets, 2.0 * tolerance_mm)
    if count > len(normals):
        normals, group_areas, offsets = _measured(corners, vectors, areas, label, count)
    sizes = np.bincount(label, minlength=count).astype(np.int32)
    starts = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int32)
    by_group = np.argsort(label, kind="stable").astype(np.int32)
    return PlanarGroups(label, normals, sizes, group_areas, starts, by_group)


def area_vectors(corners: Floats) -> Floats:
    """Normals of triangles (n, 3, 3) times their areas, mm2."""
    return np.asarray(0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))


def connected(a: Ints | Index, b: Ints | Index, count: int) -> Ints:
    """Number of the piece (count,) that each item belongs to, if items `a` are joined with items `b`."""
    links = coo_matrix((np.ones(len(a)), (a, b)), (count, count))
    return np.asarray(connected_components(links, directed=False)[1], np.int64)


class _Facets(NamedTuple):
    """What growing groups reads of a mesh."""

    vertices: Floats
    faces: Index
    twin: Index
    vectors: Floats  # (F, 3) normal times area
    areas: Floats
    longest: Floats  # (F,) longest edge, mm
    middles: Floats  # (F, 3) mm


@kernel
def _grow(facets: _Facets, order: Index, tolerance: float) -> tuple[Index, int]:
    """Label facets by plane, largest seed first; a group's plane follows all that it has taken up."""
    vertices, faces, twin, vectors, areas, longest, middles = facets
    label = np.full(len(faces), -1, np.int32)
    stack = np.empty(len(faces), np.int32)
    groups = 0
    total, normal, middle = np.empty(3), np.empty(3), np.empty(3)
    for seed in order:
        if label[seed] >= 0:
            continue
        label[seed] = groups
        area = areas[seed]
        reach = longest[seed]
        for axis in range(3):
            total[axis] = vectors[seed, axis]
            normal[axis] = total[axis] / max(area, 1e-300)
            middle[axis] = middles[seed, axis]
        depth = 0
        if area > 0.0:
            stack[0], depth = seed, 1
        while depth > 0:
            depth -= 1
            f = stack[depth]
            for k in range(3):
                g = twin[3 * f + k]
                if g == NO_TWIN or label[g // 3] >= 0:
                    continue
                e = g // 3
                tip = faces[e, (g % 3 + 2) % 3]
                x, y = vertices[tip, 0] - middle[0], vertices[tip, 1] - middle[1]
                z = vertices[tip, 2] - middle[2]
                away = np.sqrt(x * x + y * y + z * z)
                allowed = tolerance * min(1.0 + away * reach / area, MOST_REACH)
                if abs(x * normal[0] + y * normal[1] + z * normal[2]) > allowed:
                    continue
                sure = 2.0 * areas[e] > SURE_HEIGHT * tolerance * longest[e]
                facing = vectors[e, 0] * normal[0] + vectors[e, 1] * normal[1] + vectors[e, 2] * normal[2]
                if sure and facing <= 0.0:
                    continue
                label[e] = groups
                stack[depth] = e
                depth += 1
                area += areas[e]
                for axis in range(3):
                    total[axis] += vectors[e, axis]
                    middle[axis] += (middles[e, axis] - middle[axis]) * (areas[e] / area)
                length = np.sqrt(total[0] ** 2 + total[1] ** 2 + total[2] ** 2)
                for axis in range(3):
                    normal[axis] = total[axis] / length if length > 0.0 else normal[axis]
                reach = max(reach, away)
        groups += 1
    return label, groups


def _measured(
    corners: Floats, vectors: Floats, areas: Floats, label: Index, count: int
) -> tuple[Floats, Floats, Floats]:
    """Normals (G, 3), areas (G,), and distances (G,) of the planes from the origin, mm."""
    sums = [np.bincount(label, vectors[:, axis], minlength=count) for axis in range(3)]
    normals = np.stack(sums, axis=1).astype(np.float64)
    lengths = np.linalg.norm(normals, axis=1)
    normals /= np.where(lengths > 0.0, lengths, 1.0)[:, None]
    first = np.zeros((count, 3))
    first[label[::-1]] = corners[::-1, 0]
    # Relative to a vertex of the group: distances from the origin lose digits.
    off = np.einsum("fkd,fd->f", corners - first[label][:, None], normals[label])
    offsets = np.bincount(label, off, minlength=count) / (3.0 * np.bincount(label, minlength=count))
    group_areas = np.bincount(label, areas, minlength=count).astype(np.float64)
    return normals, group_areas, np.asarray(offsets + (first * normals).sum(axis=1))


def _put_out(corners: Floats, label: Index, normals: Floats, offsets: Floats, allowed: float) -> int:
    """Give facets that do not lie in the plane of their whole group groups of their own; returns the number of groups."""
    count = len(normals)
    off = np.abs(np.einsum("fkd,fd->fk", corners, normals[label]) - offsets[label][:, None]).max(axis=1)
    out = np.flatnonzero(off > allowed)
    # The last facet of a group stays in it.
    sizes, gone = np.bincount(label, minlength=count), np.bincount(label[out], minlength=count)
    last = np.full(count, -1)
    last[label[out]] = out
    out = out[~((gone == sizes)[label[out]] & (last[label[out]] == out))]
    label[out] = count + np.arange(out.size)
    return count + int(out.size)


# -- Rounding of coordinates: the tolerance within which facets count as lying in one plane --------------------


def plane_tolerance_mm(part: Part) -> float:
    """How far a vertex of a plane may lie from it, mm: twice as far as half a step of each coordinate moves it.

    Twice, because the plane itself goes through rounded vertices. At least 5e-5 mm, however fine the numbers of the file: programs
    that split an edge or rotate a part leave some 1e-5 mm. That is a twentieth of the least distance of contour points, far below
    any chord error.
    """
    return max(5e-5, float(2.0 * np.sqrt(3.0) * coordinate_error_mm(part)))


def coordinate_error_mm(part: Part) -> float:
    """Greatest rounding of a coordinate: half a step of 32-bit numbers, or of the decimals of an ASCII file."""
    largest = float(np.abs(part.bounds).max(initial=0.0))
    if not len(part.faces) or largest == 0.0:
        return 0.0
    # 32-bit numbers have steps of 2^-23 of the power of two below them.
    half_step: float = 0.5 * 2.0**-23 * 2.0 ** np.floor(np.log2(largest))
    in_file: Floats = part.vertices / UNITS_MM[part.units]
    if part.direction != (0.0, 0.0, 1.0):
        in_file = in_file @ rotation_to_z(part.direction)
    digits = _decimals(in_file, half_step / UNITS_MM[part.units])
    return half_step if digits is None else max(half_step, 0.5 * 10.0**-digits * UNITS_MM[part.units])


def _decimals(points: Floats, half_step: float) -> int | None:
    """Decimal places of all coordinates, 3 to 6; None if there are others, or if any number would fit.

    Fewer are a part's own round dimensions.
    """
    for digits in range(2, 7):
        scaled = points * 10.0**digits
        if 10.0**digits * half_step > 0.05:
            return None  # any 32-bit number of this size looks like a decimal
        if (np.abs(scaled - np.round(scaled)) <= 2.0 * 10.0**digits * half_step + 1e-9).all():
            return digits if digits >= 3 else None
    return None

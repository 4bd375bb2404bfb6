"""Planar groups of facets, grown from the largest facet over neighbours whose vertices lie in the group's plane.

Vertices are tested, not normals: rounding tilts the normal of a sliver far, but hardly moves its vertices.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ebamcheck.mesh.part import (
    Part,
    rotation_to_z,
)
from ebamcheck.mesh.topology import NO_TWIN, Index
from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Floats
from ebamcheck.settings.base import UNITS_MM

MOST_REACH = 10.0
"""Largest distance, in tolerances, at which a vertex is taken while its group grows: the plane of a small group is uncertain
far away. The vertex is tested again once the group is complete."""

SURE_HEIGHT = 8.0
"""Height of a facet, in tolerances, from which its normal shows which way it faces: rounding tilts it by only a few degrees."""

IN_PLANE = 2.0
"""Largest distance, in tolerances, of a vertex from the plane of its complete group: one for itself, one for the plane."""


class PlanarGroups(NamedTuple):
    """Facets in coplanar groups; a facet that is coplanar with no neighbour is a group of its own."""

    label: Index
    """(F,) group of each facet."""
    normals: Floats
    """(G, 3) unit normal of each group, from the sum of its facets' area vectors."""
    sizes: Index
    """(G,) number of facets."""
    areas: Floats
    """(G,) mm2."""
    starts: Index
    """(G + 1,) first facet of each group in `facets`."""
    facets: Index
    """(F,) facets by group."""


def planar_groups(vertices: Floats, faces: Index, twin: Index, tolerance_mm: float) -> PlanarGroups:
    """Group the facets that are coplanar with their neighbours, within the tolerance."""
    vectors = area_vectors(vertices, faces)
    areas = np.sqrt((vectors * vectors).sum(axis=1))
    order = np.argsort(-areas, kind="stable").astype(np.int32)
    label, count = _grow(vertices, faces, twin, vectors, areas, order, tolerance_mm)
    normals, group_areas, offsets = _measured(vertices, faces, vectors, areas, label, count)
    count = _put_out(vertices, faces, label, count, normals, offsets, IN_PLANE * tolerance_mm)
    if count > len(normals):
        normals, group_areas, offsets = _measured(vertices, faces, vectors, areas, label, count)
    sizes = np.bincount(label, minlength=count).astype(np.int32)
    starts = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int32)
    return PlanarGroups(
        label, normals, sizes, group_areas, starts, np.argsort(label, kind="stable").astype(np.int32)
    )


@kernel
def area_vectors(vertices: Floats, faces: Index) -> Floats:
    """Normal of each facet times its area (F, 3), mm2."""
    result = np.empty((len(faces), 3))
    for f in range(len(faces)):
        a, b, c = vertices[faces[f, 0]], vertices[faces[f, 1]], vertices[faces[f, 2]]
        ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
        result[f, 0] = 0.5 * (uy * vz - uz * vy)
        result[f, 1] = 0.5 * (uz * vx - ux * vz)
        result[f, 2] = 0.5 * (ux * vy - uy * vx)
    return result


@kernel
def longest_edge(vertices: Floats, faces: Index, f: int) -> float:
    """Length of the longest edge of a facet, mm."""
    longest = 0.0
    for k in range(3):
        p, q = vertices[faces[f, k]], vertices[faces[f, (k + 1) % 3]]
        longest = max(longest, (p[0] - q[0]) ** 2 + (p[1] - q[1]) ** 2 + (p[2] - q[2]) ** 2)
    return float(np.sqrt(longest))


@kernel
def _off(point: Floats, middle: Floats, normal: Floats) -> float:
    return float(
        (point[0] - middle[0]) * normal[0]
        + (point[1] - middle[1]) * normal[1]
        + (point[2] - middle[2]) * normal[2]
    )


@kernel
def _away(point: Floats, middle: Floats) -> float:
    return float(
        np.sqrt((point[0] - middle[0]) ** 2 + (point[1] - middle[1]) ** 2 + (point[2] - middle[2]) ** 2)
    )


@kernel
def _grow(
    vertices: Floats,
    faces: Index,
    twin: Index,
    vectors: Floats,
    areas: Floats,
    order: Index,
    tolerance: float,
) -> tuple[Index, int]:
    """Label facets by plane, largest seed first; a group's plane follows all that it has taken up."""
    label = np.full(len(faces), -1, np.int32)
    stack = np.empty(len(faces), np.int32)
    groups = 0
    total, normal, middle = np.empty(3), np.empty(3), np.empty(3)
    for seed in order:
        if label[seed] >= 0:
            continue
        label[seed] = groups
        total[:] = vectors[seed]
        area = areas[seed]
        reach = longest_edge(vertices, faces, seed)
        middle[:] = (vertices[faces[seed, 0]] + vertices[faces[seed, 1]] + vertices[faces[seed, 2]]) / 3.0
        normal[:] = total / max(area, 1e-300)
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
                tip = vertices[faces[e, (g % 3 + 2) % 3]]
                away = _away(tip, middle)
                allowed = tolerance * min(1.0 + away * reach / area, MOST_REACH)
                if abs(_off(tip, middle, normal)) > allowed:
                    continue
                sure = 2.0 * areas[e] > SURE_HEIGHT * tolerance * longest_edge(vertices, faces, e)
                if sure and _off(vectors[e], 0.0 * middle, normal) <= 0.0:
                    continue
                label[e] = groups
                stack[depth] = e
                depth += 1
                total += vectors[e]
                centre = (vertices[faces[e, 0]] + vertices[faces[e, 1]] + vertices[faces[e, 2]]) / 3.0
                area += areas[e]
                middle += (centre - middle) * (areas[e] / area)
                length = np.sqrt(np.sum(total * total))
                if length > 0.0:
                    normal[:] = total / length
                reach = max(reach, away)
        groups += 1
    return label, groups


@kernel
def _measured(
    vertices: Floats, faces: Index, vectors: Floats, areas: Floats, label: Index, count: int
) -> tuple[Floats, Floats, Floats]:
    """Normals (G, 3), areas (G,), and distances (G,) of the planes from the first vertex of each group, mm."""
    normals, group_areas = np.zeros((count, 3)), np.zeros(count)
    offsets, corners = np.zeros(count), np.zeros(count)
    first = np.full(count, -1, np.int32)
    for f in range(len(faces)):
        g = label[f]
        normals[g] += vectors[f]
        group_areas[g] += areas[f]
        if first[g] < 0:
            first[g] = faces[f, 0]
    for g in range(count):
        length = np.sqrt(np.sum(normals[g] * normals[g]))
        if length > 0.0:
            normals[g] /= length
    for f in range(len(faces)):
        g = label[f]
        for k in range(3):
            offsets[g] += _off(vertices[faces[f, k]], vertices[first[g]], normals[g])
            corners[g] += 1.0
    for g in range(count):
        offsets[g] = offsets[g] / corners[g] + _off(vertices[first[g]], 0.0 * normals[g], normals[g])
    return normals, group_areas, offsets


@kernel
def _put_out(
    vertices: Floats,
    faces: Index,
    label: Index,
    count: int,
    normals: Floats,
    offsets: Floats,
    allowed: float,
) -> int:
    """Give facets that do not lie in the plane of their whole group groups of their own; returns the number of groups."""
    sizes = np.bincount(label, minlength=count)
    for f in range(len(faces)):
        g = label[f]
        if g >= normals.shape[0] or sizes[g] < 2:
            continue
        off = 0.0
        for k in range(3):
            p = vertices[faces[f, k]]
            off = max(
                off, abs(p[0] * normals[g, 0] + p[1] * normals[g, 1] + p[2] * normals[g, 2] - offsets[g])
            )
        if off > allowed:
            label[f] = count
            count += 1
            sizes[g] -= 1
    return count


# -- Rounding of coordinates: the tolerance within which facets count as lying in one plane --------------------


LEAST_TOLERANCE_MM = 5e-5
"""Vertices this near to a plane lie in it, however fine the numbers of the file: programs that split an edge or rotate a part
leave some 1e-5 mm. It is a twentieth of the least distance of contour points, far below any chord error."""

DECIMALS = (3, 4, 5, 6)
"""Decimal places to look for in the numbers of an ASCII file; fewer are a part's own round dimensions."""

FLOAT32_STEP = 2.0**-23
"""Step between 32-bit floating-point numbers, over the power of two below them."""


def plane_tolerance_mm(part: Part) -> float:
    """How far a vertex of a plane may lie from it, mm: twice as far as half a step of each coordinate moves it.

    Twice, because the plane itself goes through rounded vertices.
    """
    return max(LEAST_TOLERANCE_MM, float(2.0 * np.sqrt(3.0) * coordinate_error_mm(part)))


def coordinate_error_mm(part: Part) -> float:
    """Greatest rounding of a coordinate: half a step of 32-bit numbers, or of the decimals of an ASCII file."""
    largest = float(np.abs(part.bounds).max(initial=0.0))
    if not len(part.faces) or largest == 0.0:
        return 0.0
    half_step: float = 0.5 * FLOAT32_STEP * 2.0 ** np.floor(np.log2(largest))
    digits = _decimals(_in_file(part), half_step / UNITS_MM[part.units])
    return half_step if digits is None else max(half_step, 0.5 * 10.0**-digits * UNITS_MM[part.units])


def _in_file(part: Part) -> Floats:
    """Vertices in the coordinates and unit of the file."""
    points: Floats = part.vertices / UNITS_MM[part.units]
    if part.direction != (0.0, 0.0, 1.0):
        points = points @ rotation_to_z(part.direction)
    return points


def _decimals(points: Floats, half_step: float) -> int | None:
    """Decimal places of all coordinates, of :data:`DECIMALS`; None if there are other ones, or if any number would fit."""
    for digits in (DECIMALS[0] - 1, *DECIMALS):
        scaled = points * 10.0**digits
        if 10.0**digits * half_step > 0.05:
            return None  # any 32-bit number of this size looks like a decimal
        if (np.abs(scaled - np.round(scaled)) <= 2.0 * 10.0**digits * half_step + 1e-9).all():
            return digits if digits >= DECIMALS[0] else None
    return None

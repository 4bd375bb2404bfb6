"""Solids of CAD parts as triangle meshes of any chord error: the same generator makes the mesh and its truth.

As a CAD system exports them: a plane is a few large facets, a cylinder or cone a row of strips as long as it is, and
only what is curved both ways gets a grid.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray

from ebamcheck_models.outlines import Outline
from ebamcheck_models.sampling import outline_samples

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

LEAST_STEPS = 2
"""Chords of an arc at least."""


class Triangles(NamedTuple):
    """A mesh in float64."""

    vertices: Floats
    """(V, 3) mm."""
    faces: Ints
    """(F, 3), counter-clockwise seen from outside."""


Solid = Callable[[float], Triangles]
"""Mesh of a solid by its chord error, mm."""


def steps(radius_mm: float, turn_rad: float, chord_mm: float) -> int:
    """Chords by which an arc keeps a chord error."""
    half = math.acos(max(1.0 - chord_mm / radius_mm, -1.0)) if radius_mm > 0.0 else math.pi
    return max(LEAST_STEPS, math.ceil(abs(turn_rad) / (2.0 * half) - 1e-9))


# -- rounded polytopes -------------------------------------------------------------------------------------


def rounded_polytope(corners: ArrayLike, loops: Sequence[Sequence[int]], radius_mm: float) -> Solid:
    """Convex polytope, three faces a corner, whose edges and corners are rounded by a ball that rolls inside of it.

    `corners` (n, 3) are those of the polytope of the ball's centres, mm: its faces lie `radius_mm` inside; `loops` the corners of each
    face, counter-clockwise seen from outside.
    """
    core = np.asarray(corners, dtype=np.float64)
    normals = np.array([_normal(core[list(loop)]) for loop in loops])

    def mesh(chord_mm: float) -> Triangles:
        made = _Welded()
        for loop, normal in zip(loops, normals, strict=True):
            made.fan([core[k] + radius_mm * normal for k in loop])
        edges = _edges(loops)
        widest = max(math.acos(np.clip(normals[f] @ normals[g], -1.0, 1.0)) for f, g in edges.values())
        count = steps(radius_mm, widest, chord_mm)
        for (a, b), (f, g) in edges.items():
            across = [_slerp(normals[f], normals[g], k / count) for k in range(count + 1)]
            for n, m in pairwise(across):
                made.quad(*(core[k] + radius_mm * u for k, u in ((b, n), (a, n), (a, m), (b, m))))
        for corner, around in enumerate(_around(loops, len(core))):
            made.octant(core[corner], radius_mm, [normals[f] for f in around], count)
        return made.triangles()

    return mesh


def _normal(points: Floats) -> Floats:
    n = np.cross(points[1] - points[0], points[2] - points[0])
    return np.asarray(n / np.linalg.norm(n))


def _faces(loops: Sequence[Sequence[int]]) -> dict[tuple[int, int], int]:
    """Face of each edge in the face's own direction."""
    return {(a, b): f for f, loop in enumerate(loops) for a, b in zip(loop, (*loop[1:], loop[0]), strict=True)}


def _edges(loops: Sequence[Sequence[int]]) -> dict[tuple[int, int], tuple[int, int]]:
    """Both faces of each edge, by its corners in the direction of the first face."""
    face_of = _faces(loops)
    return {(a, b): (f, face_of[b, a]) for (a, b), f in face_of.items() if a < b}


def _around(loops: Sequence[Sequence[int]], count: int) -> list[list[int]]:
    """The three faces at each corner, counter-clockwise seen from outside."""
    face_of = _faces(loops)
    result = []
    for corner in range(count):
        first = next(f for (a, _), f in face_of.items() if a == corner)
        around = [first]
        for _ in range(2):
            loop = list(loops[around[-1]])
            before = loop[loop.index(corner) - 1]
            around.append(face_of[corner, before])
        result.append(around)
    return result


def _slerp(a: Floats, b: Floats, t: float) -> Floats:
    """Unit vector a share of the way from one to another, by angle."""
    angle = math.acos(float(np.clip(a @ b, -1.0, 1.0)))
    if angle == 0.0:
        return a
    return np.asarray((math.sin((1.0 - t) * angle) * a + math.sin(t * angle) * b) / math.sin(angle))


class _Welded:
    """Triangles under way; corners that are equal up to a millionth of a millimetre are one."""

    def __init__(self) -> None:
        self._ids: dict[tuple[int, int, int], int] = {}
        self._points: list[Floats] = []
        self._faces: list[tuple[int, int, int]] = []

    def _id(self, p: Floats) -> int:
        x, y, z = np.round(p * 1e6).astype(np.int64).tolist()
        found = self._ids.setdefault((x, y, z), len(self._points))
        if found == len(self._points):
            self._points.append(p)
        return found

    def fan(self, points: Sequence[Floats]) -> None:
        """Convex polygon, counter-clockwise seen from outside."""
        ids = [self._id(p) for p in points]
        for b, c in pairwise(ids[1:]):
            if len({ids[0], b, c}) == 3:
                self._faces.append((ids[0], b, c))

    def quad(self, a: Floats, b: Floats, c: Floats, d: Floats) -> None:
        """Two triangles."""
        self.fan([a, b, c, d])

    def octant(self, centre: Floats, radius_mm: float, corners: list[Floats], count: int) -> None:
        """Triangle on a sphere in rows from its first corner."""
        a, b, c = corners
        rows = [[a]]
        for k in range(1, count + 1):
            p, q = _slerp(a, b, k / count), _slerp(a, c, k / count)
            rows.append([_slerp(p, q, m / k) for m in range(k + 1)])
        points = [[centre + radius_mm * u for u in row] for row in rows]
        for upper, lower in pairwise(points):
            for m in range(len(upper)):
                self.fan([upper[m], lower[m], lower[m + 1]])
                if m + 1 < len(upper):
                    self.fan([upper[m], lower[m + 1], upper[m + 1]])

    def triangles(self) -> Triangles:
        """The mesh."""
        return Triangles(np.array(self._points), np.array(self._faces, dtype=np.int64))


def frustum(low: tuple[float, float], high: tuple[float, float], height_mm: float, radius_mm: float) -> Solid:
    """Box with sides `low` at the bottom and `high` at the top (of the ball's centres), edges rounded."""
    corners = [
        (0.5 * sx * size[0], 0.5 * sy * size[1], z)
        for z, size in ((0.0, low), (height_mm, high))
        for sx, sy in ((-1, -1), (1, -1), (1, 1), (-1, 1))
    ]
    loops = [(3, 2, 1, 0), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)]
    return rounded_polytope(corners, loops, radius_mm)


def wedge(length_mm: float, width_mm: float, height_mm: float, radius_mm: float) -> Solid:
    """Prism over a triangle with rounded edges."""
    a, b = 0.5 * length_mm, 0.5 * width_mm
    corners = [
        (-a, -b, 0),
        (a, -b, 0),
        (a, b, 0),
        (-a, b, 0),
        (-0.3 * a, -b, height_mm),
        (-0.3 * a, b, height_mm),
    ]
    loops = [(3, 2, 1, 0), (0, 1, 4), (2, 3, 5), (1, 2, 5, 4), (3, 0, 4, 5)]
    return rounded_polytope(corners, loops, radius_mm)


# -- extrusions --------------------------------------------------------------------------------------------


def extrusion(outline: Outline, height_mm: float, holes: Sequence[Outline] = ()) -> Solid:
    """Upright prism over an outline, with holes; its walls are strips as tall as it is."""

    def mesh(chord_mm: float) -> Triangles:
        rings = [o.points(outline_samples(o, 0.0, chord_mm), 0.0) for o in (outline, *holes)]
        rings[1:] = [ring[::-1] for ring in rings[1:]]
        return extruded(rings, height_mm)

    return mesh


def extruded(rings: Sequence[Floats], height_mm: float) -> Triangles:
    """Upright prism over polygons: the outer one counter-clockwise, holes clockwise."""
    flat = np.concatenate(rings)
    n = len(flat)
    cap = _cap(rings, flat)
    walls = []
    first = 0
    for ring in rings:
        k = first + np.arange(len(ring))
        m = first + (np.arange(len(ring)) + 1) % len(ring)
        walls += [np.column_stack([k, m, m + n]), np.column_stack([k, m + n, k + n])]
        first += len(ring)
    vertices = np.concatenate([np.column_stack([flat, np.full(n, z)]) for z in (0.0, height_mm)])
    return Triangles(vertices, np.concatenate([cap[:, ::-1], cap + n, *walls]).astype(np.int64))


def _cap(rings: Sequence[Floats], flat: Floats) -> Ints:
    """Triangles of the region of a prism's ends, of its own corners."""
    region = shapely.Polygon(rings[0], rings[1:])
    found = shapely.get_parts(shapely.constrained_delaunay_triangles(region))
    corners = shapely.get_coordinates(found).reshape(-1, 4, 2)[:, :3]
    rows = {tuple(p): i for i, p in enumerate(flat.tolist())}
    ids = np.array([[rows[tuple(p)] for p in triangle] for triangle in corners.tolist()], dtype=np.int64)
    a, b, c = (flat[ids[:, k]] for k in range(3))
    turned = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0] < 0.0
    ids[turned] = ids[turned][:, ::-1]
    return ids


def regular_prism(sides: int, radius_mm: float, height_mm: float) -> Solid:
    """Upright prism over a regular polygon: its sides are the part, no chords of a circle."""
    angle = 2.0 * np.pi * np.arange(sides) / sides
    ring = radius_mm * np.column_stack([np.cos(angle), np.sin(angle)])
    return lambda chord_mm: extruded([ring], height_mm)


# -- solids of revolution ----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Bow:
    """Arc of a profile about a centre (r, z), from one angle to another."""

    r: float
    z: float
    radius_mm: float
    start_deg: float
    end_deg: float

    def points(self, chord_mm: float) -> Floats:
        """Its points, both ends among them."""
        start, end = np.deg2rad(self.start_deg), np.deg2rad(self.end_deg)
        angle = np.linspace(start, end, steps(self.radius_mm, end - start, chord_mm) + 1)
        return np.column_stack([self.r + self.radius_mm * np.cos(angle), self.z + self.radius_mm * np.sin(angle)])


Profile = Sequence[tuple[float, float] | Bow]
"""Points and arcs in the plane (r, z), joined by lines; solid lies to the left."""


def lathe(profile: Profile, closed: bool = False) -> Solid:
    """Solid of revolution about z of a profile from axis to axis, or of a closed one."""

    def mesh(chord_mm: float) -> Triangles:
        rows = np.concatenate(
            [p.points(0.5 * chord_mm) if isinstance(p, Bow) else np.array([p], float) for p in profile]
        )
        keep = np.r_[True, np.hypot(*np.diff(rows, axis=0).T) > 1e-9]
        rows = rows[keep]
        if closed and np.hypot(*(rows[0] - rows[-1])) < 1e-9:
            rows = rows[:-1]
        columns = 4 * math.ceil(steps(float(rows[:, 0].max()), 2.0 * np.pi, 0.5 * chord_mm) / 4)
        return revolved(rows, columns, closed)

    return mesh


def revolved(rows: Floats, columns: int, closed: bool) -> Triangles:
    """Mesh of revolution of a polyline (r, z); points on the axis become single vertices."""
    angle = 2.0 * np.pi * np.arange(columns) / columns
    ids: list[Ints] = []
    vertices: list[Floats] = []
    count = 0
    for r, z in rows.tolist():
        if r < 1e-9:
            ids.append(np.full(columns, count))
            vertices.append(np.array([[0.0, 0.0, z]]))
        else:
            ids.append(count + np.arange(columns))
            vertices.append(np.column_stack([r * np.cos(angle), r * np.sin(angle), np.full(columns, z)]))
        count += len(vertices[-1])
    faces = []
    for low, high in pairwise([*ids, ids[0]] if closed else ids):
        a, b, c, d = low, np.roll(low, -1), np.roll(high, -1), high
        for three in ((a, b, c), (a, c, d)):
            made = np.column_stack(three)
            whole = (made[:, 0] != made[:, 1]) & (made[:, 1] != made[:, 2]) & (made[:, 2] != made[:, 0])
            faces.append(made[whole])
    return Triangles(np.concatenate(vertices), np.concatenate(faces).astype(np.int64))

"""Solids made of walls and level faces: each wall an outline that changes with height."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
import shapely
from numpy.typing import NDArray

from ebamcheck.mesh.part import Part, from_arrays
from ebamcheck_models.model import SECTION_TOLERANCE_MM, Floats, Solid, checked_tolerance, grid_faces, single
from ebamcheck_models.outlines import Outline
from ebamcheck_models.sampling import outline_samples, wall_samples

Ints = NDArray[np.int64]

BOUNDS_TOLERANCE_MM = 1e-3
"""Sampling from which the box of a model is taken."""

VOLUME_POINTS = 24
"""Nodes of the quadrature of the area between two levels."""


@dataclass(frozen=True)
class Wall:
    """A tube: an outline, counter-clockwise also for holes, from its lowest to its highest level."""

    outline: Outline
    levels: tuple[float, ...]  # increasing heights: begin, every place where the law of the outline changes, end
    hole: bool = False  # whether the solid lies outside

    def spans(self, z: float) -> bool:
        """Whether the section at z + 0 cuts the wall."""
        return self.levels[0] <= z < self.levels[-1]


@dataclass(frozen=True)
class Face:
    """A level face between the ends of walls: an outer ring less inner ones, by the numbers of their walls."""

    outer: int
    inner: tuple[int, ...]
    z: float
    up: bool  # whether the solid lies under it


@dataclass(frozen=True)
class WalledModel(Solid):
    """A solid bounded by walls and level faces; see :class:`ebamcheck_models.Model`."""

    name: str
    summary: str
    walls: tuple[Wall, ...]
    faces: tuple[Face, ...]
    euler_number: int
    shells: int = 1

    @cached_property
    def bounds(self) -> Floats:
        """Least and greatest corner, (2, 3) mm."""
        points = []
        for wall in self.walls:
            samples, rows = wall_samples(wall.outline, wall.levels, BOUNDS_TOLERANCE_MM)
            points += [
                np.column_stack([ring := wall.outline.points(samples, z), np.full(len(ring), z)]) for z in rows.tolist()
            ]
        stacked = np.concatenate(points)
        return np.stack([stacked.min(axis=0), stacked.max(axis=0)])

    def section(self, z: float, tolerance_mm: float = SECTION_TOLERANCE_MM) -> list[shapely.Polygon]:
        """Solid regions at height `z` (that of z + 0 at a step), rings as dense as the tolerance asks."""
        cut = [wall for wall in self.walls if wall.spans(z)]
        rings = [w.outline.points(outline_samples(w.outline, z, tolerance_mm), z) for w in cut]
        holes = [ring for wall, ring in zip(cut, rings, strict=True) if wall.hole]
        outers = [shapely.Polygon(ring) for wall, ring in zip(cut, rings, strict=True) if not wall.hole]
        return [shapely.Polygon(p.exterior, [h for h in holes if p.contains(shapely.Point(h[0]))]) for p in outers]

    def area(self, z: float) -> float:
        """Exact area of the section at height `z`, mm2."""
        return sum((-1.0 if w.hole else 1.0) * w.outline.area(z) for w in self.walls if w.spans(z))

    @cached_property
    def volume(self) -> float:
        """Exact volume, mm3: the area integrated between levels, where it is smooth."""
        levels = sorted({z for wall in self.walls for z in wall.levels})
        nodes, weights = np.polynomial.legendre.leggauss(VOLUME_POINTS)
        total = 0.0
        for low, high in pairwise(levels):
            heights = low + 0.5 * (nodes + 1.0) * (high - low)
            total += 0.5 * (high - low) * float(np.dot(weights, [self.area(z) for z in heights.tolist()]))
        return total

    def tessellate(self, tolerance_mm: float) -> Part:
        """Closed, outward mesh within the tolerance; vertices lie on the surface, as 32-bit floats."""
        checked_tolerance(tolerance_mm)
        vertices: list[Floats] = []
        faces: list[Ints] = []
        ends: dict[tuple[int, float], Ints] = {}
        first = 0
        for n, wall in enumerate(self.walls):
            samples, rows = wall_samples(wall.outline, wall.levels, tolerance_mm)
            rings = [wall.outline.points(samples, z) for z in rows.tolist()]
            columns = len(rings[0])
            heights = np.repeat(rows, columns)
            vertices.append(single(np.column_stack([np.concatenate(rings), heights])))
            quads = grid_faces(first, len(rows), columns)
            faces.append(quads[:, ::-1] if wall.hole else quads)
            ends[n, wall.levels[0]] = first + np.arange(columns)
            ends[n, wall.levels[-1]] = first + (len(rows) - 1) * columns + np.arange(columns)
            first += len(rows) * columns
        points = np.concatenate(vertices)
        for face in self.faces:
            rings_of_face = [ends[n, face.z] for n in (face.outer, *face.inner)]
            triangles = level_facets(points, rings_of_face)
            faces.append(triangles if face.up else triangles[:, ::-1])
        return from_arrays(points, np.concatenate(faces), self.name)


def level_facets(points: Floats, rings: list[Ints]) -> Ints:
    """Facets (n, 3) of a level region, counter-clockwise, on the vertices of its rings: rows of `points`, the outer first."""
    polygon = shapely.Polygon(points[rings[0], :2], [points[ring, :2] for ring in rings[1:]])
    triangles = shapely.get_parts(shapely.constrained_delaunay_triangles(polygon))
    corners = shapely.get_coordinates(triangles).reshape(-1, 4, 2)[:, :3]
    row_of = {(x, y): int(row) for ring in rings for row, (x, y) in zip(ring, points[ring, :2], strict=True)}
    facets = np.array([[row_of[x, y] for x, y in corner] for corner in corners.tolist()], dtype=np.int64)
    a, b, c = np.moveaxis(corners, 1, 0)
    turn = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    facets[turn < 0] = facets[turn < 0][:, ::-1]
    return facets

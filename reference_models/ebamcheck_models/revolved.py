"""Solids of revolution about z whose walls become horizontal: a sphere and a torus."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import ArrayLike

from ebamcheck.mesh.part import Part, from_arrays
from ebamcheck_models.model import (
    SECTION_TOLERANCE_MM,
    Floats,
    Solid,
    capped_tube,
    checked_tolerance,
    grid_faces,
    rotation,
    single,
)

LEAST_STEPS = 8
"""Least number of chords of a full circle."""


def chords(radius_mm: float, tolerance_mm: float) -> int:
    """Number of chords of a full circle with a sagitta within the tolerance, a multiple of 4."""
    sagitta = min(tolerance_mm / radius_mm, 1.0)
    count = math.pi / math.acos(1.0 - sagitta)
    return max(LEAST_STEPS, 4 * math.ceil(count / 4.0))


def circle_points(radius_mm: float, count: int) -> Floats:
    """Points (count, 2) about the origin, counter-clockwise from +x."""
    angle = 2.0 * np.pi * np.arange(count) / count
    return radius_mm * np.stack([np.cos(angle), np.sin(angle)], axis=1)


@dataclass(frozen=True)
class Sphere(Solid):
    """Sphere about the origin; see :class:`ebamcheck_models.Model`."""

    name: str
    summary: str
    radius_mm: float
    euler_number: int = 2

    @property
    def bounds(self) -> Floats:
        """Least and greatest corner, (2, 3) mm."""
        return np.array([[-1.0] * 3, [1.0] * 3]) * self.radius_mm

    def section(self, z: float, tolerance_mm: float = SECTION_TOLERANCE_MM) -> list[shapely.Polygon]:
        """Disc at height `z`."""
        if abs(z) >= self.radius_mm:
            return []
        radius = math.sqrt(self.radius_mm**2 - z**2)
        return [shapely.Polygon(circle_points(radius, chords(radius, tolerance_mm)))]

    def area(self, z: float) -> float:
        """Area at height `z`, mm2: pi (r^2 - z^2)."""
        return math.pi * max(0.0, self.radius_mm**2 - z**2)

    @property
    def volume(self) -> float:
        """Volume, mm3: 4/3 pi r^3."""
        return 4.0 / 3.0 * math.pi * self.radius_mm**3

    def turned(self, direction: ArrayLike) -> Sphere:
        """Return itself: a sphere about the origin is the same in every direction."""
        rotation(direction)
        return self

    def tessellate(self, tolerance_mm: float) -> Part:
        """Meridians and parallels; each of the two directions gets half of the tolerance."""
        checked_tolerance(tolerance_mm)
        columns = chords(self.radius_mm, 0.5 * tolerance_mm)
        latitude = np.linspace(-0.5 * np.pi, 0.5 * np.pi, columns // 2 + 1)[1:-1]
        rings = [circle_points(r, columns) for r in (self.radius_mm * np.cos(latitude)).tolist()]
        heights = np.repeat(self.radius_mm * np.sin(latitude), columns)
        poles = np.array([[0.0, 0.0, -self.radius_mm], [0.0, 0.0, self.radius_mm]])
        points, faces = capped_tube(poles, np.column_stack([np.concatenate(rings), heights]), columns)
        return from_arrays(points, faces, self.name)


@dataclass(frozen=True)
class Torus(Solid):
    """Torus about z, its circle in the plane z = 0; see :class:`ebamcheck_models.Model`."""

    name: str
    summary: str
    radius_mm: float
    tube_mm: float
    euler_number: int = 0

    @property
    def bounds(self) -> Floats:
        """Least and greatest corner, (2, 3) mm."""
        outer = self.radius_mm + self.tube_mm
        return np.array([[-outer, -outer, -self.tube_mm], [outer, outer, self.tube_mm]])

    def section(self, z: float, tolerance_mm: float = SECTION_TOLERANCE_MM) -> list[shapely.Polygon]:
        """Ring between two circles at height `z`."""
        if abs(z) >= self.tube_mm:
            return []
        half = math.sqrt(self.tube_mm**2 - z**2)
        count = chords(self.radius_mm + half, tolerance_mm)
        outer, inner = (circle_points(self.radius_mm + side * half, count) for side in (1.0, -1.0))
        return [shapely.Polygon(outer, [inner])]

    def area(self, z: float) -> float:
        """Area at height `z`, mm2: 4 pi R sqrt(r^2 - z^2)."""
        return 4.0 * math.pi * self.radius_mm * math.sqrt(max(0.0, self.tube_mm**2 - z**2))

    @property
    def volume(self) -> float:
        """Volume, mm3: 2 pi^2 R r^2."""
        return 2.0 * math.pi**2 * self.radius_mm * self.tube_mm**2

    def tessellate(self, tolerance_mm: float) -> Part:
        """Circles about the axis and about the tube; each of the two directions gets half of the tolerance."""
        checked_tolerance(tolerance_mm)
        columns = chords(self.radius_mm + self.tube_mm, 0.5 * tolerance_mm)
        rows = chords(self.tube_mm, 0.5 * tolerance_mm)
        angle = 2.0 * np.pi * np.arange(rows) / rows
        radii = self.radius_mm + self.tube_mm * np.cos(angle)
        rings = np.concatenate([circle_points(r, columns) for r in radii.tolist()])
        points = np.column_stack([rings, np.repeat(self.tube_mm * np.sin(angle), columns)])
        faces = grid_faces(0, rows + 1, columns) % len(points)
        return from_arrays(single(points), faces, self.name)


SPHERE = Sphere("sphere", "sphere about the origin, radius 30 mm", 30.0)
TORUS = Torus("torus", "torus about z, radius 60 mm, tube radius 20 mm", 60.0, 20.0)

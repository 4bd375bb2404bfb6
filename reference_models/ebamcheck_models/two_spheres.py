"""Two spheres that overlap: closed shells that cut each other, whose union is the solid."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import shapely
from numpy.typing import ArrayLike

from ebamcheck.mesh.part import Part, from_arrays
from ebamcheck_models.model import SECTION_TOLERANCE_MM, Floats, Solid, rotation, single
from ebamcheck_models.revolved import Sphere, chords, circle_points

SHARE_OF_CHORDS = 0.5
"""Part of a section's tolerance for its chords; crossings of two chords may lie twice as far off."""


@dataclass(frozen=True, eq=False)
class TwoSpheres(Solid):
    """Union of two spheres that cut each other; see :class:`ebamcheck_models.TurnableModel`."""

    name: str
    summary: str
    centres: Floats  # (2, 3) mm
    radii_mm: tuple[float, float]
    euler_number: int = 4
    shells: int = 2

    @property
    def bounds(self) -> Floats:
        """Least and greatest corner, (2, 3) mm."""
        radii = np.array(self.radii_mm)[:, None]
        return np.stack([(self.centres - radii).min(axis=0), (self.centres + radii).max(axis=0)])

    @property
    def volume(self) -> float:
        """Volume of the union, mm3."""
        return self.mesh_volume - self.shared_volume

    @property
    def mesh_volume(self) -> float:
        """Volume of both spheres, mm3."""
        return 4.0 / 3.0 * math.pi * sum(r**3 for r in self.radii_mm)

    @property
    def shared_volume(self) -> float:
        """Volume of the lens, mm3: pi (R + r - d)^2 (d^2 + 2 d (R + r) - 3 (R - r)^2) / (12 d)."""
        one, other = self.radii_mm
        d = float(np.linalg.norm(self.centres[1] - self.centres[0]))
        lens = (one + other - d) ** 2 * (d * d + 2.0 * d * (one + other) - 3.0 * (one - other) ** 2)
        return math.pi * lens / (12.0 * d)

    def section(self, z: float, tolerance_mm: float = SECTION_TOLERANCE_MM) -> list[shapely.Polygon]:
        """Union of up to two discs at height `z`."""
        discs = []
        for (x, y), radius in self._discs(z):
            count = chords(radius, SHARE_OF_CHORDS * tolerance_mm)
            discs.append(shapely.Polygon(circle_points(radius, count) + np.array([x, y])))
        return [p for p in shapely.get_parts(shapely.union_all(discs)).tolist() if p.area > 0]

    def area(self, z: float) -> float:
        """Exact area of the section at height `z`, mm2: discs less the lens of two circles."""
        discs = self._discs(z)
        total = sum(math.pi * radius**2 for _, radius in discs)
        if len(discs) < 2:
            return total
        (one, p), (other, q) = discs
        return total - lens_area(math.dist(one, other), p, q)

    def turned(self, direction: ArrayLike) -> TwoSpheres:
        """Return the solid turned so that `direction` points up."""
        return replace(self, centres=self.centres @ rotation(direction).T)

    def tessellate(self, tolerance_mm: float) -> Part:
        """Both spheres, whole: their facets pass through each other."""
        vertices: list[Floats] = []
        faces = []
        for centre, radius in zip(self.centres, self.radii_mm, strict=True):
            part = Sphere("", "", radius).tessellate(tolerance_mm)
            faces.append(part.faces + sum(map(len, vertices)))
            vertices.append(single(part.vertices + centre))
        return from_arrays(np.concatenate(vertices), np.concatenate(faces).astype(np.int64), self.name)

    def _discs(self, z: float) -> list[tuple[tuple[float, float], float]]:
        """Centre and radius of every disc that the plane cuts."""
        found = []
        for (x, y, height), radius in zip(self.centres.tolist(), self.radii_mm, strict=True):
            if abs(z - height) < radius:
                found.append(((x, y), math.sqrt(radius**2 - (z - height) ** 2)))
        return found


def lens_area(distance: float, p: float, q: float) -> float:
    """Area that two discs of radii p and q share, mm2."""
    if distance >= p + q:
        return 0.0
    if distance <= abs(p - q):
        return math.pi * min(p, q) ** 2
    # Half the angles under which the centres see the chord.
    a = math.acos(np.clip((distance**2 + p * p - q * q) / (2.0 * distance * p), -1.0, 1.0))
    b = math.acos(np.clip((distance**2 + q * q - p * p) / (2.0 * distance * q), -1.0, 1.0))
    return p * p * (a - 0.5 * math.sin(2.0 * a)) + q * q * (b - 0.5 * math.sin(2.0 * b))


TWO_SPHERES = TwoSpheres(
    "two-spheres",
    "two spheres of radius 30 and 24 mm that overlap: their union is the solid",
    np.array([[0.0, 0.0, 0.0], [31.0, 9.0, 7.0]]),
    (30.0, 24.0),
)

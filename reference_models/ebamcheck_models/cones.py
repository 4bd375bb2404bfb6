"""Tapered round bars: cone and cylinder, upright or in any direction.

With the plane d . p = h spanned by e1 (steepest ascent, parameter a) and the level e2 (parameter b), the
axis distance along e1 and the height along the axis are linear in a, so that the section is
|b| <= sqrt(Q(a)) with Q(a) = r(z(a))^2 - m(a)^2, a conic, between the two ends.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import shapely
from numpy.typing import ArrayLike

from ebamcheck.mesh.part import Part, from_arrays
from ebamcheck_models.model import SECTION_TOLERANCE_MM, Floats, Solid, checked_tolerance, rotation, single
from ebamcheck_models.revolved import chords, circle_points
from ebamcheck_models.walls import level_facets

LEVEL = 1e-12
"""Sine of the angle between direction and axis below which the section counts as a disc."""

GAUSS_POINTS = 96

FIRST_STEPS, MOST_STEPS = 32, 1 << 20
"""First and largest number of chords along a conic."""


@dataclass(frozen=True, eq=False)
class Bar(Solid):
    """Solid between two discs about one axis, the lower one about the origin; see :class:`ebamcheck_models.TurnableModel`."""

    name: str
    summary: str
    bottom_mm: float  # radius of the lower disc
    top_mm: float  # of the upper one; 0 for an apex
    height_mm: float
    turn: Floats = field(default_factory=lambda: np.eye(3))
    euler_number: int = 2

    @cached_property
    def bounds(self) -> Floats:
        """Least and greatest corner, (2, 3) mm."""
        reach = np.hypot(self.turn[:, 0], self.turn[:, 1])
        rise = self.height_mm * self.turn[:, 2]
        low = np.minimum(-self.bottom_mm * reach, rise - self.top_mm * reach)
        high = np.maximum(self.bottom_mm * reach, rise + self.top_mm * reach)
        return np.stack([low, high])

    @property
    def volume(self) -> float:
        """Volume, mm3: pi/3 h (R^2 + R r + r^2)."""
        squares = self.bottom_mm**2 + self.bottom_mm * self.top_mm + self.top_mm**2
        return math.pi / 3.0 * self.height_mm * squares

    def turned(self, direction: ArrayLike) -> Bar:
        """Return the solid turned so that `direction`, in its own coordinates, points up."""
        turn = rotation(direction) @ self.turn
        return Bar(self.name, self.summary, self.bottom_mm, self.top_mm, self.height_mm, turn)

    def section(self, z: float, tolerance_mm: float = SECTION_TOLERANCE_MM) -> list[shapely.Polygon]:
        """Solid region at height `z` (that of z + 0 at an end), its ring as dense as the tolerance asks."""
        if self._level:
            radius = self._disc_radius(z)
            if radius <= 0.0:
                return []
            along = z / float(self.turn[2, 2])
            ring = circle_points(radius, chords(radius, tolerance_mm))
            points = np.column_stack([ring, np.full(len(ring), along)])
            return [shapely.Polygon(points @ self.turn[:2].T)]
        span = self._span(z)
        if span is None:
            return []
        ring = self._ring(z, span, tolerance_mm)
        polygon = shapely.Polygon(ring @ self.turn[:2].T)
        return [polygon] if polygon.area > 0 else []

    def area(self, z: float) -> float:
        """Area of the section at height `z`, mm2: the integral of 2 sqrt(Q), to rounding."""
        if self._level:
            return math.pi * self._disc_radius(z) ** 2
        span = self._span(z)
        if span is None:
            return 0.0
        # With a = middle - half cos(phi) the square roots at the ends become smooth.
        phi = 0.5 * math.pi * (_NODES + 1.0)
        low, high = span
        half = 0.5 * (high - low)
        width = np.sqrt(np.maximum(self._square(z, 0.5 * (low + high) - half * np.cos(phi)), 0.0))
        return float(math.pi * half * np.dot(_WEIGHTS, width * np.sin(phi)))

    def tessellate(self, tolerance_mm: float) -> Part:
        """Mesh with chords of the discs within the tolerance; the sides are straight lines of the surface."""
        checked_tolerance(tolerance_mm)
        columns = chords(max(self.bottom_mm, self.top_mm), tolerance_mm)
        ring = np.arange(columns)
        after = np.roll(ring, -1)
        bottom = np.column_stack([circle_points(self.bottom_mm, columns), np.zeros(columns)])
        apex = self.top_mm == 0.0
        top_ring = np.zeros((1, 2)) if apex else circle_points(self.top_mm, columns)
        top = np.column_stack([top_ring, np.full(len(top_ring), self.height_mm)])
        points = np.concatenate([bottom, top])
        faces = [level_facets(points, [ring])[:, ::-1]]
        if apex:
            faces.append(np.column_stack([ring, after, np.full(columns, columns)]))
        else:
            faces.append(np.column_stack([ring, after, columns + after]))
            faces.append(np.column_stack([ring, columns + after, columns + ring]))
            faces.append(level_facets(points, [columns + ring]))
        return from_arrays(single(points @ self.turn.T), np.concatenate(faces), self.name)

    @property
    def _level(self) -> bool:
        return math.hypot(*self.turn[2, :2].tolist()) < LEVEL

    def _disc_radius(self, z: float) -> float:
        """Radius of the section of an upright bar, 0 beyond its ends."""
        low, high = self.bounds[:, 2]
        if not low <= z < high:
            return 0.0
        return float(self._radius(z / float(self.turn[2, 2])))

    def _radius(self, along: Floats | float) -> Floats:
        taper = (self.top_mm - self.bottom_mm) * np.asarray(along) / self.height_mm
        return np.asarray(self.bottom_mm + taper, np.float64)

    @property
    def _tilt(self) -> tuple[float, float]:
        """Sine and cosine of the angle between direction and axis."""
        return math.hypot(*self.turn[2, :2].tolist()), float(self.turn[2, 2])

    def _square(self, z: float, a: Floats | float) -> Floats:
        """Q at parameters a of the plane at height `z`."""
        sine, cosine = self._tilt
        across = z * sine - np.asarray(a) * cosine
        result: Floats = self._radius(z * cosine + np.asarray(a) * sine) ** 2 - across**2
        return result

    def _span(self, z: float) -> tuple[float, float] | None:
        """Range of a within the ends in which Q is positive; a convex solid has one."""
        sine, cosine = self._tilt
        low, high = -z * cosine / sine, (self.height_mm - z * cosine) / sine
        taper = (self.top_mm - self.bottom_mm) / self.height_mm
        start = self.bottom_mm + taper * z * cosine
        # Q = (start + taper sine a)^2 - (z sine - cosine a)^2 is a product of two linear factors.
        ends = []
        for side in (1.0, -1.0):
            constant, slope = start + side * z * sine, taper * sine - side * cosine
            if slope == 0.0:
                if constant <= 0.0:
                    return None
                continue
            ends.append((slope, -constant / slope))
        # Both factors are positive inside, as their sum is twice the radius.
        for slope, root in ends:
            if slope > 0:
                low = max(low, root)
            else:
                high = min(high, root)
        return (low, high) if low < high else None

    def _ring(self, z: float, span: tuple[float, float], tolerance_mm: float) -> Floats:
        """Corners (n, 3) of the section in the upright bar's coordinates."""
        (low, high), steps = span, FIRST_STEPS
        while True:
            phi = np.linspace(0.0, math.pi, 2 * steps + 1)
            a = 0.5 * (low + high) - 0.5 * (high - low) * np.cos(phi)
            b = np.sqrt(np.maximum(self._square(z, a), 0.0))
            chord_a, chord_b = a[2::2] - a[:-2:2], b[2::2] - b[:-2:2]
            off = (a[1::2] - a[:-2:2]) * chord_b - (b[1::2] - b[:-2:2]) * chord_a
            length = np.maximum(np.hypot(chord_a, chord_b), np.finfo(float).tiny)
            if np.abs(off / length).max() <= 0.5 * tolerance_mm or steps >= MOST_STEPS:
                break
            steps *= 2
        # An end at which Q vanishes is one corner, an end cut off by a disc is a straight edge.
        lower = np.column_stack([a, -b])
        upper = np.column_stack([a, b])[::-1]
        ring = np.concatenate([lower, upper])
        keep = np.any(ring != np.roll(ring, 1, axis=0), axis=1)
        sine, cosine = self._tilt
        across = np.array([self.turn[2, 0], self.turn[2, 1]]) / sine
        a, b = ring[keep].T
        m, along = z * sine - a * cosine, z * cosine + a * sine
        return np.column_stack([m * across[0] - b * across[1], m * across[1] + b * across[0], along])


_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(GAUSS_POINTS)

CONE = Bar("cone", "upright cone, radius 25 mm, height 50 mm", 25.0, 0.0, 50.0)
CYLINDER = Bar("cylinder", "upright cylinder, radius 25 mm, height 60 mm", 25.0, 25.0, 60.0)

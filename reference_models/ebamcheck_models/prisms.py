"""Upright prisms over outlines with holes, and the same prisms turned to any direction.

A plane cuts a prism in an affine image of its outline: where the plane d . p = h crosses the line of
(x, y), z = (h - d_x x - d_y y) / d_z. The ends of the prism cut the outline to a strip of
u = (d_x x + d_y y) / |d_xy|, and the area of what lies in the strip low <= u <= high is, by Green's
theorem, the integral of clip(u, low, high) dv around the outline.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
import shapely
from numpy.typing import ArrayLike

from ebamcheck.mesh.part import Part, from_arrays
from ebamcheck_models.model import SECTION_TOLERANCE_MM, Floats, Solid, rotation, single
from ebamcheck_models.outlines import (
    COMPLEX_STEP,
    Outline,
    Piece,
    circle,
    rounded_polygon,
)
from ebamcheck_models.sampling import outline_samples
from ebamcheck_models.walls import Face, Wall, WalledModel

SEARCH_CELLS = 64
"""Cells of a piece in which turning points are searched: its curvature keeps its sign in each."""

BISECTIONS = 60
"""Halvings after which a parameter is known to the last bit."""

GAUSS_POINTS = 32

ALONG_AXIS = 1e-12
"""Sine of the angle between direction and axis below which a plane counts as level or as vertical."""

LEAST_STRETCH = 1e-3
"""Steepest plane, as cosine, for which outlines are sampled more finely to make up for stretching."""


@dataclass(frozen=True)
class Prism(WalledModel):
    """An upright prism; see :class:`ebamcheck_models.TurnableModel`."""

    outlines: tuple[Outline, ...] = ()
    height_mm: float = 0.0

    def turned(self, direction: ArrayLike) -> TurnedPrism:
        """Return the solid turned so that `direction` points up."""
        return TurnedPrism(self, rotation(direction))


def prism(name: str, summary: str, outline: Outline, height_mm: float, holes: tuple[Outline, ...] = ()) -> Prism:
    """Upright prism over an outline, with holes from bottom to top."""
    levels = (0.0, height_mm)
    walls = (Wall(outline, levels), *(Wall(hole, levels, hole=True) for hole in holes))
    through = tuple(range(1, len(walls)))
    faces = (Face(0, through, 0.0, up=False), Face(0, through, height_mm, up=True))
    euler_number = 2 - 2 * len(holes)
    return Prism(name, summary, walls, faces, euler_number, outlines=(outline, *holes), height_mm=height_mm)


@dataclass(frozen=True, eq=False)
class TurnedPrism(Solid):
    """A prism after a rotation; see :class:`ebamcheck_models.TurnableModel`."""

    upright: Prism
    turn: Floats

    @property
    def name(self) -> str:
        """Name of the upright prism."""
        return self.upright.name

    @property
    def summary(self) -> str:
        """What it is, and what points up."""
        x, y, z = self.turn[2].tolist()
        return f"{self.upright.summary}; turned so that ({x:.6g}, {y:.6g}, {z:.6g}) points up"

    @property
    def euler_number(self) -> int:
        """Euler number of the upright prism."""
        return self.upright.euler_number

    @property
    def volume(self) -> float:
        """Volume of the upright prism, mm3."""
        return self.upright.volume

    @cached_property
    def bounds(self) -> Floats:
        """Least and greatest corner, (2, 3) mm."""
        found = []
        for x, y, z in self.turn.tolist():
            spread = _spread_along(self.upright.outlines[0], x, y)
            rise = self.upright.height_mm * z
            found.append((spread[0] + min(0.0, rise), spread[1] + max(0.0, rise)))
        return np.array(found).T

    def turned(self, direction: ArrayLike) -> TurnedPrism:
        """Return the solid turned so that `direction`, in its own coordinates, points up."""
        return TurnedPrism(self.upright, rotation(direction) @ self.turn)

    def section(self, z: float, tolerance_mm: float = SECTION_TOLERANCE_MM) -> list[shapely.Polygon]:
        """Solid regions at height `z` (that of z + 0 at a step), rings as dense as the tolerance asks."""
        if self._upright_plane:
            return self._strips(z)
        dx, dy, dz = self.turn[2].tolist()
        sampling_mm = tolerance_mm * max(abs(dz), LEAST_STRETCH)
        rings = [o.points(outline_samples(o, 0.0, sampling_mm), 0.0) for o in self.upright.outlines]
        base = shapely.Polygon(rings[0], rings[1:])
        kept = shapely.intersection(base, self._strip(z, base))

        def placed(points: Floats) -> Floats:
            height = (z - points @ np.array([dx, dy])) / dz
            result: Floats = np.column_stack([points, height]) @ self.turn[:2].T
            return result

        flat = [p for p in shapely.get_parts(kept).tolist() if isinstance(p, shapely.Polygon)]
        return [p for p in (shapely.transform(q, placed) for q in flat) if p.area > 0]

    def area(self, z: float) -> float:
        """Exact area of the section at height `z`, mm2."""
        slope = self._slope
        if self._upright_plane:
            return self.upright.height_mm * sum(high - low for low, high in self._chords(z))
        if slope < ALONG_AXIS:
            return self.upright.area(0.0) if self._level_cut(z) else 0.0
        low, high = self._strip_limits(z)
        total = 0.0
        for n, monotone in enumerate(self._monotone):
            total += (-1.0 if n else 1.0) * sum(run.clipped(low, high) for run in monotone)
        return total / abs(float(self.turn[2, 2]))

    def tessellate(self, tolerance_mm: float) -> Part:
        """Mesh of the upright prism, turned and rounded to 32-bit floats."""
        part = self.upright.tessellate(tolerance_mm)
        return from_arrays(single(part.vertices @ self.turn.T), part.faces.astype(np.int64), self.name)

    @property
    def _slope(self) -> float:
        return math.hypot(*self.turn[2, :2].tolist())

    @property
    def _upright_plane(self) -> bool:
        """Whether level planes hold the prism's axis."""
        return abs(float(self.turn[2, 2])) < ALONG_AXIS

    @property
    def _across(self) -> tuple[float, float]:
        """Unit vector in the prism's base along which level planes descend or rise."""
        slope = self._slope
        return float(self.turn[2, 0]) / slope, float(self.turn[2, 1]) / slope

    @cached_property
    def _monotone(self) -> list[list[_Run]]:
        """Runs of every outline on which u rises or falls throughout."""
        return [_runs(outline, *self._across) for outline in self.upright.outlines]

    def _level_cut(self, z: float) -> bool:
        """Whether a level plane meets the prism when its axis is upright, or upside down."""
        low, high = self.bounds[:, 2]
        return bool(low <= z < high)

    def _strip_limits(self, z: float) -> tuple[float, float]:
        """Range of u in which the plane is between the prism's ends."""
        ends = (z / self._slope, (z - self.upright.height_mm * float(self.turn[2, 2])) / self._slope)
        return min(ends), max(ends)

    def _strip(self, z: float, base: shapely.Polygon) -> shapely.Geometry:
        """Part of the base's plane over which the plane is between the prism's ends."""
        if self._slope < ALONG_AXIS:
            return base if self._level_cut(z) else shapely.Polygon()
        low, high = self._strip_limits(z)
        reach = float(np.abs(np.array(base.bounds)).max()) * 2.0
        low, high = max(low, -reach), min(high, reach)
        if low >= high:
            return shapely.Polygon()
        (a, b), far = self._across, reach
        corners = [(low, -far), (high, -far), (high, far), (low, far)]
        return shapely.Polygon([(u * a - v * b, u * b + v * a) for u, v in corners])

    def _chords(self, z: float) -> list[tuple[float, float]]:
        """Ranges of v in which the line u = z (just above it) runs in the outline."""
        found = [v for monotone in self._monotone for run in monotone for v in run.meets(z / self._slope)]
        found.sort()
        return list(zip(found[::2], found[1::2], strict=True))

    def _strips(self, z: float) -> list[shapely.Polygon]:
        """Rectangles in which a plane that holds the axis cuts the prism."""
        (a, b), u = self._across, z / self._slope
        result = []
        for low, high in self._chords(z):
            ends = [(low, 0.0), (high, 0.0), (high, self.upright.height_mm), (low, self.upright.height_mm)]
            corners = np.array([(u * a - v * b, u * b + v * a, w) for v, w in ends])
            rectangle = shapely.Polygon(corners @ self.turn[:2].T)
            if rectangle.area > 0:
                result.append(rectangle)
        return result


@dataclass(frozen=True)
class _Run:
    """Part of a piece on which u = x a + y b rises or falls throughout; v = y a - x b."""

    piece: Piece
    a: float
    b: float
    start: float
    stop: float

    def uv(self, s: float) -> tuple[float, float]:
        """Coordinates across the strip and along it."""
        x, y = self.piece(np.array(s), _BASE)
        return float(x * self.a + y * self.b), float(y * self.a - x * self.b)

    @cached_property
    def ends(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Coordinates where the run starts and stops."""
        return self.uv(self.start), self.uv(self.stop)

    @cached_property
    def whole(self) -> float:
        """Integral of u dv along the run."""
        return self.integral(self.start, self.stop)

    def at(self, level: float) -> float:
        """Parameter at which u passes a level that lies between its ends."""
        low, high = self.start, self.stop
        rising = self.ends[1][0] >= self.ends[0][0]
        for _ in range(BISECTIONS):
            middle = 0.5 * (low + high)
            if (self.uv(middle)[0] < level) == rising:
                low = middle
            else:
                high = middle
        return 0.5 * (low + high)

    def meets(self, level: float) -> list[float]:
        """v where u passes the level, that of level + 0 at an end."""
        low, high = sorted((self.ends[0][0], self.ends[1][0]))
        return [self.uv(self.at(level))[1]] if low <= level < high else []

    def integral(self, start: float, stop: float) -> float:
        """Integral of u dv between two parameters, by Gauss and Legendre."""
        s = start + 0.5 * (_NODES + 1.0) * (stop - start)
        x, y = self.piece(s + 1j * COMPLEX_STEP, _BASE)
        dv = (y * self.a - x * self.b).imag / COMPLEX_STEP
        u = (x * self.a + y * self.b).real
        return 0.5 * (stop - start) * float(np.dot(_WEIGHTS, u * dv))

    def clipped(self, low: float, high: float) -> float:
        """Integral of clip(u, low, high) dv along the run."""
        (u0, v0), (u1, v1) = self.ends
        least, greatest = min(u0, u1), max(u0, u1)
        if low <= least and greatest <= high:
            return self.whole
        if greatest <= low or high <= least:
            return (low if greatest <= low else high) * (v1 - v0)
        marks = [self.start, *(self.at(k) for k in (low, high) if least < k < greatest), self.stop]
        total = 0.0
        for start, stop in pairwise(sorted(marks)):
            u = self.uv(0.5 * (start + stop))[0]
            if low < u < high:
                total += self.integral(start, stop)
            else:
                total += (low if u <= low else high) * (self.uv(stop)[1] - self.uv(start)[1])
        return total


_BASE = np.zeros(())
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(GAUSS_POINTS)


def _runs(outline: Outline, a: float, b: float) -> list[_Run]:
    """Split an outline where u = x a + y b turns."""
    edges = np.linspace(0.0, 1.0, SEARCH_CELLS + 1)
    result = []
    for piece in outline.pieces:

        def slope(s: Floats, piece: Piece = piece) -> Floats:
            x, y = piece(s + 1j * COMPLEX_STEP, _BASE)
            found: Floats = (x * a + y * b).imag
            return found

        signs = np.sign(slope(edges))
        turns = np.flatnonzero(signs[:-1] * signs[1:] < 0)
        low, high = edges[turns], edges[turns + 1]
        for _ in range(BISECTIONS):
            middle = 0.5 * (low + high)
            before = np.sign(slope(middle)) == signs[turns]
            low, high = np.where(before, middle, low), np.where(before, high, middle)
        marks = [0.0, *(0.5 * (low + high)).tolist(), *edges[1:-1][signs[1:-1] == 0].tolist(), 1.0]
        marks = sorted(set(marks))
        result += [_Run(piece, a, b, s, t) for s, t in pairwise(marks)]
    return result


def _spread_along(outline: Outline, x: float, y: float) -> tuple[float, float]:
    """Least and greatest x * X + y * Y of an outline's points (X, Y)."""
    ends = [u for run in _runs(outline, x, y) for u, _ in run.ends]
    return min(ends), max(ends)


LEG_MM = 12.0
BRACE_X_MM, BRACE_Y_MM = 82.0, 62.0
"""Where the outer side of the brace would meet the insides of the legs."""
BRACE_MM = 0.8


def _bracket() -> Prism:
    along, up = BRACE_X_MM - LEG_MM, BRACE_Y_MM - LEG_MM
    # The inner side of the brace is parallel to the outer one, nearer to the corner by its thickness.
    nearer = 1.0 - BRACE_MM * math.hypot(along, up) / (along * up)
    outside = [
        *((0.0, 0.0, 16.0), (112.0, 0.0, 6.0), (112.0, LEG_MM, 5.0), (BRACE_X_MM, LEG_MM, 6.0)),
        *((LEG_MM, BRACE_Y_MM, 6.0), (LEG_MM, 90.0, 5.0), (0.0, 90.0, 6.0)),
    ]
    inside = [
        (LEG_MM, LEG_MM, 8.0),
        (LEG_MM + nearer * along, LEG_MM, 2.0),
        (LEG_MM, LEG_MM + nearer * up, 2.0),
    ]
    return prism(
        "bracket",
        "angle bracket of 112 x 90 x 30 mm: fillets, two bolt holes, a brace of 0.8 mm between the legs",
        rounded_polygon(outside),
        30.0,
        (rounded_polygon(inside), circle(100.0, 0.5 * LEG_MM, 3.0), circle(0.5 * LEG_MM, 79.0, 3.0)),
    )


BRACKET = _bracket()

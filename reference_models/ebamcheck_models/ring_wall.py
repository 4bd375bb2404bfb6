"""A tall freeform ring wall with rounded lips and closed channels in it, in closed form at every height.

In the level z the wall lies between the curves (polar, about the axis)

    r = middle(angle, z) +- half(angle, z) lip(z)
    middle = R (1 + bulge sin(pi z / H)) + A2 cos 2(angle - twist(z)) + A3 cos 3(angle - twist(z))
    half = W + W2 cos 2(angle - twist(z)),   twist(z) = twist z / H

with lip = 1 but near the ends, where it falls as a quarter of an ellipse to 0. Each channel is an ellipse
about a point of the middle curve, whose half axes shrink in the same way at its two ends. So

    area = 2 pi lip (2 R' W + A2 W2) - sum of pi a b cap^2
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import shapely
from numpy.typing import NDArray

from ebamcheck.mesh.part import Part, from_arrays
from ebamcheck_models.model import (
    SECTION_TOLERANCE_MM,
    Floats,
    Solid,
    capped_tube,
    checked_tolerance,
    grid_faces,
    single,
)
from ebamcheck_models.surface_grid import Bends, Surface, bends, grid_counts

Ints = NDArray[np.int64]

GAUSS_POINTS = 48

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(GAUSS_POINTS)

MOST_RING_POINTS = 1 << 18

Law = Callable[[Floats], tuple[Floats, Floats]]
"""Heights and factors of the widths at parameters 0 .. 1."""


@dataclass(frozen=True)
class Rounding:
    """A height range whose ends are rounded off as quarters of an ellipse."""

    low_mm: float
    high_mm: float
    cap_mm: float  # height of each rounded end

    def factor(self, z: Floats | float) -> Floats:
        """What is left of the widths at height `z`: 1 between the caps, 0 at the ends and beyond."""
        depth = np.minimum(np.asarray(z) - self.low_mm, self.high_mm - np.asarray(z)) / self.cap_mm
        missing = np.clip(1.0 - depth, 0.0, 1.0)
        result: Floats = np.sqrt((1.0 - missing) * (1.0 + missing))
        return result

    def lower(self, t: Floats) -> tuple[Floats, Floats]:
        """Height and factor at 0 .. 1 of the lower cap, even in the angle of the ellipse."""
        angle = 0.5 * np.pi * t
        return self.low_mm + 2.0 * self.cap_mm * np.sin(0.5 * angle) ** 2, np.sin(angle)

    def straight(self, t: Floats) -> tuple[Floats, Floats]:
        """Height and factor at 0 .. 1 between the caps."""
        low, high = self.low_mm + self.cap_mm, self.high_mm - self.cap_mm
        return low + (high - low) * t, np.ones_like(t)

    def upper(self, t: Floats) -> tuple[Floats, Floats]:
        """Height and factor at 0 .. 1 of the upper cap."""
        angle = 0.5 * np.pi * (1.0 - t)
        return self.high_mm - 2.0 * self.cap_mm * np.sin(0.5 * angle) ** 2, np.sin(angle)

    @property
    def steps(self) -> tuple[Law, Law, Law]:
        """The three laws from the lower to the upper end."""
        return self.lower, self.straight, self.upper


@dataclass(frozen=True)
class Channel:
    """A closed channel in the wall: an ellipse about its middle, which follows the twist."""

    angle_deg: float  # of its middle about the axis, at the wall's foot
    along_mm: float  # half axis of the ellipse along the wall
    through_mm: float  # and through it
    ends: Rounding


TURNS_DEG = [90.0, 0.0, 90.0]
"""Turn of the lower rounded end, of what lies between, and of the upper end."""


@dataclass(frozen=True)
class RingWall(Solid):
    """The ring wall; see :class:`ebamcheck_models.Model`."""

    name: str
    summary: str
    height_mm: float
    lip_mm: float
    radius_mm: float
    bulge: float
    oval_mm: float
    lobes_mm: float
    half_mm: float
    half_oval_mm: float
    twist_deg: float
    channels: tuple[Channel, ...]

    @property
    def euler_number(self) -> int:
        """Nothing for the ring, 2 for each closed channel."""
        return 2 * len(self.channels)

    @property
    def shells(self) -> int:
        """The ring's surface and those of the channels."""
        return 1 + len(self.channels)

    @property
    def ends(self) -> Rounding:
        """Height range of the wall with its lips."""
        return Rounding(0.0, self.height_mm, self.lip_mm)

    @cached_property
    def bounds(self) -> Floats:
        """Least and greatest corner, (2, 3) mm, to the last digit that 32-bit floats keep."""
        v = np.linspace(0.0, 1.0, 401)[None, :]
        z, factor = self.ends.straight(v)

        def outermost(axis: int, sign: float) -> Callable[[Floats], Floats]:
            return lambda u: sign * self.wall_point(u, z, factor, 1.0)[axis]

        box = np.zeros((2, 3))
        for row, sign in enumerate((-1.0, 1.0)):
            for axis in (0, 1):
                box[row, axis] = sign * _greatest(outermost(axis, sign))
        box[1, 2] = self.height_mm
        return box

    def section(self, z: float, tolerance_mm: float = SECTION_TOLERANCE_MM) -> list[shapely.Polygon]:
        """Solid region at height `z`, rings as dense as the tolerance asks."""
        if not 0.0 < z < self.height_mm:
            return []
        height, lip = np.array(z), self.ends.factor(z)

        def wall(side: float) -> Callable[[Floats], Floats]:
            return lambda u: self.wall_point(u, height, lip, side)

        def tube(channel: Channel) -> Callable[[Floats], Floats]:
            return lambda u: self.tube_point(channel, u, height, channel.ends.factor(z))

        outer, inner = (_ring(wall(side), tolerance_mm) for side in (1.0, -1.0))
        cut = [c for c in self.channels if c.ends.low_mm < z < c.ends.high_mm]
        holes = [_ring(tube(channel), tolerance_mm) for channel in cut]
        return [shapely.Polygon(outer, [inner, *holes])]

    def area(self, z: float) -> float:
        """Exact area of the section at height `z`, mm2."""
        wall = float(self.ends.factor(z) * self._around(np.array(z)))
        return wall - sum(math.pi * c.along_mm * c.through_mm * float(c.ends.factor(z)) ** 2 for c in self.channels)

    @cached_property
    def volume(self) -> float:
        """Exact volume, mm3; a rounded end of a channel holds two thirds of its prism."""
        t = 0.5 * (_NODES + 1.0)
        total = 0.0
        for law, turn in zip(self.ends.steps, TURNS_DEG, strict=True):
            z, factor = law(t)
            # On a rounded end dz = lip sin(angle) d(angle), and that sine is the factor.
            step = 0.5 * np.pi * self.lip_mm * factor if turn else self.height_mm - 2.0 * self.lip_mm
            total += 0.5 * float(np.dot(_WEIGHTS, self._around(z) * factor * step))
        return total - sum(
            math.pi * c.along_mm * c.through_mm * (c.ends.high_mm - c.ends.low_mm - 2.0 / 3.0 * c.ends.cap_mm)
            for c in self.channels
        )

    def tessellate(self, tolerance_mm: float) -> Part:
        """Grids in level rows: one about the wall, over both lips, and one on each channel."""
        checked_tolerance(tolerance_mm)
        points, faces = self._wall_mesh(tolerance_mm)
        vertices, facets, first = [points], [faces], len(points)
        for channel in self.channels:
            points, faces = self._channel_mesh(channel, tolerance_mm)
            vertices.append(points)
            facets.append(faces + first)
            first += len(points)
        return from_arrays(np.concatenate(vertices), np.concatenate(facets), self.name)

    def _around(self, z: Floats) -> Floats:
        """Area of the ring without lips and channels, mm2."""
        result: Floats = 2.0 * math.pi * (2.0 * self._radius(z) * self.half_mm + self.oval_mm * self.half_oval_mm)
        return result

    def _radius(self, z: Floats) -> Floats:
        result: Floats = self.radius_mm * (1.0 + self.bulge * np.sin(np.pi * z / self.height_mm))
        return result

    def _twist(self, z: Floats) -> Floats:
        result: Floats = math.radians(self.twist_deg) * z / self.height_mm
        return result

    def _middle(self, angle: Floats, z: Floats) -> Floats:
        """Polar radius of the wall's middle."""
        turned = angle - self._twist(z)
        return self._radius(z) + self.oval_mm * np.cos(2.0 * turned) + self.lobes_mm * np.cos(3.0 * turned)

    def wall_point(self, u: Floats, z: Floats, lip: Floats, side: float) -> Floats:
        """Points (3, ...) of the outer (side 1) or inner (side -1) surface; `u` runs once about the axis, 0 .. 1."""
        angle = 2.0 * np.pi * u
        half = self.half_mm + self.half_oval_mm * np.cos(2.0 * (angle - self._twist(z)))
        radius = self._middle(angle, z) + side * half * lip
        return np.stack(np.broadcast_arrays(radius * np.cos(angle), radius * np.sin(angle), z))

    def tube_point(self, channel: Channel, u: Floats, z: Floats, cap: Floats) -> Floats:
        """Points (3, ...) of a channel's surface; `u` runs once about the channel, 0 .. 1."""
        place = math.radians(channel.angle_deg) + self._twist(z)
        out = self._middle(place, z) + channel.through_mm * cap * np.cos(2.0 * np.pi * u)
        along = channel.along_mm * cap * np.sin(2.0 * np.pi * u)
        x = out * np.cos(place) - along * np.sin(place)
        y = out * np.sin(place) + along * np.cos(place)
        return np.stack(np.broadcast_arrays(x, y, z))

    def _wall_mesh(self, tolerance_mm: float) -> tuple[Floats, Ints]:
        """Vertices and facets of a torus of level rows: up outside, over the lip, down inside."""
        bent = self._wall_bends
        columns, rows = grid_counts(bent, TURNS_DEG * 2, tolerance_mm)
        # Both sides have the same heights, so that the lips have rows in common.
        counts = [max(pair) for pair in zip(rows[:3], rows[3:], strict=True)]
        z, lip = levels(self.ends, counts)
        u = (np.arange(columns) / columns)[None, :]
        outside = self.wall_point(u, z[:, None], lip[:, None], 1.0)
        inside = self.wall_point(u, z[-2:0:-1, None], lip[-2:0:-1, None], -1.0)
        points = single(np.concatenate([outside, inside], axis=1).reshape(3, -1).T)
        faces = grid_faces(0, len(points) // columns + 1, columns) % len(points)
        return points, faces

    def _channel_mesh(self, channel: Channel, tolerance_mm: float) -> tuple[Floats, Ints]:
        """Vertices and facets of a closed tube between two poles, looking into it."""
        columns, rows = grid_counts(self._channel_bends[channel], TURNS_DEG, tolerance_mm)
        z, cap = levels(channel.ends, rows)
        u = (np.arange(columns) / columns)[None, :]
        rings = self.tube_point(channel, u, z[1:-1, None], cap[1:-1, None]).reshape(3, -1).T
        poles = self.tube_point(channel, np.zeros(2), z[[0, -1]], np.zeros(2)).T
        points, faces = capped_tube(poles, rings, columns)
        return points, faces[:, ::-1]

    @cached_property
    def _wall_bends(self) -> list[Bends]:
        def patch(law: Law, side: float) -> Surface:
            return lambda u, v: self.wall_point(u, *law(v), side)

        return [bends(patch(law, side)) for side in (1.0, -1.0) for law in self.ends.steps]

    @cached_property
    def _channel_bends(self) -> dict[Channel, list[Bends]]:
        def patch(channel: Channel, law: Law) -> Surface:
            return lambda u, v: self.tube_point(channel, u, *law(v))

        return {c: [bends(patch(c, law)) for law in c.ends.steps] for c in self.channels}


def levels(ends: Rounding, counts: list[int]) -> tuple[Floats, Floats]:
    """Heights and factors of the rows, both ends included; `counts` are the steps of each of the three laws."""
    found = [law(np.arange(count) / count) for law, count in zip(ends.steps, counts, strict=True)]
    z = np.concatenate([*(z for z, _ in found), [ends.high_mm]])
    factor = np.concatenate([*(f for _, f in found), [0.0]])
    return z, factor


def _ring(curve: Callable[[Floats], Floats], tolerance_mm: float) -> Floats:
    """Points (n, 2) of a closed curve with chords within the tolerance."""
    count = 64
    while True:
        x, y, _ = curve(np.arange(2 * count) / (2.0 * count))
        start, middle = np.stack([x[::2], y[::2]]), np.stack([x[1::2], y[1::2]])
        off = middle - 0.5 * (start + np.roll(start, -1, axis=1))
        if np.hypot(*off).max() <= tolerance_mm or count >= MOST_RING_POINTS:
            return start.T
        count *= 2


def _greatest(value: Callable[[Floats], Floats]) -> float:
    """Greatest value about the ring and over the rows, refined about the best sample."""
    u, step = np.arange(720) / 720.0, 1.0 / 720.0
    best = float("-inf")
    for _ in range(6):
        found = value(u[:, None]).max(axis=1)
        best = max(best, float(found.max()))
        centre = u[int(found.argmax())]
        u, step = centre + np.linspace(-step, step, 41), step / 20.0
    return best


LADDER_TOLERANCES_MM = (1.0, 0.8, 0.4, 0.08, 0.06, 0.04, 0.01, 0.006, 0.004, 0.002, 0.001)
"""The paper's tolerances; its list has 0.4 and 0.8 swapped, as its file sizes show."""

LAYER_MM = 0.2
LAYERS = 4488

LADDER = RingWall(
    name="ladder",
    summary="twisted ring wall with rounded lips and three closed channels, 245 x 207 x 897.6 mm",
    height_mm=LAYERS * LAYER_MM,
    lip_mm=3.4,
    radius_mm=105.2,
    bulge=0.02,
    oval_mm=10.05,
    lobes_mm=0.6,
    half_mm=5.1,
    half_oval_mm=0.4,
    twist_deg=20.0,
    channels=(
        Channel(0.0, 6.0, 2.4, Rounding(40.0, 860.0, 4.0)),
        Channel(115.0, 5.0, 2.4, Rounding(70.0, 700.0, 4.0)),
        Channel(240.0, 4.5, 2.2, Rounding(200.0, 850.0, 4.0)),
    ),
)
"""One freeform part at eleven tolerances, from 4400 to 1.48 million facets.

It stands in for the part of the paper that this project follows (section 5.1, figure 9), of which only the tolerances and
file sizes are published: 0.23 .. 70.73 MB of binary STL for 1 .. 0.001 mm. Like it, it has 4488 layers of 0.2 mm. Its shape is
chosen so that the tolerance alone, kept as every model keeps it, gives meshes of those sizes: the wall is curved in both
directions, which makes facets grow as one over the tolerance, and coarse meshes are held up by the greatest turn of a step.
"""

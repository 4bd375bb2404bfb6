"""Closed outlines that change with height: pieces of smooth curves, joined at corners."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ebamcheck_models.model import Floats

Array = NDArray[Any]
Piece = Callable[[Array, Array], tuple[Array, Array]]
"""x, y in mm of a smooth piece at parameters s in 0 .. 1 and heights z (broadcast against each other).

It must be analytic in s and take complex s: lengths and areas come from complex-step derivatives.
"""

COMPLEX_STEP = 1e-30
"""Step of the complex-step derivative; it has no cancellation, so it can be this small."""

GAUSS_POINTS = 64
"""Nodes of the quadrature on each piece: enough for full precision on pieces as smooth as ours."""

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(GAUSS_POINTS)


@dataclass(frozen=True)
class Outline:
    """A closed curve, counter-clockwise seen from above, whose shape depends on height."""

    pieces: tuple[Piece, ...]  # each ends where the next one starts
    least: int = 1  # chords into which each piece is split at least

    def points(self, samples: tuple[Floats, ...], z: float) -> Floats:
        """Points (n, 2) at the given parameters of each piece, without each piece's end."""
        height = np.array(z)
        found = [np.stack(p(s[:-1], height), axis=-1) for p, s in zip(self.pieces, samples, strict=True)]
        return np.concatenate(found)

    def area(self, z: float) -> float:
        """Exact area inside, mm2: half of the integral of x dy - y dx, by Gauss and Legendre."""
        s, height = 0.5 * (_NODES + 1.0), np.array(z)
        total = 0.0
        for piece in self.pieces:
            x, y = piece(s + 1j * COMPLEX_STEP, height)
            dx, dy = x.imag / COMPLEX_STEP, y.imag / COMPLEX_STEP
            total += float(np.dot(0.5 * _WEIGHTS, 0.5 * (x.real * dy - y.real * dx)))
        return total


def line(start: Piece, end: Piece) -> Piece:
    """Straight piece between two points that move with height (each a piece of which s = 0 is taken)."""

    def piece(s: Array, z: Array) -> tuple[Array, Array]:
        zero = np.zeros(())
        (x0, y0), (x1, y1) = start(zero, z), end(zero, z)
        return x0 + s * (x1 - x0), y0 + s * (y1 - y0)

    return piece


def fixed(x: float, y: float) -> Piece:
    """A point that does not move."""

    def piece(s: Array, z: Array) -> tuple[Array, Array]:
        nothing = 0.0 * (s + z)
        return x + nothing, y + nothing

    return piece


def arc(x: float, y: float, radius_x: float, radius_y: float, start_deg: float, end_deg: float) -> Piece:
    """Arc of an axis-parallel ellipse, counter-clockwise from one angle to another."""
    start, turn = np.deg2rad(start_deg), np.deg2rad(end_deg - start_deg)

    def piece(s: Array, z: Array) -> tuple[Array, Array]:
        angle = start + turn * s + 0.0 * z
        return x + radius_x * np.cos(angle), y + radius_y * np.sin(angle)

    return piece


def closed(curve: Piece, pieces: int, least: int) -> Outline:
    """Outline of a closed curve without corners over parameters 0 .. 1, as equal pieces."""

    def of(number: int) -> Piece:
        return lambda s, z: curve((number + s) / pieces, z)

    return Outline(tuple(of(number) for number in range(pieces)), least)


def circle(x: float, y: float, radius: float) -> Outline:
    """Circle as four quarters, so that its extreme points are vertices of every mesh."""
    quarters = tuple(arc(x, y, radius, radius, a, a + 90.0) for a in (0.0, 90.0, 180.0, 270.0))
    return Outline(quarters, least=2)


def polygon(corners: list[tuple[float, float]]) -> Outline:
    """Polygon with straight sides, corners counter-clockwise."""
    points = [fixed(x, y) for x, y in corners]
    return Outline(tuple(line(a, b) for a, b in zip(points, points[1:] + points[:1], strict=True)))


def rounded_polygon(corners: list[tuple[float, float, float]]) -> Outline:
    """Polygon whose corners (x, y, radius; counter-clockwise) are rounded off, or filleted where they turn in."""
    points = np.array([corner[:2] for corner in corners])
    pieces: list[Piece] = []
    ends: list[tuple[Piece, Piece]] = []
    arcs: list[Piece | None] = []
    for n, (x, y, radius) in enumerate(corners):
        before = points[n] - points[n - 1]
        after = points[(n + 1) % len(points)] - points[n]
        before, after = before / np.hypot(*before), after / np.hypot(*after)
        turn = math.atan2(before[0] * after[1] - before[1] * after[0], float(before @ after))
        reach = radius * math.tan(0.5 * abs(turn))
        start, stop = (x, y) - reach * before, (x, y) + reach * after
        ends.append((fixed(float(start[0]), float(start[1])), fixed(float(stop[0]), float(stop[1]))))
        inward = math.copysign(radius, turn) * np.array([-before[1], before[0]])
        angle = math.degrees(math.atan2(-inward[1], -inward[0]))
        at_x, at_y = (start + inward).tolist()
        rounded = arc(at_x, at_y, radius, radius, angle, angle + math.degrees(turn)) if radius > 0 else None
        arcs.append(rounded)
    for n, rounded in enumerate(arcs):
        if rounded is not None:
            pieces.append(rounded)
        pieces.append(line(ends[n][1], ends[(n + 1) % len(ends)][0]))
    return Outline(tuple(pieces))


def rounded_rectangle(half_x: float, half_y: float, radius: float) -> Outline:
    """Rectangle about the origin with rounded corners."""
    a, b = half_x - radius, half_y - radius
    sides = (
        *((half_x, -b, half_x, b), (a, half_y, -a, half_y)),
        *((-half_x, b, -half_x, -b), (-a, -half_y, a, -half_y)),
    )
    pieces: list[Piece] = []
    for k, (x0, y0, x1, y1) in enumerate(sides):
        x, y = ((a, b), (-a, b), (-a, -b), (a, -b))[k]
        pieces += [line(fixed(x0, y0), fixed(x1, y1)), arc(x, y, radius, radius, k * 90.0, k * 90.0 + 90.0)]
    return Outline(tuple(pieces))


def loft(low: Outline, high: Outline, from_mm: float, to_mm: float) -> Outline:
    """Ruled surface from one outline to another of as many pieces; below and above it they stay as they are."""

    def between(first: Piece, last: Piece) -> Piece:
        def piece(s: Array, z: Array) -> tuple[Array, Array]:
            rise = np.clip((z - from_mm) / (to_mm - from_mm), 0.0, 1.0)
            (x0, y0), (x1, y1) = first(s, z), last(s, z)
            return x0 + rise * (x1 - x0), y0 + rise * (y1 - y0)

        return piece

    pieces = tuple(between(a, b) for a, b in zip(low.pieces, high.pieces, strict=True))
    return Outline(pieces, max(low.least, high.least))

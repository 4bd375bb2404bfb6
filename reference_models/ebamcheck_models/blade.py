"""The demo part: a hollow compressor blade of 320 mm with a dovetail root and a platform.

From below: a dovetail root with sharp edges; a shank that spreads by 30 degrees (33 at its corners) into a platform with
rounded corners, so that no layer reaches out farther than it can be built without support; and an
airfoil that flares into the platform, tapers, twists and leans as it rises. Three channels run from
the root's bottom to the tip. The airfoil's section, in coordinates (u along the chord, y across), is

    u = c^2,   y = 4 m (u (1 - u) - 0.2) + k(c),   k(c) = c ((1 - c^2)(a0 + a1 c^2) + e),   -1 <= c <= 1

(a class-shape curve after Kulfan, J. Aircraft 45(1) 2008, round at the leading edge), closed by the
straight trailing edge of thickness 2 e. It is analytic in c, so areas come out to rounding.
"""

from __future__ import annotations

import numpy as np

from ebamcheck_models.outlines import Array, Outline, Piece, closed, line, loft, rounded_rectangle
from ebamcheck_models.walls import Face, Wall, WalledModel

ROOT_FOOT_MM, ROOT_TOP_MM = 14.0, 30.0
"""Heights at which the dovetail's foot ends and its flank does."""
SHANK_TOP_MM, PLATFORM_TOP_MM, FLARE_TOP_MM, TIP_MM = 54.0, 62.0, 80.0, 320.0

ROOT_HALF_LENGTH_MM = 114.0
FOOT_HALF_WIDTH_MM, NECK_HALF_WIDTH_MM = 38.0, 28.0

PLATFORM_HALF_LENGTH_MM, PLATFORM_HALF_WIDTH_MM, PLATFORM_CORNER_MM = 126.0, 40.0, 14.0
SHANK_HALF_WIDTH_MM, SHANK_CORNER_MM = 26.0, 4.0
"""Of the shank where it begins."""

CHORD_MM, CAMBER_MM = 206.0, 15.0
MEAN_CAMBER = 0.2
"""Taken off u (1 - u), so that the channels lie about the middle of the root."""
CHORD_AT_TIP, THICKNESS_AT_TIP = 0.78, 0.82
"""What is left of chord and thickness at the tip."""
A0_MM, A1_MM, TRAILING_EDGE_HALF_MM = 55.0, -9.0, 4.0
TWIST_DEG = 34.0
LEAN_MM = 26.0
SWEEP_MM = 18.0
FLARE_MM = 4.0
"""What the airfoil gains on every side where it meets the platform."""

CHANNEL_STATIONS = (0.17, 0.40, 0.62)
"""Places of the channels along the chord; each is an ellipse of these half axes at the platform."""
CHANNEL_HALF_LENGTHS_MM = (10.8, 13.5, 14.0)
CHANNEL_HALF_WIDTHS_MM = (10.8, 12.8, 9.8)


def _rise(z: Array) -> Array:
    """0 up to the platform, 1 at the tip."""
    return np.maximum(0.0, (z - PLATFORM_TOP_MM) / (TIP_MM - PLATFORM_TOP_MM))


def _placed(along: Array, across: Array, z: Array) -> tuple[Array, Array]:
    """Turn a section by its twist and move it by lean and sweep; along and across in mm."""
    rise = _rise(z)
    # Squares of the rise: below the platform nothing turns, and there is no kink at it.
    angle = np.deg2rad(TWIST_DEG) * rise**2 * (1.5 - 0.5 * rise)
    cos, sin = np.cos(angle), np.sin(angle)
    x = cos * along - sin * across + SWEEP_MM * rise**2
    y = sin * along + cos * across - LEAN_MM * rise**2
    return x, y


def _camber(u: Array) -> Array:
    """Height of the camber line over the chord, mm, before tapering."""
    return 4.0 * CAMBER_MM * (u * (1.0 - u) - MEAN_CAMBER)


def _chord(z: Array) -> Array:
    return CHORD_MM * (1.0 - (1.0 - CHORD_AT_TIP) * _rise(z))


def _thickness(z: Array) -> Array:
    return 1.0 - (1.0 - THICKNESS_AT_TIP) * _rise(z)


def _airfoil_point(c: Array, z: Array) -> tuple[Array, Array]:
    """Point of the airfoil at c from 1 (upper trailing edge) by 0 (leading edge) to -1 (lower)."""
    u = c * c
    half = c * ((1.0 - u) * (A0_MM + A1_MM * u) + TRAILING_EDGE_HALF_MM)
    flare = np.maximum(0.0, (FLARE_TOP_MM - z) / (FLARE_TOP_MM - PLATFORM_TOP_MM)) ** 2
    along = _chord(z) * (u - 0.5) + FLARE_MM * flare * (2.0 * u - 1.0)
    across = _thickness(z) * (_camber(u) + half) + FLARE_MM * flare * c * (2.0 - u)
    return _placed(along, across, z)


def _airfoil() -> Outline:
    def surface(s: Array, z: Array) -> tuple[Array, Array]:
        return _airfoil_point(1.0 - 2.0 * s, z)

    def corner(c: float) -> Piece:
        return lambda s, z: _airfoil_point(c + 0.0 * s, z)

    return Outline((surface, line(corner(-1.0), corner(1.0))), least=2)


def _channel(station: float, half_length_mm: float, half_width_mm: float) -> Outline:
    """Ellipse on the camber line, as four quarters."""

    def ellipse(s: Array, z: Array) -> tuple[Array, Array]:
        angle, taper = 2.0 * np.pi * s, _chord(z) / CHORD_MM
        along = _chord(z) * (station - 0.5) + taper * half_length_mm * np.cos(angle)
        across = _thickness(z) * (_camber(np.array(station)) + half_width_mm * np.sin(angle))
        return _placed(along, across, z)

    return closed(ellipse, 4, 2)


def _root() -> Outline:
    """Rectangle whose half width follows the dovetail."""

    def corner(x: float, y: float) -> Piece:
        def piece(s: Array, z: Array) -> tuple[Array, Array]:
            flank = np.clip((z - ROOT_FOOT_MM) / (ROOT_TOP_MM - ROOT_FOOT_MM), 0.0, 1.0)
            half = FOOT_HALF_WIDTH_MM + (NECK_HALF_WIDTH_MM - FOOT_HALF_WIDTH_MM) * flank
            return x * ROOT_HALF_LENGTH_MM + 0.0 * (s + z), y * half + 0.0 * s

        return piece

    corners = [corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0), corner(-1.0, -1.0)]
    return Outline(tuple(line(a, b) for a, b in zip(corners, corners[1:] + corners[:1], strict=True)))


def _shank() -> Outline:
    """Rounded rectangle that spreads from within the root's top to the platform, and stays there."""
    reach = PLATFORM_HALF_WIDTH_MM - SHANK_HALF_WIDTH_MM
    low = rounded_rectangle(PLATFORM_HALF_LENGTH_MM - reach, SHANK_HALF_WIDTH_MM, SHANK_CORNER_MM)
    high = rounded_rectangle(PLATFORM_HALF_LENGTH_MM, PLATFORM_HALF_WIDTH_MM, PLATFORM_CORNER_MM)
    return loft(low, high, ROOT_TOP_MM, SHANK_TOP_MM)


_CHANNELS = tuple(
    Wall(_channel(*channel), (0.0, PLATFORM_TOP_MM, TIP_MM), hole=True)
    for channel in zip(CHANNEL_STATIONS, CHANNEL_HALF_LENGTHS_MM, CHANNEL_HALF_WIDTHS_MM, strict=True)
)

BLADE = WalledModel(
    name="blade",
    summary="hollow compressor blade of 320 mm: dovetail root, platform, twisted airfoil, three channels",
    walls=(
        Wall(_root(), (0.0, ROOT_FOOT_MM, ROOT_TOP_MM)),
        Wall(_shank(), (ROOT_TOP_MM, SHANK_TOP_MM, PLATFORM_TOP_MM)),
        Wall(_airfoil(), (PLATFORM_TOP_MM, FLARE_TOP_MM, TIP_MM)),
        *_CHANNELS,
    ),
    faces=(
        Face(0, (3, 4, 5), 0.0, up=False),
        Face(0, (1,), ROOT_TOP_MM, up=True),
        Face(1, (2,), PLATFORM_TOP_MM, up=True),
        Face(2, (3, 4, 5), TIP_MM, up=True),
    ),
    euler_number=2 - 2 * len(_CHANNELS),
)

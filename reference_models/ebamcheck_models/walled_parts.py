"""Large parts of walls: an impeller, a block with a helical channel, a bulkhead with pockets, and a nozzle with a flange.

At height z the boundary of the impeller is one closed curve. With t from 0 to 2 pi, radius and angle are

    r = hub(z) + blade(z) exp(k (cos(7 t) - 1)),   angle = t + twist(z) - sweep (r - hub(z))

The sweep shears each circle along itself, which changes no area, so that with Bessel functions I0
area = pi (hub^2 + 2 hub blade e^-k I0(k) + blade^2 e^-2k I0(2k)), less the bore.
"""

from __future__ import annotations

import numpy as np

from ebamcheck_models.outlines import (
    Array,
    Outline,
    Piece,
    circle,
    closed,
    rounded_polygon,
    rounded_rectangle,
)
from ebamcheck_models.walls import Face, Wall, WalledModel

QUARTERS = 4
"""Smooth pieces of a closed curve without corners."""

BLADES = 7
SHARPNESS = 6.0
"""The k above: blades are narrower the greater it is."""

PLATE_TOP_MM, TOP_MM = 8.0, 78.0
PLATE_RADIUS_MM, BORE_RADIUS_MM = 88.0, 9.0
HUB_TOP_MM, HUB_FLARE_MM = 19.0, 31.0
BLADE_TOP_MM, BLADE_FLARE_MM = 24.0, 10.0
TWIST_DEG = 48.0
SWEEP_RAD_MM = 0.016


def fall(z: Array) -> Array:
    """1 on the plate, 0 at the top."""
    return (TOP_MM - z) / (TOP_MM - PLATE_TOP_MM)


def hub_mm(z: Array) -> Array:
    """Radius of the hub between blades."""
    return HUB_TOP_MM + HUB_FLARE_MM * fall(z) ** 2


def blade_mm(z: Array) -> Array:
    """Height of the blades over the hub, mm."""
    return BLADE_TOP_MM + BLADE_FLARE_MM * fall(z)


def _outline() -> Outline:
    """Outline with one piece per blade, from gap to gap."""

    def of(blade: int) -> Piece:
        def piece(s: Array, z: Array) -> tuple[Array, Array]:
            turn = 2.0 * np.pi * (blade + s - 0.5)
            out = blade_mm(z) * np.exp(SHARPNESS * (np.cos(turn) - 1.0))
            radius = hub_mm(z) + out
            angle = turn / BLADES - np.deg2rad(TWIST_DEG) * fall(z) - SWEEP_RAD_MM * out
            return radius * np.cos(angle), radius * np.sin(angle)

        return piece

    return Outline(tuple(of(blade) for blade in range(BLADES)), least=12)


IMPELLER = WalledModel(
    name="impeller",
    summary="impeller of 176 mm: plate, hub, bore, and seven blades that twist and sweep back",
    walls=(
        Wall(circle(0.0, 0.0, PLATE_RADIUS_MM), (0.0, PLATE_TOP_MM)),
        Wall(_outline(), (PLATE_TOP_MM, TOP_MM)),
        Wall(circle(0.0, 0.0, BORE_RADIUS_MM), (0.0, TOP_MM), hole=True),
    ),
    faces=(
        Face(0, (2,), 0.0, up=False),
        Face(0, (1,), PLATE_TOP_MM, up=True),
        Face(1, (2,), TOP_MM, up=True),
    ),
    euler_number=0,
)


HALF_SIDE_MM, CORNER_MM = 40.0, 10.0
HEIGHT_MM = 120.0
HELIX_MM, PITCH_MM, CHANNEL_MM = 22.0, 60.0, 8.0
"""Radius and pitch of the helix of the channel's centre, and radius of the channel's circle, mm."""


def _channel(s: Array, z: Array) -> tuple[Array, Array]:
    """Circle about a point of the helix."""
    turn, angle = 2.0 * np.pi * z / PITCH_MM, 2.0 * np.pi * s
    return HELIX_MM * np.cos(turn) + CHANNEL_MM * np.cos(angle), HELIX_MM * np.sin(turn) + CHANNEL_MM * np.sin(angle)


HELICAL_CHANNEL = WalledModel(
    name="helical-channel",
    summary="block of 80 x 80 x 120 mm with a helical channel of two turns, a circle of 16 mm in every layer",
    walls=(
        Wall(rounded_rectangle(HALF_SIDE_MM, HALF_SIDE_MM, CORNER_MM), (0.0, HEIGHT_MM)),
        Wall(closed(_channel, QUARTERS, 3), (0.0, HEIGHT_MM), hole=True),
    ),
    faces=(Face(0, (1,), 0.0, up=False), Face(0, (1,), HEIGHT_MM, up=True)),
    euler_number=0,
)


BULKHEAD_HALF_X_MM, BULKHEAD_HALF_Y_MM = 210.0, 125.0
FLOOR_MM, BULKHEAD_MM = 24.0, 70.0
"""Thickness of the bulkhead under its pockets, and its total thickness, mm."""

FLANGE_MM, NOZZLE_MM = 24.0, 260.0
FLANGE_RADIUS_MM, EXIT_RADIUS_MM, THROAT_RADIUS_MM = 190.0, 130.0, 62.0
THICK_MM, THIN_MM = 34.0, 22.0
"""Radial width of the nozzle's wall at its exit and at its throat."""


def _rim(s: Array, z: Array) -> tuple[Array, Array]:
    """The bulkhead's freeform outline: an ellipse with waves of three and of five."""
    angle = 2.0 * np.pi * s + 0.0 * z
    reach = 1.0 + 0.09 * np.cos(3.0 * angle + 0.4) + 0.05 * np.sin(5.0 * angle)
    return BULKHEAD_HALF_X_MM * reach * np.cos(angle), BULKHEAD_HALF_Y_MM * reach * np.sin(angle)


def bore_mm(z: Array) -> Array:
    """Inner radius of the nozzle: a bell that narrows to the throat."""
    return THROAT_RADIUS_MM + (EXIT_RADIUS_MM - THROAT_RADIUS_MM) * (1.0 - z / NOZZLE_MM) ** 2


def wall_mm(z: Array) -> Array:
    """Radial width of the nozzle's wall over the flange."""
    return THICK_MM + (THIN_MM - THICK_MM) * z / NOZZLE_MM


def _bore(s: Array, z: Array) -> tuple[Array, Array]:
    radius = bore_mm(z)
    return radius * np.cos(2.0 * np.pi * s), radius * np.sin(2.0 * np.pi * s)


def _skin(s: Array, z: Array) -> tuple[Array, Array]:
    radius = bore_mm(z) + wall_mm(z)
    return radius * np.cos(2.0 * np.pi * s), radius * np.sin(2.0 * np.pi * s)


_POCKETS = (
    rounded_polygon([(-150.0, -35.0, 14.0), (-95.0, -62.0, 14.0), (-62.0, 48.0, 14.0), (-128.0, 52.0, 14.0)]),
    rounded_polygon([(62.0, -62.0, 14.0), (140.0, -30.0, 14.0), (150.0, 40.0, 14.0), (62.0, 40.0, 14.0)]),
)

BULKHEAD = WalledModel(
    name="bulkhead",
    summary="freeform bulkhead of 450 x 250 x 70 mm with a bore and two pockets over a floor of 24 mm",
    walls=(
        Wall(closed(_rim, QUARTERS, 8), (0.0, BULKHEAD_MM)),
        Wall(circle(0.0, -8.0, 32.0), (0.0, BULKHEAD_MM), hole=True),
        *(Wall(pocket, (FLOOR_MM, BULKHEAD_MM), hole=True) for pocket in _POCKETS),
    ),
    faces=(
        Face(0, (1,), 0.0, up=False),
        Face(2, (), FLOOR_MM, up=True),
        Face(3, (), FLOOR_MM, up=True),
        Face(0, (1, 2, 3), BULKHEAD_MM, up=True),
    ),
    euler_number=0,
)

NOZZLE = WalledModel(
    name="nozzle",
    summary="bell nozzle of 380 mm and 260 mm height: a flange, and a wall of 34 to 22 mm that narrows to the throat",
    walls=(
        Wall(circle(0.0, 0.0, FLANGE_RADIUS_MM), (0.0, FLANGE_MM)),
        Wall(closed(_skin, QUARTERS, 8), (FLANGE_MM, NOZZLE_MM)),
        Wall(closed(_bore, QUARTERS, 8), (0.0, NOZZLE_MM), hole=True),
    ),
    faces=(
        Face(0, (2,), 0.0, up=False),
        Face(0, (1,), FLANGE_MM, up=True),
        Face(1, (2,), NOZZLE_MM, up=True),
    ),
    euler_number=0,
)

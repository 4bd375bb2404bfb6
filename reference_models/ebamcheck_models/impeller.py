"""An impeller: a plate, a tapering hub, and seven twisted, backswept blades.

At height z the boundary is one closed curve. With t from 0 to 2 pi, radius and angle are

    r = hub(z) + blade(z) exp(k (cos(7 t) - 1)),   angle = t + twist(z) - sweep (r - hub(z))

The sweep shears each circle along itself, which changes no area, so that with Bessel functions I0
area = pi (hub^2 + 2 hub blade e^-k I0(k) + blade^2 e^-2k I0(2k)), less the bore.
"""

from __future__ import annotations

import numpy as np

from ebamcheck_models.outlines import Array, Outline, Piece, circle
from ebamcheck_models.walls import Face, Wall, WalledModel

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

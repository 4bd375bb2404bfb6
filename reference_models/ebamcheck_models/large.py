"""Parts of the size that wire-fed electron-beam machines build: a bulkhead with pockets, and a nozzle with a flange."""

from __future__ import annotations

import numpy as np

from ebamcheck_models.outlines import Array, Outline, Piece, circle, rounded_polygon
from ebamcheck_models.walls import Face, Wall, WalledModel

QUARTERS = 4
"""Smooth pieces of a closed curve without corners."""

BULKHEAD_HALF_X_MM, BULKHEAD_HALF_Y_MM = 210.0, 125.0
FLOOR_MM, BULKHEAD_MM = 24.0, 70.0
"""Thickness of the bulkhead under its pockets, and its total thickness, mm."""

FLANGE_MM, NOZZLE_MM = 24.0, 260.0
FLANGE_RADIUS_MM, EXIT_RADIUS_MM, THROAT_RADIUS_MM = 190.0, 130.0, 62.0
THICK_MM, THIN_MM = 34.0, 22.0
"""Radial width of the nozzle's wall at its exit and at its throat."""


def _closed(curve: Piece) -> Outline:
    """Outline of a smooth closed curve over parameters 0 .. 1."""

    def of(quarter: int) -> Piece:
        return lambda s, z: curve((quarter + s) / QUARTERS, z)

    return Outline(tuple(of(quarter) for quarter in range(QUARTERS)), least=8)


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
    angle, radius = 2.0 * np.pi * s, bore_mm(z)
    return radius * np.cos(angle), radius * np.sin(angle)


def _skin(s: Array, z: Array) -> tuple[Array, Array]:
    angle, radius = 2.0 * np.pi * s, bore_mm(z) + wall_mm(z)
    return radius * np.cos(angle), radius * np.sin(angle)


_POCKETS = (
    rounded_polygon([(-150.0, -35.0, 14.0), (-95.0, -62.0, 14.0), (-62.0, 48.0, 14.0), (-128.0, 52.0, 14.0)]),
    rounded_polygon([(62.0, -62.0, 14.0), (140.0, -30.0, 14.0), (150.0, 40.0, 14.0), (62.0, 40.0, 14.0)]),
)

BULKHEAD = WalledModel(
    name="bulkhead",
    summary="freeform bulkhead of 450 x 250 x 70 mm with a bore and two pockets over a floor of 24 mm",
    walls=(
        Wall(_closed(_rim), (0.0, BULKHEAD_MM)),
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
        Wall(_closed(_skin), (FLANGE_MM, NOZZLE_MM)),
        Wall(_closed(_bore), (0.0, NOZZLE_MM), hole=True),
    ),
    faces=(
        Face(0, (2,), 0.0, up=False),
        Face(0, (1,), FLANGE_MM, up=True),
        Face(1, (2,), NOZZLE_MM, up=True),
    ),
    euler_number=0,
)

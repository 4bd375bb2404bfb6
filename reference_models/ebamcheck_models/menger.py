"""Menger sponges of side 27 mm, of levels one to three."""

from __future__ import annotations

import numpy as np

from ebamcheck_models.polyhedra import Polyhedron, cells

SIDE_MM = 27.0

EULER_NUMBERS = (-8, -160, -2816)
"""2 - 2 g with g = 5, 81, 1409 for levels 1, 2, 3."""


def menger(level: int) -> Polyhedron:
    """Sponge of a level: a cell is solid if, in no place of their base-3 digits, two coordinates have a 1."""
    side = 3**level
    digits = np.arange(side)[:, None] // 3 ** np.arange(level) % 3 == 1
    ones = digits[:, None, None].astype(np.int64) + digits[None, :, None] + digits[None, None, :]
    planes = np.arange(side + 1) * (SIDE_MM / side)
    return cells(
        f"menger-{level}",
        f"Menger sponge of level {level}, side 27 mm: {20**level} cubes of {27 // side} mm",
        (planes, planes, planes),
        (ones < 2).all(axis=-1),
        EULER_NUMBERS[level - 1],
    )


MENGER_1, MENGER_2, MENGER_3 = (menger(level) for level in (1, 2, 3))

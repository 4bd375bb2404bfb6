"""A block with a helical channel whose horizontal section is a circle at every height."""

from __future__ import annotations

import numpy as np

from ebamcheck_models.outlines import Array, Outline, Piece, rounded_rectangle
from ebamcheck_models.walls import Face, Wall, WalledModel

HALF_SIDE_MM, CORNER_MM = 40.0, 10.0
HEIGHT_MM = 120.0
HELIX_MM, PITCH_MM, CHANNEL_MM = 22.0, 60.0, 8.0
"""Radius and pitch of the helix of the channel's centre, and radius of the channel's circle, mm."""


def _channel() -> Outline:
    """Circle about a point of the helix, as four quarters."""

    def quarter(start: float) -> Piece:
        def piece(s: Array, z: Array) -> tuple[Array, Array]:
            turn, angle = 2.0 * np.pi * z / PITCH_MM, 0.5 * np.pi * (start + s)
            x = HELIX_MM * np.cos(turn) + CHANNEL_MM * np.cos(angle)
            y = HELIX_MM * np.sin(turn) + CHANNEL_MM * np.sin(angle)
            return x, y

        return piece

    return Outline(tuple(quarter(k) for k in (0.0, 1.0, 2.0, 3.0)), least=3)


HELICAL_CHANNEL = WalledModel(
    name="helical-channel",
    summary="block of 80 x 80 x 120 mm with a helical channel of two turns, a circle of 16 mm in every layer",
    walls=(
        Wall(rounded_rectangle(HALF_SIDE_MM, HALF_SIDE_MM, CORNER_MM), (0.0, HEIGHT_MM)),
        Wall(_channel(), (0.0, HEIGHT_MM), hole=True),
    ),
    faces=(Face(0, (1,), 0.0, up=False), Face(0, (1,), HEIGHT_MM, up=True)),
    euler_number=0,
)

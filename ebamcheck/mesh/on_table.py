"""Mounting of a part that is turned between layers: the rigid motion from the table to the turned part, from the mesh."""

from __future__ import annotations

import numpy as np

from ebamcheck.errors import InputError
from ebamcheck.kernels import Floats
from ebamcheck.mesh.part import Part
from ebamcheck.settings.machine import OnTable

RIGID_MM = 1e-6  # largest residual of the motion between two parts of the same file


def rigid_motion(before: Part, now: Part) -> tuple[Floats, Floats]:
    """Rotation (3, 3) and shift (3,) that take one part to the other as p @ rotation + shift, from their vertices."""
    if before.vertices.shape != now.vertices.shape:
        raise InputError(f"part {now.name!r}: is of another file than the one that was built")
    middle = before.vertices.mean(axis=0)
    turn, *_ = np.linalg.lstsq(before.vertices - middle, now.vertices - now.vertices.mean(axis=0), rcond=None)
    u, _, v = np.linalg.svd(turn)
    turn = np.asarray(u @ v, np.float64)
    shift = now.vertices.mean(axis=0) - middle @ turn
    scale = max(float(np.abs(before.bounds).max()), 1.0)
    if np.abs(before.vertices @ turn + shift - now.vertices).max() > RIGID_MM * scale:
        raise InputError(f"part {now.name!r}: is of another file than the one that was built")
    return turn, np.asarray(shift, np.float64)


def on_table(before: Part, now: Part, built_mm: float = 0.0) -> OnTable:
    """Mounting of a part that was built along one direction up to `built_mm` over the plate, and is turned to another.

    `before` is the part on the table with all axes at 0, `now` the part in the program of the turned layer, each with Z from its lowest point.
    """
    turn, shift = rigid_motion(before, now)
    zero = np.array([0.0, 0.0, before.bounds[0, 2]])
    shift = zero @ turn + shift - np.array([0.0, 0.0, now.bounds[0, 2]])
    low, high = before.bounds - zero

    def triple(values: Floats) -> tuple[float, float, float]:
        x, y, z = (np.asarray(values, np.float64) + 0.0).tolist()
        return x, y, z

    return OnTable(
        direction=before.direction,
        turn=(triple(turn[0]), triple(turn[1]), triple(turn[2])),
        shift_mm=triple(shift),
        low_mm=triple(low),
        high_mm=triple(high),
        built_mm=built_mm,
    )

"""Least-squares fit of a form to points by their distances, with damped Gauss-Newton steps (Levenberg and Marquardt)."""

from __future__ import annotations

import numpy as np

from ebamcheck.curves.exact.forms import (
    CONE,
    CYLINDER,
    KIND,
    OWN,
    PLACE,
    SPHERE,
    TORUS,
    distances,
)
from ebamcheck.numeric.elimination import eliminated
from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Floats

MOST_STEPS = 40

LOST_STEPS = 8
"""Steps after which a form that is still far from its points is given up."""

LOST = 100.0
"""Largest root mean square distance after that many steps, in tolerances."""

STEP = 1e-6
"""Step of the difference quotients: a fraction of the points' extent, or rad."""

ENOUGH = 1e-13
"""Root of the sum of squared distances, over the points' extent, at which nothing is left to gain."""

MOST_UNKNOWNS = 7

NO_PIVOT = 1e-14


@kernel
def refined(row: Floats, points: Floats, tolerance: float) -> Floats:
    """The form of least squares from a first guess.

    Parameters
    ----------
    row
        (SIZE,) the guess: a sphere, cylinder, cone or torus.
    points
        (n, 3) mm.
    tolerance
        How far a point may lie off, mm; a form that stays far beyond is given up early.

    Returns
    -------
    numpy.ndarray
        (SIZE,) the form.
    """
    size = 0.0
    for axis in range(3):
        size = max(size, points[:, axis].max() - points[:, axis].min())
    count = _unknowns(int(row[KIND]))
    best = row.copy()
    off = distances(best, points) / size
    square = np.sum(off * off)
    damping = 1e-4
    jacobian = np.empty((count, len(points)))
    move = np.zeros(MOST_UNKNOWNS)
    equations = np.empty((count, count + 1))
    for step in range(MOST_STEPS):
        if square <= ENOUGH * ENOUGH or not np.isfinite(square):
            break
        if step == LOST_STEPS and np.sqrt(square / len(points)) * size > LOST * tolerance:
            break
        for k in range(count):
            move[:] = 0.0
            move[k] = STEP
            jacobian[k] = (distances(_moved(best, move, size), points) / size - off) / STEP
        gained = False
        for _ in range(MOST_UNKNOWNS):
            for i in range(count):
                for j in range(count):
                    equations[i, j] = np.dot(jacobian[i], jacobian[j])
                equations[i, count] = -np.dot(jacobian[i], off)
                equations[i, i] *= 1.0 + damping
                equations[i, i] += 1e-300
            if eliminated(equations, count, NO_PIVOT):
                move[:] = 0.0
                move[:count] = equations[:, count]
                tried = _moved(best, move, size)
                there = distances(tried, points) / size
                lesser = np.sum(there * there)
                if lesser < square:
                    gained = bool(lesser < (1.0 - 1e-9) * square)
                    best, off, square = tried, there, lesser
                    damping = max(0.1 * damping, 1e-12)
                    break
            damping = 10.0 * damping
        if not gained:
            break
    return best


@kernel
def _unknowns(kind: int) -> int:
    if kind == SPHERE:
        return 4
    if kind == CYLINDER:
        return 5
    return 6 if kind == CONE else 7


@kernel
def _moved(row: Floats, move: Floats, size: float) -> Floats:
    """A form after a small move: of its place and sizes in units of `size`, of its axis and angles in rad."""
    kind = int(row[KIND])
    found = row.copy()
    if kind == SPHERE:
        for k in range(3):
            found[PLACE + k] += size * move[k]
        found[OWN] += size * move[3]
        return found
    axis = row[OWN : OWN + 3]
    u = np.zeros(3)
    u[np.argmin(np.abs(axis))] = 1.0
    u -= axis * np.sum(u * axis)
    u /= np.sqrt(np.sum(u * u))
    v = np.array([
        axis[1] * u[2] - axis[2] * u[1],
        axis[2] * u[0] - axis[0] * u[2],
        axis[0] * u[1] - axis[1] * u[0],
    ])  # fmt: skip
    turned = axis + move[0] * u + move[1] * v
    found[OWN : OWN + 3] = turned / np.sqrt(np.sum(turned * turned))
    found[PLACE : PLACE + 3] += size * (move[2] * u + move[3] * v)
    if kind == CYLINDER:
        found[OWN + 3] += size * move[4]
        return found
    found[PLACE : PLACE + 3] += size * move[4] * axis
    if kind == CONE:
        angle = np.arctan2(row[OWN + 4], row[OWN + 3]) + move[5]
        found[OWN + 3], found[OWN + 4] = np.cos(angle), np.sin(angle)
    elif kind == TORUS:
        found[OWN + 3] += size * move[5]
        found[OWN + 4] += size * move[6]
    return found

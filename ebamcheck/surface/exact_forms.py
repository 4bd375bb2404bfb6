"""Forms of exact surfaces as rows of numbers: signed distances from them, and the gradients of these.

A row holds the kind, a reference point, the parameters of the kind, and last the sign of the side on which there is no solid.
"""

from __future__ import annotations

import numpy as np

from ebamcheck.kernels import Floats, kernel

SPHERE, CYLINDER, CONE, TORUS, QUADRIC, FLAT = range(6)

NAMES = ("sphere", "cylinder", "cone", "torus", "quadric", "plane")
"""Kinds by number."""

SIZE = 15
"""Numbers in a row: kind, reference point (3), parameters of the kind (10), side."""

KIND, PLACE, OWN, SIDE = 0, 1, 4, 14
"""Indices within a row: of the kind, the reference point, the first parameter and the side.

Parameters are, of a sphere, its radius; of a cylinder, its axis (3) and radius; of a cone, whose reference point is its tip,
its axis (3) and the cosine and sine of its half angle; of a torus, its axis (3) and the radii of its ring and its tube; of a
quadric, in coordinates from the reference point, the coefficients of x^2, y^2, z^2, xy, xz, yz, x, y, z and 1; of a plane, its
normal (3).
"""

LEAST = 1e-300

Signed = tuple[float, float, float, float]
"""Signed distance, mm, and its gradient, a unit vector."""


@kernel
def signed_distance(row: Floats, x: float, y: float, z: float) -> Signed:
    """Signed distance of a point from a surface, and its gradient; of a quadric to first order."""
    kind = int(row[KIND])
    x, y, z = x - row[PLACE], y - row[PLACE + 1], z - row[PLACE + 2]
    if kind == SPHERE:
        away = max(np.sqrt(x * x + y * y + z * z), LEAST)
        return away - row[OWN], x / away, y / away, z / away
    if kind == QUADRIC:
        return _off_quadric(row[OWN:SIDE], x, y, z)
    u, v, w = row[OWN], row[OWN + 1], row[OWN + 2]
    along = x * u + y * v + z * w
    if kind == FLAT:
        return along, u, v, w
    x, y, z = x - along * u, y - along * v, z - along * w
    across = max(np.sqrt(x * x + y * y + z * z), LEAST)
    x, y, z = x / across, y / across, z / across
    if kind == CYLINDER:
        return across - row[OWN + 3], x, y, z
    if kind == CONE:
        cosine, sine = row[OWN + 3], row[OWN + 4]
        return (
            across * cosine - along * sine,
            x * cosine - u * sine,
            y * cosine - v * sine,
            z * cosine - w * sine,
        )
    off = across - row[OWN + 3]
    away = max(np.sqrt(off * off + along * along), LEAST)
    off, along_share = off / away, along / away
    return (
        away - row[OWN + 4],
        x * off + u * along_share,
        y * off + v * along_share,
        z * off + w * along_share,
    )


@kernel
def _off_quadric(own: Floats, x: float, y: float, z: float) -> Signed:
    gx = 2.0 * own[0] * x + own[3] * y + own[4] * z + own[6]
    gy = 2.0 * own[1] * y + own[3] * x + own[5] * z + own[7]
    gz = 2.0 * own[2] * z + own[4] * x + own[5] * y + own[8]
    value = 0.5 * (x * (gx + own[6]) + y * (gy + own[7]) + z * (gz + own[8])) + own[9]
    slope = max(np.sqrt(gx * gx + gy * gy + gz * gz), LEAST)
    return value / slope, gx / slope, gy / slope, gz / slope


@kernel
def signed_distances(rows: Floats, points: Floats) -> Floats:
    """Signed distances of points (n, 3) from a surface each, mm, and their gradients, (n, 4); one row of surfaces serves all."""
    found = np.empty((len(points), 4))
    for i in range(len(points)):
        row = rows[i if len(rows) > 1 else 0]
        found[i] = signed_distance(row, points[i, 0], points[i, 1], points[i, 2])
    return found


def distances(row: Floats, points: Floats) -> Floats:
    """Signed distances (n,) of points (n, 3) from a surface, mm."""
    return np.asarray(signed_distances(row[None], points)[:, 0])

"""Forms of exact surfaces as rows of numbers: signed distances from them, and the directions in which they grow.

A row holds the kind, a point of reference, what the kind needs, and last the side on which the solid does not lie.
"""

from __future__ import annotations

import numpy as np

from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Floats

SPHERE, CYLINDER, CONE, TORUS, QUADRIC, FLAT = range(6)

NAMES = ("sphere", "cylinder", "cone", "torus", "quadric", "plane")
"""Kinds by number."""

SIZE = 15
"""Numbers in a row: kind, reference point (3), 10 of the kind, and the side."""

KIND, PLACE, OWN, SIDE = 0, 1, 4, 14
"""Places in a row.

Of its own a sphere has its radius; a cylinder its axis (3) and radius; a cone, about its tip, its axis (3), and cosine and
sine of its half angle; a torus its axis (3), the radius of its ring and that of its tube; a quadric, of coordinates from its
reference point, the coefficients of x2, y2, z2, xy, xz, yz, x, y, z and 1; a plane its normal (3).
"""

LEAST = 1e-300

Signed = tuple[float, float, float, float]
"""Signed distance, mm, and the unit vector in which it grows."""


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
def distances(row: Floats, points: Floats) -> Floats:
    """Signed distances (n,) of points (n, 3) from a surface, mm."""
    found = np.empty(len(points))
    for i in range(len(points)):
        found[i] = signed_distance(row, points[i, 0], points[i, 1], points[i, 2])[0]
    return found

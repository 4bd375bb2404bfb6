"""Sections and a linear medium, for the tests of the heat model."""

from __future__ import annotations

import numpy as np
import shapely
from shapely import affinity

from ebamcheck.heat import Medium

LINEAR = Medium(conductivity_w_mmk=0.020, heat_capacity_j_mm3k=4300 * 700 * 1e-9)
ALPHA = LINEAR.diffusivity_mm2_s
RING = shapely.Point(3, 4).buffer(40, 64).difference(shapely.Point(10, 4).buffer(12, 32))
SHAPES = {
    "ring": RING,
    "turned L": affinity.rotate(
        shapely.Polygon([(0, 0), (60, 0), (60, 20), (20, 20), (20, 50), (0, 50)]), 27
    ),
    "two regions": shapely.union_all([shapely.box(0, 0, 40, 30), shapely.Point(80, 10).buffer(17, 32)]),
    "thin wall": affinity.rotate(shapely.box(0, 0, 120, 1.5), 33),
    "far away": affinity.translate(RING, 5e4, -5e4),
}


def gauss(low, high, count, panels=1):
    nodes, weights = np.polynomial.legendre.leggauss(count)
    edges = np.linspace(low, high, panels + 1)
    half = 0.5 * np.diff(edges)
    return ((edges[:-1] + half)[:, None] + half[:, None] * nodes).ravel(), (half[:, None] * weights).ravel()

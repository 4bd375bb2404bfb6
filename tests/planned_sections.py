"""A stack of turned blades for plans, and whether two plans are one."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd
import shapely
from shapely import affinity

from ebamcheck.layers.stack import from_polygons
from ebamcheck.settings.config import Config

PROFILE = Config().changed(scan={"annealing_steps": 1000})
"""Orders are improved for a fortieth of the usual time: no law of a plan hangs on how good they are."""

ANGLE = np.linspace(0, 2 * math.pi, 500, endpoint=False)


def disc(x, y, radius, fine=48):
    return shapely.Point(x, y).buffer(radius, quad_segs=fine)


def blade():
    outline = np.column_stack(
        [150 * np.cos(ANGLE) + 12 * np.cos(3 * ANGLE), 70 * np.sin(ANGLE) + 10 * np.sin(5 * ANGLE)]
    )
    body = shapely.Polygon(outline).difference(disc(-60, 0, 22)).difference(shapely.box(30, -20, 90, 15))
    walls = [shapely.box(140, -4, 260, 4), shapely.box(255, -80, 260, 80), shapely.box(200, 30, 258, 34)]
    return shapely.union_all([body, *walls])


def stack(count=7):
    bodies = [[affinity.rotate(blade(), 3.0 * k)] for k in range(count)]
    bodies[3] = []
    # The lowest cut lies half a layer over the plate: heights are then those over the plate.
    heights = 0.5 * PROFILE.layer_height_mm + np.arange(count) * 1.7
    return from_polygons(heights, bodies, part="abc", backend="planecut")


def equal_plans(a, b):
    for name in ("heights", "island_layer", "island_kind", "island_area_mm2", "island_centroid"):
        assert np.array_equal(getattr(a, name), getattr(b, name)), name
    for name in ("neighbours", "border_mm", "order"):
        assert np.array_equal(getattr(a, name), getattr(b, name)), name
    for name in ("islands", "contours"):
        assert np.array_equal(shapely.to_wkb(getattr(a, name)), shapely.to_wkb(getattr(b, name))), name
    assert (a.sections is None) == (b.sections is None)
    if a.sections is not None:
        assert np.array_equal(shapely.to_wkb(a.sections), shapely.to_wkb(b.sections)), "sections"
    pd.testing.assert_frame_equal(a.vectors, b.vectors, check_exact=True)
    pd.testing.assert_frame_equal(a.metrics, b.metrics, check_exact=True)
    assert a.settings == b.settings

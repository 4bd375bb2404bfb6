"""Stacks of one box and what comparing them finds, for the tests of the comparison."""

from __future__ import annotations

import numpy as np
import shapely

from ebamcheck.comparison import compare_all
from ebamcheck.layers.stack import from_polygons
from ebamcheck.mesh.part import from_arrays
from ebamcheck.settings.stages import ComparisonSettings

COLUMNS = [
    "layer", "height_mm", "class", "area_a_mm2", "area_b_mm2", "area_difference_mm2",
    "symmetric_difference_mm2", "iou", "hausdorff_ab_mm", "hausdorff_ba_mm", "hausdorff_mm", "p95_ab_mm",
    "p95_ba_mm", "depth_mm", "depth_x_mm", "depth_y_mm", "rings_a", "rings_b", "holes_a", "holes_b",
    "open_a", "open_b", "topology_agrees", "set_aside", "limit_mm", "agrees",
]  # fmt: skip

SQUARE = np.array([(0, 0), (10, 0), (10, 10), (0, 10)], float)
HEIGHTS = np.array([1.0, 2.0, 3.0])


def box(low=(0, 0, 0), high=(10, 10, 4)):
    """Box as a part: 8 vertices, 12 facets, outward."""
    x, y, z = zip(low, high, strict=True)
    corners = np.array([(x[i & 1], y[i >> 1 & 1], z[i >> 2]) for i in range(8)], float)
    faces = [
        (0, 2, 1), (1, 2, 3), (4, 5, 6), (5, 7, 6), (0, 1, 4), (1, 5, 4),
        (2, 6, 3), (3, 6, 7), (0, 4, 2), (2, 4, 6), (1, 3, 5), (3, 7, 5),
    ]  # fmt: skip
    return from_arrays(corners, faces)


def shifted(points, x_mm):
    return points + np.array([x_mm, 0.0])


def stack(*layers, heights=HEIGHTS, **labels):
    return from_polygons(heights, [[shapely.Polygon(r)] if r is not None else [] for r in layers], **labels)


def judged(stacks, part=None, heights_bound=0.0, rules=None, exact=(), bound=0.0, **settings):
    return compare_all(
        stacks,
        part or box(),
        dict.fromkeys(stacks, (bound, heights_bound)),
        {name: name in exact for name in stacks},
        rules or dict.fromkeys(stacks, "half-open"),
        ComparisonSettings(**settings),
    )

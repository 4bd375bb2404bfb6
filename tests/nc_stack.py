"""A small stack with every kind of piece and travel, for the tests of programs."""

from __future__ import annotations

import numpy as np
import pandas as pd
import shapely

from ebamcheck.curves.columns import Curves
from ebamcheck.scan.plan.columns import ScanPlan

REACHES_OUT = "overhang"
"""Check that the stack does not pass: its layers are curves of chance, and reach out over each other by any distance."""

SPACING_MM = 4.32
"""Hatch spacing of the default process: 0.72 of a bead of 6 mm."""


def clamped_knots(rng: np.random.Generator, controls: int) -> np.ndarray:
    inner = np.cumsum(rng.uniform(0.3, 9.0, controls - 3))
    return np.concatenate([np.zeros(4), inner, np.full(3, inner[-1])])


def make_curves(heights, layers, closed) -> Curves:
    """Curves from nested lists: layers of rings of pieces (control, knots or None)."""
    rings = [ring for layer in layers for ring in layer]
    pieces = [piece for ring in rings for piece in ring]
    sizes = [len(knots) if knots is not None else 0 for _, knots in pieces]
    return Curves(
        heights=np.asarray(heights, float),
        layer_starts=np.cumsum([0] + [len(layer) for layer in layers]),
        ring_starts=np.cumsum([0] + [len(ring) for ring in rings]),
        closed=np.asarray(closed, bool),
        kind=np.array([knots is not None for _, knots in pieces], np.uint8),
        control_starts=np.cumsum([0] + [len(control) for control, _ in pieces]),
        control=np.concatenate([control for control, _ in pieces] or [np.zeros((0, 2))]),
        knot_starts=np.cumsum([0, *sizes]),
        knots=np.concatenate([knots for _, knots in pieces if knots is not None] or [np.zeros(0)]),
    )


def make_plan(heights, islands) -> ScanPlan:
    """Scan plan from (layer, vectors) of each island, in scan order; vectors are (x0, y0, x1, y1)."""
    layer = np.array([k for k, _ in islands], np.int64)
    ends = np.array([v for _, vectors in islands for v in vectors], float).reshape(-1, 4)
    count = len(islands)
    vectors = pd.DataFrame(ends, columns=["x0", "y0", "x1", "y1"])
    vectors.insert(0, "island", np.repeat(np.arange(count), [len(v) for _, v in islands]))
    vectors["angle"] = 0.0
    heights = np.asarray(heights, float)
    return ScanPlan(
        heights=heights,
        contours=np.array([shapely.Polygon()] * len(heights), object),
        islands=np.array([shapely.box(0, 0, 1, 1)] * count, object),
        island_layer=layer,
        island_kind=np.array(["whole"] * count),
        island_area_mm2=np.ones(count),
        island_centroid=np.zeros((count, 2)),
        neighbours=np.zeros((0, 2), np.int64),
        border_mm=np.zeros(0),
        order=np.arange(count),
        vectors=vectors,
        metrics=pd.DataFrame(),
    )


def hatch(x: float, y: float, lines: int, length: float = 30.0) -> list[tuple[float, float, float, float]]:
    """Parallel lines that alternate in direction, one spacing apart."""
    rows = [(x, y + i * SPACING_MM, x + length, y + i * SPACING_MM) for i in range(lines)]
    return [(c, d, a, b) if i % 2 else (a, b, c, d) for i, (a, b, c, d) in enumerate(rows)]


def stack(seed: int = 0, count: int = 3, layer_height: float = 1.5) -> tuple[Curves, ScanPlan]:
    """A ring of two splines and a polyline with corners, a square hole, an open path; three islands a layer.

    The third island of each layer lies apart, over that of the layer below: nothing else stands there.
    """
    rng = np.random.default_rng(seed)
    layers, closed, islands, apart = [], [], [], None
    for k in range(count):
        a, b, c = rng.uniform(-120, 120, (3, 2))
        first = np.vstack([a, rng.uniform(-150, 150, (8, 2)), b])
        second = np.vstack([b, rng.uniform(-150, 150, (2, 2)), c])
        line = np.vstack([c, rng.uniform(-150, 150, (3, 2)), a])
        square = rng.uniform(-50, 50, 2) + np.array([(0, 0), (0, 9), (9, 9), (9, 0), (0, 0)], float)
        path = rng.uniform(-90, 90, (4, 2))
        layers.append(
            [
                [(first, clamped_knots(rng, 10)), (second, clamped_knots(rng, 4)), (line, None)],
                [(square, None)],
                [(path, clamped_knots(rng, 4))],
            ]
        )
        closed += [True, True, False]
        x, y = rng.uniform(-60, 0, 2)
        apart = apart or hatch(x + 200, y, 3)
        islands += [(k, hatch(x, y, 5)), (k, hatch(x + 34, y, 4)), (k, apart)]
    heights = 7.0 + (np.arange(count) + 0.5) * layer_height
    return make_curves(heights, layers, closed), make_plan(heights, islands)

"""Sections of every sort that a layer may have: holes, several islands, thin walls, sharp corners, necks."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import shapely
from shapely import affinity

BEAD_MM = 6.0
"""Width of the default bead, in which the sizes of walls are told."""


def disc(x: float, y: float, radius: float) -> shapely.Polygon:
    return shapely.Point(x, y).buffer(radius, quad_segs=32)


def gear(teeth: int, root: float, tip: float, bore: float) -> shapely.Polygon:
    pitch = 2.0 * math.pi / teeth
    flank = [(-0.28, root), (-0.14, tip), (0.14, tip), (0.28, root)]
    points = [
        (r * math.cos((n + share) * pitch), r * math.sin((n + share) * pitch))
        for n in range(teeth)
        for share, r in flank
    ]
    return shapely.Polygon(points).difference(disc(0, 0, bore))


def star(corners: int, inner: float, outer: float) -> shapely.Polygon:
    turn = math.pi / corners * np.arange(2 * corners)
    radius = np.where(np.arange(2 * corners) % 2 == 0, outer, inner)
    return shapely.Polygon(np.column_stack([radius * np.cos(turn), radius * np.sin(turn)]))


def crooked(seed: int) -> shapely.Geometry:
    """Polygon of nine random corners, crossing itself, with three holes."""
    rng = np.random.default_rng(seed)
    shape = shapely.make_valid(shapely.Polygon(rng.uniform(-120, 120, (9, 2))))
    shape = shapely.union_all([p for p in shapely.get_parts(shape) if p.area > 0])
    for _ in range(3):
        shape = shape.difference(disc(*rng.uniform(-80, 80, 2), rng.uniform(4, 20)))
    return shape


def walls() -> Iterator[tuple[str, shapely.Geometry]]:
    """Straight, round, bent and crossing walls from half a bead to six."""
    for beads in (0.5, 1.0, 1.25, 1.75, 2.0, 2.4, 3.0, 4.0, 6.0):
        thick = beads * BEAD_MM
        yield f"wall of {beads} beads", affinity.rotate(shapely.box(0, 0, 150, thick), 17)
        yield f"ring of {beads} beads", disc(0, 0, 60).difference(disc(0, 0, 60 - thick))
    for beads in (0.7, 1.2, 1.6, 2.3, 3.1):
        thick = beads * BEAD_MM
        foot = shapely.box(0, 0, 100, thick)
        yield f"L of {beads} beads", foot.union(shapely.box(0, 0, thick, 80))
        yield f"T of {beads} beads", foot.union(shapely.box(50 - thick / 2, 0, 50 + thick / 2, 80))
        trough = shapely.box(0, 0, 100, 70).difference(shapely.box(thick, thick, 100 - thick, 80))
        yield f"U of {beads} beads", affinity.rotate(trough, 31)
        bar = shapely.box(-50, -thick / 2, 50, thick / 2)
        yield f"cross of {beads} beads", bar.union(affinity.rotate(bar, 60))


def solids() -> Iterator[tuple[str, shapely.Geometry]]:
    """Plates with holes and slots, several islands, sharp corners, necks."""
    plate = shapely.box(0, 0, 240, 160)
    holes = [disc(14 + 26 * i, 16 + 26 * j, 9) for i in range(9) for j in range(6)]
    yield "plate with 54 holes", plate.difference(shapely.union_all(holes))
    rng = np.random.default_rng(1)
    holes = [disc(*rng.uniform([10, 10], [230, 150]), rng.uniform(3, 18)) for _ in range(30)]
    yield "plate with holes that meet", plate.difference(shapely.union_all(holes))
    slots = [shapely.box(20, 10 + 12 * i, 180, 14 + 12 * i) for i in range(7)]
    yield "slots", shapely.box(0, 0, 200, 100).difference(shapely.union_all(slots))
    bores = [disc(10 + 18 * i + 9 * (j % 2), 10 + 16 * j, 7.5) for i in range(8) for j in range(6)]
    yield "honeycomb", shapely.box(0, 0, 150, 100).difference(shapely.union_all(bores))
    several = [disc(60 * i, 70 * j, 8 + 6 * i + 3 * j) for i in range(3) for j in range(2)]
    yield "six islands", shapely.union_all(several)
    yield "island in a ring", disc(0, 0, 90).difference(disc(0, 0, 60)).union(disc(5, 5, 35))
    yield "gear", gear(24, 70, 85, 20)
    yield "fine gear", gear(40, 90, 98, 30)
    yield "star", star(8, 45, 80)
    yield "sharp star", star(12, 30, 90)
    yield "wedge", shapely.Polygon([(0, 0), (150, 0), (0, 30)])
    yield "sharp wedge", shapely.Polygon([(0, 0), (150, 0), (0, 12)])
    yield "hair", affinity.rotate(shapely.Polygon([(-65, 0.01), (17, -0.03), (25, 0.03)]), 40)
    yield "tapered wall", shapely.Polygon([(0, -9), (150, -1), (150, 1), (0, 9)])
    yield "neck", shapely.union_all([disc(0, 0, 30), disc(80, 0, 30), shapely.box(0, -2, 80, 2)])
    yield "discs that touch", shapely.union_all([disc(0, 0, 30), disc(59.5, 0, 30)])
    squares = [shapely.box(10 * i, 10 * j, 10 * i + 7, 10 * j + 7) for i in range(5) for j in range(5)]
    yield "squares of a bead", shapely.union_all(squares)
    turned = affinity.rotate(shapely.box(0, 0, 120, 30).union(shapely.box(0, 0, 25, 90)), 37)
    yield "far from the origin", affinity.translate(turned, 3e4, -2e4)
    for size in (0.5, 3.0, 7.0, 8.0, 12.0, 15.0):
        yield f"square of {size} mm", shapely.box(0, 0, size, size)
        yield f"triangle of {size} mm", shapely.Polygon([(0, 0), (size, 0), (size / 2, size)])
    for seed in (100, 101, 104, 108):
        yield f"crooked {seed}", crooked(seed)


ZOO: dict[str, shapely.Geometry] = {**dict(walls()), **dict(solids())}

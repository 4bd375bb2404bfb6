"""Named cases: small solids on which known slicers failed, each from the report that its summary cites.

Reports that come with a file are re-made here from what they say of the shape; nothing is copied.
"""

from __future__ import annotations

import math

import numpy as np

from ebamcheck_models.model import single
from ebamcheck_models.outlines import polygon
from ebamcheck_models.polyhedra import PITCH_MM, Polyhedron, block, box_corners, cells
from ebamcheck_models.prisms import Prism, prism


def _two_by_two(name: str, summary: str, filled: list[list[int]], euler_number: int, shells: int) -> Polyhedron:
    """Cubes of 10 mm on the squares of a board, as tall as wide."""
    side = 10.0 * np.arange(len(filled) + 1)
    pattern = np.array(filled, dtype=bool)[:, :, None]
    return cells(name, summary, (side, side, (0.0, 10.0)), pattern, euler_number, shells, two_manifold=False)


def _window() -> Polyhedron:
    filled = np.ones((3, 3, 3), dtype=bool)
    filled[1, 1, 1:] = False
    filled[1, 0, 1] = False
    return cells(
        "case-prusa-1260",
        "open box with a window in one wall; PrusaSlicer #1260: layers at the window's sill and lintel vanish",
        ((0.0, 2.0, 28.0, 30.0), (0.0, 2.0, 28.0, 30.0), (0.0, 10.0, 14.0, 20.0)),
        filled,
        0,
    )


def _lattice() -> Polyhedron:
    count = 6
    filled = np.zeros((2 * count + 1, 2 * count + 1, 3), dtype=bool)
    filled[::2, :, :] = True
    filled[:, ::2, :] = True
    filled[1:-1, 1:-1, 1] = False
    holes = count * count
    planes = np.cumsum([0.0, *([3.0, 7.0] * count), 3.0])
    # Bores open into one room from below and from above: a surface of genus 2 * holes - 1.
    return cells(
        "case-pyslm-21",
        "plate of bores above and below one inner room; pyslm #21: areas closed wrongly in some layers",
        (planes, planes, (0.0, 5.0, 9.0, 14.0)),
        filled,
        2 - 2 * (2 * holes - 1),
    )


def _spiral() -> Prism:
    """Strip that winds inward with straight sides of growing length, as one long thin concave ring."""
    turns, gap, strip = 13, 4.0, 3.0
    lengths = [(k // 2 + 1) * (gap + strip) for k in range(turns, 0, -1)]
    x = y = heading = 0.0
    path = [(x, y)]
    for length in lengths:
        x, y = x + length * math.cos(heading), y + length * math.sin(heading)
        heading += 0.5 * math.pi
        path.append((round(x, 6), round(y, 6)))
    left, right = [], []
    for n, point in enumerate(path):
        before = np.subtract(point, path[n - 1]) if n else np.subtract(path[1], path[0])
        after = np.subtract(path[n + 1], point) if n + 1 < len(path) else before
        before, after = before / np.abs(before).sum(), after / np.abs(after).sum()
        sides = np.array([[-before[1], before[0]], [-after[1], after[0]]])
        offset = sides.sum(axis=0) if n and n + 1 < len(path) else sides[0]
        left.append(tuple((np.array(point) + 0.5 * strip * offset).tolist()))
        right.append(tuple((np.array(point) - 0.5 * strip * offset).tolist()))
    return prism(
        "case-trimesh-1944",
        "strip wound to a square spiral; trimesh #1944, #2224: a contour closed across open space, or split",
        polygon([*right, *left[::-1]]),
        15.0,
    )


def _gap_plug() -> Polyhedron:
    """Square plug in a square hole, free all around."""
    clearance = 0.05
    planes = np.cumsum([0.0, 15.0, clearance, 20.0, clearance, 15.0])
    filled = np.ones((5, 5, 1), dtype=bool)
    filled[1:4, 1:4] = False
    filled[2, 2] = True
    return cells(
        "case-prusa-4245",
        "plug in a hole with 0.05 mm of play; PrusaSlicer #4245: the gap closes and the plug joins the base",
        (planes, planes, (0.0, 12.0)),
        filled,
        2,
        shells=2,
    )


def _gap_slit(name: str, summary: str, gap_mm: float) -> Polyhedron:
    """Block slit from one side almost through."""
    filled = np.ones((3, 2, 1), dtype=bool)
    filled[1, 1] = False
    x = np.cumsum([0.0, 3 * PITCH_MM, gap_mm, 3 * PITCH_MM])
    return cells(name, summary, (x, (0.0, 5.0, 25.0), (0.0, 26.0)), filled, 2)


def _far() -> Polyhedron:
    corner = np.array([4000.0, -6000.0, 2500.0])
    slanted = box_corners((0.0, 0.0, 0.0), (20.0, 20.0, 20.0))
    slanted[4:, 0] += 7.0
    return block(
        "case-trimesh-48",
        "slanted block of 20 mm that lies 7.6 m off the origin; trimesh #48, #2324: 32-bit numbers run out",
        slanted + corner,
    )


def _peak() -> Polyhedron:
    angle = 2.0 * np.pi * np.arange(8) / 8
    ring = np.column_stack([20.0 * np.cos(angle), 20.0 * np.sin(angle), np.zeros(8)])
    corners = np.concatenate([ring, [[0.0, 0.0, 15.0], [0.0, 0.0, -15.0]]])
    after = np.roll(np.arange(8), -1)
    upper = np.column_stack([np.arange(8), after, np.full(8, 8)])
    lower = np.column_stack([after, np.arange(8), np.full(8, 9)])
    return Polyhedron(
        "case-trimesh-2317",
        "octagonal double pyramid, eight facets at each apex; trimesh #2317: a ray at a vertex hits 0 to 8 times",
        single(corners),
        np.concatenate([upper, lower]),
        np.arange(10)[None, :],
        2,
    )


CURA_1473 = block(
    "case-cura-1473",
    "cube of 100 mm; CuraEngine #1473: at 0.2 mm layers all but a diagonal is missing at z = 14.2",
    box_corners((0.0, 0.0, 0.0), (100.0, 100.0, 100.0)),
)
PRUSA_1260 = _window()
PRUSA_4245 = _gap_plug()
PRUSA_520 = _gap_slit("case-prusa-520", "block with a slit of 0.042 mm; PrusaSlicer #520: the slit is filled", 0.042)
PRUSA_9028 = _gap_slit(
    "case-prusa-9028", "block with a slit of 0.1 mm; PrusaSlicer #9028: new perimeters replace the slit", 0.1
)
PYSLM_21 = _lattice()
TRIMESH_1944 = _spiral()
TRIMESH_1766 = block(
    "case-trimesh-1766",
    "slab whose facets' diagonal passes through the origin; trimesh #1766, embree #188: rays slip between facets",
    box_corners((-16.0, -16.0, -2.0), (16.0, 16.0, 2.0)),
)
TRIMESH_2317 = _peak()
TRIMESH_48 = _far()
TOUCHING_EDGE = _two_by_two(
    "case-touching-edge",
    "two cubes that share one upright edge; touching contours, wrongly joined or split",
    [[1, 0], [0, 1]],
    euler_number=3,
    shells=1,
)
TOUCHING_BOARD = _two_by_two(
    "case-touching-board",
    "chess board of 5 x 5 cubes that touch along upright edges: contours meet in every corner",
    (np.indices((5, 5)).sum(axis=0) % 2 == 0).astype(int).tolist(),
    euler_number=13 * 2 - 16,
    shells=1,
)

CASES: tuple[Polyhedron | Prism, ...] = (
    *(
        CURA_1473,
        PRUSA_1260,
        PRUSA_4245,
        PRUSA_520,
        PRUSA_9028,
        PYSLM_21,
        TRIMESH_1944,
        TRIMESH_1766,
        TRIMESH_2317,
    ),
    *(TRIMESH_48, TOUCHING_EDGE, TOUCHING_BOARD),
)
"""All named cases, in the order of their names."""

"""Simple solids: a cube, a cylinder, and a plate with holes."""

from __future__ import annotations

from ebamcheck_models.outlines import Outline, circle, polygon, rounded_rectangle
from ebamcheck_models.walls import Face, Wall, WalledModel


def prism(
    name: str, summary: str, outline: Outline, height_mm: float, holes: tuple[Outline, ...] = ()
) -> WalledModel:
    """Upright prism over an outline, with holes from bottom to top."""
    levels = (0.0, height_mm)
    walls = (Wall(outline, levels), *(Wall(hole, levels, hole=True) for hole in holes))
    through = tuple(range(1, len(walls)))
    faces = (Face(0, through, 0.0, up=False), Face(0, through, height_mm, up=True))
    return WalledModel(name, summary, walls, faces, euler_number=2 - 2 * len(holes))


CUBE = prism(
    "cube",
    "cube of 20 mm, a corner at the origin",
    polygon([(0.0, 0.0), (20.0, 0.0), (20.0, 20.0), (0.0, 20.0)]),
    20.0,
)

CYLINDER = prism("cylinder", "upright cylinder, radius 25 mm, height 60 mm", circle(0.0, 0.0, 25.0), 60.0)

PRISM = prism(
    "prism",
    "rounded plate of 160 x 100 x 40 mm with two round holes, an L-shaped one and a triangular one",
    rounded_rectangle(80.0, 50.0, 18.0),
    40.0,
    (
        circle(-50.0, 20.0, 15.0),
        circle(-50.0, -25.0, 8.0),
        polygon([(-15.0, -30.0), (25.0, -30.0), (25.0, -15.0), (0.0, -15.0), (0.0, 30.0), (-15.0, 30.0)]),
        polygon([(20.0, 10.0), (60.0, -20.0), (60.0, 30.0)]),
    ),
)

"""Simple prisms: a cube, and a plate with holes."""

from __future__ import annotations

from ebamcheck_models.outlines import circle, polygon, rounded_rectangle
from ebamcheck_models.prisms import prism

CUBE = prism(
    "cube",
    "cube of 20 mm, a corner at the origin",
    polygon([(0.0, 0.0), (20.0, 0.0), (20.0, 20.0), (0.0, 20.0)]),
    20.0,
)

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

"""Where the lattice lies on each layer: along the smallest rectangle, then shifted and turned from layer to layer.

Borders of islands are where beads start, stop and meet at an angle. Were they to lie over each other from
layer to layer, they would grow into walls of lack of fusion through the part. So each layer turns the
lattice on, which leaves borders of two layers at most points in common, not lines; and it shifts it, so that
layers whose turns are alike again do not repeat it. The lowest layer has the lattice of the paper.
"""

from __future__ import annotations

import math

from numpy.typing import ArrayLike

from ebamcheck.scan.islands.lattice import SQRT3
from ebamcheck.scan.islands.rectangle import Rectangle, minimum_rectangle, rectangle_along
from ebamcheck.settings.config import Config

PLASTIC = 1.324717957244746
"""Real root of x^3 = x + 1. Multiples of its inverse and of its inverse squared spread pairs of fractions as
evenly as can be, however many layers there are (M. Roberts, 2018: the sequence R2)."""

ROWS_REPEAT = 3.0
"""Rows of hexagons repeat along L2 after so many sides d; along L1 hexagons repeat after sqrt(3) d. Squares and
stripes repeat after less, sqrt(3) d, so that they are shifted over their whole period, too."""


def layer_place(points: ArrayLike, side_mm: float, config: Config, layer: int) -> Rectangle:
    """Rectangle around a layer over which its cells are laid, shifted and turned as the settings say.

    The rule of the lattice counts from the midpoint of L1 and from the start of L2. So a rectangle that is
    moved, and grown by as much as it moves, shifts the lattice and still holds every point.

    Parameters
    ----------
    points
        (N, 2) mm, of the section's border.
    side_mm
        Side d of the hexagons.
    layer
        Index of the layer.
    """
    smallest = minimum_rectangle(points, config.scan.rectangle)
    turn = math.radians(layer * config.scan.lattice_angle_deg)
    around = smallest if turn == 0.0 else rectangle_along(points, smallest.angle_rad + turn)
    if not config.scan.lattice_shift or layer == 0:
        return around
    first, second = shift_shares(layer)
    return shifted(around, (first - 0.5) * SQRT3 * side_mm, second * ROWS_REPEAT * side_mm)


def shift_shares(layer: int) -> tuple[float, float]:
    """Shift of a layer's lattice along L1 and L2, as shares of its periods, each in [0, 1)."""
    return layer / PLASTIC % 1.0, layer / PLASTIC**2 % 1.0


def shifted(rectangle: Rectangle, along_short_mm: float, along_long_mm: float) -> Rectangle:
    """Move the midpoint of L1 and the start of L2; the rectangle grows so that it holds what it held.

    Parameters
    ----------
    along_short_mm
        Shift along L1, either way.
    along_long_mm
        Shift against L2, at least 0.
    """
    x, y = rectangle.to_world(along_short_mm, -0.5 * along_long_mm)
    return Rectangle(
        float(x),
        float(y),
        rectangle.angle_rad,
        rectangle.short_mm + 2.0 * abs(along_short_mm),
        rectangle.long_mm + along_long_mm,
    )

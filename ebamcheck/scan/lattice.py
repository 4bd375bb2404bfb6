"""The hexagons laid over a layer: the paper's odd/even rule (section 4.1), and the side by default.

The paper's rule, worked out: along the short side L1 stand ``n = round(L1 / d) + 1`` hexagons, one more
where that is even, so that n is always odd and one centre lies on the midpoint of L1; centres are
``sqrt(3) d`` apart. Rows follow each other along L2 at ``1.5 d``, every other one shifted by half a step.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import shapely

from ebamcheck.errors import SettingsError
from ebamcheck.rings import Floats, Ints
from ebamcheck.scan.rectangle import Rectangle

SQRT3 = math.sqrt(3.0)

LEAST_ACROSS = 3
"""The rule gives one hexagon where L1 < d/2; a single shifted one would then miss half of the rectangle."""

ZONES = 60
"""Islands that an ordinary layer is divided into: enough to spread the heat, few enough wire starts."""

BEADS_ACROSS = (4, 12)
"""Fewest and most beads between two opposite sides of a hexagon: under 4 the ends of the beads rule the
island, over 12 the scan lines grow as long as those that the partition is there to avoid."""

ROUNDING = 1e-12
"""Relative rounding of a length that must not cost a row of hexagons."""

MOST_HEXAGONS = 1_000_000
"""More hexagons than this on one layer are a mistyped side."""


@dataclass(frozen=True, eq=False)
class Lattice:
    """Hexagons of one layer.

    Parameters
    ----------
    side_mm
        Side d.
    centres
        (H, 2) mm, row by row along the long side of the rectangle.
    colour
        (H,) 0, 1 or 2, such that no two hexagons with a common side have the same one; the hatch
        turns by it.
    hexagons
        (H,) polygons; hexagons with a common side share its two corners to the last bit.
    """

    side_mm: float
    centres: Floats
    colour: Ints
    hexagons: np.ndarray


def hexagons_across(short_mm: float, side_mm: float) -> int:
    """Hexagons along the short side, always odd (paper, section 4.1; halves round up).

    Examples
    --------
    >>> hexagons_across(100.0, 10.0), hexagons_across(110.0, 10.0)
    (11, 13)
    """
    count = math.floor(short_mm / side_mm + 0.5) + 1
    if count % 2 == 0:
        count += 1
    return max(count, LEAST_ACROSS)


def rows_along(long_mm: float, side_mm: float) -> int:
    """Rows along the long side, the first one centred on its start: as many as reach its end.

    A row covers its full width from half a side before its centres to half a side after them, and
    shares the band between with its neighbour.
    """
    return max(0, math.ceil((long_mm - 0.5 * side_mm) / (1.5 * side_mm) - ROUNDING)) + 1


def hexagon_lattice(rectangle: Rectangle, side_mm: float) -> Lattice:
    """Lay hexagons of a given side over a rectangle; together they cover all of it.

    Raises
    ------
    SettingsError
        If there would be more than :data:`MOST_HEXAGONS`.
    """
    across = hexagons_across(rectangle.short_mm, side_mm)
    rows = rows_along(rectangle.long_mm, side_mm)
    if across * rows > MOST_HEXAGONS:
        raise SettingsError(
            f"scan.hexagon_side_mm {side_mm:g} lays {across} x {rows} hexagons over one layer of "
            f"{rectangle.short_mm:g} x {rectangle.long_mm:g} mm, over the limit of {MOST_HEXAGONS}: give a larger side"
        )
    row, column = (grid.ravel() for grid in np.mgrid[0:rows, 0:across])
    # Half steps of sqrt(3)/2 d along L1 and of d/2 along L2: corners of neighbours are the same integers.
    half = 2 * column - (across - 1) + row % 2
    third = 3 * row
    corner_half = half[:, None] + np.array([0, 1, 1, 0, -1, -1])
    corner_third = third[:, None] + np.array([-2, -1, 1, 2, 1, -1])
    corners = _place(rectangle, side_mm, corner_half, corner_third)
    return Lattice(
        side_mm=side_mm,
        centres=_place(rectangle, side_mm, half, third),
        # Axial coordinates: a step along the row and a step to either row above change it differently.
        colour=((column - row // 2 - row) % 3).astype(np.int64),
        hexagons=np.asarray(shapely.polygons(corners)),
    )


def _place(rectangle: Rectangle, side_mm: float, half: Ints, third: Ints) -> Floats:
    return rectangle.to_world(
        half * (0.5 * SQRT3 * side_mm), third * (0.5 * side_mm) - 0.5 * rectangle.long_mm
    )


def planned_side_mm(area_mm2: float, perimeter_mm: float, spacing_mm: float) -> float:
    """Side of the hexagons from the area of a layer and its thickness (paper, introduction, point 2).

    The layer is divided into about :data:`ZONES` islands, none wider than the layer is thick on average
    (2 A / P); then the width between two sides is rounded to a whole number of beads, since d and the
    hatch go together: ``sqrt(3) d = m spacing``, m within :data:`BEADS_ACROSS`.

    Examples
    --------
    >>> round(planned_side_mm(30_000.0, 800.0, 4.32), 2)  # 300 x 100 mm, six beads across
    14.96
    """
    width = SQRT3 * math.sqrt(2.0 * area_mm2 / (3.0 * SQRT3 * ZONES))
    if perimeter_mm > 0:
        width = min(width, 2.0 * area_mm2 / perimeter_mm)
    fewest, most = BEADS_ACROSS
    beads = min(max(round(width / spacing_mm), fewest), most)
    return beads * spacing_mm / SQRT3

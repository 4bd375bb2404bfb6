"""Direction of the hatch in every island: no two that touch share one, also where slivers were merged or cells cut in two.

The colours of a lattice keep neighbouring cells apart, by multiples of `scan.island_angle_deg`. Islands are not
its cells any more: two parts of one cell may touch, and an island that took in a sliver reaches further. So
those that clash take another multiple, and, where a neighbour has each of them, one halfway between.

An island narrower than the spacing is filled along its long side, whatever its colour (:func:`ebamcheck.scan.filling.hatch.hatch`):
its neighbours turn away from it, but two of them that touch may share a direction, as two ends of one wall do.
"""

from __future__ import annotations

import math

import numpy as np
import shapely

from ebamcheck.geometry.regions import equivalent_rectangles_mm
from ebamcheck.numeric.rings import Bools, Floats, Ints
from ebamcheck.scan.islands.clipping import Cells, shared_borders
from ebamcheck.scan.islands.rectangle import minimum_rectangle

LEAST_TURN_DEG = 15.0
"""Directions closer than this count as one: a quarter of the usual turn, so that halves between always part."""

LEAST_SHARE = 0.25
"""A smaller turn from island to island that is asked for parts directions by this share of it."""

STEPS = np.concatenate([np.arange(12.0) + part for part in (0.0, 0.5, 0.25, 0.75)])
"""Turns that are tried, in this order, in steps of the angle that is set."""

ROUNDING_DEG = 1e-6


def hatch_directions(found: Cells, spacing_mm: float, turn_deg: float, island_angle_deg: float) -> Floats:
    """Direction of the lines of each island, (I,) rad.

    Parameters
    ----------
    spacing_mm
        Islands narrower than this are filled along their long side.
    turn_deg
        Direction of the first colour on this layer.
    island_angle_deg
        Turn from colour to colour; at a multiple of 180 all islands have the direction of the layer.
    """
    width, _ = equivalent_rectangles_mm(found.polygons)
    narrow = width < spacing_mm
    angle = turn_deg + island_angle_deg * found.colour.astype(np.float64)
    angle[narrow] = [long_direction_deg(island) for island in found.polygons[narrow]]
    least = least_turn_deg(island_angle_deg)
    if least > ROUNDING_DEG:
        pairs, _ = shared_borders(found.polygons)
        area = np.asarray(shapely.area(found.polygons), np.float64)
        for i in _clashing(pairs, angle, narrow, area, least):
            beside = np.concatenate([pairs[pairs[:, 0] == i, 1], pairs[pairs[:, 1] == i, 0]])
            tried = np.concatenate([angle[i : i + 1], turn_deg + island_angle_deg * STEPS])
            apart = turn_between_deg(tried[:, None], angle[beside]).min(axis=1)
            wide = np.flatnonzero(apart >= least - ROUNDING_DEG)
            angle[i] = tried[wide[0] if wide.size else np.argmax(apart)]
    return np.radians(angle)


def least_turn_deg(island_angle_deg: float) -> float:
    """Least angle between the hatches of two islands that touch."""
    turn = float(turn_between_deg(np.float64(island_angle_deg), np.float64(0.0)))
    return min(LEAST_TURN_DEG, LEAST_SHARE * turn)


def turn_between_deg(first: Floats | np.float64, second: Floats | np.float64) -> Floats:
    """Angle between two directions of lines, 0 to 90."""
    turn = np.abs(first - second) % 180.0
    return np.asarray(np.minimum(turn, 180.0 - turn), np.float64)


def long_direction_deg(island: shapely.Polygon) -> float:
    """Direction of the long side of the smallest rectangle around an island."""
    hull = shapely.get_coordinates(shapely.convex_hull(island))
    return math.degrees(minimum_rectangle(hull).angle_rad) + 90.0


def _clashing(pairs: Ints, angle: Floats, narrow: Bools, area: Floats, least_deg: float) -> list[int]:
    """Of each two that touch and share a direction the one that is to turn: not the narrow one, else the smaller."""
    a, b = pairs.T
    same = turn_between_deg(angle[a], angle[b]) < least_deg - ROUNDING_DEG
    a, b = (column[same & ~(narrow[a] & narrow[b])] for column in (a, b))
    first = np.where(narrow[a] | narrow[b], narrow[b], area[a] <= area[b])
    turned = np.unique(np.where(first, a, b))
    by_area: list[int] = turned[np.lexsort((turned, area[turned]))].tolist()
    return by_area

"""Lines along which a section is of one depth, by distances alone.

Who plans and writes contours takes them from an inset. Who reads and checks a program works out where they must lie in
another way: places straight in from every side, and around every inward corner, of which those count that no other side is nearer to.
"""

from __future__ import annotations

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from ebamcheck.geometry.nearest import distances, segments_of
from ebamcheck.numeric.rings import Floats, Ints

STEP_MM = 0.5  # Distance of the places that are tried along the sides
# Stretches into which the shortest side is parted: of a side of a small circle only the middle has the depth.
FEWEST = 4
# Angle between the places that are tried around an inward corner: chords of beads keep the depth within OFF_MM.
TURN_RAD = np.pi / 96.0
OFF_MM = 1e-3  # By how much less deep a place may be
HALVINGS = 8  # Halvings of the stretch in which a line ends


def depth_lines(section: BaseGeometry, depth_mm: float) -> Floats:
    """Sides (n, 4) of the lines along which a section is `depth_mm` deep: x0, y0, x1, y1, at most :data:`STEP_MM` apart along sides.

    Lines of neighbouring sides may lie on one another for a stretch, within :data:`OFF_MM`.

    Examples
    --------
    >>> lines = depth_lines(shapely.box(0, 0, 10, 8), 3.0)
    >>> np.round(np.hypot(*(lines[:, 2:] - lines[:, :2]).T).sum(), 2)
    np.float64(12.0)
    """
    if section.is_empty or depth_mm <= 0.0:
        return np.zeros((0, 4))
    sides = segments_of(shapely.boundary(section))
    shapely.prepare(section)

    def holds(places: Floats) -> np.ndarray:
        inside = shapely.contains_xy(section, places[:, 0], places[:, 1])
        inside[inside] = distances(places[inside], sides) >= depth_mm - OFF_MM
        return np.asarray(inside)

    places, line = _tried(section, depth_mm)
    good = holds(places)
    follows = line[1:] == line[:-1]
    a, b = places[:-1][follows], places[1:][follows]
    at_a, at_b = good[:-1][follows], good[1:][follows]
    ends = at_a != at_b
    inner = np.where(at_a[ends, None], a[ends], b[ends])
    outer = np.where(at_a[ends, None], b[ends], a[ends])
    first = inner
    for _ in range(HALVINGS):
        middle = 0.5 * (inner + outer)
        held = holds(middle)[:, None]
        inner, outer = np.where(held, middle, inner), np.where(held, outer, middle)
    whole = at_a & at_b
    return np.concatenate([np.hstack([a[whole], b[whole]]), np.hstack([first, inner])])


def _tried(section: BaseGeometry, depth_mm: float) -> tuple[Floats, Ints]:
    """Places (n, 2) at a distance from each side and inward corner, in order, and the line that each belongs to."""
    rings = shapely.get_rings(shapely.get_parts(shapely.orient_polygons(section)))
    points, ring = shapely.get_coordinates(rings, return_index=True)
    side = np.flatnonzero((ring[1:] == ring[:-1]) & (points[1:] != points[:-1]).any(axis=1))
    start, way, ring = points[side], points[side + 1] - points[side], ring[side]
    length = np.hypot(way[:, 0], way[:, 1])
    normal = np.column_stack([-way[:, 1], way[:, 0]]) / length[:, None]
    row, share = _shares(np.maximum(np.ceil(length / STEP_MM).astype(np.int64), FEWEST))
    along = start[row] + share[:, None] * way[row] + depth_mm * normal[row]
    # The side before each: of the first of a ring it is its last.
    before = np.arange(side.size) - 1
    first = np.flatnonzero(np.append(True, ring[1:] != ring[:-1]))
    before[first] = np.append(first[1:], side.size) - 1
    sine = normal[before, 0] * normal[:, 1] - normal[before, 1] * normal[:, 0]
    turn = np.arctan2(sine, (normal[before] * normal).sum(axis=1))
    inward = np.flatnonzero(turn < 0.0)
    corner, share = _shares(np.ceil(-turn[inward] / TURN_RAD).astype(np.int64))
    of = inward[corner]
    angle = np.arctan2(normal[before[of], 1], normal[before[of], 0]) + share * turn[of]
    around = start[of] + depth_mm * np.column_stack([np.cos(angle), np.sin(angle)])
    return np.concatenate([along, around]), np.concatenate([row, side.size + corner])


def _shares(count: Ints) -> tuple[Ints, Floats]:
    """Row of each of ``count + 1`` places a row, and where along it they are, from 0 to 1."""
    row = np.repeat(np.arange(count.size), count + 1)
    at = np.arange(row.size) - np.repeat(np.cumsum(count + 1) - count - 1, count + 1)
    return row, at / count[row]

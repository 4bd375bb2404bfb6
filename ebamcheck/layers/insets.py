"""Insets of regions, checked by distances: what lies deeper in a region than a distance.

GEOS finds an inset by sides that it moves inwards; by a rule of thumb it takes some of a few sides for turned over, and leaves
them out whole. So every inset is held against what must be true of it, by distances alone, and where it is not, the second
way is gone: the border of the region is widened, side by side, and taken away.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ebamcheck.errors import GeometryError
from ebamcheck.geometry.nearest import distances, segments_of
from ebamcheck.numeric.rings import Floats

if TYPE_CHECKING:
    # Loaded only where regions are made; most commands make none.
    from shapely.geometry.base import BaseGeometry

SIMPLIFIED = 0.01
"""Share of the distance by which GEOS simplifies a border before it moves it (``BufferParameters::simplifyFactor``)."""

SAMPLES = 4.0
"""Places at which an inset must have its border, on every stretch of a side as long as the distance."""

MOST_SAMPLES = 4096
"""Places tried at most, beside one for each side: where the distance is so small, hardly any area may be lacking."""

ROUNDING = 1e-12
"""Share of the coordinates that rounding may take."""

JUDGED = 1e-9
"""Share of the coordinates up to which a distance is mere rounding, and its inset is not judged."""


def eroded(region: BaseGeometry, distance_mm: float, quad_segs: int = 16) -> BaseGeometry:
    """Points of a region deeper than a distance: outward corners stay corners, inward ones become arcs.

    Parameters
    ----------
    region
        Polygon or multi-polygon, valid.
    distance_mm
        From the border, 0 or more.
    quad_segs
        Chords of a quarter turn.

    Raises
    ------
    GeometryError
        If both ways give something that is not the inset.

    Examples
    --------
    >>> import shapely
    >>> eroded(shapely.box(0, 0, 10, 8), 3.0).bounds
    (3.0, 3.0, 7.0, 5.0)
    """
    import shapely

    if distance_mm == 0.0 or region.is_empty:
        return region
    found = shapely.buffer(region, -distance_mm, quad_segs=quad_segs)
    if is_inset(found, region, distance_mm, quad_segs):
        return found
    parts = [_part_eroded(part, distance_mm, quad_segs) for part in shapely.get_parts(region)]
    return shapely.union_all(parts)


def _part_eroded(part: BaseGeometry, distance_mm: float, quad_segs: int) -> BaseGeometry:
    import shapely

    found: BaseGeometry = shapely.buffer(part, -distance_mm, quad_segs=quad_segs)
    if is_inset(found, part, distance_mm, quad_segs):
        return found
    start, end, _ = _sides(part)
    sides = shapely.linestrings(np.stack([start, end], axis=1))
    found = shapely.difference(
        part, shapely.union_all(shapely.buffer(sides, distance_mm, quad_segs=quad_segs))
    )
    if is_inset(found, part, distance_mm, quad_segs):
        return found
    x, y = shapely.get_coordinates(shapely.point_on_surface(part))[0].tolist()
    raise GeometryError(
        f"the inset by {distance_mm:g} mm of the region around ({x:.3f}, {y:.3f}) cannot be made (GEOS "
        f"{shapely.geos_version_string}): mend the contour there, or change the inset (scan.contour_offset_mm, "
        "process.bead_width_mm)"
    )


def is_inset(found: BaseGeometry, region: BaseGeometry, distance_mm: float, quad_segs: int = 16) -> bool:
    """Whether a region is the inset of another one by a distance, by what needs no offset.

    All of it lies in the other region, nowhere nearer to the border than the distance. Its area is no less than what a simple
    region loses at most (length of the border times the distance; Sz.-Nagy 1959: with more than one hole, a circle for each more).
    And places at that distance in from a side, if no other side is nearer, lie on its border: none of it is left out that is as
    large as a quarter of the distance.
    """
    import shapely

    if not np.isfinite(shapely.get_coordinates(found)).all():
        return False
    off = SIMPLIFIED + 1.0 - math.cos(0.25 * math.pi / quad_segs)
    border = shapely.boundary(region)
    shapely.prepare([border, region, found])
    scale = float(np.abs(shapely.bounds(region)).max())
    if distance_mm <= JUDGED * scale:
        return True
    rounding_mm = ROUNDING * scale
    if not found.is_empty:
        first = np.array([shapely.get_coordinates(part)[0] for part in shapely.get_parts(found)])
        inside = shapely.contains_xy(region, first[:, 0], first[:, 1]).all()
        least_mm = distance_mm * (1.0 - off) - rounding_mm
        if not inside or shapely.dwithin(border, found, least_mm):
            return False
    holes = int(shapely.get_num_interior_rings(shapely.get_parts(region)).sum())
    circles = math.pi * distance_mm**2 * max(holes - 1, 0)
    least_mm2 = region.area - region.length * distance_mm * (1.0 + off) - circles
    if found.area < least_mm2 - rounding_mm * region.length:
        return False
    depth_mm = distance_mm * (1.0 + 2.0 * off)
    places = _places_at(region, depth_mm, distance_mm / SAMPLES)
    lacking = places[~shapely.intersects_xy(found, places[:, 0], places[:, 1])]
    # Where a border folds back on itself within rounding, a place straight in from one side lies beyond the next, outside.
    lacking = lacking[shapely.contains_xy(region, lacking[:, 0], lacking[:, 1])]
    deep = distances(lacking, segments_of(border)) >= depth_mm - rounding_mm
    return not bool(deep.any())


def _places_at(region: BaseGeometry, depth_mm: float, step_mm: float) -> Floats:
    """Places (n, 2) straight in from the sides of a region, by a depth that they may not have: another side may be nearer."""
    start, end, inwards = _sides(region)
    length = np.hypot(*(end - start).T)
    count = np.ceil(length / max(step_mm, float(length.sum()) / MOST_SAMPLES)).astype(np.int64)
    side = np.repeat(np.arange(count.size), count)
    share = (np.arange(side.size) - np.repeat(np.cumsum(count) - count, count) + 0.5) / count[side]
    return np.asarray(start[side] + share[:, None] * (end - start)[side] + depth_mm * inwards[side])


def _sides(region: BaseGeometry) -> tuple[Floats, Floats, Floats]:
    """Start, end and unit normal inwards of every side of a region, (S, 2) each."""
    import shapely

    rings = shapely.get_rings(shapely.get_parts(shapely.orient_polygons(region)))
    points, ring = shapely.get_coordinates(rings, return_index=True)
    joined = np.flatnonzero((ring[1:] == ring[:-1]) & (points[1:] != points[:-1]).any(axis=1))
    start, end = points[joined], points[joined + 1]
    way = end - start
    inwards = np.column_stack([-way[:, 1], way[:, 0]]) / np.hypot(way[:, 0], way[:, 1])[:, None]
    return start, end, inwards

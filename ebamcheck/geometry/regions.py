"""Regions of layers: their polygons, sections, insets, mean widths, and the ground under beads.

GEOS finds an inset by sides that it moves inwards; by a rule of thumb it takes some of a few sides for turned over, and leaves
them out whole. So every inset is held against what must be true of it, by distances alone, and where it is not, the second
way is gone: the border of the region is widened, side by side, and taken away.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from ebamcheck.errors import GeometryError
from ebamcheck.geometry.nearest import distances, segments_of
from ebamcheck.kernels import Floats, Ints

# Chords in a quarter turn around an inward corner. Arcs, not mitres: they keep the distance exactly, the gun goes around without a
# stop, and mitred offsets of GEOS 3.14 lose whole regions or grow NaN points
ARC_SEGMENTS = 16
NO_WIDTH_MM = 1e-3  # an inset region narrower than this on average has vanished but for rounding
# Overlap at which a region grown back over another counts as covering it: far under any bead, far over the rounding of offsets, so
# that differences leave no slivers along common borders
JOIN_MM = 1e-3
WALL_ASPECT = 2.0  # least length over width of a thin wall; rounder pieces are small solids
POLYGON = 3  # type of a polygon among shapely's geometries; collections have the greater ones
# Share of the distance by which GEOS simplifies a border before it moves it (``BufferParameters::simplifyFactor``)
SIMPLIFIED = 0.01
# Places at which an inset must have its border, on every stretch of a side as long as the distance
SAMPLES = 4.0
# Places tried at most, beside one for each side: where the distance is so small, hardly any area may be lacking
MOST_SAMPLES = 4096
ROUNDING = 1e-12  # share of the coordinates that rounding may take
JUDGED = 1e-9  # share of the coordinates up to which a distance is mere rounding, and its inset is not judged


def valid_polygons(geometry: BaseGeometry) -> list[shapely.Polygon]:
    """Polygons with area in a geometry; invalid ones are made valid."""
    if not geometry.is_valid:
        geometry = shapely.make_valid(geometry)
    parts = shapely.get_parts(geometry)
    kind = shapely.get_type_id(parts)
    if (kind > POLYGON).any():
        return [polygon for part in parts for polygon in valid_polygons(part)]
    found: list[shapely.Polygon] = parts[(kind == POLYGON) & (shapely.area(parts) > 0.0)].tolist()
    return found


def layer_section(polygons: BaseGeometry | Iterable[BaseGeometry]) -> BaseGeometry:
    """Return the solid region of a layer as one valid geometry; overlapping polygons unite.

    Raises
    ------
    GeometryError
        If a coordinate is not finite, or something else than a geometry is given.
    """
    given = [polygons] if isinstance(polygons, BaseGeometry) else list(polygons)
    for number, geometry in enumerate(given):
        if not isinstance(geometry, BaseGeometry):
            raise GeometryError(
                f"polygon {number} of the layer is a {type(geometry).__name__}, not a shapely geometry: "
                "give those of one layer, such as layers.polygons(3)"
            )
        if not np.isfinite(shapely.get_coordinates(geometry)).all():
            raise GeometryError(f"polygon {number} of the layer has a coordinate that is not finite: mend the contour")
    parts = [part for geometry in given for part in valid_polygons(geometry)]
    if len(parts) > 1:
        return shapely.union_all(parts)
    return parts[0] if parts else shapely.Polygon()


def equivalent_rectangles_mm(polygons: Sequence[BaseGeometry] | NDArray[np.object_]) -> tuple[Floats, Floats]:
    """Width and length (I,) of the rectangle with the same area and the same border length as a polygon.

    A wall that is bent, or closed to a ring, has the width and length of the straight one; anything
    rounder than a square counts as a square of its border length.
    """
    geometries = np.asarray(polygons, object).reshape(-1)
    quarter, area = 0.25 * shapely.length(geometries), shapely.area(geometries)
    length = quarter + np.sqrt(np.maximum(quarter**2 - area, 0.0))
    width = np.divide(area, length, out=np.zeros_like(length), where=length > 0)
    return width, length


def mean_width_mm(polygon: BaseGeometry) -> float:
    """Width of a polygon as of a wall, see :func:`equivalent_rectangles_mm`."""
    width, _ = equivalent_rectangles_mm([polygon])
    return float(width[0])


def aspect(polygon: BaseGeometry) -> float:
    """Length over width of a polygon as of a wall; infinite without width."""
    width, length = equivalent_rectangles_mm([polygon])
    return float(length[0] / width[0]) if width[0] > 0 else math.inf


def ring_columns(islands: NDArray[np.object_]) -> tuple[Floats, tuple[Ints, Ints]]:
    """Points (N, 2) of all rings, first row of each ring (R + 1,), first ring of each polygon (I + 1,)."""
    if not islands.size:
        return np.zeros((0, 2)), (np.zeros(1, np.int64), np.zeros(1, np.int64))
    kind, points, offsets = shapely.to_ragged_array(islands)
    if kind == shapely.GeometryType.MULTIPOLYGON:  # pragma: no cover - islands are polygons
        raise TypeError("islands must be polygons")
    ring_starts, island_rings = (np.asarray(o, np.int64) for o in offsets)
    return np.ascontiguousarray(points, np.float64), (ring_starts, island_rings)


def inset(region: BaseGeometry, distance_mm: float) -> BaseGeometry:
    """Points of a region deeper than a distance: outward corners stay corners, inward ones become arcs.

    Parts that vanish but for rounding are left out.
    """
    parts = valid_polygons(eroded(region, distance_mm, ARC_SEGMENTS))
    return shapely.MultiPolygon([p for p in parts if mean_width_mm(p) > NO_WIDTH_MM])


def eroded(region: BaseGeometry, distance_mm: float, quad_segs: int = 16) -> BaseGeometry:
    """Points of a valid region deeper than a distance: outward corners stay corners, inward ones become arcs.

    Raises :class:`GeometryError` if both ways to make it give something that is not the inset.

    Examples
    --------
    >>> eroded(shapely.box(0, 0, 10, 8), 3.0).bounds
    (3.0, 3.0, 7.0, 5.0)
    """
    if distance_mm == 0.0 or region.is_empty:
        return region
    found = shapely.buffer(region, -distance_mm, quad_segs=quad_segs)
    if is_inset(found, region, distance_mm, quad_segs):
        return found
    parts = [_part_eroded(part, distance_mm, quad_segs) for part in shapely.get_parts(region)]
    return shapely.union_all(parts)


def _part_eroded(part: BaseGeometry, distance_mm: float, quad_segs: int) -> BaseGeometry:
    found: BaseGeometry = shapely.buffer(part, -distance_mm, quad_segs=quad_segs)
    if is_inset(found, part, distance_mm, quad_segs):
        return found
    start, end, _ = _sides(part)
    sides = shapely.linestrings(np.stack([start, end], axis=1))
    found = shapely.difference(part, shapely.union_all(shapely.buffer(sides, distance_mm, quad_segs=quad_segs)))
    if is_inset(found, part, distance_mm, quad_segs):
        return found
    with np.errstate(over="ignore"):  # of slivers, whose place is found all the same
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
    rings = shapely.get_rings(shapely.get_parts(shapely.orient_polygons(region)))
    points, ring = shapely.get_coordinates(rings, return_index=True)
    joined = np.flatnonzero((ring[1:] == ring[:-1]) & (points[1:] != points[:-1]).any(axis=1))
    start, end = points[joined], points[joined + 1]
    way = end - start
    inwards = np.column_stack([-way[:, 1], way[:, 0]]) / np.hypot(way[:, 0], way[:, 1])[:, None]
    return start, end, inwards


def split_thin(
    region: BaseGeometry, width_mm: float, crumb_mm2: float
) -> tuple[list[shapely.Polygon], list[shapely.Polygon]]:
    """Split a region into solids and parts narrower than `width_mm`, by opening.

    The core is the region eroded by half the width and grown back; what it does not reach is thin.
    Crumbs (corners) and pieces that are not longer than wide go back to the solids.

    Returns
    -------
    solids, thin
        Polygons that together are the region.
    """
    grown_mm = 0.5 * width_mm + JOIN_MM
    core = shapely.buffer(eroded(region, 0.5 * width_mm, ARC_SEGMENTS), grown_mm, quad_segs=ARC_SEGMENTS)
    pieces = valid_polygons(region if core.is_empty else shapely.difference(region, core))
    thin = [p for p in pieces if p.area >= crumb_mm2 and aspect(p) >= WALL_ASPECT]
    if not thin:
        return valid_polygons(region), []
    if core.is_empty and len(thin) == len(pieces):
        return [], thin
    # The core takes the rim by which it was overgrown: solids and thin parts share their border exactly.
    solids = valid_polygons(shapely.difference(region, shapely.union_all(thin)))
    return [p for p in solids if mean_width_mm(p) > NO_WIDTH_MM], thin


def ground(lines: NDArray[np.object_], bead_width_mm: float) -> BaseGeometry:
    """Ground under beads along lines (S,); they end in half discs.

    Lines that follow each other are widened as one: ten times as fast as one by one.
    """
    of_points = lines[shapely.length(lines) == 0.0]  # merging would drop them
    chains = shapely.get_parts(shapely.line_merge(shapely.multilinestrings(lines)))
    beads = shapely.buffer([*chains, *of_points], 0.5 * bead_width_mm, quad_segs=2 * ARC_SEGMENTS)
    return shapely.union_all(beads)

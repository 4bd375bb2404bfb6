"""Sections of a mesh by plain means: segments, polygons of their arrangement, winding numbers.

The reference of the kit for any mesh. It shares no code with a slicer, works in float64 and takes time
with the number of segments squared, so it is for small parts.
"""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray
from shapely.geometry.base import BaseGeometry

from ebamcheck.layers.stack import Layers, from_polygons
from ebamcheck.mesh.part import Part

WindingRule = Callable[[int], bool]
"""Whether a winding number is solid."""

HOUSE_RULE = "winding > 0"


def winding_rule(text: str) -> WindingRule | None:
    """Read an inside rule: ``winding > 0``, ``winding != 0``, ``odd`` or a range ``1..2``; None for any other.

    Examples
    --------
    >>> [w for w in range(-1, 4) if winding_rule("1..2")(w)]
    [1, 2]
    """
    if text == HOUSE_RULE:
        return house_rule
    if text == "winding != 0":
        return lambda count: count != 0
    if text == "odd":
        return lambda count: count % 2 == 1
    span = re.fullmatch(r"(-?\d+)\.\.(-?\d+)", text)
    if span is None:
        return None
    low, high = int(span[1]), int(span[2])
    return lambda count: low <= count <= high


def house_rule(winding: int) -> bool:
    """Overlapping shells unite; what is inside out is empty."""
    return winding > 0


def segments(part: Part, height: float) -> NDArray[np.float64]:
    """Directed segments of the plane z = height + 0, (S, 2, 2) mm, material on the left.

    An edge is cut where ``min <= height < max``; the crossing is computed from its lower vertex, so that
    both facets of an edge give the same point.
    """
    corners = part.triangles
    above = corners[:, :, 2] > height
    crossing = above.any(axis=1) & ~above.all(axis=1)
    corners, above = corners[crossing], above[crossing]
    found = np.empty((len(corners), 2, 2))
    for tail, head in ((0, 1), (1, 2), (2, 0)):
        for end, rising in enumerate((False, True)):
            rows = np.flatnonzero((above[:, tail] != above[:, head]) & (above[:, head] == rising))
            lower = corners[rows, tail if rising else head]
            upper = corners[rows, head if rising else tail]
            t = (height - lower[:, 2]) / (upper[:, 2] - lower[:, 2])
            found[rows, end] = lower[:, :2] + t[:, None] * (upper - lower)[:, :2]
    return found


def winding_number(cut: NDArray[np.float64], x: float, y: float) -> int:
    """Winding number of closed directed segments about a point."""
    (x0, y0), (x1, y1) = cut[:, 0].T, cut[:, 1].T
    side = (x1 - x0) * (y - y0) - (x - x0) * (y1 - y0)
    upward = (y0 <= y) & (y < y1) & (side > 0)
    downward = (y1 <= y) & (y < y0) & (side < 0)
    return int(np.count_nonzero(upward) - np.count_nonzero(downward))


def section(part: Part, height: float, rule: WindingRule) -> list[shapely.Polygon]:
    """Solid regions of a closed part in the plane z = height + 0."""
    cut = segments(part, height)
    cut = cut[(cut[:, 0] != cut[:, 1]).any(axis=1)]
    if not len(cut):
        return []
    lines = shapely.node(shapely.multilinestrings(shapely.linestrings(cut)))
    cells = shapely.get_parts(shapely.polygonize([lines]))
    middles = shapely.get_coordinates(shapely.point_on_surface(cells))
    solid = [cell for cell, (x, y) in zip(cells, middles, strict=True) if rule(winding_number(cut, x, y))]
    return polygons_of(shapely.union_all(solid))


def sections(part: Part, heights: ArrayLike, rule: WindingRule) -> Layers:
    """Sections of a closed part as layers, one a height."""
    planes = np.asarray(heights, dtype=np.float64).reshape(-1)
    return from_polygons(planes, [section(part, h, rule) for h in planes.tolist()], part=part.sha256)


def polygons_of(geometry: BaseGeometry) -> list[shapely.Polygon]:
    """Polygons with area in a geometry."""
    return [g for g in shapely.get_parts(geometry) if g.geom_type == "Polygon" and g.area > 0.0]


def region(layers: Layers, layer: int) -> BaseGeometry:
    """Union of the solid regions of a layer."""
    return shapely.union_all(layers.polygons(layer))

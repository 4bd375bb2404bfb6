"""The polygons with area in any shapely geometry, made valid."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    # Loaded only where polygons are made; most commands make none.
    import shapely
    from shapely.geometry.base import BaseGeometry

POLYGON = 3
"""Type of a polygon among shapely's geometries; collections have the greater ones."""


def valid_polygons(geometry: BaseGeometry) -> list[shapely.Polygon]:
    """Polygons with area in a geometry; invalid ones are made valid."""
    import shapely

    if not geometry.is_valid:
        geometry = shapely.make_valid(geometry)
    parts = shapely.get_parts(geometry)
    kind = shapely.get_type_id(parts)
    if (kind > POLYGON).any():
        return [polygon for part in parts for polygon in valid_polygons(part)]
    found: list[shapely.Polygon] = parts[(kind == POLYGON) & (shapely.area(parts) > 0.0)].tolist()
    return found

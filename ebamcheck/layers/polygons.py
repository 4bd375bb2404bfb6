"""The polygons with area in any shapely geometry, made valid."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    # Loaded only where polygons are made; most commands make none.
    import shapely
    from shapely.geometry.base import BaseGeometry


def valid_polygons(geometry: BaseGeometry) -> list[shapely.Polygon]:
    """Polygons with area in a geometry; invalid ones are made valid."""
    import shapely

    if not geometry.is_valid:
        geometry = shapely.make_valid(geometry)
    parts = shapely.get_parts(geometry)
    if any(part.geom_type == "GeometryCollection" or part.geom_type.startswith("Multi") for part in parts):
        return [polygon for part in parts for polygon in valid_polygons(part)]
    return [part for part in parts if part.geom_type == "Polygon" and part.area > 0]

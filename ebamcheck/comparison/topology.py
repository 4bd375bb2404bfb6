"""Whether two regions have the same outer rings and holes once thin features are set aside.

A feature thinner than twice the limit (a sliver, a neck, a slit, a pore) may rightly be in one region and
not in the other. So each region is counted with its thin features and without: as it is, without the pieces and holes
that are thin throughout, opened by the limit (thin solids gone), closed by it (thin gaps gone), and both in either
order. The two agree if their ranges of the number of outer rings overlap, and their ranges of the number of holes too.

A piece of a wedge that is just thinner than that in one region may be up to twice as thick in the other, cut off from it by
necks that are gone. Regions that do not agree are therefore counted once more at twice the limit. No fault hides there: a
feature thicker than ``2 r`` that one of two regions lacks has a depth of more than `r`, which has a limit of its own.
"""

from __future__ import annotations

import shapely
from shapely.geometry.base import BaseGeometry

from ebamcheck.geometry.regions import eroded
from ebamcheck.layers.stack import Layers

ARC_SEGMENTS = 4
"""Segments a quarter circle in the offsets: their radius is right to 2 %."""

Counts = tuple[range, range]
"""Range of the number of outer rings, and of holes."""


def topologies_agree(a: Layers, b: Layers, layer: int, limit_mm: float) -> bool:
    """Whether a layer's outer rings and holes agree once features thinner than ``2 limit_mm`` in either are set aside."""
    return regions_agree(a.section(layer), b.section(layer), limit_mm)


def regions_agree(a: BaseGeometry, b: BaseGeometry, limit_mm: float) -> bool:
    """Whether two regions whose boundaries are within a limit of each other have the same outer rings and holes.

    Examples
    --------
    >>> block = shapely.box(-9, -5, 0, 5)
    >>> fin = block.union(shapely.box(0, -0.55, 20, 0.55))
    >>> broken = block.union(shapely.box(10, -0.65, 14, 0.65))
    >>> regions_agree(fin, broken, 0.6), regions_agree(fin, broken, 0.3)
    (True, False)
    """
    for radius_mm in (limit_mm, 2.0 * limit_mm):
        (outer_a, holes_a), (outer_b, holes_b) = thin_counts(a, radius_mm), thin_counts(b, radius_mm)
        if _overlap(outer_a, outer_b) and _overlap(holes_a, holes_b):
            return True
    return False


def thin_counts(solid: BaseGeometry, limit_mm: float) -> Counts:
    """Ranges of the number of outer rings and of holes, with thin features kept or set aside."""
    variants = [solid]
    if limit_mm > 0.0 and not solid.is_empty:
        opened = _closed(solid, -limit_mm)
        closed = _closed(solid, limit_mm)
        variants += [opened, closed, _closed(opened, limit_mm), _closed(closed, -limit_mm)]
    counts = [_counts(variant) for variant in variants]
    counts.append(_counts(solid, limit_mm))
    outer, holes = [c[0] for c in counts], [c[1] for c in counts]
    return range(min(outer), max(outer) + 1), range(min(holes), max(holes) + 1)


def _closed(solid: BaseGeometry, by_mm: float) -> BaseGeometry:
    """Region closed by a distance, or opened where it is negative."""
    if by_mm < 0.0:
        return eroded(solid, -by_mm, ARC_SEGMENTS).buffer(-by_mm, quad_segs=ARC_SEGMENTS)
    return eroded(solid.buffer(by_mm, quad_segs=ARC_SEGMENTS), by_mm, ARC_SEGMENTS)


def _counts(solid: BaseGeometry, thin_mm: float = 0.0) -> tuple[int, int]:
    """Polygons and holes of a region, without those that a circle of radius `thin_mm` fits into nowhere."""
    polygons = [p for p in shapely.get_parts(solid) if p.geom_type == "Polygon" and not p.is_empty]
    holes = [shapely.Polygon(ring) for polygon in polygons for ring in polygon.interiors]
    if thin_mm > 0.0:
        polygons, holes = (
            [p for p in those if not eroded(p, thin_mm, ARC_SEGMENTS).is_empty] for those in (polygons, holes)
        )
    return len(polygons), len(holes)


def _overlap(a: range, b: range) -> bool:
    return a.start < b.stop and b.start < a.stop

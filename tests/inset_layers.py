"""Layers inset by an offset: centre lines of contour beads by shapely alone."""

from __future__ import annotations

from ebamcheck.geometry.regions import inset, valid_polygons
from ebamcheck.layers.stack import Layers, from_polygons


def contour_paths(layers: Layers, offset_mm: float) -> Layers:
    """Centre lines of the contour beads: every layer's solid region inset by `offset_mm`.

    Outward corners stay corners, inward ones are rounded by the offset; points along curves stay as
    dense as they were. A layer whose region vanishes is empty. The labels (part, direction, slicer) are those of `layers`;
    the settings name the offset. Open paths bound no region and are left out.
    """
    stack = []
    for k in range(len(layers)):
        region = inset(layers.section(k), offset_mm)
        stack.append(valid_polygons(region))
    return from_polygons(
        layers.heights,
        stack,
        part=layers.part,
        direction=layers.direction,
        backend=layers.backend,
        settings={**layers.settings, "contour_offset_mm": offset_mm},
    )

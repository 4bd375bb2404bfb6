"""What beads leave bare of a region: found on a grid of samples, and cut out exactly where it is wide enough to ask for."""

from __future__ import annotations

import numpy as np
import shapely
from scipy import ndimage
from shapely.geometry.base import BaseGeometry

from ebamcheck.geometry.raster import BareSamples, bare_samples
from ebamcheck.geometry.regions import ground, valid_polygons
from ebamcheck.numeric.rings import Floats

MARGIN = 2
"""Samples by which the box around a patch is wider than the patch: what is bare between its samples and the next ones."""


def widest_part(
    region: BaseGeometry, segments: Floats, bead_width_mm: float, wider_than_mm: float = 0.0
) -> tuple[float, shapely.Polygon | None]:
    """Find the widest part of a region that lies further than half a bead width from every segment.

    Only beads that reach a patch of bare samples are laid there, so that a few bare spots of a layer of a thousand beads
    cost no union of a thousand. What holds no sample, no wider than one and a half steps of them, is left out.

    Parameters
    ----------
    region
        Polygon or multi-polygon.
    segments
        (S, 4) x0, y0, x1, y1 of the centre lines of the beads, mm; beads end in half discs.
    bead_width_mm
        Width of the beads.
    wider_than_mm
        Width that is asked for: patches come the widest first, and those that cannot hold a circle of that diameter, or
        of that of a part found already, are not cut out.

    Returns
    -------
    tuple
        Diameter of the largest circle in the part, mm, and the part, within the box around its patch; `wider_than_mm`
        and None where none is wider.
    """
    bare = bare_samples(region, segments, bead_width_mm)
    widest_mm, widest = wider_than_mm, None
    if bare.covered == 1.0:
        return widest_mm, widest
    boxes, most_mm = _patches(bare)
    lines = np.asarray(shapely.linestrings(segments.reshape(-1, 2, 2)), object)
    tree = shapely.STRtree(lines)
    for n in np.argsort(-most_mm, kind="stable"):
        if most_mm[n] <= widest_mm:
            break
        near = np.sort(tree.query(boxes[n], predicate="dwithin", distance=0.5 * bead_width_mm))
        beads = ground(lines[near], bead_width_mm)
        left = shapely.difference(shapely.intersection(region, boxes[n]), beads)
        for part in valid_polygons(left):
            across_mm = 2.0 * float(shapely.length(shapely.maximum_inscribed_circle(part)))
            if across_mm > widest_mm:
                widest_mm, widest = across_mm, part
    return widest_mm, widest


def _patches(bare: BareSamples) -> tuple[np.ndarray, Floats]:
    """Boxes (P,) around patches of bare samples that touch, and the widest circle that each could hold, mm."""
    labels, _ = ndimage.label(bare.grid, structure=np.ones((3, 3)))
    places = [place for place in ndimage.find_objects(labels) if place is not None]
    low = np.array([(x.start, y.start) for y, x in places], np.float64).reshape(-1, 2) - MARGIN
    high = np.array([(x.stop, y.stop) for y, x in places], np.float64).reshape(-1, 2) + MARGIN
    corners = np.hstack([low, high]) * bare.step_mm + np.tile(bare.origin, 2)
    return np.asarray(shapely.box(*corners.T), object), bare.step_mm * (high - low).min(axis=1)

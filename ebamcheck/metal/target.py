"""The metal that a layer is to have: the exact share of a section in each cell of a grid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from ebamcheck.geometry.raster import cell_shares, oriented_rings
from ebamcheck.geometry.regions import valid_polygons
from ebamcheck.numeric.rings import Floats

CELLS_PER_BEAD = 6
"""Cells across a bead: a third of the half bead that a height field has to resolve."""

ROUNDING = 1e-9
"""Shares under this are the rounding of a sum along a row of cells."""

REACHED = 0.07
"""Height of metal over that of the layer under which a place is bare: the tip of a corner, which no bead builds."""

MOST_CELLS = 4_000_000
"""Cells of one layer at most; a larger one gets coarser cells."""


@dataclass(frozen=True, eq=False)
class Target:
    """Cells around a section.

    Parameters
    ----------
    origin
        (2,) lower left corner, a whole number of cells from the origin of the part, mm.
    step_mm
        Width of a cell.
    share
        (rows, columns) share of each cell that lies in the section.
    """

    origin: Floats
    step_mm: float
    share: Floats


def cell_mm(bounds: Floats, bead_width_mm: float) -> float:
    """Width of cells for a layer or a part of the given bounds (x0, y0, x1, y1)."""
    box = float((bounds[2] - bounds[0] + 2.0 * bead_width_mm) * (bounds[3] - bounds[1] + 2.0 * bead_width_mm))
    return float(max(bead_width_mm / CELLS_PER_BEAD, np.sqrt(box / MOST_CELLS)))


def target_of(section: BaseGeometry, step_mm: float, margin_mm: float) -> Target:
    """Lay cells over a section and a margin around it; raises nothing for an empty one, which has no cells.

    Examples
    --------
    >>> found = target_of(shapely.box(0.0, 0.0, 2.5, 2.0), 1.0, 1.0)
    >>> float(found.share.sum())
    5.0
    """
    polygons = np.array(valid_polygons(section), object)
    if not polygons.size:
        return Target(np.zeros(2), step_mm, np.zeros((0, 0)))
    x0, y0, x1, y1 = shapely.total_bounds(polygons)
    low = np.floor((np.array([x0, y0]) - margin_mm) / step_mm)
    columns, rows = (np.ceil((np.array([x1, y1]) + margin_mm) / step_mm) - low).astype(np.int64).tolist()
    origin = low * step_mm
    points, (ring_starts, _) = oriented_rings(polygons, origin, np.full(2, step_mm))
    share = np.clip(cell_shares(points, ring_starts, rows, columns), 0.0, 1.0)
    share[share < ROUNDING] = 0.0
    return Target(origin, step_mm, share)

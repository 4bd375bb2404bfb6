"""Metal of a layer on a grid, pool by pool: each place along a bead shares its metal between the cells around it.

Slower to build widths on than :mod:`ebamcheck.metal.footprints`, which knows each bead by itself, but free of the steps that come from
whether the middle of a cell lies within a pool: a tip that gets a film of metal is part of the surface, and has to be known as that.
"""

from __future__ import annotations

import math

import numpy as np
from scipy import ndimage

from ebamcheck.numeric.rings import Floats


def pooled(
    places: Floats, area_mm2: Floats, radius: float, shape: tuple[int, ...], cell_mm2: float
) -> Floats:
    """Height of the metal in each cell, over that of the layer.

    Parameters
    ----------
    places
        (n, 2) places along beads, in cells from the lower left corner of the grid.
    area_mm2
        (n,) metal that each stands for, over the height of the layer.
    radius
        Half the width of the pool, in cells.
    shape, cell_mm2
        Rows and columns of the grid, and area of a cell. Metal beside the grid is left out.

    Examples
    --------
    >>> laid = pooled(np.array([[4.5, 4.5]]), np.array([2.0]), 3.0, (9, 9), 1.0)
    >>> round(float(laid.sum()), 9), bool(laid.argmax() == 40)
    (2.0, True)
    """
    rows, columns = shape
    corner = np.floor(places - 0.5)
    part = places - 0.5 - corner
    x, y = corner.astype(np.int64).T
    found = np.zeros(rows * columns)
    for right, along in ((0, 1.0 - part[:, 0]), (1, part[:, 0])):
        for up, across in ((0, 1.0 - part[:, 1]), (1, part[:, 1])):
            held = (x + right >= 0) & (x + right < columns) & (y + up >= 0) & (y + up < rows)
            cell = (y + up) * columns + x + right
            found += np.bincount(cell[held], (area_mm2 * along * across)[held], minlength=found.size)
    reach = math.ceil(radius)
    away = np.hypot(*np.mgrid[-reach : reach + 1, -reach : reach + 1])
    pool = np.sqrt(np.maximum(radius**2 - away**2, 0.0))
    laid = ndimage.convolve(found.reshape(rows, columns) / cell_mm2, pool / pool.sum(), mode="constant")
    return np.asarray(laid, np.float64)

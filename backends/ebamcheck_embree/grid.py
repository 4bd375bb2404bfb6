"""The grid of rays: where its lines lie, and its default cell."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ebamcheck.errors import SettingsError
from ebamcheck.kernels import Floats
from ebamcheck.mesh.part import Part

USUAL_CELL_MM = 0.1  # cell for a part of usual size: the pixel of the paper (section 2.2)
# Cells along the longer side: at least the order of the paper's image, at most what bounds the cost of a layer
COARSE_LINES, FINE_LINES = 1024, 4096
# Most lines of a grid: more come from a mistyped cell and would not fit into memory
LARGEST_LINE_COUNT = 65_536

# Fractions of a cell by which the lines are offset from the part's box: parts are drawn in round numbers, on which lines must not lie.
# About 2 - golden ratio, and (5 - sqrt 5) / 10
OFFSET_X, OFFSET_Y = 0.381966, 0.276393


class Grid(NamedTuple):
    """Nodes ``(x0 + i cell, y0 + j cell)``, mm from the centre of the part; the outermost lie outside the part."""

    x0_mm: float
    y0_mm: float
    cell_mm: float
    columns: int
    rows: int

    @property
    def column_x_mm(self) -> Floats:
        """x of each column of nodes, (columns,) mm."""
        return self.x0_mm + self.cell_mm * np.arange(self.columns, dtype=np.float64)

    @property
    def row_y_mm(self) -> Floats:
        """y of each row of nodes, (rows,) mm."""
        return self.y0_mm + self.cell_mm * np.arange(self.rows, dtype=np.float64)


def automatic_cell_mm(part: Part) -> float:
    """Cell for a part: its longer side over 1024, at most 0.1 mm, but at least that side over 4096."""
    side = float(part.size[:2].max(initial=0.0))
    return max(min(side / COARSE_LINES, USUAL_CELL_MM), side / FINE_LINES) if side else USUAL_CELL_MM


def grid_over(part: Part, cell_mm: float) -> Grid:
    """Lay the grid over the box of a part; :class:`SettingsError` where the cell is too fine for it."""
    (x0, y0, _), (x1, y1, _) = part.bounds - part.bounds.mean(axis=0)
    cells = max(x1 - x0, y1 - y0) / cell_mm
    if cells > LARGEST_LINE_COUNT - 4:
        raise SettingsError(
            f"backend 'embree', setting 'grid_mm': {cell_mm:g} mm gives {cells:.3g} cells along {part.name!r}; "
            f"leave it out for {automatic_cell_mm(part):.3g} mm, or give a larger one"
        )
    left, bottom = x0 - (1.0 + OFFSET_X) * cell_mm, y0 - (1.0 + OFFSET_Y) * cell_mm
    columns = math.ceil((x1 - left) / cell_mm) + 2
    rows = math.ceil((y1 - bottom) / cell_mm) + 2
    return Grid(float(left), float(bottom), cell_mm, columns, rows)

"""Rays in the plane of each layer, along the rows and the columns of the grid."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ebamcheck.backend import Progress
from ebamcheck.part import Part
from ebamcheck_embree.crossings import RayBorders
from ebamcheck_embree.grid import Grid
from ebamcheck_embree.knots import Lattice, RowKnots, row_knots
from ebamcheck_embree.marching import contours
from ebamcheck_embree.scene import Floats, Hits, Singles
from ebamcheck_embree.stack import LayerRings, Rays


class InPlaneRays(Rays):
    """Every grid edge that the contour crosses is crossed where the mesh's own section crosses it."""

    def __init__(self, part: Part, grid: Grid, rays_per_call: int, labels: Mapping[str, Any]) -> None:
        super().__init__(part, grid, rays_per_call, labels)
        self._borders = RayBorders(self.vertices, self.faces)
        self._origins = _line_origins(grid, part)

    def cut(self, z_mm: Floats, report: Progress) -> list[LayerRings]:
        """Cut by casting the rays of as many layers at once as one call may hold."""
        count = self.grid.rows + self.grid.columns
        together = max(1, self.rays_per_call // count)
        found: list[LayerRings] = []
        for start in range(0, len(z_mm), together):
            heights = z_mm[start : start + together]
            found.extend(self._cut_together(heights))
            report(len(heights))
        return found

    def _cut_together(self, z_mm: Floats) -> list[LayerRings]:
        row_origins, column_origins = self._origins
        along_x = self.scene.facets_along(_at_heights(row_origins, z_mm), axis=0)
        along_y = self.scene.facets_along(_at_heights(column_origins, z_mm), axis=1)
        return [
            self._layer(
                float(z), _of_layer(along_x, k, self.grid.rows), _of_layer(along_y, k, self.grid.columns)
            )
            for k, z in enumerate(z_mm)
        ]

    def _layer(self, z: float, along_x: Hits, along_y: Hits) -> LayerRings:
        grid = self.grid
        rows, columns = self._borders.of_layer(z, grid.row_y_mm, along_x, grid.column_x_mm, along_y)
        lattice: Lattice = (grid.x0_mm, grid.y0_mm, grid.cell_mm, grid.columns, grid.rows)
        knots = RowKnots(*row_knots(lattice, rows[:4], columns[:4]))
        corners = rows.simple and columns.simple
        points, starts = contours(grid, knots, columns[:4], (self.vertices, self.faces), z, corners)
        return LayerRings(points, starts, int((~rows.sound).sum() + (~columns.sound).sum()))


def _line_origins(grid: Grid, part: Part) -> tuple[Singles, Singles]:
    """Where the rays of the rows and of the columns start, z left open; outside the part's box."""
    rows = np.zeros((grid.rows, 3), np.float32)
    rows[:, 0] = grid.x0_mm - 0.01 * float(part.size[0])
    rows[:, 1] = grid.row_y_mm
    columns = np.zeros((grid.columns, 3), np.float32)
    columns[:, 0] = grid.column_x_mm
    columns[:, 1] = grid.y0_mm - 0.01 * float(part.size[1])
    return rows, columns


def _at_heights(origins: Singles, z_mm: Floats) -> Singles:
    """Repeat the rays of one layer at several heights."""
    repeated = np.tile(origins, (len(z_mm), 1))
    repeated[:, 2] = np.repeat(z_mm.astype(np.float32), len(origins))
    return repeated


def _of_layer(hits: Hits, k: int, rays: int) -> Hits:
    """Hits of the k-th layer of those cast together."""
    starts = hits.starts[k * rays : (k + 1) * rays + 1]
    return Hits(starts - starts[0], hits.facets[starts[0] : starts[-1]])

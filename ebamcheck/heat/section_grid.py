"""A section on a grid of cells: the exact area of each cell inside it, and the exact open length of each face.

Areas and face lengths are sums over the border (Green's theorem), cell by cell. Nothing is sampled, so no
area is lost or gained, and a wall thinner than a cell still conducts along its length.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy import sparse

from ebamcheck.geometry.raster import cell_shares, face_shares, islands_in_cells, oriented_rings
from ebamcheck.numeric.rings import Floats, Ints

LEAST_SHARE = 1e-6
"""Least share of a cell or face in the section; with less it is left out, as irrelevant for heat."""


@dataclass(frozen=True, eq=False)
class SectionGrid:
    """Cells of a section.

    Parameters
    ----------
    origin, step
        (2,) lower left corner, and width and height of a cell, mm.
    number
        (rows, columns) number of each cell, -1 outside the section.
    area_mm2
        (M,) area of each cell within the section.
    coupling
        (M, M) sparse Laplacian of the faces, positive semi-definite: open length over distance.
    """

    origin: Floats
    step: Floats
    number: Ints
    area_mm2: Floats
    coupling: sparse.csr_array

    def island_shares(self, islands: NDArray[np.object_]) -> sparse.csr_array:
        """Share of each island's area in each cell, (I, M): rows add up to 1."""
        points, (ring_starts, island_rings) = oriented_rings(islands, self.origin, self.step)
        owner, place, area = islands_in_cells(points, ring_starts, island_rings, self.number.shape)
        cell = self.number.ravel()[place]
        kept = (cell >= 0) & (area > 0.0)
        shape = (len(islands), len(self.area_mm2))
        table = sparse.csr_array((area[kept], (owner[kept], cell[kept])), shape=shape)
        return _rows_of_one(table)

    def interpolation(self, points: Floats) -> sparse.csr_array:
        """Weights (P, M) of the cells around points; rows add up to 1, or 0 far outside.

        Cubic (Lagrange, over 4 x 4 cells) if all of these are in the section; bilinear near its border.
        """
        place = (np.asarray(points, np.float64) - self.origin) / self.step - 0.5
        corner = np.floor(place).astype(np.int64)
        (weight, cell), (linear, near) = (self._weights(corner, w) for w in _lagrange(place - corner))
        border = np.flatnonzero((cell < 0).any(axis=1))
        cell[border] = -1
        weight[border, :4], cell[border, :4] = linear[border], near[border]
        kept = cell >= 0
        count = kept.sum(axis=1)
        starts = np.concatenate([[0], np.cumsum(count)])
        some = count > 0
        total = np.ones(len(place))
        total[some] = np.add.reduceat(weight[kept], starts[:-1][some]) if some.any() else 1.0
        weight *= (1.0 / np.where(total > 0.0, total, 1.0))[:, None]
        # From the upper right to the lower left: a fixed order, as it decides how sums are rounded.
        last = np.ascontiguousarray(kept[:, ::-1])
        table = weight[:, ::-1][last], cell[:, ::-1][last], starts
        return sparse.csr_array(table, shape=(len(place), len(self.area_mm2)))

    def _weights(self, corner: Ints, along: Floats) -> tuple[Floats, Ints]:
        """Weights and cells (P, W^2) around points, by rows from the lower left; -1 outside of the section.

        Parameters
        ----------
        corner
            (P, 2) column and row of the cell to the lower left of each point.
        along
            (W, P, 2) weights of W columns and rows, among which `corner` is the lower of the middle two.
        """
        reach = np.arange(len(along)) - (len(along) // 2 - 1)
        rows, columns = self.number.shape
        column, row = corner[:, :1] + reach, corner[:, 1:] + reach
        wide, high = (column >= 0) & (column < columns), (row >= 0) & (row < rows)
        cell = self.number[np.clip(row, 0, rows - 1)[:, :, None], np.clip(column, 0, columns - 1)[:, None, :]]
        cell = np.where(high[:, :, None] & wide[:, None, :], cell, -1)
        weight = along[:, :, 0].T[:, None, :] * along[:, :, 1].T[:, :, None]
        return weight.reshape(len(corner), -1), cell.reshape(len(corner), -1)


def _lagrange(share: Floats) -> tuple[Floats, Floats]:
    """Interpolation weights of four and of two neighbours on a line, (4, ...) and (2, ...), at shares of the middle interval."""
    u = share
    four = (
        -u * (u - 1.0) * (u - 2.0) / 6.0,
        (u + 1.0) * (u - 1.0) * (u - 2.0) / 2.0,
        -(u + 1.0) * u * (u - 2.0) / 2.0,
        (u + 1.0) * u * (u - 1.0) / 6.0,
    )
    return np.stack(four), np.stack([1.0 - u, u])


def section_grid(parts: Sequence[shapely.Polygon], step_mm: float) -> SectionGrid:
    """Lay cells of about the given width over polygons that do not overlap; a whole number of cells fills their box."""
    polygons = np.empty(len(parts), object)
    polygons[:] = parts
    x0, y0, x1, y1 = shapely.total_bounds(polygons)
    columns, rows = max(1, math.ceil((x1 - x0) / step_mm)), max(1, math.ceil((y1 - y0) / step_mm))
    origin, step = np.array([x0, y0]), np.array([(x1 - x0) / columns, (y1 - y0) / rows])
    points, (ring_starts, _) = oriented_rings(polygons, origin, step)
    share = cell_shares(points, ring_starts, rows, columns)
    inside = share > LEAST_SHARE
    number = np.full((rows, columns), -1, np.int64)
    number[inside] = np.arange(np.count_nonzero(inside))
    upright = face_shares(points, ring_starts, rows, columns)
    flat = face_shares(np.ascontiguousarray(points[:, ::-1]), ring_starts, columns, rows).T
    # Open length over the distance of the centres, across vertical faces and across horizontal ones.
    across = _pairs(number[:, :-1], number[:, 1:], np.abs(upright[:, 1:columns]) * (step[1] / step[0]))
    along = _pairs(number[:-1], number[1:], np.abs(flat[1:rows]) * (step[0] / step[1]))
    a, b, conductance = (np.concatenate(c) for c in zip(across, along, strict=True))
    area = share[inside] * (step[0] * step[1])
    return SectionGrid(origin, step, number, area, _laplacian(a, b, conductance, len(area)))


def _pairs(first: Ints, second: Ints, conductance: Floats) -> tuple[Ints, Ints, Floats]:
    """Cells on both sides of every open face."""
    kept = (first >= 0) & (second >= 0) & (conductance > LEAST_SHARE)
    return first[kept], second[kept], conductance[kept]


def _laplacian(a: Ints, b: Ints, conductance: Floats, count: int) -> sparse.csr_array:
    """Graph Laplacian of the faces."""
    beside = sparse.coo_array((conductance, (a, b)), shape=(count, count))
    both = sparse.csr_array(beside + beside.T)
    return sparse.csr_array(sparse.diags_array(np.asarray(both.sum(axis=1)).ravel()) - both)


def _rows_of_one(table: sparse.csr_array) -> sparse.csr_array:
    """Rows scaled so that each adds up to 1; empty rows stay empty."""
    total: Floats = np.asarray(table.sum(axis=1), np.float64).ravel()
    scale = np.divide(1.0, total, out=np.zeros_like(total), where=total > 0)
    return sparse.csr_array(sparse.diags_array(scale) @ table)

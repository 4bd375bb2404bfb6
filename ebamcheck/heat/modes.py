"""Modes of a section: the shapes in which heat spreads within its outline, each decaying at its own rate.

They are the eigenmodes of the Laplacian without heat flow through the border (Neumann), by finite volumes
on the cells of the section. A section of several regions has the modes of each: no heat crosses a gap.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import linalg, sparse
from scipy.sparse import csgraph
from scipy.sparse.linalg import eigsh
from shapely.geometry.base import BaseGeometry

from ebamcheck.errors import GeometryError
from ebamcheck.geometry.regions import valid_polygons
from ebamcheck.heat.one_blas_thread import one_blas_thread
from ebamcheck.heat.section_grid import SectionGrid, section_grid
from ebamcheck.numeric.rings import Floats, Ints

CELLS_PER_WAVE = 6.0
"""Cells per shortest wavelength. Uncorrected, the decay rate of that wave would be up to 9 % low ((k h)^2 / 12)."""

WHOLE = 0.999
"""Share of a cell that must lie in the section for it to count as whole."""

LEAST_CELLS = 12.0
"""Least number of cells across the square root of the area, lest a small region be a single cell."""

MOST_CELLS = 20_000
"""Most cells of a section, several times what its waves need: a sliver, or thousands of specks, would need far more."""

DENSE_CELLS = 800
"""Regions with fewer cells are solved for all modes by divide and conquer, which is fastest there."""

DENSE_SHARE = 0.05
"""Larger regions are also solved by a dense solver if more than this share of all modes is wanted."""

SURPLUS = 1.15
"""Modes requested over Weyl's estimate, lest one below the limit be missed."""


@dataclass(frozen=True, eq=False)
class ContourModes:
    """Modes phi_k of a section, normalised: the integral of phi_k^2 over it is 1.

    Parameters
    ----------
    eigenvalue
        (K,) lambda_k, 1/mm^2, ascending; exactly 0 for one mode of each region.
    values
        (M, K) values of the modes in the cells, 1/mm.
    grid
        The cells.
    """

    eigenvalue: Floats
    values: Floats
    grid: SectionGrid

    @property
    def area_mm2(self) -> float:
        """Area of the section."""
        return float(self.grid.area_mm2.sum())

    def at(self, points: ArrayLike) -> Floats:
        """Modes at points (P, 2), (P, K)."""
        where = np.asarray(points, np.float64).reshape(-1, 2)
        return np.asarray(self.grid.interpolation(where) @ self.values, np.float64)

    def means(self, islands: NDArray[np.object_]) -> Floats:
        """Mean of the modes over islands, (I, K)."""
        return np.asarray(self.grid.island_shares(islands) @ self.values, np.float64)

    def integral(self) -> Floats:
        """Integral of the modes over the section, (K,): 0 for all but those of eigenvalue 0."""
        return np.asarray(self.grid.area_mm2 @ self.values, np.float64)


def modes_below(area_mm2: float, perimeter_mm: float, eigenvalue: float) -> float:
    """Estimate the number of modes under an eigenvalue (Weyl 1912, with the border's term; Neumann)."""
    return area_mm2 * eigenvalue / (4.0 * math.pi) + perimeter_mm * math.sqrt(eigenvalue) / (4.0 * math.pi)


def eigenvalue_of(area_mm2: float, perimeter_mm: float, count: float) -> float:
    """Eigenvalue under which about `count` modes lie: the inverse of :func:`modes_below`."""
    half = perimeter_mm / (2.0 * area_mm2)
    return (math.sqrt(half**2 + 4.0 * math.pi * count / area_mm2) - half) ** 2


@one_blas_thread()
def contour_modes(
    section: BaseGeometry,
    largest_eigenvalue: float,
    most_modes: int,
    cells_per_wave: float = CELLS_PER_WAVE,
) -> ContourModes:
    """Find the modes of a section up to an eigenvalue.

    Parameters
    ----------
    section
        Polygon or multi-polygon, mm.
    largest_eigenvalue
        (2 pi / wavelength)^2 of the shortest wave, 1/mm^2.
    most_modes
        Most modes, in effect a lower limit of the eigenvalue; one per region is always kept.
    cells_per_wave
        Cells per shortest wavelength.

    Raises
    ------
    GeometryError
        If the section has no area.
    """
    parts = valid_polygons(section)
    area, perimeter = sum(p.area for p in parts), sum(p.length for p in parts)
    if area <= 0.0:
        raise GeometryError("heat in a section without area: give at least one polygon")
    limit = min(largest_eigenvalue, eigenvalue_of(area, perimeter, most_modes))
    step = 2.0 * math.pi / math.sqrt(limit) / cells_per_wave
    # Least width of cells for MOST_CELLS of them to cover the section and its border.
    least = (perimeter + math.sqrt(perimeter**2 + 4.0 * area * MOST_CELLS)) / (2.0 * MOST_CELLS)
    grid = section_grid(parts, max(min(step, math.sqrt(area) / LEAST_CELLS), least))
    count, region = csgraph.connected_components(grid.coupling, directed=False)
    place = np.argwhere(grid.number >= 0) * grid.step[::-1]
    by_region = np.split(
        np.argsort(region, kind="stable"), np.cumsum(np.bincount(region, minlength=count))[:-1]
    )
    found = [
        _region_modes(grid, cells, float(np.ptp(place[cells], axis=0).max()), limit) for cells in by_region
    ]
    eigenvalue = np.concatenate([values for values, _, _ in found])
    values = np.zeros((len(grid.area_mm2), len(eigenvalue)))
    used = 0
    for own, modes, cells in found:
        values[cells, used : used + len(own)] = modes
        used += len(own)
    eigenvalue = undispersed(grid, eigenvalue, values)
    # One mode of each region is kept, however small the region is.
    rising = np.argsort(eigenvalue, kind="stable")[: max(most_modes, count)]
    rising = rising[(eigenvalue[rising] <= limit) | (eigenvalue[rising] == 0.0)]
    return ContourModes(eigenvalue[rising], np.ascontiguousarray(values[:, rising]), grid)


def undispersed(grid: SectionGrid, eigenvalue: Floats, values: Floats) -> Floats:
    """Eigenvalues (K,) less the error that cells of width h make in waves.

    A difference over cells has 4/h^2 sin^2(p h/2) for p^2, which is p^2 - h^2 p^4 / 12. To the first order of
    perturbation the eigenvalue is therefore low by h^2/12 times the mean of phi_xx^2 + phi_yy^2 over that of phi^2,
    which are read from the mode itself, over its whole cells. Without whole cells, as in a wall thinner than a
    cell, the waves count as of all directions: 3/4 of lambda^2 for that mean.
    """
    rows, columns = np.nonzero(grid.number >= 0)
    padded = np.pad(grid.number, 1, constant_values=-1)
    around = [padded[rows + 1 + dy, columns + 1 + dx] for dy, dx in ((0, -1), (0, 1), (-1, 0), (1, 0))]
    whole = (grid.area_mm2 > WHOLE * grid.step.prod()) & np.all([cell >= 0 for cell in around], axis=0)
    middle = values[whole]
    if not len(middle):
        return np.asarray(eigenvalue + np.mean(grid.step**2) / 16.0 * eigenvalue**2, np.float64)
    left, right, under, over = (values[cell[whole]] for cell in around)
    bent_x = ((left + right - 2.0 * middle) ** 2).sum(axis=0) / grid.step[0] ** 2
    bent_y = ((under + over - 2.0 * middle) ** 2).sum(axis=0) / grid.step[1] ** 2
    mean_square = (middle**2).sum(axis=0)
    known = mean_square > 0.0
    low = np.divide(bent_x + bent_y, 12.0 * mean_square, out=np.zeros_like(bent_x), where=known)
    low = np.where(known, low, np.mean(grid.step**2) / 16.0 * eigenvalue**2)
    return np.where(eigenvalue == 0.0, 0.0, eigenvalue + low)


def _region_modes(
    grid: SectionGrid, cells: Ints, extent_mm: float, limit: float
) -> tuple[Floats, Floats, Ints]:
    """Eigenvalues up to the limit, modes in the cells of one region of an extent, and those cells."""
    area = grid.area_mm2[cells]
    total, size = float(area.sum()), len(cells)
    border = 4.0 * math.sqrt(total)
    wanted = min(size, math.ceil(SURPLUS * modes_below(total, border, limit)) + 1)
    root = np.sqrt(area)
    scale = sparse.diags_array(1.0 / root)
    matrix = sparse.csc_array(scale @ grid.coupling[cells][:, cells] @ scale)
    if size <= DENSE_CELLS:
        # The same routine as scipy's, but free of the interpreter lock.
        eigenvalue, vectors = np.linalg.eigh(matrix.toarray())
    elif wanted > DENSE_SHARE * size:
        eigenvalue, vectors = linalg.eigh(matrix.toarray(), subset_by_index=(0, wanted - 1))
    else:
        # A shift just below zero keeps the matrix definite; it is less than the eigenvalue of the first wave along the
        # region, which may be a sliver. The start vector is fixed, so that runs repeat.
        start = root * (1.0 + np.cos(np.arange(size)))
        eigenvalue, vectors = eigsh(matrix, wanted, sigma=-1.0 / extent_mm**2, which="LM", v0=start)
    rising = np.argsort(eigenvalue, kind="stable")
    eigenvalue, vectors = eigenvalue[rising], vectors[:, rising]
    # The mode of eigenvalue zero is known exactly, which conserves energy to the last digits.
    eigenvalue[0], vectors[:, 0] = 0.0, root / math.sqrt(total)
    vectors[:, 1:] -= np.outer(vectors[:, 0], vectors[:, 0] @ vectors[:, 1:])
    kept = eigenvalue <= limit
    kept[0] = True
    return np.asarray(eigenvalue[kept], np.float64), vectors[:, kept] / root[:, None], cells

"""Modes of a section: the shapes in which heat spreads within its outline, each decaying at its own rate.

They are the eigenmodes of the Laplacian without heat flow through the border (Neumann), by finite volumes
on the cells of the section. A section of several regions has the modes of each: no heat crosses a gap.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from threading import Lock

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray
from scipy import linalg, sparse
from scipy.sparse import csgraph
from scipy.sparse.linalg import eigsh
from shapely.geometry.base import BaseGeometry
from threadpoolctl import OpenBLASController, ThreadpoolController, threadpool_limits

from ebamcheck.errors import GeometryError
from ebamcheck.geometry.raster import cell_shares, face_shares, islands_in_cells, oriented_rings
from ebamcheck.geometry.regions import valid_polygons
from ebamcheck.kernels import Floats, Ints

WHOLE = 0.999  # share of a cell that must lie in the section for it to count as whole
# Most cells of a section, several times what its waves need: a sliver, or thousands of specks, would need far more
MOST_CELLS = 20_000


# -- Linear algebra on the calling thread only. Layers are spread over our own threads. If BLAS used threads of its own for
# each, these would wait for each other by spinning: planning on a busy machine would take ten times as long.

_LOCK = Lock()
_entered = 0
_limits: threadpool_limits | None = None


@cache
def _controller() -> ThreadpoolController:
    """The BLAS libraries of the process; finding them takes milliseconds."""
    return ThreadpoolController()


def _take_control() -> None:
    """Let this thread change the limit: since 3.8, threadpoolctl obeys only the first thread that did so."""
    release = getattr(OpenBLASController, "clear_controlling_thread", None)
    if release is not None:
        release(force=True)


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Limit BLAS to one thread until the last of all threads within such a block leaves it."""
    global _entered, _limits
    with _LOCK:
        _entered += 1
        if _entered == 1:
            _take_control()
            _limits = _controller().limit(limits=1, user_api="blas")
    try:
        yield
    finally:
        with _LOCK:
            _entered -= 1
            if _entered == 0 and _limits is not None:
                _take_control()
                _limits.restore_original_limits()
                _limits = None


@dataclass(frozen=True, eq=False)
class ContourModes:
    """Modes phi_k of a section, normalised: the integral of phi_k^2 over it is 1."""

    eigenvalue: Floats  # (K,) lambda_k, 1/mm^2, ascending; exactly 0 for one mode of each region
    values: Floats  # (M, K) values of the modes in the cells, 1/mm
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


@one_blas_thread()
def contour_modes(
    section: BaseGeometry, largest_eigenvalue: float, most_modes: int, cells_per_wave: float = 6.0
) -> ContourModes:
    """Find the modes of a section (polygon or multi-polygon, mm) up to an eigenvalue; raises GeometryError if it has no area.

    `largest_eigenvalue`: (2 pi / wavelength)^2 of the shortest wave, 1/mm^2; `most_modes`: in effect a lower limit of the eigenvalue;
    one per region is always kept; `cells_per_wave`: cells per shortest wavelength: with six, its decay rate would be up to 9 % low if
    it were not corrected ((k h)^2 / 12).
    """
    parts = valid_polygons(section)
    area, perimeter = sum(p.area for p in parts), sum(p.length for p in parts)
    if area <= 0.0:
        raise GeometryError("heat in a section without area: give at least one polygon")
    # The inverse of :func:`modes_below`.
    half = perimeter / (2.0 * area)
    limit = min(largest_eigenvalue, (math.sqrt(half**2 + 4.0 * math.pi * most_modes / area) - half) ** 2)
    step = 2.0 * math.pi / math.sqrt(limit) / cells_per_wave
    # Least width of cells for MOST_CELLS of them to cover the section and its border.
    least = (perimeter + math.sqrt(perimeter**2 + 4.0 * area * MOST_CELLS)) / (2.0 * MOST_CELLS)
    # Twelve cells across the square root of the area, lest a small region be a single cell.
    grid = section_grid(parts, max(min(step, math.sqrt(area) / 12.0), least))
    count, region = csgraph.connected_components(grid.coupling, directed=False)
    place = np.argwhere(grid.number >= 0) * grid.step[::-1]
    edges = np.cumsum(np.bincount(region, minlength=count))[:-1]
    regions = np.split(np.argsort(region, kind="stable"), edges)
    extents_mm = [float(np.ptp(place[cells], axis=0).max()) for cells in regions]
    solved = [_region_modes(grid, cells, mm, limit) for cells, mm in zip(regions, extents_mm, strict=True)]
    eigenvalue = np.concatenate([own for own, _ in solved])
    values = np.zeros((len(grid.area_mm2), len(eigenvalue)))
    used = 0
    for (own, modes), cells in zip(solved, regions, strict=True):
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


def _region_modes(grid: SectionGrid, cells: Ints, extent_mm: float, limit: float) -> tuple[Floats, Floats]:
    """Eigenvalues up to the limit, and modes, in the cells of one region of an extent."""
    area = grid.area_mm2[cells]
    total, size = float(area.sum()), len(cells)
    # More modes than Weyl's estimate, lest one below the limit be missed.
    wanted = min(size, math.ceil(1.15 * modes_below(total, 4.0 * math.sqrt(total), limit)) + 1)
    root = np.sqrt(area)
    scale = sparse.diags_array(1.0 / root)
    matrix = sparse.csc_array(scale @ grid.coupling[cells][:, cells] @ scale)
    if size <= 800:
        # All modes by divide and conquer, which is fastest there: scipy's routine, but free of the interpreter lock.
        eigenvalue, vectors = np.linalg.eigh(matrix.toarray())
    elif wanted > 0.05 * size:
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
    return np.asarray(eigenvalue[kept], np.float64), vectors[:, kept] / root[:, None]


# Least share of a cell or face in the section; with less it is left out, as irrelevant for heat
LEAST_SHARE = 1e-6


@dataclass(frozen=True, eq=False)
class SectionGrid:
    """Cells of a section."""

    origin: Floats  # (2,) lower left corner, mm
    step: Floats  # (2,) width and height of a cell, mm
    number: Ints  # (rows, columns) number of each cell, -1 outside the section
    area_mm2: Floats  # (M,) area of each cell within the section
    coupling: sparse.csr_array  # (M, M) Laplacian of the faces, positive semi-definite: open length over distance

    def island_shares(self, islands: NDArray[np.object_]) -> sparse.csr_array:
        """Share of each island's area in each cell, (I, M): rows add up to 1, or are empty."""
        points, (ring_starts, island_rings) = oriented_rings(islands, self.origin, self.step)
        owner, place, area = islands_in_cells(points, ring_starts, island_rings, self.number.shape)
        cell = self.number.ravel()[place]
        kept = (cell >= 0) & (area > 0.0)
        shape = (len(islands), len(self.area_mm2))
        table = sparse.csr_array((area[kept], (owner[kept], cell[kept])), shape=shape)
        total: Floats = np.asarray(table.sum(axis=1), np.float64).ravel()
        scale = np.divide(1.0, total, out=np.zeros_like(total), where=total > 0)
        return sparse.csr_array(sparse.diags_array(scale) @ table)

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

        The weights `along` (W, P, 2) are those of W columns and rows, of which `corner` (P, 2) is the lower of the middle two.
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
    beside = sparse.coo_array((conductance, (a, b)), shape=(len(area), len(area)))
    both = sparse.csr_array(beside + beside.T)
    coupling = sparse.csr_array(sparse.diags_array(np.asarray(both.sum(axis=1)).ravel()) - both)
    return SectionGrid(origin, step, number, area, coupling)


def _pairs(first: Ints, second: Ints, conductance: Floats) -> tuple[Ints, Ints, Floats]:
    """Cells on both sides of every open face."""
    kept = (first >= 0) & (second >= 0) & (conductance > LEAST_SHARE)
    return first[kept], second[kept], conductance[kept]

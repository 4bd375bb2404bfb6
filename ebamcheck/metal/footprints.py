"""Where the metal of each bead comes to lie, and how much wire each needs so that the beads together lay the section.

Wire melts into a pool as wide as the bead, which moves on; one that is filled like a half sphere leaves, along a straight line, the
parabolic section of a bead (Pixner et al. 2020), and a round end."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from ebamcheck.kernels import Floats, Ints, kernel


@dataclass(frozen=True, eq=False)
class Footprints:
    """Length of each bead by the cells in which its metal lies."""

    starts: Ints  # (B + 1,) first entry of each bead
    cell: Ints  # (n,) row-major index of a cell
    length_mm: Floats  # (n,) share of the bead's length: those of a bead add up to its length

    def joined(self, first: Ints) -> Footprints:
        """Footprints of runs of beads, each from one of `first` (n,) to before the next; cells may come more than once."""
        return Footprints(np.append(self.starts[first], self.starts[-1]), self.cell, self.length_mm)

    def laid(self, width_mm: Floats, cells: int, cell_mm2: float) -> Floats:
        """Metal in each cell, (cells,), as a height over that of the layer, by what each bead (B,) lays on a length, over the
        height of the layer."""
        weight = np.repeat(width_mm, np.diff(self.starts)) * self.length_mm
        return np.bincount(self.cell, weight, minlength=cells) / cell_mm2


def footprints(
    places: Floats, length_mm: Floats, bead: Ints, beads: int, radius: float, shape: tuple[int, int]
) -> Footprints:
    """Cells in which the metal of beads lies; metal beside the grid of a shape is not counted.

    `places` (n, 2) lie along the beads, in cells from the lower left corner of the grid, sorted by bead; each stands for a length
    (n,) of its bead (n,). The radius is half the width of the pool, in cells."""
    return Footprints(*gathered(places, length_mm, bead, beads, radius, *shape))


@kernel
def gathered(
    places: Floats, length_mm: Floats, bead: Ints, beads: int, radius: float, rows: int, columns: int
) -> tuple[Ints, Ints, Floats]:
    """Return the columns of :class:`Footprints`."""
    starts = np.zeros(beads + 1, np.int64)
    capacity = 1024
    cell, length = np.empty(capacity, np.int64), np.empty(capacity)
    scratch = np.zeros(rows * columns)
    side = int(2.0 * radius) + 3
    pool = np.empty(side * side)
    used, place = 0, 0
    for number in range(beads):
        first = used
        while place < len(bead) and bead[place] == number:
            x, y = places[place, 0], places[place, 1]
            left, low = int(np.floor(x - radius)), int(np.floor(y - radius))
            total = 0.0
            for i in range(side):
                for j in range(side):
                    dx, dy = left + j + 0.5 - x, low + i + 0.5 - y
                    depth = np.sqrt(max(radius * radius - dx * dx - dy * dy, 0.0))
                    pool[i * side + j] = depth
                    total += depth
            if total == 0.0:  # a pool smaller than a cell
                left, low, total = int(np.floor(x)), int(np.floor(y)), 1.0
                pool[0] = 1.0
            for i in range(side):
                row = low + i
                if row < 0 or row >= rows:
                    continue
                for j in range(side):
                    column = left + j
                    share = pool[i * side + j]
                    if share == 0.0 or column < 0 or column >= columns:
                        continue
                    index = row * columns + column
                    if scratch[index] == 0.0:
                        if used == capacity:
                            cell = np.concatenate((cell, np.empty(capacity, np.int64)))
                            length = np.concatenate((length, np.empty(capacity)))
                            capacity *= 2
                        cell[used] = index
                        used += 1
                    scratch[index] += length_mm[place] * share / total
            place += 1
        for n in range(first, used):
            length[n] = scratch[cell[n]]
            scratch[cell[n]] = 0.0
        starts[number + 1] = used
    return starts, cell[:used].copy(), length[:used].copy()


def pooled(places: Floats, area_mm2: Floats, radius: float, shape: tuple[int, ...], cell_mm2: float) -> Floats:
    """Height of the metal in each cell, over that of the layer: each place (n, 2), in cells, shares its metal (n,) between those
    within a radius.

    Slower to build widths on than :func:`footprints`, which knows each bead by itself, but free of the steps that come from whether
    the middle of a cell lies within a pool: a tip that gets a film of metal is part of the surface.

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


def balanced_widths(
    found: Footprints,
    share: Floats,
    weight: Floats,
    cell_mm2: float,
    width_mm: Floats,
    limits_mm: tuple[float, float],
) -> Floats:
    """Widths of metal (B,) between limits that lay a section flat, mm, with the greatest likelihood, and the sum of the metal that
    of the section.

    By the multiplicative iteration of Richardson (1972, J. Opt. Soc. Am. 62:55) and Lucy (1974, Astron. J. 79:745), which keeps
    them positive. `share` and `weight` (rows, columns) are what of each cell is to be metal, one layer high, and how much it
    counts."""
    columns = found.starts, found.cell, found.length_mm
    width = np.array(width_mm, np.float64)
    # The sum is right after the first of ten steps, and a layer hardly gets flatter after so many.
    iterate(columns, share.ravel(), weight.ravel(), cell_mm2, width, limits_mm, 10)
    # Cells that count less, or that pools only touch, miss some of a layer: all beads lay it together, but for those at a limit,
    # whose places ask for less, or for more, than they get.
    free = (width > limits_mm[0]) & (width < limits_mm[1])
    laid, by_free = (found.laid(some, share.size, cell_mm2).sum() for some in (width, np.where(free, width, 0.0)))
    if by_free <= 0.0:
        return width
    # Walls a little wider than a bead would get under three quarters of their metal.
    missing = min(max(1.0 + (share.sum() - laid) / by_free, 1.0 / 1.15), 1.4)
    return np.where(free, np.clip(width * missing, *limits_mm), width)


@kernel
def iterate(
    columns: tuple[Ints, Ints, Floats],
    share: Floats,
    weight: Floats,
    cell_mm2: float,
    width: Floats,
    limits_mm: tuple[float, float],
    steps: int,
) -> None:
    """Change `width` step by step, by footprints' starts, cells and lengths."""
    starts, cell, length_mm = columns
    least, most = limits_mm
    laid = np.empty(share.size)
    for _ in range(steps):
        laid[:] = 0.0
        for bead in range(len(width)):
            for n in range(starts[bead], starts[bead + 1]):
                laid[cell[n]] += width[bead] * length_mm[n] / cell_mm2
        for bead in range(len(width)):
            wanted, whole = 0.0, 0.0
            for n in range(starts[bead], starts[bead + 1]):
                counted = weight[cell[n]] * length_mm[n]
                whole += counted
                if share[cell[n]] > 0.0:
                    wanted += counted * share[cell[n]] / laid[cell[n]]
            if whole > 0.0:
                width[bead] = min(max(width[bead] * wanted / whole, least), most)

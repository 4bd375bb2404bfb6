"""Footprints: where the metal of each bead comes to lie.

Wire melts into a pool as wide as the bead, and the pool leaves it behind as it moves on. A pool that is filled like a
half sphere leaves, along a straight line, the parabolic section of a bead (Pixner et al. 2020), and a round end.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Floats, Ints


@dataclass(frozen=True, eq=False)
class Footprints:
    """Length of each bead by the cells in which its metal lies.

    Parameters
    ----------
    starts
        (B + 1,) first entry of each bead.
    cell
        (n,) row-major index of a cell.
    length_mm
        (n,) share of the bead's length: those of a bead add up to its length.
    """

    starts: Ints
    cell: Ints
    length_mm: Floats

    def joined(self, first: Ints) -> Footprints:
        """Footprints of runs of beads, each from one of `first` (n,) to before the next; cells may come more than once."""
        return Footprints(np.append(self.starts[first], self.starts[-1]), self.cell, self.length_mm)

    def laid(self, width_mm: Floats, cells: int, cell_mm2: float) -> Floats:
        """Metal in each cell, (cells,), as a height over that of the layer.

        Parameters
        ----------
        width_mm
            (B,) metal that a bead lays on a length of path, over the height of the layer.
        """
        weight = np.repeat(width_mm, np.diff(self.starts)) * self.length_mm
        return np.bincount(self.cell, weight, minlength=cells) / cell_mm2


def footprints(
    places: Floats, length_mm: Floats, bead: Ints, beads: int, radius: float, shape: tuple[int, int]
) -> Footprints:
    """Gather the cells in which the metal of beads lies.

    Parameters
    ----------
    places
        (n, 2) places along the beads, in cells from the lower left corner of the grid; sorted by bead.
    length_mm
        (n,) length of path that each place stands for.
    bead
        (n,) number of its bead, under `beads`.
    radius
        Half the width of the pool, in cells.
    shape
        Rows and columns of the grid; metal that would fall beside it is not counted.
    """
    starts, cell, length = gathered(places, length_mm, bead, beads, radius, shape[0], shape[1])
    return Footprints(starts, cell, length)


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
                            capacity *= 2
                            cell, length = _longer(cell, length, capacity)
                        cell[used] = index
                        used += 1
                    scratch[index] += length_mm[place] * share / total
            place += 1
        for n in range(first, used):
            length[n] = scratch[cell[n]]
            scratch[cell[n]] = 0.0
        starts[number + 1] = used
    return starts, cell[:used].copy(), length[:used].copy()


@kernel
def _longer(cell: Ints, length: Floats, capacity: int) -> tuple[Ints, Floats]:
    """Copy the columns into longer ones."""
    new_cell, new_length = np.empty(capacity, np.int64), np.empty(capacity)
    new_cell[: cell.size], new_length[: length.size] = cell, length
    return new_cell, new_length

"""Distances between the cells of a grid, exactly: those of whole numbers, of which roots alone are rounded."""

from __future__ import annotations

import numpy as np

from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Bools, Floats, Ints


def border_distance(cells: Bools) -> Floats:
    """Distance of the middle of each cell from that of the nearest one that is none of them.

    Parameters
    ----------
    cells
        (rows, columns) cells that are meant.

    Returns
    -------
    (rows, columns) distances, in cells: 0 for a cell that is none of them; endless where there is no such cell.

    References
    ----------
    A. Meijster, J. B. T. M. Roerdink, W. H. Hesselink, "A general algorithm for computing distance transforms in
    linear time", Mathematical Morphology and its Applications to Image and Signal Processing (2000) 331.

    Examples
    --------
    >>> border_distance(np.array([[False, True, True], [True, True, True]])).round(3).tolist()
    [[0.0, 1.0, 2.0], [1.0, 1.414, 2.236]]
    """
    cells = np.ascontiguousarray(cells, np.bool_)
    if cells.all():
        return np.full(cells.shape, np.inf)
    return np.asarray(np.sqrt(squared_distances(cells)), np.float64)


@kernel
def squared_distances(cells: Bools) -> Ints:
    """Square of the distance of each cell (rows, columns) from the nearest that is none of them; there has to be one."""
    rows, columns = cells.shape
    far = rows + columns
    upright = np.empty((rows, columns), np.int64)
    for x in range(columns):
        upright[0, x] = far if cells[0, x] else 0
    for y in range(1, rows):
        for x in range(columns):
            upright[y, x] = min(upright[y - 1, x] + 1, far) if cells[y, x] else 0
    for y in range(rows - 2, -1, -1):
        for x in range(columns):
            upright[y, x] = min(upright[y, x], upright[y + 1, x] + 1)
    result = np.zeros((rows, columns), np.int64)
    parabola, begin = np.empty(columns, np.int64), np.empty(columns, np.int64)
    for y in range(rows):
        high = upright[y]
        last = 0
        parabola[0] = begin[0] = 0
        for x in range(1, columns):
            while last >= 0:
                i, at = parabola[last], begin[last]
                if (at - i) ** 2 + high[i] ** 2 <= (at - x) ** 2 + high[x] ** 2:
                    break
                last -= 1
            if last < 0:
                last = 0
                parabola[0] = x
                continue
            i = parabola[last]
            from_ = 1 + (x**2 - i**2 + high[x] ** 2 - high[i] ** 2) // (2 * (x - i))
            if from_ < columns:
                last += 1
                parabola[last], begin[last] = x, from_
        for x in range(columns - 1, -1, -1):
            i = parabola[last]
            result[y, x] = (x - i) ** 2 + high[i] ** 2
            if x == begin[last]:
                last -= 1
    return result


@kernel
def moved_to_neighbours(found: Floats, field: Floats, moved: Bools, to: Bools) -> None:
    """Add the values of some cells to those of the nearest of other cells that touch them, be it at a corner.

    Parameters
    ----------
    found
        (rows, columns) what is added to.
    field, moved
        (rows, columns) values, and which of them are added; one that touches none of `to` is not.
    to
        (rows, columns) cells that are added to; of two alike near ones the left one, then the lower one.
    """
    rows, columns = field.shape
    # The four beside it are nearer than those at its corners.
    up = np.array([0, -1, 1, 0, -1, 1, -1, 1])
    right = np.array([-1, 0, 0, 1, -1, -1, 1, 1])
    for y in range(rows):
        for x in range(columns):
            if not moved[y, x]:
                continue
            for k in range(8):
                row, column = y + up[k], x + right[k]
                if 0 <= row < rows and 0 <= column < columns and to[row, column]:
                    found[row, column] += field[y, x]
                    break

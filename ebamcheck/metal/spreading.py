"""Spreading: a field on a grid becomes its mean under a Gaussian around each cell; beyond the grid there is nothing."""

from __future__ import annotations

import numpy as np

from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Floats

REACH = 4.0
"""Standard deviations from which on a Gaussian counts as nothing: less than a ten-thousandth of it lies beyond."""


def gaussian_weights(sigma: float) -> Floats:
    """Weights (n + 1,) of the cells from n to none away, for a standard deviation in cells; with both sides they add up to 1.

    Examples
    --------
    >>> [round(float(weight), 4) for weight in gaussian_weights(0.5)]
    [0.0003, 0.1065, 0.7866]
    """
    away = np.arange(-int(REACH * sigma + 0.5), int(REACH * sigma + 0.5) + 1)
    weights = np.exp(-0.5 / (sigma * sigma) * away**2)
    return np.asarray((weights / weights.sum())[: away.size // 2 + 1], np.float64)


@kernel
def spread_by(field: Floats, weights: Floats) -> Floats:
    """Spread a field (rows, columns), first along its columns and then along its rows, by :func:`gaussian_weights`.

    Each sum begins in the middle and goes on from the farthest pair of cells to the nearest.
    """
    rows, columns = field.shape
    reach = weights.size - 1
    high = np.zeros((rows + 2 * reach, columns))
    high[reach : reach + rows] = field
    wide = np.zeros(columns + 2 * reach)
    result = np.empty((rows, columns))
    for row in range(rows):
        line = wide[reach : reach + columns]
        line[:] = high[row + reach] * weights[reach]
        for n in range(reach):
            _add(line, high[row + n], high[row + 2 * reach - n], weights[n])
        result[row] = line * weights[reach]
        for n in range(reach):
            _add(
                result[row], wide[n : n + columns], wide[2 * reach - n : 2 * reach - n + columns], weights[n]
            )
    return result


@kernel
def _add(line: Floats, left: Floats, right: Floats, weight: float) -> None:
    """Add both neighbours of each cell of a line (columns,), by their weight."""
    for i in range(line.size):
        line[i] += (left[i] + right[i]) * weight

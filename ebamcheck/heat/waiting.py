"""Waits of a heat column: time passes until the metal under the next bead is cool enough (interpass temperature)."""

from __future__ import annotations

import numpy as np

from ebamcheck.heat.marching import FEW_STEPS, SHORT_S, STEPS, ColumnFields, march
from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Floats

FIRST_WAIT_S, WAIT_GROWTH = 1.0, 0.5
"""Least step of a wait, and least step over the wait so far: steps grow with the wait."""


@kernel
def cooled(
    content: Floats, fields: ColumnFields, under: int, top: int, bed_k: float, longest_s: float
) -> tuple[float, Floats]:
    """Age a column, without power, until its bed is no warmer than `bed_k`, or the wait is over `longest_s`.

    All steps are taken in here: a wait takes dozens of them, and each alone would wait for the interpreter.

    Parameters
    ----------
    content, fields
        As :func:`~ebamcheck.heat.marching.march` has them.
    under, top
        First cell of the layer under the uppermost one, and of that.

    Returns
    -------
    The wait, s, and the heat to the table and radiated, J.
    """
    wait_s, step_s, gone = 0.0, FIRST_WAIT_S, np.zeros(2)
    while bed_temperature_k(content, fields, under, top) > bed_k:
        gone += march(content, fields, top, 0.0, step_s, FEW_STEPS if step_s <= SHORT_S else STEPS)
        wait_s, step_s = wait_s + step_s, max(FIRST_WAIT_S, WAIT_GROWTH * wait_s)
        if wait_s > longest_s:
            break
    return wait_s, gone


@kernel
def bed_temperature_k(content: Floats, fields: ColumnFields, under: int, top: int) -> float:
    """Temperature of the warmer one of the uppermost layer and that under it."""
    upper_k = _mean_k(content, fields, top, len(content))
    return max(upper_k, _mean_k(content, fields, under, top))


@kernel
def _mean_k(content: Floats, fields: ColumnFields, start: int, stop: int) -> float:
    """Mean temperature of some cells, by their lengths; NaN where a heat content is none, after a time without end for instance."""
    table, step, size = fields[0], fields[2], fields[3]
    total_k, whole_mm = 0.0, 0.0
    for i in range(start, stop):
        if np.isnan(content[i]):
            return np.nan
        place = min(max(np.true_divide(content[i], step), 0.0), table.size - 1.0)
        node = min(int(place), table.size - 2)
        total_k += ((table[node + 1] - table[node]) * (place - node) + table[node]) * size[i]
        whole_mm += size[i]
    return float(np.true_divide(total_k, whole_mm))

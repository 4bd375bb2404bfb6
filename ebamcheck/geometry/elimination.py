"""Elimination: small symmetric equations solved in place, as fits within kernels need them."""

from __future__ import annotations

import numpy as np

from ebamcheck.kernels import Floats, kernel


@kernel
def eliminated(equations: Floats, count: int, least_pivot: float) -> bool:
    """Solve `count` symmetric positive equations (n, n + 1) in place; false where they do not determine all unknowns.

    The right side stands in column `count`, where the unknowns take its place. Of each diagonal element at least the share
    `least_pivot` has to be left.
    """
    diagonal = np.empty(count)
    for i in range(count):
        diagonal[i] = equations[i, i]
    for i in range(count):
        if not equations[i, i] > least_pivot * diagonal[i]:
            return False
        for j in range(i + 1, count):
            factor = equations[j, i] / equations[i, i]
            for k in range(i, count + 1):
                equations[j, k] -= factor * equations[i, k]
    for i in range(count - 1, -1, -1):
        for k in range(i + 1, count):
            equations[i, count] -= equations[i, k] * equations[k, count]
        equations[i, count] /= equations[i, i]
    return True

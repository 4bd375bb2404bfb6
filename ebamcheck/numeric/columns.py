"""Joining long columns on all threads."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from ebamcheck.numeric.kernels import run_blocks

ROWS_A_BLOCK = 2**18
"""Fewest rows worth a thread."""

_Scalar = TypeVar("_Scalar", bound="np.generic[Any]")


def joined(columns: Sequence[NDArray[_Scalar]]) -> NDArray[_Scalar]:
    """Join columns (n, ...) of one kind end to end, as ``np.concatenate`` does, on all threads.

    Examples
    --------
    >>> joined([np.array([1, 2]), np.array([3])])
    array([1, 2, 3])
    """
    starts = np.cumsum([0, *(len(column) for column in columns)])
    out = np.empty((int(starts[-1]), *columns[0].shape[1:]), columns[0].dtype)

    def copy(start: int, stop: int) -> None:
        for column, (first, past) in zip(columns, pairwise(starts.tolist()), strict=True):
            low, high = max(start, first), min(stop, past)
            if low < high:
                out[low:high] = column[low - first : high - first]

    run_blocks(copy, len(out), ROWS_A_BLOCK)
    return out

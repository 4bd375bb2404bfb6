"""Sorting and rotating columns within kernels: compiled once, and not anew into every kernel that does so."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ebamcheck.kernels import Floats, Ints, kernel


@kernel
def stable_order(keys: Floats) -> Ints:
    """Places (n,) of keys (n,) from the least to the greatest; equal ones stay as they stand."""
    return np.argsort(keys, kind="mergesort")


@kernel
def put_in_order(values: NDArray[Any], order: Ints) -> None:
    """Bring values (n,) into an order (n,), in place."""
    before = values.copy()
    for i in range(order.size):
        values[i] = before[order[i]]


@kernel
def rotate_to(values: NDArray[Any], first: int) -> None:
    """Let values (n,) that close on themselves begin with another one, in place."""
    before = values.copy()
    k = first
    for i in range(values.size):
        values[i] = before[k]
        k = k + 1 if k + 1 < values.size else 0


@kernel
def as_floats(values: NDArray[Any]) -> Floats:
    """Whole numbers (n,) as keys for :func:`stable_order`."""
    keys = np.empty(values.size)
    for i in range(values.size):
        keys[i] = values[i]
    return keys

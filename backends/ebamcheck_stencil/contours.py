"""From the rings that marching squares finds, block by block, to layers in mm."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ebamcheck.layers.stack import Layers, canonical
from ebamcheck.numeric.kernels import run_blocks
from ebamcheck_stencil.field_of_view import FieldOfView

Rings = tuple[NDArray[np.int32], NDArray[np.int64], NDArray[np.int64]]
"""Of a block of layers: points in half pixels, first point of each ring, and number of rings of each layer."""


def contoured(
    heights: NDArray[np.float64],
    rings_between: Callable[[int, int], Rings],
    view: FieldOfView,
    labels: dict[str, Any],
) -> Layers:
    """Find the rings of all heights (L,) on all threads, by ``rings_between(start, stop)``, and make layers of them."""

    def walk(start: int, stop: int) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
        points, ring_starts, ring_counts = rings_between(start, stop)
        return view.to_mm(points), np.diff(ring_starts), ring_counts

    walked = run_blocks(walk, heights.size)
    points, ring_sizes, ring_counts = (np.concatenate(column) for column in zip(*walked, strict=True))
    return canonical(
        heights,
        points,
        np.concatenate([[0], np.cumsum(ring_sizes)]),
        np.concatenate([[0], np.cumsum(ring_counts)]),
        np.ones(len(ring_sizes), np.bool_),
        **labels,
    )

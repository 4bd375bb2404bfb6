"""From the rings that marching squares finds, block by block, to layers in mm."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ebamcheck.layers.stack import Layers, canonical
from ebamcheck.numeric.kernels import kernel, run_blocks
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
    found = run_blocks(rings_between, heights.size)
    starts = np.cumsum([0, *(len(points) for points, _, _ in found)]).tolist()
    points = np.empty((starts[-1], 2))

    def place(start: int, stop: int) -> None:
        for k in range(start, stop):
            _place(found[k][0], *view.affine, points[starts[k] : starts[k + 1]])

    run_blocks(place, len(found))
    return canonical(
        heights,
        points,
        np.cumsum(np.concatenate([[0], *(np.diff(ring_starts) for _, ring_starts, _ in found)])),
        np.cumsum(np.concatenate([[0], *(ring_counts for _, _, ring_counts in found)])),
        np.ones(sum(len(ring_starts) - 1 for _, ring_starts, _ in found), np.bool_),
        **labels,
    )


@kernel
def _place(
    half_pixels: NDArray[np.int32],
    low_mm: NDArray[np.float64],
    shift_px: NDArray[np.float64],
    pixel_mm: float,
    points: NDArray[np.float64],
) -> None:
    """Write points in mm, as :meth:`FieldOfView.to_mm` gives them."""
    for i in range(len(half_pixels)):
        for axis in range(2):
            points[i, axis] = low_mm[axis] + (0.5 * half_pixels[i, axis] + shift_px[axis]) * pixel_mm

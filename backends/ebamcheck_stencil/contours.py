"""From the rings that marching squares finds, block by block, to layers in mm."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ebamcheck.kernels import kernel
from ebamcheck.layers.stack import Layers, canonical
from ebamcheck.threads import run_blocks
from ebamcheck_stencil.field_of_view import FieldOfView

# Side of a pixel over the largest coordinate, above which float64 keeps points apart and areas clear of rounding
LEAST_PIXEL = 2.0**-40


class Rings(NamedTuple):
    """Rings of a block of layers, as marching squares finds them."""

    points: NDArray[np.int32]
    """(N, 2) half pixels from the centre of pixel (0, 0)."""
    starts: NDArray[np.int64]
    """(R + 1,) first point of each ring."""
    least: NDArray[np.int64]
    """(R,) row of each ring's lexicographically least point."""
    counts: NDArray[np.int64]
    """(L,) rings of each layer."""

    def canonical_order(self) -> NDArray[np.int64]:
        """Rings as they stand in :class:`Layers`: by layer, and there by their least points, of which no two are alike."""
        layer = np.repeat(np.arange(len(self.counts)), self.counts)
        return np.lexsort((self.points[self.least, 1], self.points[self.least, 0], layer))


def layers_of(
    heights: NDArray[np.float64], found: Sequence[Rings], view: FieldOfView, labels: dict[str, Any]
) -> Layers:
    """Make layers at heights (L,) of the rings of their blocks, in canonical form.

    No point of a bitmap's contours is passed twice, and every ring encloses a pixel, so that the form is a matter
    of order alone; unless pixels are so small, and the part so far from the origin, that points fall together in mm.
    """
    orders = [block.canonical_order() for block in found]
    sizes = [np.diff(block.starts)[order] for block, order in zip(found, orders, strict=True)]
    ring_starts = np.concatenate([[0], np.cumsum(np.concatenate(sizes))]).astype(np.int64)
    first_rings = np.cumsum([0, *(len(order) for order in orders)]).tolist()
    points = np.empty((int(ring_starts[-1]), 2))

    def place(start: int, stop: int) -> None:
        for k in range(start, stop):
            block, first = found[k], first_rings[k]
            _place(
                block.points, block.starts, block.least, orders[k], ring_starts[first:], *view.affine, points
            )

    run_blocks(place, len(found))
    layer_starts = np.concatenate([[0], np.cumsum(np.concatenate([block.counts for block in found]))])
    closed = np.ones(len(ring_starts) - 1, np.bool_)
    if view.pixel_mm < LEAST_PIXEL * float(np.abs(points).max(initial=0.0)):
        return canonical(heights, points, ring_starts, layer_starts, closed, **labels)
    return Layers(heights, points, ring_starts, layer_starts, closed, **labels)


@kernel
def _place(
    half_pixels: NDArray[np.int32],
    starts: NDArray[np.int64],
    least: NDArray[np.int64],
    order: NDArray[np.int64],
    new_starts: NDArray[np.int64],
    low_mm: NDArray[np.float64],
    shift_px: NDArray[np.float64],
    pixel_mm: float,
    points: NDArray[np.float64],
) -> None:
    """Write the rings of a block in their order, each from its least point on, in mm as :meth:`FieldOfView.to_mm` gives them."""
    for n in range(order.size):
        r = order[n]
        to = new_starts[n]
        for a, b in ((least[r], starts[r + 1]), (starts[r], least[r])):
            for i in range(a, b):
                for axis in range(2):
                    points[to, axis] = low_mm[axis] + (0.5 * half_pixels[i, axis] + shift_px[axis]) * pixel_mm
                to += 1

"""A part drawn once: any layer follows from the crossings of its rays."""

from __future__ import annotations

from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from ebamcheck.backend import Progress
from ebamcheck.layers.stack import Layers
from ebamcheck.numeric.kernels import block_edges, run_in_order
from ebamcheck_stencil.bitmaps import as_image, empty_bitmap, flip, flips_by_layer
from ebamcheck_stencil.contours import Rings, layers_of
from ebamcheck_stencil.crossings import Crossings
from ebamcheck_stencil.field_of_view import WORD_BITS, FieldOfView
from ebamcheck_stencil.marching_squares import contours_of_layers

LAYERS_AT_ONCE = 256
"""Most layers between two reports of progress."""


class DrawnOnce:
    """A part drawn once: the crossings of all rays, from which any layer follows without OpenGL."""

    def __init__(self, view: FieldOfView, crossings: Crossings, labels: dict[str, Any]) -> None:
        self._view = view
        self._crossings = crossings
        self._labels = labels

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Free nothing: the context was released when the part had been drawn."""

    def slice(self, heights: NDArray[np.float64], progress: Progress | None = None) -> Layers:
        """Cut at strictly increasing heights (L,), in any number of calls."""
        heights = np.ascontiguousarray(heights, dtype=np.float64)
        flips = flips_by_layer(self._crossings, heights)
        words, row_words = empty_bitmap(self._view).size, self._view.stride_px // WORD_BITS

        def rings_between(start: int, stop: int) -> Rings:
            return Rings(*contours_of_layers(flips, start, stop, words, row_words))

        edges = block_edges(heights.size, largest=LAYERS_AT_ONCE)
        found: list[Rings] = []
        for first, rings in zip(edges, run_in_order(rings_between, edges), strict=False):
            found.append(rings)
            if progress is not None:
                progress(edges[len(found)] - first)
        return layers_of(heights, found, self._view, self._labels)

    def bitmap(self, height_mm: float) -> NDArray[np.bool_]:
        """Image (height, width) of the section at a height, row 0 at the least y."""
        bitmap = empty_bitmap(self._view)
        flip(bitmap, flips_by_layer(self._crossings, np.array([height_mm])).pixels)
        return as_image(bitmap, self._view)

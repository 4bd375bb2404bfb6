"""Sources of layers for the comparison: stacks in memory, or files that are read block by block."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import Any, Protocol

import numpy as np
import pandas as pd

from ebamcheck.kernels import Floats, Ints
from ebamcheck.layers.stack import Layers


class LayerSource(Protocol):
    """A source of blocks of one stack: :class:`~ebamcheck.layers.stack.Layers`, or a file of them."""

    def __len__(self) -> int: ...

    @property
    def part(self) -> str:
        """Hash of the part."""

    @property
    def heights(self) -> Floats:
        """Heights of all layers, (L,) mm."""

    @property
    def settings(self) -> Mapping[str, Any]:
        """Settings of the slicer, and its declarations about the part."""

    def block(self, start: int, stop: int) -> Layers:
        """Layers ``start .. stop - 1``."""


def blocks_of(sources: Sequence[LayerSource], borders: Ints | None) -> Iterator[tuple[int, list[Layers]]]:
    """Yield the first layer and the stacks of each block; all layers at once if there are no borders.

    While a block is processed the next one is read, so no more than two of each source are in memory.
    """
    if not sources:
        return
    spans = list(pairwise([0, len(sources[0])] if borders is None else borders.tolist()))

    def read(span: tuple[int, int]) -> list[Layers]:
        return [source.block(*span) for source in sources]

    with ThreadPoolExecutor(1) as reader:
        ahead = reader.submit(read, spans[0])
        for (start, _), following in zip(spans, [*spans[1:], None], strict=True):
            block = ahead.result()
            if following is not None:
                ahead = reader.submit(read, following)
            yield start, block
            del block


def contour_figures(layers: Layers) -> pd.DataFrame:
    """Figures of each layer of one stack: area, and numbers of closed rings, outer rings, open paths and points."""
    return pd.DataFrame(
        {
            "area_mm2": layers.areas(),
            "rings": layers.ring_counts(),
            "outer_rings": layers.outer_counts(),
            "open_paths": layers.open_counts(),
            "points": np.diff(layers.ring_starts[layers.layer_starts]),
        }
    )


WINDOW = 32  # layers read from a file at once


class Reader:
    """Single layers of a stack in memory or in a file, read a window at a time."""

    def __init__(self, source: LayerSource) -> None:
        self.source = source
        self._first = -1
        self._window: Layers | None = None

    def layer(self, layer: int) -> Layers:
        """One layer as a stack of its own."""
        first = layer - layer % WINDOW
        if self._window is None or first != self._first:
            self._window = self.source.block(first, min(first + WINDOW, len(self.source)))
            self._first = first
        return self._window.block(layer - first, layer - first + 1)

"""Sheets: single layers of two stacks side by side, from which causes are found; a bounded sample of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from ebamcheck.comparison.outline import Outline, outline
from ebamcheck.comparison.overlap import overlap
from ebamcheck.comparison.sources import LayerSource
from ebamcheck.layers.stack import Layers, canonical
from ebamcheck.numeric.rings import Floats, Ints

MOST_SHEETS = 12
"""Most layers of a pair that are examined: enough to find what they have in common."""

MOST_RINGS = 300_000
"""Most rings of these layers, of both slicers together: fewer are taken where each has over 25,000, as specks of a raster may be."""

WINDOW = 32
"""Layers read from a file at once."""


@dataclass(frozen=True, eq=False)
class Sheet:
    """One layer of the slicer that differs and of the one that it is compared with, as stacks of one layer each."""

    layer: int
    height_mm: float
    a: Layers
    """Of the slicer that differs."""
    b: Layers
    """Of the other."""
    origin_mm: tuple[float, float]

    @cached_property
    def outline_a(self) -> Outline:
        """Contours of `a`, from the origin."""
        return outline(self.a, 0, self.origin_mm)

    @cached_property
    def outline_b(self) -> Outline:
        """Contours of `b`, from the origin."""
        return outline(self.b, 0, self.origin_mm)

    @cached_property
    def difference_mm2(self) -> float:
        """Area of the symmetric difference."""
        return apart_mm2(self.outline_a, self.outline_b)

    @property
    def both_solid(self) -> bool:
        """Whether both have a closed ring."""
        return bool(self.a.closed.any() and self.b.closed.any())

    def with_a(self, a: Layers) -> Sheet:
        """Return the sheet with other contours in place of those that differ."""
        return replace(self, a=a)


def apart_mm2(a: Outline, b: Outline) -> float:
    """Area of the symmetric difference of two outlines, mm2; infinite if they have too many crossings."""
    found = overlap(a, b, False)
    return float(found.symmetric_difference_mm2) if found.sound else np.inf


def total_mm2(sheets: Sequence[Sheet]) -> float:
    """Area of the symmetric difference on all sheets, mm2."""
    return float(sum(sheet.difference_mm2 for sheet in sheets))


def one_layer(height_mm: float, rings: Sequence[ArrayLike]) -> Layers:
    """Stack of one layer of closed rings."""
    arrays = [np.asarray(ring, np.float64).reshape(-1, 2) for ring in rings]
    return canonical(
        [height_mm],
        np.concatenate([np.zeros((0, 2)), *arrays]),
        np.concatenate([[0], np.cumsum([len(a) for a in arrays], dtype=np.int64)]),
        np.array([0, len(arrays)]),
        np.ones(len(arrays), np.bool_),
    )


def moved_points(layers: Layers, points: Floats, mirrored: bool = False) -> Layers:
    """The same closed rings with other points, in canonical form; reversed if the map of the points mirrors."""
    found = replace(layers, points=np.ascontiguousarray(points))
    step = -1 if mirrored else 1
    return one_layer(
        float(layers.heights[0]), [found.ring(r)[::step] for r in found.rings_of(0) if found.closed[r]]
    )


class Reader:
    """Single layers of a stack in memory or in a file, read a window at a time."""

    def __init__(self, source: LayerSource) -> None:
        self._source = source
        self._first = -1
        self._window: Layers | None = None

    def layer(self, layer: int) -> Layers:
        """One layer as a stack of its own."""
        first = layer - layer % WINDOW
        if self._window is None or first != self._first:
            stop = min(first + WINDOW, len(self._source))
            self._window = self._source.block(first, stop)
            self._first = first
        assert self._window is not None
        return self._window.block(layer - first, layer - first + 1)


def sample(
    layers: Ints, rings: Ints, heights: Floats, a: Reader, b: Reader, origin_mm: tuple[float, float]
) -> list[Sheet]:
    """Sheets of a few of the layers on which two stacks differ, spread evenly; `rings` (L,) is how many each has."""
    if not layers.size:
        return []
    # The more rings the layers have, by their median, the fewer are taken; points are not counted before a layer is read.
    typical = max(float(np.median(rings[layers])), 1.0)
    count = int(np.clip(MOST_RINGS / typical, 1, min(MOST_SHEETS, layers.size)))
    at = np.unique(np.round(np.linspace(0, layers.size - 1, count + 2)[1:-1]).astype(np.int64))
    return [Sheet(k, float(heights[k]), a.layer(k), b.layer(k), origin_mm) for k in layers[at].tolist()]

"""Layers of two slicers side by side, and how much of the area between them a guess explains."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from ebamcheck.comparison.outline import Outline, outline, windings
from ebamcheck.comparison.place_causes import MeshFlaws
from ebamcheck.comparison.sources import LayerSource
from ebamcheck.comparison.sweep import overlap
from ebamcheck.geometry.nearest import distances
from ebamcheck.kernels import Floats, Ints
from ebamcheck.layers.stack import Layers, from_rings

MOST_SHEETS = 12  # most layers of a pair that are examined: enough to find what they have in common
# Most rings of these layers, of both slicers together: fewer are taken where each has over 25,000, as specks of a raster may be
MOST_RINGS = 300_000
WINDOW = 32  # layers read from a file at once
PLACES = 160  # places along the contours of a sheet at which distances are taken
MOST_SEGMENTS = (
    4000  # most segments for which the winding number on both sides is computed, which takes quadratic time
)
ASIDE = 1e-6  # distance beside a segment, over its length, at which the winding number is computed


@dataclass(frozen=True, eq=False)
class Sheet:
    """One layer of the slicer that differs, `a`, and of the one that it is compared with, as stacks of one layer each."""

    layer: int
    height_mm: float
    a: Layers
    b: Layers
    origin_mm: tuple[float, float]

    @cached_property
    def outline_a(self) -> Outline:
        """Outline of `a` from the origin."""
        return outline(self.a, 0, self.origin_mm)

    @cached_property
    def contours_a(self) -> Floats:
        """Segments (S, 4) of the closed rings of `a` from the origin."""
        return from_origin(ring_segments(self.a), self.origin_mm)

    @cached_property
    def contours_b(self) -> Floats:
        """Segments (S, 4) of the closed rings of `b` from the origin."""
        return from_origin(ring_segments(self.b), self.origin_mm)

    @cached_property
    def difference_mm2(self) -> float:
        """Area of the symmetric difference."""
        return self.apart_mm2(self.b)

    def apart_mm2(self, other: Layers) -> float:
        """Area of the symmetric difference of `a` and another layer; infinite if they have too many crossings."""
        swept = overlap(self.outline_a, outline(other, 0, self.origin_mm), False)
        return float(swept.symmetric_difference_mm2) if swept.sound else np.inf

    @property
    def both_solid(self) -> bool:
        """Whether both have a closed ring."""
        return bool(self.a.closed.any() and self.b.closed.any())

    def with_rings(self, rings: Sequence[ArrayLike]) -> Sheet:
        """Return the sheet with other closed rings in place of those of `a`."""
        return replace(self, a=from_rings([self.height_mm], [rings]))


def ring_segments(layers: Layers) -> Floats:
    """Segments (S, 4) of all closed rings: ``x0, y0, x1, y1`` with the solid on their left."""
    following = np.arange(1, len(layers.points) + 1)
    following[layers.ring_starts[1:] - 1] = layers.ring_starts[:-1]
    closed = np.repeat(layers.closed, np.diff(layers.ring_starts))
    return np.hstack([layers.points, layers.points[following]])[closed]


def from_origin(segments: Floats, origin_mm: tuple[float, float]) -> Floats:
    """The same segments (S, 4) from an origin."""
    return np.asarray(segments - np.array([*origin_mm, *origin_mm]))


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


# -- Areas between two layers: exactly, and by distances, which a fit can follow --------------------------------


def total_mm2(sheets: Sequence[Sheet]) -> float:
    """Area of the symmetric difference on all sheets, mm2."""
    return float(sum(sheet.difference_mm2 for sheet in sheets))


def along(contours: Floats) -> tuple[Floats, float]:
    """Places (N, 2) at equal steps along all contours, and the length that each represents, mm."""
    ends = contours[:, 2:] - contours[:, :2]
    extent = np.hypot(ends[:, 0], ends[:, 1])
    reach = np.cumsum(extent)
    total = float(reach[-1]) if reach.size else 0.0
    if not total > 0.0:
        return np.zeros((0, 2)), 0.0
    at = (np.arange(PLACES) + 0.5) / PLACES * total
    s = np.minimum(np.searchsorted(reach, at, side="right"), len(contours) - 1)
    t = 1.0 - (reach[s] - at) / np.maximum(extent[s], np.finfo(np.float64).tiny)
    return contours[s, :2] + t[:, None] * ends[s], total / PLACES


def beside(contours: Floats, places: Floats) -> Floats:
    """Distances (N,) mm of places (N, 2) from contours, negative inside the solid; infinite where there are none."""
    contours, places = np.ascontiguousarray(contours), np.ascontiguousarray(places)
    return np.where(windings(contours, places) > 0, -1.0, 1.0) * distances(places, contours)


def gap_mm2(a: Floats, b: Floats, offset_mm: float = 0.0, farthest_mm: float = math.inf) -> float:
    """Area between contours `a` and `b`, the latter offset outward: distances, at most the farthest, times lengths."""
    total = 0.0
    for one, other, outward_mm in ((a, b, -offset_mm), (b, a, offset_mm)):
        places, length_mm = along(one)
        apart = np.abs(beside(other, places) + outward_mm)
        total += 0.5 * length_mm * float(np.minimum(apart, farthest_mm).sum())
    return total


def share_explained(sheets: Sequence[Sheet], guess: Callable[[Sheet], Floats]) -> float:
    """Share of the difference that is explained if these are the contours (S, 4) of the slicer that differs, 0 .. 1."""
    before = sum(gap_mm2(sheet.contours_a, sheet.contours_b) for sheet in sheets)
    after = sum(gap_mm2(sheet.contours_a, guess(sheet)) for sheet in sheets)
    return max(1.0 - after / before, 0.0) if before > 0.0 else 0.0


def mesh_contours(flaws: MeshFlaws, height_mm: float, origin_mm: tuple[float, float]) -> Floats:
    """Section of the mesh, from an origin; where bodies overlap, without the segments that lie inside another body."""
    segments = from_origin(flaws.section(height_mm), origin_mm)
    if flaws.bodies > 1 and len(segments) <= MOST_SEGMENTS:
        middle, way = 0.5 * (segments[:, :2] + segments[:, 2:]), segments[:, 2:] - segments[:, :2]
        aside = ASIDE * np.column_stack([-way[:, 1], way[:, 0]])
        left, right = windings(segments, middle + aside) > 0, windings(segments, middle - aside) > 0
        segments = segments[left != right]
    return segments

"""A part made ready for the exact plane cut."""

from __future__ import annotations

from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import NDArray

from ebamcheck.backend import BackendSettings, Progress
from ebamcheck.kernels import run_blocks
from ebamcheck.layers import Layers, canonical, concatenate
from ebamcheck.part import Part
from ebamcheck.topology import edge_groups, twins
from ebamcheck_planecut import overlaps
from ebamcheck_planecut.trace import (
    Floats,
    Index,
    facet_spans,
    facets_by_layer,
    mixed_directions,
    trace_layers,
)

SMALLEST_BLOCK = 16
"""Layers that a thread takes at least: fewer do not pay for passing over the facets once a block."""


class PreparedCut:
    """Neighbours of every facet, found once; cuts any block of layers."""

    def __init__(self, part: Part, settings: BackendSettings) -> None:
        self._part = part
        self._settings = settings.model_dump()
        self._vertices, self._faces, self._original = _sorted_by_height(part)
        groups = edge_groups(self._faces, len(self._vertices))
        self._twin = twins(self._vertices, self._faces, groups.half_edges, groups.starts)
        paired = int(np.count_nonzero(self._twin >= 0))
        self._mixed = mixed_directions(self._faces, self._twin)
        self._open = paired != groups.half_edges.size

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Hold nothing that needs freeing."""

    def slice(self, heights: NDArray[np.float64], progress: Progress | None = None) -> Layers:
        """Cut at strictly increasing heights (L,), mm."""
        levels = np.searchsorted(heights, self._vertices[:, 2], side="left").astype(np.int32)
        first, last = facet_spans(levels, self._faces)

        def block(start: int, stop: int) -> Layers:
            layers = self._cut_block(heights, levels, first, last, start, stop)
            if progress is not None:
                progress(stop - start)
            return layers

        return concatenate(run_blocks(block, heights.size, SMALLEST_BLOCK)) if heights.size else self._empty()

    def _cut_block(
        self,
        heights: NDArray[np.float64],
        levels: NDArray[np.int32],
        first: NDArray[np.int32],
        last: NDArray[np.int32],
        start: int,
        stop: int,
    ) -> Layers:
        part = self._part
        layer_starts, facets = facets_by_layer(first, last, start, stop)
        points, edge, edge_t, ring_starts, rings_of_layer, closed = trace_layers(
            self._vertices,
            self._faces,
            levels,
            self._twin,
            heights,
            start,
            layer_starts,
            facets,
            self._open,
            self._mixed,
        )
        layers = canonical(
            heights[start:stop],
            points,
            ring_starts,
            rings_of_layer,
            closed,
            edge=self._original[edge],
            edge_t=edge_t,
            part=part.sha256,
            direction=part.direction,
            backend="planecut",
            settings=self._settings,
        )
        return _united(layers) if self._settings["overlaps"] == "unite" else layers

    def _empty(self) -> Layers:
        return canonical(
            np.zeros(0),
            np.zeros((0, 2)),
            [0],
            [0],
            np.zeros(0, np.bool_),
            edge=np.zeros((0, 2), np.int32),
            edge_t=np.zeros(0),
            part=self._part.sha256,
            direction=self._part.direction,
            backend="planecut",
            settings=self._settings,
        )


def _united(layers: Layers) -> Layers:
    """Resolve the layers whose shells overlap; the others stay as they are."""
    kinds = overlaps.classify_layers(layers)
    doubtful = np.flatnonzero(kinds != overlaps.CLEAN)
    if not doubtful.size:
        return layers
    blocks: list[Layers] = []
    done = 0
    for k in doubtful.tolist():
        one = layers.block(k, k + 1)
        resolved = overlaps.unite(one, int(kinds[k]))
        if resolved is None:
            continue
        points, ring_starts, closed, edge, edge_t = resolved
        again = canonical(
            one.heights, points, ring_starts, [0, closed.size], closed, edge=edge, edge_t=edge_t,
            part=one.part, direction=one.direction, backend=one.backend, settings=one.settings,
        )  # fmt: skip
        blocks += [layers.block(done, k), again.labelled(dropped=again.dropped + one.dropped)]
        done = k + 1
    return concatenate([*blocks, layers.block(done, len(layers))]) if blocks else layers


def _sorted_by_height(part: Part) -> tuple[Floats, Index, Index]:
    """Vertices by height and facets by their lowest vertex, and the part's number of each vertex.

    What a layer needs then lies together in memory, in whatever order the file had it. Facets with a repeated vertex
    have no section and are left out.
    """
    original = np.argsort(part.vertices[:, 2], kind="stable").astype(np.int32)
    rank = np.empty_like(original)
    rank[original] = np.arange(original.size, dtype=np.int32)
    a, b, c = part.faces.T
    faces = rank[part.faces[(a != b) & (b != c) & (c != a)]]
    order = np.argsort(faces.min(axis=1), kind="stable")
    return part.vertices[original], faces[order], original

"""A part prepared for the exact plane cut."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from threading import Lock
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from ebamcheck.backend import BackendSettings, Progress, labels_of
from ebamcheck.layers.stack import Layers, concatenate
from ebamcheck.mesh.part import Part
from ebamcheck.threads import run_blocks, run_each
from ebamcheck_planecut import PlaneCut
from ebamcheck_planecut.overlaps import CLEAN, TOUCHING
from ebamcheck_planecut.sorted_mesh import SortedMesh, crossed_mesh, sorted_mesh, vertices_under
from ebamcheck_planecut.sweep import Block, Columns, cut_block

Sheets = Callable[[], NDArray[np.int32]]

SMALLEST_BLOCK = 16  # fewest layers worth a thread
# Most layers along a new direction that are cut without sorting its mesh: finding their facets takes no longer than sorting
LONE_LAYERS = 8


class PreparedCut:
    """The part's mesh sorted by height, with the neighbours of every facet; cuts any block of layers.

    With `before`, a sorted mesh with the same `faces`, this one is sorted only after more than :data:`LONE_LAYERS` layers were
    requested. `sheets` gives the sheet of each vertex.
    """

    def __init__(
        self,
        part: Part,
        settings: BackendSettings,
        before: SortedMesh | None = None,
        sheets: Sheets | None = None,
    ) -> None:
        self._part = part
        self._sheets = sheets or cache(lambda: _sheets_of(part))
        self._settings = settings
        self._before = before
        self._lone_layers = 0
        self._lock = Lock()
        self._mesh = _while_hashed(part, lambda: sorted_mesh(part)) if before is None else None

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Hold nothing that needs freeing."""

    def turned(self, part: Part) -> PreparedCut:
        """Prepare a part with the same `faces` along another direction, without searching for their neighbours again."""
        return PreparedCut(part, self._settings, self._before if self._mesh is None else self._mesh, self._sheets)

    def _mesh_across(self, heights: NDArray[np.float64]) -> SortedMesh:
        """Sorted mesh with all facets that the planes cross: the whole one or, for a few planes, only these facets."""
        with self._lock:
            self._lone_layers += heights.size
            if self._mesh is None and self._before is not None and self._lone_layers > LONE_LAYERS:
                self._mesh = sorted_mesh(self._part, self._before)
            mesh = self._mesh
        return _while_hashed(self._part, lambda: crossed_mesh(self._part, heights)) if mesh is None else mesh

    def slice(self, heights: NDArray[np.float64], progress: Progress | None = None) -> Layers:
        """Cut at strictly increasing heights (L,), mm."""
        heights = np.ascontiguousarray(heights, dtype=np.float64)
        mesh = self._mesh_across(heights)
        under = vertices_under(mesh, heights)
        rows = np.concatenate([[0], np.cumsum(mesh.crossed[under])])
        columns = Columns(np.empty((int(rows[-1]), 2)), np.empty((int(rows[-1]), 2), np.int32), np.empty(int(rows[-1])))
        unite = self._settings.model_dump()["overlaps"] == "unite"
        reach_mm = PlaneCut().error_bound_mm(self._part, self._settings)

        def block(start: int, stop: int) -> Block:
            # Zeroed memory costs nothing until it is touched, and a block touches only that of its own facets.
            seen = np.zeros(len(mesh.faces), np.int32)
            at = int(rows[start])
            cut = cut_block(mesh, heights[start:stop], under[start:stop], seen, columns, at, unite, reach_mm)
            if progress is not None:
                progress(stop - start)
            return cut

        blocks = run_blocks(block, heights.size, SMALLEST_BLOCK) if heights.size else []
        layers = self._joined(heights, columns, blocks)
        kinds = np.concatenate([np.zeros(0, np.int8), *(cut.kinds for cut in blocks)])
        return _united(layers, kinds, reach_mm, self._sheets)

    def _joined(self, heights: NDArray[np.float64], columns: Columns, blocks: list[Block]) -> Layers:
        """Join blocks that were written to shared columns into one stack, in their order."""
        run_blocks(lambda a, b: _close_gaps(columns[a:b], blocks), len(columns))
        filled = rings = 0
        ring_starts, layer_starts = [np.zeros(1, np.int64)], [np.zeros(1, np.int64)]
        for cut in blocks:
            first, stop = int(cut.ring_starts[0]), int(cut.ring_starts[-1])
            ring_starts.append(cut.ring_starts[1:] - (first - filled))
            layer_starts.append(cut.layer_starts[1:] + rings)
            filled += stop - first
            rings += cut.closed.size
        return Layers(
            heights=heights,
            points=columns.points[:filled],
            ring_starts=np.concatenate(ring_starts),
            layer_starts=np.concatenate(layer_starts),
            closed=np.concatenate([np.zeros(0, np.bool_), *(cut.closed for cut in blocks)]),
            edge=columns.edge[:filled],
            edge_t=columns.edge_t[:filled],
            **labels_of(self._part, PlaneCut.name, self._settings.model_dump()),
            dropped=np.concatenate([np.zeros(0, np.int64), *(cut.dropped for cut in blocks)]),
        )


def _close_gaps(columns: Sequence[NDArray[Any]], blocks: list[Block]) -> None:
    """Close the gaps between the rows of blocks, which rings without area and merged points leave."""
    for column in columns:
        # numpy moves overlapping rows of one dimension in place; with two it would copy them to new memory first.
        flat, width = column.reshape(-1), column.size // max(1, len(column))
        filled = 0
        for cut in blocks:
            first, stop = int(cut.ring_starts[0]), int(cut.ring_starts[-1])
            if filled < first:
                flat[width * filled : width * (filled + stop - first)] = flat[width * first : width * stop]
            filled += stop - first


def _sheets_of(part: Part) -> NDArray[np.int32]:
    # Few parts need them, and what they need takes longer to load than a small part takes to cut.
    from ebamcheck_planecut.arrangement import sheets_of_vertices

    return sheets_of_vertices(part.faces, len(part.vertices))


def _while_hashed(part: Part, make: Callable[[], SortedMesh]) -> SortedMesh:
    """Make a mesh while another thread computes the part's hash, which layers carry."""
    with ThreadPoolExecutor(1) as aside:
        hashed = aside.submit(lambda: part.sha256)
        mesh = make()
        hashed.result()
    return mesh


def _united(layers: Layers, kinds: NDArray[np.int8], reach_mm: float, sheets: Sheets) -> Layers:
    """Unite the shells of layers on which they overlap or touch; other layers stay as they are."""
    doubtful = np.flatnonzero(kinds != CLEAN).tolist()
    if not doubtful:
        return layers
    from ebamcheck_planecut.arrangement import unite

    sheet = sheets() if (kinds == TOUCHING).any() else np.zeros(0, np.int32)
    found = run_each(lambda k: unite(layers.block(k, k + 1), int(kinds[k]), reach_mm, sheet), doubtful)
    blocks: list[Layers] = []
    done = 0
    for k, one in zip(doubtful, found, strict=True):
        if one is not None:
            blocks += [layers.block(done, k), one]
            done = k + 1
    return concatenate([*blocks, layers.block(done, len(layers))]) if blocks else layers

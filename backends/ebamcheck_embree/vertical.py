"""Vertical rays, one for each node of the grid, cast once for all layers."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ebamcheck.backend import Progress
from ebamcheck.kernels import kernel, run_blocks
from ebamcheck.part import Part
from ebamcheck_embree.above_nodes import doubtful_nodes, facet_counts, facets_at, heights_on_facets
from ebamcheck_embree.crossings import Bools, borders
from ebamcheck_embree.grid import Grid
from ebamcheck_embree.knots import NO_FACET, Lattice, RowKnots
from ebamcheck_embree.marching import contours
from ebamcheck_embree.scene import Facets, Floats, Hits, Ints
from ebamcheck_embree.stack import LayerRings, Rays

Raster = NDArray[np.uint8]


class Towers(NamedTuple):
    """Heights at which each node's ray enters and leaves the material, grouped by ray."""

    starts: Ints
    along: Floats
    paired: Bools
    sound: Bools
    doubtful: Bools
    """(R,) whether Embree named other facets than lie over and under the node, or not all of them."""


class VerticalRays(Rays):
    """The material above each node, as intervals of height."""

    def __init__(self, part: Part, grid: Grid, rays_per_call: int, labels: Mapping[str, Any]) -> None:
        super().__init__(part, grid, rays_per_call, labels)
        towers = self._cast_all()
        self._unpaired = int(np.count_nonzero(~towers.sound))
        towers = _borrowed(towers, grid.columns)
        self._starts, self._along = towers.starts, towers.along
        self._node = np.repeat(np.arange(len(towers.starts) - 1), np.diff(towers.starts))

    def _cast_all(self) -> Towers:
        """Cast the ray of every node, in blocks."""
        lattice = (self.grid.x0_mm, self.grid.y0_mm, self.grid.cell_mm, self.grid.columns, self.grid.rows)
        counts = facet_counts(self.vertices, self.faces, lattice)

        def cast_block(start: int, stop: int) -> list[Towers]:
            step = self.rays_per_call
            edges = [*range(start, stop, step), stop]
            return [self._cast(a, counts[a:b]) for a, b in itertools.pairwise(edges)]

        cast = _joined(
            [towers for block in run_blocks(cast_block, len(counts), smallest=4096) for towers in block]
        )
        doubtful = np.flatnonzero(cast.doubtful)
        return (
            _replaced(cast, doubtful, self._in_double(lattice, doubtful, counts)) if doubtful.size else cast
        )

    def _cast(self, start: int, counts: Ints) -> Towers:
        """Cast the rays of consecutive nodes, of which the number of facets that each meets is known."""
        x, y = self._places(np.arange(start, start + len(counts)))
        origins = np.empty((len(counts), 3), np.float32)
        origins[:, 0], origins[:, 1] = x, y
        origins[:, 2] = -0.51 * float(self.part.size[2]) - self.grid.cell_mm
        return self._measured(x, y, self.scene.facets_along(origins, axis=2), counts)

    def _in_double(self, lattice: Lattice, nodes: Ints, counts: Ints) -> Towers:
        """Towers of nodes whose rays Embree did not give all facets: by every facet that float64 finds."""
        wanted = np.zeros(len(counts), np.bool_)
        wanted[nodes] = True
        starts = np.concatenate([[0], np.cumsum(np.where(wanted, counts, 0))]).astype(np.int64)
        facets = np.empty(starts[-1], np.int32)
        facets_at(self.vertices, self.faces, lattice, wanted, starts, facets)
        own = np.append(starts[nodes], starts[-1])
        return self._measured(*self._places(nodes), Hits(own, facets), counts[nodes])

    def _places(self, nodes: Ints) -> tuple[Floats, Floats]:
        row, column = np.divmod(nodes, self.grid.columns)
        return self.grid.column_x_mm[column], self.grid.row_y_mm[row]

    def _measured(self, x: Floats, y: Floats, hits: Hits, counts: Ints) -> Towers:
        along, sign = heights_on_facets(self.vertices, self.faces, x, y, hits.starts, hits.facets)
        doubtful = doubtful_nodes(hits.starts, sign, counts)
        starts, along, _, paired, sound, _ = borders(hits.starts, along, sign, hits.facets)
        return Towers(starts, along, paired, sound, doubtful)

    def cut(self, z_mm: Floats, report: Progress) -> list[LayerRings]:
        """Cut by turning over, from each layer to the next, the nodes whose rays pass a border between."""
        grid = self.grid
        raster = _raster_at(self._starts, self._along, z_mm[0]).reshape(grid.rows, grid.columns)
        here = np.flatnonzero((self._along > z_mm[0]) & (self._along <= z_mm[-1]))
        layer = np.searchsorted(z_mm, self._along[here], side="left")
        nodes = self._node[here[np.argsort(layer, kind="stable")]]
        ends = np.cumsum(np.bincount(layer, minlength=len(z_mm)))
        found: list[LayerRings] = []
        for k, z in enumerate(z_mm):
            if k:
                _turn_over(raster, nodes[ends[k - 1] : ends[k]])
            found.append(self._layer(raster, float(z)))
            report(1)
        return found

    def _layer(self, raster: Raster, z: float) -> LayerRings:
        grid = self.grid
        knots = RowKnots(*_raster_knots(raster, grid.x0_mm, grid.cell_mm))
        nothing = (
            np.zeros(grid.columns + 1, np.int64),
            np.zeros(0),
            np.zeros(0, np.int32),
            np.ones(grid.columns, np.bool_),
        )
        points, starts = contours(grid, knots, nothing, (self.vertices, self.faces), z, corners=False)
        return LayerRings(points, starts, self._unpaired)


def _replaced(towers: Towers, rays: Ints, others: Towers) -> Towers:
    """Towers with those of some rays (ascending) taken from others."""
    joined = _joined([towers, others])
    source = np.arange(towers.paired.size)
    source[rays] = towers.paired.size + np.arange(rays.size)
    return _taken(joined, source)


def _taken(towers: Towers, source: Ints) -> Towers:
    """Towers of the rays `source`; -1 stands for a ray that meets nothing."""
    sizes = np.where(source >= 0, np.diff(towers.starts)[source], 0)
    starts = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
    rows = np.arange(starts[-1]) + np.repeat(towers.starts[source] - starts[:-1], sizes)
    return Towers(
        starts, towers.along[rows], towers.paired[source], towers.sound[source], towers.doubtful[source]
    )


def _joined(blocks: list[Towers]) -> Towers:
    sizes = np.concatenate([np.diff(block.starts) for block in blocks])
    return Towers(
        np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64),
        np.concatenate([block.along for block in blocks]),
        np.concatenate([block.paired for block in blocks]),
        np.concatenate([block.sound for block in blocks]),
        np.concatenate([block.doubtful for block in blocks]),
    )


def _borrowed(towers: Towers, columns: int) -> Towers:
    """Give each ray that does not pair the tower of the nearest one to its left in its row that does."""
    if towers.paired.all():
        return towers
    own = np.where(towers.paired, np.arange(towers.paired.size), -1).reshape(-1, columns)
    return _taken(towers, np.maximum.accumulate(own, axis=1).ravel())


@kernel
def _raster_at(starts: Ints, along: Floats, z: float) -> Raster:
    """Nodes inside the material at z = h + 0: an odd number of borders at or under it."""
    inside = np.zeros(starts.size - 1, np.uint8)
    for r in range(starts.size - 1):
        for n in range(starts[r], starts[r + 1]):
            if along[n] > z:
                break
            inside[r] ^= 1
    return inside


@kernel
def _turn_over(raster: Raster, nodes: Ints) -> None:
    columns = raster.shape[1]
    for node in nodes:
        raster[node // columns, node % columns] ^= 1


@kernel
def _raster_knots(raster: Raster, x0: float, cell: float) -> tuple[Ints, Ints, Floats, Facets]:
    """Middles of the grid edges between nodes of different sides; columns of :class:`RowKnots`."""
    rows, columns = raster.shape
    starts = np.zeros(rows + 1, np.int64)
    for j in range(rows):
        changes = 0
        for i in range(1, columns):
            changes += raster[j, i] ^ raster[j, i - 1]
        starts[j + 1] = starts[j] + changes
    node = np.empty(starts[rows], np.int64)
    along = np.empty(starts[rows])
    out = 0
    for j in range(rows):
        if starts[j + 1] == starts[j]:
            continue
        for i in range(1, columns):
            if raster[j, i] != raster[j, i - 1]:
                node[out], along[out] = i, x0 + cell * (i - 0.5)
                out += 1
    return starts, node, along, np.full(out, NO_FACET, np.int32)

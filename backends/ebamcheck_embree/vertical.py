"""Vertical rays, one for each node of the grid, cast once for all layers."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ebamcheck.backend import Progress
from ebamcheck.kernels import kernel, run_blocks
from ebamcheck.part import Part
from ebamcheck_embree.crossings import Bools, borders
from ebamcheck_embree.grid import NUDGE, Grid
from ebamcheck_embree.knots import NO_FACET, RowKnots
from ebamcheck_embree.marching import contours
from ebamcheck_embree.scene import Facets, Floats, Hits, Ints
from ebamcheck_embree.stack import LayerRings, Rays

Raster = NDArray[np.uint8]

GOLDEN_ANGLE_RAD = math.pi * (3.0 - math.sqrt(5.0))
"""Successive multiples of it point everywhere and along no edge twice."""

NUDGES = tuple(
    (NUDGE * math.cos(k * GOLDEN_ANGLE_RAD), NUDGE * math.sin(k * GOLDEN_ANGLE_RAD)) for k in range(1, 6)
)
"""Steps, in cells, by which a ray that does not pair is moved off whatever edge it grazed."""

RAYS_IN_DOUBLE = 256
"""Rays cast in float64 where single precision cannot part two facets; an open part has many more."""


class Towers(NamedTuple):
    """Heights at which each node's ray enters and leaves the material, grouped by ray."""

    starts: Ints
    along: Floats
    paired: Bools
    sound: Bools


class VerticalRays(Rays):
    """The material above each node, as intervals of height."""

    def __init__(self, part: Part, grid: Grid, rays_per_call: int, labels: Mapping[str, Any]) -> None:
        super().__init__(part, grid, rays_per_call, labels)
        towers = self._checked(self._all_towers())
        self._unpaired = int(np.count_nonzero(~towers.sound))
        towers = _borrowed(towers, grid.columns)
        self._starts, self._along = towers.starts, towers.along
        self._node = np.repeat(np.arange(len(towers.starts) - 1), np.diff(towers.starts))

    def _all_towers(self) -> Towers:
        def cast_block(start: int, stop: int) -> list[Towers]:
            step = self.rays_per_call
            return [self._towers(np.arange(a, min(a + step, stop))) for a in range(start, stop, step)]

        found = run_blocks(cast_block, self.grid.rows * self.grid.columns, smallest=4096)
        return _joined([towers for block in found for towers in block])

    def _checked(self, towers: Towers) -> Towers:
        """Cast the first few rays that still do not pair in float64 against every facet."""
        wrong = np.flatnonzero(~towers.sound)[:RAYS_IN_DOUBLE]
        if not wrong.size:
            return towers
        x, y = self._places(wrong)
        hits = [
            _facets_over(self.vertices, self.faces, float(a), float(b)) for a, b in zip(x, y, strict=True)
        ]
        starts = np.concatenate([[0], np.cumsum([len(facets) for facets in hits])]).astype(np.int64)
        return _replaced(towers, wrong, self._measured(x, y, Hits(starts, np.concatenate(hits))))

    def _towers(self, nodes: Ints) -> Towers:
        """Cast the rays of some nodes; those that do not pair are moved a little and cast again."""
        towers = self._cast(nodes, 0.0, 0.0)
        for dx, dy in NUDGES:
            wrong = np.flatnonzero(~towers.sound)
            if not wrong.size:
                break
            again = self._cast(nodes[wrong], dx * self.grid.cell_mm, dy * self.grid.cell_mm)
            towers = _replaced(towers, wrong, again)
        return towers

    def _cast(self, nodes: Ints, dx_mm: float, dy_mm: float) -> Towers:
        x, y = self._places(nodes)
        x, y = x + dx_mm, y + dy_mm
        origins = np.empty((len(nodes), 3), np.float32)
        origins[:, 0], origins[:, 1] = x, y
        origins[:, 2] = -0.51 * float(self.part.size[2]) - self.grid.cell_mm
        return self._measured(x, y, self.scene.facets_along(origins, axis=2))

    def _places(self, nodes: Ints) -> tuple[Floats, Floats]:
        return self.grid.column_x_mm[nodes % self.grid.columns], self.grid.row_y_mm[
            nodes // self.grid.columns
        ]

    def _measured(self, x: Floats, y: Floats, hits: Hits) -> Towers:
        along, sign = _heights_on_facets(self.vertices, self.faces, x, y, hits.starts, hits.facets)
        starts, along, _, paired, sound, _ = borders(hits.starts, along, sign, hits.facets)
        return Towers(starts, along, paired, sound)

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


@kernel
def _facets_over(vertices: Floats, faces: Facets, x: float, y: float) -> Facets:
    """Facets whose projection holds (x, y), by edges crossed to the right of it: neighbours share each edge."""
    found = np.empty(faces.shape[0], np.int32)
    count = 0
    for f in range(faces.shape[0]):
        odd = False
        for k in range(3):
            a, b = faces[f, k], faces[f, (k + 1) % 3]
            if (vertices[a, 1] <= y) == (vertices[b, 1] <= y):
                continue
            low, high = (a, b) if vertices[a, 1] <= y else (b, a)
            t = (y - vertices[low, 1]) / (vertices[high, 1] - vertices[low, 1])
            odd ^= vertices[low, 0] + t * (vertices[high, 0] - vertices[low, 0]) > x
        if odd:
            found[count] = f
            count += 1
    return found[:count].copy()


@kernel
def _heights_on_facets(
    vertices: Floats, faces: Facets, x: Floats, y: Floats, starts: Ints, facets: Facets
) -> tuple[Floats, Ints]:
    """Height (H,) at which each ray meets each facet it hit, and +1 where it enters, -1 where it leaves.

    Weights and heights are kept within the facet: a steep one gives no height beyond its own, a level one
    exactly its own.
    """
    along = np.zeros(facets.size)
    sign = np.zeros(facets.size, np.int64)
    for r in range(starts.size - 1):
        for n in range(starts[r], starts[r + 1]):
            f = facets[n]
            a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
            ax, ay = vertices[a, 0] - x[r], vertices[a, 1] - y[r]
            bx, by = vertices[b, 0] - x[r], vertices[b, 1] - y[r]
            cx, cy = vertices[c, 0] - x[r], vertices[c, 1] - y[r]
            wa, wb, wc = bx * cy - cx * by, cx * ay - ax * cy, ax * by - bx * ay
            total = wa + wb + wc
            if total == 0.0:
                continue
            wa, wb, wc = max(wa / total, 0.0), max(wb / total, 0.0), max(wc / total, 0.0)
            za, zb, zc = vertices[a, 2], vertices[b, 2], vertices[c, 2]
            height = (wa * za + wb * zb + wc * zc) / (wa + wb + wc)
            along[n] = min(max(height, min(za, zb, zc)), max(za, zb, zc))
            sign[n] = -1 if total > 0.0 else 1
    return along, sign


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
    return Towers(starts, towers.along[rows], towers.paired[source], towers.sound[source])


def _joined(blocks: list[Towers]) -> Towers:
    sizes = np.concatenate([np.diff(block.starts) for block in blocks])
    return Towers(
        np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64),
        np.concatenate([block.along for block in blocks]),
        np.concatenate([block.paired for block in blocks]),
        np.concatenate([block.sound for block in blocks]),
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

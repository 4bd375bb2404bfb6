"""Vertical rays, one for each node of the grid, cast once for all layers."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from ebamcheck.mesh.part import Part
from ebamcheck.numeric.kernels import kernel, run_blocks, thread_count
from ebamcheck_embree.above_nodes import facet_counts, take_from_facets, take_heights
from ebamcheck_embree.grid import Grid, Lattice
from ebamcheck_embree.hits import Borders, borders, room_for, short_rays
from ebamcheck_embree.raster import Raster, contours, empty_raster, turn_over
from ebamcheck_embree.rings import Rings, append_layer, room_for_rings
from ebamcheck_embree.scene import Bools, Facets, Floats, Ints, Scene, Singles, UnderWay, under_way
from ebamcheck_embree.section import part_of
from ebamcheck_embree.stack import PIECES_A_THREAD, GridRays

LEAST_LAYERS = 16
"""Fewest layers of a piece: fewer cost more than they save."""

LAYERS_AT_ONCE = 32
"""Layers whose rings are brought into canonical form together: their points stay in the processor's cache."""


class Towers(NamedTuple):
    """Heights at which each node's ray enters and leaves the material, grouped by ray."""

    starts: Ints
    """(R + 1,)"""
    along: Floats
    """(H,) in, out, in, out along each ray, mm about the centre of the part."""


class VerticalRays(GridRays):
    """The material above each node, as intervals of z."""

    def __init__(self, part: Part, grid: Grid, rays_per_call: int, labels: Mapping[str, Any]) -> None:
        super().__init__(part, grid, rays_per_call, labels)
        found = self._cast_all()
        self._unpaired = int(np.count_nonzero(~found.sound))
        self._towers = _borrowed(Towers(found.starts, found.along), found.paired, grid.columns)

    def _cast_all(self) -> Borders:
        """Cast the ray of every node that lies over a facet, in blocks; the tree holds only such facets."""
        lattice = self.grid.lattice
        counts, is_counted = facet_counts(self.mesh, lattice)
        mesh = part_of(
            self.mesh,
            np.flatnonzero(is_counted).astype(np.int32),
            np.full(len(self.mesh.vertices), -1, np.int32),
        )
        scene = Scene(*mesh)
        hits = room_for(counts)
        wanted = np.flatnonzero(counts)

        def take(met: Facets, distance: Singles, rays: UnderWay) -> int:
            return take_heights(mesh, lattice, met, distance, rays, hits)

        def cast(start: int, stop: int) -> None:
            for first in range(start, stop, self.rays_per_call):
                rays = wanted[first : min(first + self.rays_per_call, stop)].copy()
                scene.follow(under_way(rays, self._origins(rays)), 2, take)

        run_blocks(cast, len(wanted), smallest=4096)
        short = short_rays(hits)
        if short.any():
            take_from_facets(mesh, lattice, short, hits)
        return borders(hits.starts, hits.along, hits.sign, hits.facet)

    def _origins(self, nodes: Ints) -> Singles:
        row, column = np.divmod(nodes, self.grid.columns)
        origins = np.empty((len(nodes), 3), np.float32)
        origins[:, 0], origins[:, 1] = self.grid.column_x_mm[column], self.grid.row_y_mm[row]
        origins[:, 2] = -0.51 * float(self.part.size[2]) - self.grid.cell_mm
        return origins

    def pieces(self, z_mm: Floats) -> Ints:
        """Divide evenly: each piece needs one pass over all rays."""
        count = max(1, min(PIECES_A_THREAD * thread_count(), len(z_mm) // LEAST_LAYERS))
        return np.arange(count + 1) * len(z_mm) // count

    def cut(self, z_mm: Floats) -> Iterator[Rings]:
        """Cut by flipping, from each layer to the next, the nodes whose rays pass a border between the two."""
        turn_starts, nodes = _turns(self._towers, z_mm)
        raster = empty_raster(self.grid.lattice)
        for first in range(0, len(z_mm), LAYERS_AT_ONCE):
            past = min(first + LAYERS_AT_ONCE, len(z_mm))
            rings = _rings(raster, turn_starts[first : past + 1], nodes, self.grid.lattice, self.centre_mm)
            rings.unpaired[:] = self._unpaired
            yield rings


def _borrowed(towers: Towers, paired: Bools, columns: int) -> Towers:
    """Give each ray whose borders do not pair the intervals of the nearest ray to its left in its row whose do."""
    if paired.all():
        return towers
    own = np.where(paired, np.arange(paired.size), -1).reshape(-1, columns)
    source = np.maximum.accumulate(own, axis=1).ravel()  # -1: no ray to the left pairs, so no material
    sizes = np.where(source >= 0, np.diff(towers.starts)[source], 0)
    starts = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
    rows = np.arange(starts[-1]) + np.repeat(towers.starts[source] - starts[:-1], sizes)
    return Towers(starts, towers.along[rows])


@kernel
def _turns(towers: Towers, z_mm: Floats) -> tuple[Ints, Ints]:
    """Nodes that change sides at each layer: starts (L + 1,) and nodes, the first layer's from nothing.

    A border at the very height of a layer is under it: the layer shows z = h + 0.
    """
    starts = np.zeros(z_mm.size + 1, np.int64)
    node_count = towers.starts.size - 1
    layer = np.full(towers.along.size, z_mm.size, np.int32)
    for n in range(towers.along.size):
        if towers.along[n] <= z_mm[-1]:
            layer[n] = np.searchsorted(z_mm, towers.along[n])
            starts[layer[n] + 1] += 1
    for k in range(z_mm.size):
        starts[k + 1] += starts[k]
    nodes = np.empty(starts[-1], np.int64)
    place = starts[:-1].copy()
    for node in range(node_count):
        for n in range(towers.starts[node], towers.starts[node + 1]):
            if layer[n] < z_mm.size:
                nodes[place[layer[n]]] = node
                place[layer[n]] += 1
    return starts, nodes


@kernel
def _rings(raster: Raster, turn_starts: Ints, nodes: Ints, lattice: Lattice, shift_mm: Floats) -> Rings:
    """Rings of consecutive layers, each a raster that differs from the last by the nodes turned over."""
    rings = room_for_rings(turn_starts.size - 1)
    for layer in range(turn_starts.size - 1):
        turn_over(raster, nodes[turn_starts[layer] : turn_starts[layer + 1]], lattice)
        points, starts = contours(raster, lattice)
        rings = append_layer(rings, layer, points, starts, shift_mm)
    return rings

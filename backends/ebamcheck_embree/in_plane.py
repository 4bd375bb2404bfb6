"""Rays in the plane of each layer, along the rows and the columns of the grid."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import pairwise
from typing import Any

import numpy as np

from ebamcheck.mesh.part import Part
from ebamcheck.numeric.kernels import kernel, thread_count
from ebamcheck_embree.crossings import crossing_counts, take_crossings, take_from_segments
from ebamcheck_embree.grid import Grid, Lattice
from ebamcheck_embree.hits import Borders, borders, room_for, short_rays
from ebamcheck_embree.knots import RayColumns, column_knots, row_knots
from ebamcheck_embree.marching import rings_of_layer
from ebamcheck_embree.rings import Rings, append_layer, room_for_rings
from ebamcheck_embree.scene import Facets, Floats, Ints, Scene, Singles, UnderWay, under_way
from ebamcheck_embree.section import Mesh, Sections, sections_at
from ebamcheck_embree.slabs import Slabs
from ebamcheck_embree.stack import PIECES_A_THREAD, GridRays

SEGMENTS_AT_ONCE = 1 << 22
"""Most segments of sections that a thread holds at once, unless a single section has more: at most 150 MB."""


class InPlaneRays(GridRays):
    """Every grid edge that the contour crosses is crossed where the mesh's own section crosses it."""

    def __init__(self, part: Part, grid: Grid, rays_per_call: int, labels: Mapping[str, Any]) -> None:
        super().__init__(part, grid, rays_per_call, labels)
        self._slabs = Slabs(self.mesh, axis=2)
        # By axis: the coordinates of its rays across it, and where they start, outside the part's box.
        self._lines = (grid.row_y_mm, grid.column_x_mm)
        self._start_mm = (grid.x0_mm - 0.01 * float(part.size[0]), grid.y0_mm - 0.01 * float(part.size[1]))

    def pieces(self, z_mm: Floats) -> Ints:
        """Divide within slabs, as the rays of one call of Embree and the memory for sections allow."""
        slab = self._slabs.of(z_mm)
        borders_of_slabs = [0, *(np.flatnonzero(np.diff(slab)) + 1).tolist(), len(z_mm)]
        fair = -(-len(z_mm) // (PIECES_A_THREAD * thread_count()))
        most_rays = self.rays_per_call // max(self.grid.rows, self.grid.columns)
        edges = [0]
        for first, past in pairwise(borders_of_slabs):
            most_segments = SEGMENTS_AT_ONCE // max(1, self._slabs.facets_in(int(slab[first])))
            count = -(-(past - first) // max(1, min(fair, most_rays, most_segments)))
            edges += [first + (past - first) * (n + 1) // count for n in range(count)]
        return np.array(edges)

    def cut(self, z_mm: Floats) -> Iterator[Rings]:
        """Cut by casting the rays of all these layers at once."""
        slab = self._slabs[int(self._slabs.of(z_mm[:1])[0])]
        sections = sections_at(slab.mesh, z_mm)
        rows, columns = (self._borders(slab.scene, z_mm, sections, axis) for axis in (0, 1))
        yield _rings(self.grid.lattice, rows, columns, slab.mesh, z_mm, self.centre_mm)

    def _borders(self, scene: Scene, z_mm: Floats, sections: Sections, axis: int) -> Borders:
        """Borders on the rays along an axis of some layers, those of the first layer first."""
        lines = self._lines[axis]
        counts = crossing_counts(sections, len(z_mm), axis, lines)
        hits = room_for(counts)

        def take(met: Facets, distance: Singles, rays: UnderWay) -> int:
            return take_crossings(sections, axis, lines, met, distance, rays, hits)

        wanted = np.flatnonzero(counts)
        scene.follow(under_way(wanted, self._origins(wanted, z_mm, axis)), axis, take)
        short = short_rays(hits)
        if short.any():
            take_from_segments(sections, axis, lines, short, hits)
        return borders(hits.starts, hits.along, hits.sign, hits.facet)

    def _origins(self, rays: Ints, z_mm: Floats, axis: int) -> Singles:
        layer, line = np.divmod(rays, len(self._lines[axis]))
        origins = np.empty((len(rays), 3), np.float32)
        origins[:, axis] = self._start_mm[axis]
        origins[:, 1 - axis] = self._lines[axis][line]
        origins[:, 2] = z_mm[layer]
        return origins


@kernel
def _rings(
    lattice: Lattice, rows: Borders, columns: Borders, mesh: Mesh, z_mm: Floats, shift_mm: Floats
) -> Rings:
    """Rings of several layers, from the borders on their rays."""
    _, _, _, column_count, row_count = lattice
    rings = room_for_rings(z_mm.size)
    for layer in range(z_mm.size):
        a, b = layer * row_count, (layer + 1) * row_count
        c, d = layer * column_count, (layer + 1) * column_count
        along_columns = _rays(columns, c, d)
        knots = row_knots(lattice, _rays(rows, a, b), along_columns)
        across = column_knots(lattice, knots, along_columns)
        corners = bool(rows.simple[a:b].all() and columns.simple[c:d].all())
        points, starts = rings_of_layer(lattice, knots, across, mesh, z_mm[layer], corners)
        rings = append_layer(rings, layer, points, starts, shift_mm)
        rings.unpaired[layer] = (~rows.sound[a:b]).sum() + (~columns.sound[c:d]).sum()
    return rings


@kernel
def _rays(found: Borders, first: int, past: int) -> RayColumns:
    """Borders of the rays ``first .. past - 1`` alone."""
    a, b = found.starts[first], found.starts[past]
    starts = found.starts[first : past + 1] - a
    return starts, found.along[a:b], found.facet[a:b], found.paired[first:past]

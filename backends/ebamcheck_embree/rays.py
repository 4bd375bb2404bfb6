"""Rays in the plane of each layer, along the rows and the columns of the grid, for blocks of layers on all threads."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from itertools import pairwise
from typing import Any, Self

import numpy as np

from ebamcheck.backend import Progress
from ebamcheck.errors import BackendFailed
from ebamcheck.kernels import Floats, Ints
from ebamcheck.layers.stack import Layers, canonical, concatenate
from ebamcheck.mesh.part import Part
from ebamcheck.threads import run_in_order, thread_count
from ebamcheck_embree import crossings
from ebamcheck_embree.contours import RayColumns, rings_of_layer
from ebamcheck_embree.crossings import Borders, Sections
from ebamcheck_embree.grid import Grid
from ebamcheck_embree.scene import Facets, Mesh, Scene, Singles, Slabs, UnderWay

log = logging.getLogger(__name__)

# Most segments of sections that a thread holds at once, unless a single section has more: at most 150 MB
SEGMENTS_AT_ONCE = 1 << 22
# Least number of pieces of a stack per thread, if it has enough layers: they take unequal time
PIECES_A_THREAD = 4


class InPlaneRays:
    """A part prepared for casting: every grid edge that the contour crosses is crossed where the mesh's own section crosses it."""

    def __init__(self, part: Part, grid: Grid, rays_per_call: int, labels: Mapping[str, Any]) -> None:
        self.part = part
        self.grid = grid
        self._rays_per_call = rays_per_call
        self._labels = labels
        self._centre_mm: Floats = part.bounds.mean(axis=0)
        vertices = np.ascontiguousarray(part.vertices - self._centre_mm)
        self._slabs = Slabs(Mesh(vertices, np.ascontiguousarray(part.faces, dtype=np.int32)))
        # By axis: the coordinates of its rays across it, and where they start, outside the part's box.
        self._lines = (grid.row_y_mm, grid.column_x_mm)
        self._start_mm = (grid.x0_mm - 0.01 * float(part.size[0]), grid.y0_mm - 0.01 * float(part.size[1]))
        self._released = False

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._released = True

    def slice(self, heights: Floats, progress: Progress | None = None) -> Layers:
        """Cut at strictly increasing heights (L,), mm, on all threads."""
        heights = np.ascontiguousarray(heights, dtype=np.float64)
        if self._released:
            raise BackendFailed(f"embree: part {self.part.name!r} was released: prepare it again")
        z_mm = heights - self._centre_mm[2]
        blocks: list[Layers] = []
        unpaired: list[int] = []
        for layers, odd in run_in_order(lambda a, b: self._cut(heights[a:b], z_mm[a:b]), self._pieces(z_mm)):
            blocks.append(layers)
            unpaired += odd
            if progress is not None and len(layers):
                progress(len(layers))
        if any(unpaired):
            worst = int(np.argmax(unpaired))
            log.warning(
                "embree: part %r is open or has facets turned over: in %d of %d layers rays do not pair "
                "(most at z = %.6g mm: %d); they were mended from their neighbours",
                self.part.name, np.count_nonzero(unpaired), len(unpaired), heights[worst], unpaired[worst],
            )  # fmt: skip
        return concatenate(blocks)

    def _pieces(self, z_mm: Floats) -> list[int]:
        """Edges of pieces within slabs, as the rays of one call of Embree and the memory for sections allow."""
        slab = self._slabs.of(z_mm)
        slab_edges = [0, *(np.flatnonzero(np.diff(slab)) + 1).tolist(), len(z_mm)]
        fair = -(-len(z_mm) // (PIECES_A_THREAD * thread_count()))
        most_rays = self._rays_per_call // max(self.grid.rows, self.grid.columns)
        edges = [0]
        for first, past in pairwise(slab_edges):
            facets = self._slabs.facets_in(int(slab[first])) if len(slab) else 0
            most_segments = SEGMENTS_AT_ONCE // max(1, facets)
            count = max(1, -(-(past - first) // max(1, min(fair, most_rays, most_segments))))
            edges += [first + (past - first) * (n + 1) // count for n in range(count)]
        return edges

    def _cut(self, heights: Floats, z_mm: Floats) -> tuple[Layers, list[int]]:
        """Layers of one piece in canonical form, by casting all their rays at once; and the unpaired rays of each."""
        points: list[Floats] = [np.zeros((0, 2))]
        sizes: list[Ints] = [np.zeros(1, np.int64)]
        layer_starts, unpaired = [0], list[int]()
        if len(z_mm):
            mesh, scene = self._slabs[int(self._slabs.of(z_mm[:1])[0])]
            sections = crossings.sections_at(mesh, z_mm)
            rows, columns = (self._borders(scene, z_mm, sections, axis) for axis in (0, 1))
        for layer, z in enumerate(z_mm.tolist()):
            a, b = layer * self.grid.rows, (layer + 1) * self.grid.rows
            c, d = layer * self.grid.columns, (layer + 1) * self.grid.columns
            corners = bool(rows.simple[a:b].all() and columns.simple[c:d].all())
            across, upwards = _rays(rows, a, b), _rays(columns, c, d)
            found, starts = rings_of_layer(self.grid, across, upwards, mesh, z, corners)
            points.append(found + self._centre_mm[:2])
            sizes.append(np.diff(starts))
            layer_starts.append(layer_starts[-1] + len(starts) - 1)
            unpaired.append(int((~rows.sound[a:b]).sum() + (~columns.sound[c:d]).sum()))
        layers = canonical(
            heights,
            np.concatenate(points),
            np.cumsum(np.concatenate(sizes)),
            np.array(layer_starts),
            np.ones(layer_starts[-1], np.bool_),
            **self._labels,
        )
        return layers, unpaired

    def _borders(self, scene: Scene, z_mm: Floats, sections: Sections, axis: int) -> Borders:
        """Borders on the rays along an axis of some layers, those of the first layer first."""
        lines = self._lines[axis]
        begins, ends = crossings.rays_across(sections, axis, lines)
        hits = crossings.hits_of_rays(begins, ends, len(z_mm) * len(lines))

        def take(met: Facets, distance: Singles, rays: UnderWay) -> int:
            return crossings.take_crossings(sections, axis, lines, met, distance, rays, hits)

        wanted = np.flatnonzero(np.diff(hits.starts))
        layer, line = np.divmod(wanted, len(lines))
        origins = np.empty((len(wanted), 3), np.float32)
        origins[:, axis], origins[:, 1 - axis], origins[:, 2] = self._start_mm[axis], lines[line], z_mm[layer]
        scene.follow(wanted, origins, axis, take)
        crossings.fill_short_rays(hits, sections, axis, lines, begins, ends)
        return crossings.borders(hits.starts, hits.along, hits.sign, hits.facet)


def _rays(found: Borders, first: int, past: int) -> RayColumns:
    """Borders of the rays ``first .. past - 1`` alone."""
    a, b = found.starts[first], found.starts[past]
    starts = found.starts[first : past + 1] - a
    return starts, found.along[a:b], found.facet[a:b], found.paired[first:past]

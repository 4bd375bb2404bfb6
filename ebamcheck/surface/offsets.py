"""Offsets: whether the vertices of a mesh lie on the surface that it approximates, or outside it, where a decimation put them.

Lifting assumes that they lie on it. Tessellation puts them there. Decimation by the planes of the facets (quadric error
metrics) puts each vertex outside the surface, farther the longer its edges are, and a whole lift then ends as far outside as
the contour was inside. Two things decide. One is rows: nearly all vertices of a tessellator's mesh have six edges. The other is
the place of each vertex as predicted from its neighbours, by regression over the mesh. A mesh that has neither rows nor enough
such vertices, like a CAD solid after many edge collapses, gives no evidence for a lift.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ebamcheck.kernels import Bools, Floats, Ints
from ebamcheck.mesh.topology import Index
from ebamcheck.surface.jets import Corners, corners_by, predicted
from ebamcheck.surface.planes import area_vectors
from ebamcheck.threads import run_blocks

IN_ROWS = 0.85
"""Least share of inner vertices with as many edges as in rows for a mesh to be a tessellator's. It is three quarters after edge
collapses that remove a third of the facets, and three tenths on meshes of scattered points."""

LARGEST_OFFSET = 0.15
"""Largest distance of a vertex outside the surface, over its sagitta, error included. Scattered points and edge collapses onto
remaining vertices give -0.1 to 0, collapses to the point of least quadric error 0.3 to 0.8."""

HALF = 0.5
"""Share of a lift that is made where vertices lie outside the surface. The point of least quadric error for the facets that
collapsed into a vertex, those up to half an edge away, is half a sagitta outside; the facets between such vertices are half
a sagitta inside on average."""


class Offsets(NamedTuple):
    """Where the inner vertices of the freely curved facets lie, against the surface."""

    inner: int  # Number of vertices surrounded by freely curved facets; those that split an edge do not count
    in_rows: float  # Share of the inner vertices that have as many edges as those of a tessellator's rows
    told: int  # Number of vertices whose neighbours predict their place
    offset: float  # Distance of a vertex outside the surface, over its own sagitta, by regression
    error: float  # Standard error of the offset

    @property
    def is_in_rows(self) -> bool:
        """Whether the mesh is a tessellator's; one with too few inner vertices counts as such."""
        return self.inner < 4 or self.in_rows >= IN_ROWS  # a cone has only its tip

    @property
    def lift_share(self) -> float:
        """Share of a lift for which there is evidence, 0 .. 1."""
        if self.is_in_rows:
            return 1.0
        if self.told < 100:  # too few vertices for the regression to be evidence
            return 0.0
        # Farther inside the surface no program puts vertices: the prediction is wrong.
        return 1.0 if abs(self.offset + 2.0 * self.error) <= LARGEST_OFFSET else HALF


def vertex_offsets(vertices: Floats, faces: Index, smooth: Bools, fans: Index, free: Bools) -> Offsets:
    """Find whether the vertices of a mesh lie on the surface that it approximates.

    `smooth` (3 F,) half-edges are no creases, `fans` (F, 3) are the smooth fans of corners, and `free` (F,) facets are freely
    curved."""
    flat = fans.reshape(-1)
    by_fan = corners_by(vertices, faces, fans)
    edges = np.diff(by_fan.starts).astype(np.int64)
    count = edges.size
    on = smooth.reshape(-1, 3)
    around = on & on[:, [2, 0, 1]]
    closed = (np.bincount(flat, around.reshape(-1), minlength=count) == edges) & (edges > 0)
    inner = closed & (np.bincount(flat, np.repeat(free, 3), minlength=count) == edges)
    split, fewer = _splitting(by_fan, closed)
    in_rows = (edges - fewer)[inner & ~split]
    if not in_rows.size:
        return Offsets(0, 0.0, 0, 0.0, np.inf)
    share = float(max(np.mean(in_rows == 6), np.mean((in_rows == 4) | (in_rows == 8))))
    rows = Offsets(in_rows.size, share, 0, 0.0, np.inf)
    if share >= IN_ROWS:
        return rows
    found = np.full((count, 2), np.nan)
    # At most 20,000 vertices, evenly spread over the mesh: more would not make the offset more certain.
    asked = np.zeros(count, np.bool_)
    asked[np.flatnonzero(inner)[:: -(-int(inner.sum()) // 20_000)]] = True
    areas = area_vectors(vertices[faces])

    def work(first: int, last: int) -> None:
        predicted(by_fan, areas, asked, first, last, found)

    run_blocks(work, count, 512)
    x, r = found[np.isfinite(found).all(axis=1)].T
    square = float(x @ x)
    if len(x) < 2 or square == 0.0:
        return rows._replace(told=len(x))
    offset = float(x @ r) / square
    left = r - offset * x
    error = float(np.sqrt(left @ left / (len(x) - 1) / square))
    return rows._replace(told=len(x), offset=offset, error=error)


def _splitting(by_fan: Corners, closed: Bools) -> tuple[Bools, Ints]:
    """Fans of vertices that split an edge, and how many edges fewer each fan has without them."""
    split, fewer = np.zeros(closed.size, np.bool_), np.zeros(closed.size, np.int64)
    four = np.flatnonzero(closed & (np.diff(by_fan.starts) == 4))
    around = by_fan.corners[by_fan.starts[four][:, None] + np.arange(4)]
    flat, vertices = by_fan.faces.reshape(-1), by_fan.vertices
    ahead = vertices[flat[3 * (around // 3) + (around + 1) % 3]] - vertices[flat[around[:, :1]]]
    lengths = np.linalg.norm(ahead, axis=2)
    product = np.einsum("nad,nbd->nab", ahead, ahead)
    cosine = product / np.maximum(lengths[:, :, None] * lengths[:, None], 1e-300)
    straight = cosine.min(axis=2, initial=1.0) <= -0.999  # two edges that continue each other
    split[four[straight.any(axis=1)]] = True
    # Two of the four lie on the line; the corner that follows one of them in its facet is one of the other two.
    across = around[straight]
    np.add.at(fewer, by_fan.sectors.reshape(-1)[3 * (across // 3) + (across + 2) % 3], 1)
    return split, fewer

"""Offsets: whether the vertices of a mesh lie on the surface that it stands for, or beyond it, where a program put them.

A lift believes that they do. Who tessellates a surface puts them there; who decimates a mesh by the planes of its facets
puts each beyond the surface, by the more the longer its edges are, and a whole lift comes out as far outside as the contour
was inside. Two things tell. Rows: nearly all vertices of a tessellator have six edges. And what each vertex's neighbours
say of its place, by regression over the mesh. Where a mesh has neither rows nor enough vertices to ask, as what is left of a
CAD solid after many collapses, nothing speaks for a lift.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ebamcheck.curves.regions.foretold import foretold
from ebamcheck.mesh.topology import Index
from ebamcheck.numeric.kernels import kernel, run_blocks
from ebamcheck.numeric.rings import Bools, Floats

VERTICES_A_BLOCK = 512

MOST_ASKED = 20_000
"""Vertices that are asked, evenly spread over the mesh: more would tell the offset no better."""

LEAST_INNER = 4
"""Inner vertices from which rows mean something; a cone has its tip alone."""

IN_ROWS = 0.85
"""Share of inner vertices with the edges of a row, from which a mesh is a tessellator's; collapses leave three quarters of a
mesh that loses a third of its facets, scattered points have three tenths."""

LEAST_TOLD = 100
"""Vertices from which the regression is evidence, where there are no rows."""

LARGEST_OFFSET = 0.15
"""Of its sagitta, by which a vertex may stand beyond the surface, error included: scattered points and collapses onto what
is left of the vertices give -0.1 to 0, collapses to the best place for the planes about it 0.3 to 0.8."""

HALF = 0.5
"""Of a lift that is made where vertices stand beyond the surface. The best place for the planes of the facets that went up in
a vertex, those up to half an edge away, is half a sagitta beyond it; the facets between such vertices stand half a sagitta
inside on average."""

ERRORS = 2.0
"""Standard errors that count as part of an offset."""

IN_LINE_COSINE = -0.999
"""A vertex of four edges between two that lie this straight beyond each other split their edge, and is no vertex of a row."""


class Offsets(NamedTuple):
    """What the inner vertices of a mesh's freely curved facets say."""

    inner: int
    """Vertices whose facets are all freely curved, and close about them; those that split an edge do not count."""
    in_rows: float
    """Share of them that have as many edges as the vertices of a tessellator's rows."""
    told: int
    """Vertices of which their neighbours tell the place."""
    offset: float
    """By how much of its own sagitta a vertex stands beyond the surface, by regression."""
    error: float
    """Standard error of that."""

    @property
    def is_in_rows(self) -> bool:
        """Whether the mesh is a tessellator's; so is one with too few vertices to ask."""
        return self.inner < LEAST_INNER or self.in_rows >= IN_ROWS

    @property
    def lift_share(self) -> float:
        """Of a lift, that there is evidence for."""
        if self.is_in_rows:
            return 1.0
        if self.told < LEAST_TOLD:
            return 0.0
        if self.offset + ERRORS * self.error < -LARGEST_OFFSET:
            return HALF  # inside of the surface, where no program puts them: their neighbours do not tell it
        return 1.0 if self.offset + ERRORS * self.error <= LARGEST_OFFSET else HALF


NOTHING_TOLD = Offsets(0, 0.0, 0, 0.0, np.inf)
"""Of a mesh without inner vertices, or one that is not asked."""


def vertex_offsets(vertices: Floats, faces: Index, smooth: Bools, fans: Index, free: Bools) -> Offsets:
    """Ask the vertices of a mesh where they stand.

    Parameters
    ----------
    vertices, faces
        The mesh.
    smooth
        (3 F,) half-edges across which the surface goes on without a crease.
    fans
        (F, 3) smooth fan of each corner.
    free
        (F,) facets that are freely curved.
    """
    flat = fans.reshape(-1)
    count = int(flat.max(initial=-1)) + 1
    on = smooth.reshape(-1, 3)
    around = on & on[:, [2, 0, 1]]
    edges = np.bincount(flat, minlength=count)
    closed = (np.bincount(flat, around.reshape(-1), minlength=count) == edges) & (edges > 0)
    inner = closed & (np.bincount(flat, np.repeat(free, 3), minlength=count) == edges)
    starts = np.concatenate([[0], np.cumsum(edges)]).astype(np.int32)
    corners = np.argsort(flat, kind="stable").astype(np.int32)
    split, fewer = _splitting(vertices, faces, fans, starts, corners, closed)
    in_rows = (edges - fewer)[inner & ~split]
    if not in_rows.size:
        return NOTHING_TOLD
    share = float(max(np.mean(in_rows == 6), np.mean((in_rows == 4) | (in_rows == 8))))
    rows = NOTHING_TOLD._replace(inner=in_rows.size, in_rows=share)
    if share >= IN_ROWS:
        return rows
    found = np.full((count, 2), np.nan)
    asked = np.zeros(count, np.bool_)
    asked[np.flatnonzero(inner)[:: -(-int(inner.sum()) // MOST_ASKED)]] = True

    def work(first: int, last: int) -> None:
        foretold(vertices, faces, fans, starts, corners, asked, first, last, found)

    run_blocks(work, count, VERTICES_A_BLOCK)
    x, r = found[np.isfinite(found).all(axis=1)].T
    square = float(x @ x)
    if len(x) < 2 or square == 0.0:
        return rows._replace(told=len(x))
    offset = float(x @ r) / square
    left = r - offset * x
    error = float(np.sqrt(left @ left / (len(x) - 1) / square))
    return rows._replace(told=len(x), offset=offset, error=error)


@kernel
def _splitting(
    vertices: Floats, faces: Index, fans: Index, starts: Index, corners: Index, closed: Bools
) -> tuple[Bools, Index]:
    """Fans of vertices that split an edge, and how many edges fewer each fan has without them."""
    split = np.zeros(closed.size, np.bool_)
    fewer = np.zeros(closed.size, np.int32)
    for s in range(closed.size):
        if not closed[s] or starts[s + 1] - starts[s] != 4:
            continue
        for place in range(starts[s], starts[s + 1]):
            f, k = corners[place] // 3, corners[place] % 3
            v, a = faces[f, k], faces[f, (k + 1) % 3]
            least = 1.0
            for other in range(starts[s], starts[s + 1]):
                g, m = corners[other] // 3, corners[other] % 3
                least = min(least, _cosine(vertices, v, a, faces[g, (m + 1) % 3]))
            if least > IN_LINE_COSINE:
                continue
            # Two of the four lie on the line; the corner that follows `a` in its facet is one of the other two.
            split[s] = True
            fewer[fans[f, (k + 2) % 3]] += 1
    return split, fewer


@kernel
def _cosine(vertices: Floats, v: int, a: int, b: int) -> float:
    product = p = q = 0.0
    for i in range(3):
        x, y = vertices[a, i] - vertices[v, i], vertices[b, i] - vertices[v, i]
        product += x * y
        p += x * x
        q += y * y
    return float(product / max(np.sqrt(p * q), 1e-300))

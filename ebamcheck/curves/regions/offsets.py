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

from ebamcheck.mesh.topology import Index
from ebamcheck.numeric.kernels import kernel, run_blocks
from ebamcheck.numeric.rings import Bools, Floats

CUBIC = 10
"""Coefficients of a cubic over the plane: height, two slopes, three curvatures, and their four changes."""

SPARE = 3
"""Neighbours beyond the coefficients from which a cubic is more than an interpolation."""

MOST_NEIGHBOURS = 48
"""Vertices taken about one; two rings of an even mesh hold 18."""

LEAST_PIVOT = 1e-6
"""A pivot of the normal equations, scaled to a diagonal of 1, under which neighbours do not tell a cubic."""

SOFTENING = 0.3
"""Squared distance, in units of the first ring, to which neighbours are trusted alike."""

VERTICES_A_BLOCK = 512


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
    def lift_share(self) -> float:
        """Of a lift, that there is evidence for; all of it where there are too few vertices to ask."""
        if self.inner < LEAST_INNER or self.in_rows >= IN_ROWS:
            return 1.0
        if self.told < LEAST_TOLD:
            return 0.0
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
    share = max(np.mean(in_rows == 6), np.mean((in_rows == 4) | (in_rows == 8)))
    found = np.full((count, 2), np.nan)

    def work(first: int, last: int) -> None:
        _stand(vertices, faces, fans, starts, corners, inner, first, last, found)

    run_blocks(work, count, VERTICES_A_BLOCK)
    x, r = found[np.isfinite(found).all(axis=1)].T
    square = float(x @ x)
    if len(x) < 2 or square == 0.0:
        return NOTHING_TOLD._replace(inner=in_rows.size, in_rows=float(share), told=len(x))
    offset = float(x @ r) / square
    left = r - offset * x
    return Offsets(
        in_rows.size, float(share), len(x), offset, float(np.sqrt(left @ left / (len(x) - 1) / square))
    )


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
            least, third = 1.0, -1
            for other in range(starts[s], starts[s + 1]):
                g, m = corners[other] // 3, corners[other] % 3
                least = min(least, _cosine(vertices, v, a, faces[g, (m + 1) % 3]))
            if least > IN_LINE_COSINE:
                continue
            # Two of the four lie on the line; the corner that follows `a` in its facet is one of the other two.
            third = fans[f, (k + 2) % 3]
            split[s] = True
            fewer[third] += 1
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


@kernel
def _stand(
    vertices: Floats,
    faces: Index,
    fans: Index,
    starts: Index,
    corners: Index,
    inner: Bools,
    first: int,
    last: int,
    found: Floats,
) -> None:
    around, of_fan = np.empty(MOST_NEIGHBOURS, np.int32), np.empty(MOST_NEIGHBOURS, np.int32)
    rows, weights = np.empty((MOST_NEIGHBOURS, 3)), np.empty(MOST_NEIGHBOURS)
    A, B = np.empty((CUBIC, CUBIC + 1)), np.empty((CUBIC, CUBIC + 1))
    terms = np.empty(CUBIC)
    u, w, n = np.empty(3), np.empty(3), np.empty(3)
    for s in range(first, last):
        if not inner[s]:
            continue
        near, count = _neighbours(faces, fans, starts, corners, s, around, of_fan)
        if count < CUBIC + SPARE:
            continue
        corner = corners[starts[s]]
        here = vertices[faces[corner // 3, corner % 3]]
        if not _frame(vertices, faces, starts, corners, s, n, u, w):
            continue
        for i in range(count):
            _along(vertices[around[i]], here, u, w, n, rows[i])
        scale = _even_out(rows, near, count, u, w)
        if not scale > 0.0:
            continue
        _equations(rows, count, weights, terms, A, B)
        if not (_eliminated(A) and _eliminated(B)):
            continue
        c, d, e = A[3, CUBIC], A[4, CUBIC], A[5, CUBIC]
        own, size = _sagitta(vertices, faces, starts, corners, s, here, u, w, c, d, e)
        expected = 0.0
        sizes = size
        for i in range(count):
            _cubic(rows[i, 0], rows[i, 1], terms)
            share = 0.0
            for k in range(CUBIC):
                share += B[k, CUBIC] * terms[k]
            other, size = _sagitta(
                vertices, faces, starts, corners, of_fan[i], vertices[around[i]], u, w, c, d, e
            )
            expected += share * weights[i] * other
            sizes += size
        typical = sizes / (count + 1)
        if typical > 0.0:
            found[s, 0] = (own - expected) / typical
            found[s, 1] = min(max(-A[0, CUBIC] / typical, -1.0), 1.0)


@kernel
def _neighbours(
    faces: Index, fans: Index, starts: Index, corners: Index, s: int, around: Index, of_fan: Index
) -> tuple[int, int]:
    """Vertices of the first ring, then of the second, and their fans; returns how many are in the first and in both."""
    count = 0
    own = faces[corners[starts[s]] // 3, corners[starts[s]] % 3]
    for place in range(starts[s], starts[s + 1]):
        c = corners[place]
        for step in (1, 2):
            k = (c % 3 + step) % 3
            count = _add(around, of_fan, count, own, faces[c // 3, k], fans[c // 3, k])
    near = count
    for i in range(near):
        ring = of_fan[i]
        for place in range(starts[ring], starts[ring + 1]):
            c = corners[place]
            for step in (1, 2):
                k = (c % 3 + step) % 3
                count = _add(around, of_fan, count, own, faces[c // 3, k], fans[c // 3, k])
    return near, count


@kernel
def _add(around: Index, of_fan: Index, count: int, own: int, vertex: int, fan: int) -> int:
    if vertex == own or count == MOST_NEIGHBOURS:
        return count
    for i in range(count):
        if around[i] == vertex:
            return count
    around[count], of_fan[count] = vertex, fan
    return count + 1


@kernel
def _frame(
    vertices: Floats, faces: Index, starts: Index, corners: Index, s: int, n: Floats, u: Floats, w: Floats
) -> bool:
    """Mean normal of a fan by area, and two directions across it."""
    n[:] = 0.0
    for place in range(starts[s], starts[s + 1]):
        f = corners[place] // 3
        p, q, r = vertices[faces[f, 0]], vertices[faces[f, 1]], vertices[faces[f, 2]]
        ax, ay, az = q[0] - p[0], q[1] - p[1], q[2] - p[2]
        bx, by, bz = r[0] - p[0], r[1] - p[1], r[2] - p[2]
        n[0] += ay * bz - az * by
        n[1] += az * bx - ax * bz
        n[2] += ax * by - ay * bx
    length = np.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
    if length == 0.0:
        return False
    k = 0
    for i in range(3):
        n[i] /= length
        if abs(n[i]) < abs(n[k]):
            k = i
    for i in range(3):
        u[i] = (1.0 if i == k else 0.0) - n[i] * n[k]
    length = np.sqrt(u[0] * u[0] + u[1] * u[1] + u[2] * u[2])
    for i in range(3):
        u[i] /= length
    w[0], w[1], w[2] = n[1] * u[2] - n[2] * u[1], n[2] * u[0] - n[0] * u[2], n[0] * u[1] - n[1] * u[0]
    return True


@kernel
def _along(point: Floats, here: Floats, u: Floats, w: Floats, n: Floats, row: Floats) -> None:
    row[:] = 0.0
    for i in range(3):
        d = point[i] - here[i]
        row[0] += d * u[i]
        row[1] += d * w[i]
        row[2] += d * n[i]


@kernel
def _even_out(rows: Floats, near: int, count: int, u: Floats, w: Floats) -> float:
    """Turn the frame to the axes of the first ring, and scale both by its extents; returns their ratio, or 0.

    `u` and `w` become the axes over the extents: they take a difference of places to the units of the rows.
    """
    xx = xy = yy = 0.0
    for i in range(near):
        xx += rows[i, 0] * rows[i, 0] / near
        xy += rows[i, 0] * rows[i, 1] / near
        yy += rows[i, 1] * rows[i, 1] / near
    angle = 0.5 * np.arctan2(2.0 * xy, xx - yy)
    c, s = np.cos(angle), np.sin(angle)
    long = np.sqrt(max(c * c * xx + 2.0 * c * s * xy + s * s * yy, 0.0))
    wide = np.sqrt(max(s * s * xx - 2.0 * c * s * xy + c * c * yy, 0.0))
    if not wide > 1e-6 * long:
        return 0.0
    for i in range(3):
        u[i], w[i] = (c * u[i] + s * w[i]) / long, (c * w[i] - s * u[i]) / wide
    for i in range(count):
        x, y = rows[i, 0], rows[i, 1]
        rows[i, 0], rows[i, 1] = (c * x + s * y) / long, (c * y - s * x) / wide
    return float(wide / long)


@kernel
def _cubic(x: float, y: float, row: Floats) -> None:
    row[0], row[1], row[2], row[3], row[4], row[5] = 1.0, x, y, 0.5 * x * x, x * y, 0.5 * y * y
    row[6], row[7], row[8], row[9] = x * x * x / 6.0, 0.5 * x * x * y, 0.5 * x * y * y, y * y * y / 6.0


@kernel
def _equations(rows: Floats, count: int, weights: Floats, row: Floats, A: Floats, B: Floats) -> None:
    """Normal equations of the cubic through the neighbours, and those of the weights by which its height is theirs."""
    A[:], B[:] = 0.0, 0.0
    for k in range(count):
        x, y = rows[k, 0], rows[k, 1]
        _cubic(x, y, row)
        root = x * x + y * y + SOFTENING
        weights[k] = 1.0 / (root * root)
        for i in range(CUBIC):
            for j in range(CUBIC):
                A[i, j] += weights[k] * row[i] * row[j]
            A[i, CUBIC] += weights[k] * row[i] * rows[k, 2]
    B[:, :CUBIC] = A[:, :CUBIC]
    B[0, CUBIC] = 1.0


@kernel
def _eliminated(A: Floats) -> bool:
    """Solve symmetric equations (n, n + 1) in place; false where a pivot is lost."""
    n = CUBIC
    diagonal = np.empty(n)
    for i in range(n):
        diagonal[i] = A[i, i]
    for i in range(n):
        if not A[i, i] > LEAST_PIVOT * diagonal[i]:
            return False
        for j in range(i + 1, n):
            factor = A[j, i] / A[i, i]
            for k in range(i, n + 1):
                A[j, k] -= factor * A[i, k]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            A[i, n] -= A[i, k] * A[k, n]
        A[i, n] /= A[i, i]
    return True


@kernel
def _sagitta(
    vertices: Floats,
    faces: Index,
    starts: Index,
    corners: Index,
    s: int,
    here: Floats,
    u: Floats,
    w: Floats,
    c: float,
    d: float,
    e: float,
) -> tuple[float, float]:
    """Mean sagitta of the edges of a fan under given curvatures, mm: signed, positive where convex; and its magnitude."""
    total = size = 0.0
    count = 0
    for place in range(starts[s], starts[s + 1]):
        f, k = corners[place] // 3, corners[place] % 3
        for step in (1, 2):
            p = vertices[faces[f, (k + step) % 3]]
            x = y = 0.0
            for i in range(3):
                x += (p[i] - here[i]) * u[i]
                y += (p[i] - here[i]) * w[i]
            rise = -(0.5 * c * x * x + d * x * y + 0.5 * e * y * y) / 4.0
            total += rise
            size += abs(rise)
            count += 1
    return total / count, size / count


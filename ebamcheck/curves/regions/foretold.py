"""Predicted places: where the neighbours of a vertex put it, by a cubic fitted to them without it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ebamcheck.mesh.topology import Index
from ebamcheck.numeric.elimination import eliminated
from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Bools, Floats

CUBIC = 10
"""Coefficients of a cubic over the plane: height, two slopes, three curvatures, and their four changes."""

SPARE = 3
"""Neighbours beyond the number of coefficients: with fewer, a cubic is little more than an interpolation."""

MOST_NEIGHBOURS = 48
"""Most neighbours used of a vertex; two rings of a regular mesh hold 18."""

LEAST_PIVOT = 1e-6
"""Least pivot of the normal equations, scaled to a unit diagonal, for neighbours that determine a cubic."""

SOFTENING = 0.3
"""Squared distance, in units of the first ring, within which neighbours have about the same weight."""


class _Corners(NamedTuple):
    """A mesh, and the corners of its facets by smooth fan."""

    vertices: Floats
    faces: Index
    starts: Index
    corners: Index


@kernel
def foretold(
    vertices: Floats,
    faces: Index,
    fans: Index,
    starts: Index,
    corners: Index,
    asked: Bools,
    first: int,
    last: int,
    found: Floats,
) -> None:
    """Ask the neighbours of some fans from `first` on, and write what is found of each (S, 2); NaN stays where nothing is told.

    First by how much more a vertex would stand beyond the surface than its neighbours do, by the weights that the cubic
    gives them, if each stood there by the mean sagitta of its own edges; then by how much it does. Both in mean sagittas.
    """
    around, of_fan = np.empty(MOST_NEIGHBOURS, np.int32), np.empty(MOST_NEIGHBOURS, np.int32)
    rows, weights = np.empty((MOST_NEIGHBOURS, 3)), np.empty(MOST_NEIGHBOURS)
    A, B = np.empty((CUBIC, CUBIC + 1)), np.empty((CUBIC, CUBIC + 1))
    terms = np.empty(CUBIC)
    u, w, n = np.empty(3), np.empty(3), np.empty(3)
    mesh = _Corners(vertices, faces, starts, corners)
    for s in range(first, last):
        if not asked[s]:
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
        if not (eliminated(A, CUBIC, LEAST_PIVOT) and eliminated(B, CUBIC, LEAST_PIVOT)):
            continue
        c, d, e = A[3, CUBIC], A[4, CUBIC], A[5, CUBIC]
        own, size = _sagitta(mesh, s, here, u, w, c, d, e)
        expected = 0.0
        sizes = size
        for i in range(count):
            _cubic(rows[i, 0], rows[i, 1], terms)
            share = 0.0
            for k in range(CUBIC):
                share += B[k, CUBIC] * terms[k]
            other, size = _sagitta(mesh, of_fan[i], vertices[around[i]], u, w, c, d, e)
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
def _sagitta(
    mesh: _Corners,
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
    for place in range(mesh.starts[s], mesh.starts[s + 1]):
        f, k = mesh.corners[place] // 3, mesh.corners[place] % 3
        for step in (1, 2):
            p = mesh.vertices[mesh.faces[f, (k + step) % 3]]
            x = y = 0.0
            for i in range(3):
                x += (p[i] - here[i]) * u[i]
                y += (p[i] - here[i]) * w[i]
            rise = -(0.5 * c * x * x + d * x * y + 0.5 * e * y * y) / 4.0
            total += rise
            size += abs(rise)
            count += 1
    return total / count, size / count

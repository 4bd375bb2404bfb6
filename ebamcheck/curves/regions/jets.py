"""Jets: polynomials through a vertex, fitted to the vertices about it, from which its normal and the noise follow.

A cubic over two rings of neighbours where they tell one, else a quadric, else the mean normal (Cazals, Pouget 2005,
"Estimating differential quantities using polynomial fitting of osculating jets"). What a polynomial of degree k leaves out
grows with the power k + 1 of the distance, and a neighbour is trusted as much: so near ones decide where fine facets meet
coarse ones, and no normal crosses a jump in size.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ebamcheck.kernels import kernel, run_blocks
from ebamcheck.rings import Bools, Floats
from ebamcheck.topology import Index

CUBIC, QUADRIC = 9, 5
"""Coefficients of jets through the vertex: slopes, curvatures, and for the cubic their changes."""

MOST_NEIGHBOURS = 48
"""Vertices taken about one; two rings of an even mesh hold 18."""

SPARE = 3
"""Neighbours beyond the coefficients from which a jet is more than an interpolation."""

LEAST_PIVOT = 1e-5
"""A pivot of the normal equations, scaled to a diagonal of 1, under which neighbours do not tell a jet."""

NEAREST = 0.3
"""Of the mean distance of the first ring: nearer neighbours are trusted no more than at that distance, since the
rounding of their coordinates tilts what they say."""

SECTORS_A_BLOCK = 512


class Corners(NamedTuple):
    """Which corners of facets belong to which sector, and which facets may be looked at."""

    sectors: Index
    """(F, 3)."""
    starts: Index
    """(S + 1,)"""
    corners: Index
    """(3 F,) corners 3 f + i by sector."""
    seen: Bools
    """(F,) facets that are not of a plane."""


class Jets(NamedTuple):
    """What jets say of each sector."""

    normals: Floats
    """(S, 3) unit normals."""
    noise: Floats
    """(S,) root mean square of what the jet leaves of its neighbours, per degree of freedom, mm; NaN without a jet."""


def jets(vertices: Floats, faces: Index, corners: Corners, means: Floats, least_cosines: Floats) -> Jets:
    """Fit jets to all sectors; the normal stays the mean where none is told or it leaves the facets' normals."""
    found = Jets(means.copy(), np.full(len(means), np.nan))

    def work(first: int, last: int) -> None:
        _jets(vertices, faces, corners, means, least_cosines, first, last, found)

    run_blocks(work, len(means), SECTORS_A_BLOCK)
    return found


@kernel
def _jets(
    vertices: Floats,
    faces: Index,
    corners: Corners,
    means: Floats,
    least_cosines: Floats,
    first: int,
    last: int,
    found: Jets,
) -> None:
    rows = np.empty((MOST_NEIGHBOURS, 3))
    around = np.empty(MOST_NEIGHBOURS, np.int32)
    equations = np.empty((CUBIC, CUBIC + 1))
    u, w = np.empty(3), np.empty(3)
    for s in range(first, last):
        if least_cosines[s] >= 1.0 - 1e-15 or corners.starts[s + 1] == corners.starts[s]:
            continue
        near, count = _neighbours(faces, corners, s, around)
        if near < 3:
            continue
        n = means[s]
        _frame(n, u, w)
        corner = corners.corners[corners.starts[s]]
        here = vertices[faces[corner // 3, corner % 3]]
        unit = 0.0
        for i in range(count):
            p = vertices[around[i]]
            x, y, z = p[0] - here[0], p[1] - here[1], p[2] - here[2]
            rows[i, 0] = x * u[0] + y * u[1] + z * u[2]
            rows[i, 1] = x * w[0] + y * w[1] + z * w[2]
            rows[i, 2] = x * n[0] + y * n[1] + z * n[2]
            if i < near:
                unit += np.sqrt(x * x + y * y + z * z) / near
        if unit == 0.0:
            continue
        for attempt in range(3):
            size = CUBIC if attempt == 0 else QUADRIC
            used = count if attempt < 2 else near
            if used < size + (SPARE if attempt < 2 else 0):
                continue
            if not _solved(rows, used, unit, size, equations):
                continue
            a, b = equations[0, size], equations[1, size]
            length = np.sqrt(1.0 + a * a + b * b)
            if 1.0 / length < least_cosines[s]:
                continue
            found.normals[s] = (n - a * u - b * w) / length
            if used > size:
                found.noise[s] = _residual(rows, used, unit, size, equations)
            break


@kernel
def _neighbours(faces: Index, corners: Corners, s: int, around: Index) -> tuple[int, int]:
    """Vertices of the first ring, then of the second; returns how many are in the first and in both."""
    count = 0
    corner = corners.corners[corners.starts[s]]
    own = faces[corner // 3, corner % 3]
    for place in range(corners.starts[s], corners.starts[s + 1]):
        c = corners.corners[place]
        for step in (1, 2):
            count = _add(around, count, own, faces[c // 3, (c % 3 + step) % 3])
    near = count
    for place in range(corners.starts[s], corners.starts[s + 1]):
        c = corners.corners[place]
        if not corners.seen[c // 3]:
            continue
        for step in (1, 2):
            ring = corners.sectors[c // 3, (c % 3 + step) % 3]
            for at in range(corners.starts[ring], corners.starts[ring + 1]):
                other = corners.corners[at]
                if not corners.seen[other // 3]:
                    continue
                for side in (1, 2):
                    count = _add(around, count, own, faces[other // 3, (other % 3 + side) % 3])
    return near, count


@kernel
def _add(around: Index, count: int, own: int, vertex: int) -> int:
    if vertex == own or count == MOST_NEIGHBOURS:
        return count
    for i in range(count):
        if around[i] == vertex:
            return count
    around[count] = vertex
    return count + 1


@kernel
def _frame(n: Floats, u: Floats, w: Floats) -> None:
    """Two unit vectors that span the plane across a unit normal."""
    k = 0
    for i in range(3):
        if abs(n[i]) < abs(n[k]):
            k = i
    for i in range(3):
        u[i] = (1.0 if i == k else 0.0) - n[i] * n[k]
    length = np.sqrt(u[0] * u[0] + u[1] * u[1] + u[2] * u[2])
    for i in range(3):
        u[i] /= max(length, 1e-300)
    w[0], w[1], w[2] = n[1] * u[2] - n[2] * u[1], n[2] * u[0] - n[0] * u[2], n[0] * u[1] - n[1] * u[0]


@kernel
def _terms(x: float, y: float, size: int, row: Floats) -> None:
    row[0], row[1], row[2], row[3], row[4] = x, y, 0.5 * x * x, x * y, 0.5 * y * y
    if size == CUBIC:
        row[5], row[6], row[7], row[8] = x * x * x / 6.0, 0.5 * x * x * y, 0.5 * x * y * y, y * y * y / 6.0


@kernel
def _weight(x: float, y: float, size: int) -> float:
    """Square of one over the distance to the power that the jet leaves out."""
    square = x * x + y * y + NEAREST * NEAREST
    return float(1.0 / (square * square * square * (square if size == CUBIC else 1.0)))


@kernel
def _solved(rows: Floats, count: int, unit: float, size: int, A: Floats) -> bool:
    """Coefficients in units of `unit`, in the last column of A; false where the neighbours do not tell them all."""
    row = np.empty(CUBIC)
    for i in range(size):
        for j in range(size + 1):
            A[i, j] = 0.0
    for k in range(count):
        x, y, z = rows[k, 0] / unit, rows[k, 1] / unit, rows[k, 2] / unit
        _terms(x, y, size, row)
        weight = _weight(x, y, size)
        for i in range(size):
            for j in range(i, size):
                A[i, j] += weight * row[i] * row[j]
            A[i, size] += weight * row[i] * z
    for i in range(size):
        if not A[i, i] > 0.0:
            return False
        for j in range(i):
            A[i, j] = A[j, i]
    return _eliminated(A, size)


@kernel
def _eliminated(A: Floats, n: int) -> bool:
    """Solve symmetric equations (n, n + 1) in place; false where a pivot is lost."""
    diagonal = np.empty(CUBIC)
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
def _residual(rows: Floats, count: int, unit: float, size: int, A: Floats) -> float:
    """Root mean square of what a jet leaves of its neighbours, weighed as in the fit, per degree of freedom, mm."""
    row = np.empty(CUBIC)
    total = weights = 0.0
    for k in range(count):
        weight = _weight(rows[k, 0] / unit, rows[k, 1] / unit, size)
        _terms(rows[k, 0] / unit, rows[k, 1] / unit, size, row)
        off = rows[k, 2] / unit
        for i in range(size):
            off -= A[i, size] * row[i]
        total += weight * off * off
        weights += weight
    return float(unit * np.sqrt(total / weights * count / (count - size)))

"""Jets: polynomials through a vertex, fitted to the vertices about it, which give its normal and the noise.

A quadric over the first ring of neighbours or, where the two agree, a cubic over two rings; else the mean normal (Cazals, Pouget
2005, "Estimating differential quantities using polynomial fitting of osculating jets"). Distances are in units of the first
ring's extents along its two axes: a mesh has long facets where its surface is straight, and there a far neighbour along them
tells as much about the slope as a near one across them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ebamcheck.kernels import Bools, Floats, kernel
from ebamcheck.mesh.topology import Index
from ebamcheck.threads import run_blocks

CUBIC, QUADRIC = 9, 5
"""Coefficients of jets through the vertex: slopes, curvatures, and for the cubic the changes of these."""

MOST_NEIGHBOURS = 48
"""Most neighbours used of a vertex; two rings of a regular mesh hold 18."""

SPARE = 3
"""Neighbours beyond the number of coefficients: with fewer, a jet is little more than an interpolation."""

LEAST_PIVOT = 1e-5
"""Least pivot of the normal equations, scaled to a unit diagonal, for neighbours that determine a jet."""

NEAREST = 0.3
"""Distance, in extents of the first ring, within which the weight of a neighbour no longer grows: the rounding of its
coordinates tilts the jet the more the nearer it is."""

OFF_CENTRE = 0.5
"""Largest distance of the first ring's mean from the vertex, in extents of the ring; beyond it the vertex is at a border."""

AGREE = 0.35
"""Largest angle between the normals of the two jets, over the spread of the facets' normals. If they differ by more, the surface
is poorly determined, and the jet of the first ring is used."""

LONGEST_RING = 3.0
"""Ratio of the first ring's extents from which the second ring is not used: the cubic's error across tilts it along, which
would lift long edges."""

FLATTEST_RING = 1e-6
"""Ratio of the first ring's extents below which its vertices lie on a line."""

SECTORS_A_BLOCK = 512


class Corners(NamedTuple):
    """The corners of facets by sector, and the facets that jets may use."""

    sectors: Index
    """(F, 3) sector of each corner."""
    starts: Index
    """(S + 1,) first entry of each sector in `corners`."""
    corners: Index
    """Corners 3 f + i by sector."""
    seen: Bools
    """(F,) facets that jets may use: those outside of planes."""


class Jets(NamedTuple):
    """Normal and noise of each sector."""

    normals: Floats
    """(S, 3) unit normals."""
    noise: Floats
    """(S,) root mean square of what the jet leaves of its neighbours, per degree of freedom, mm; NaN without a jet."""


class _Frame(NamedTuple):
    """Orthonormal vectors: a normal, and two that span the plane perpendicular to it."""

    n: Floats
    u: Floats
    w: Floats


def jets(vertices: Floats, faces: Index, corners: Corners, means: Floats, least_cosines: Floats) -> Jets:
    """Fit jets to all sectors; the mean normal is kept where no jet is determined, or where it leaves the facets' normals."""
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
    around, of_fan = np.empty(MOST_NEIGHBOURS, np.int32), np.empty(MOST_NEIGHBOURS, np.int32)
    equations = np.empty((CUBIC, CUBIC + 1))
    u, w, scales, normal = np.empty(3), np.empty(3), np.empty(2), np.empty(3)
    for s in range(first, last):
        if least_cosines[s] >= 1.0 - 1e-15 or corners.starts[s + 1] == corners.starts[s]:
            continue
        near, count = _neighbours(faces, corners, s, around, of_fan)
        if near < 3:
            continue
        n = means[s]
        _frame(n, u, w)
        frame = _Frame(n, u, w)
        corner = corners.corners[corners.starts[s]]
        here = vertices[faces[corner // 3, corner % 3]]
        _set_rows(vertices, around, count, here, n, u, w, rows)
        if not _even_out(rows, near, count, u, w, scales):
            continue
        own = _normal(rows, near, QUADRIC, 0, equations, scales, frame, least_cosines[s], normal)
        if own:
            found.normals[s] = normal
            if near > QUADRIC:
                found.noise[s] = _residual(rows, near, QUADRIC, equations)
            if scales[0] > LONGEST_RING * scales[1] or scales[1] > LONGEST_RING * scales[0]:
                continue
        size = CUBIC if _is_centred(rows, near) else QUADRIC
        if not _normal(rows, count, size, SPARE, equations, scales, frame, least_cosines[s], normal):
            continue
        found.noise[s] = _residual(rows, count, size, equations)
        spread = np.arccos(min(max(least_cosines[s], -1.0), 1.0))
        if not own or np.sum(normal * found.normals[s]) >= np.cos(AGREE * spread):
            found.normals[s] = normal


@kernel
def _is_centred(rows: Floats, near: int) -> bool:
    """Whether the first ring lies about the vertex, and not to one side: a cubic is not drawn on beyond what it knows."""
    x = y = 0.0
    for i in range(near):
        x += rows[i, 0] / near
        y += rows[i, 1] / near
    return bool(x * x + y * y < OFF_CENTRE * OFF_CENTRE)


@kernel
def _normal(
    rows: Floats,
    count: int,
    size: int,
    spare: int,
    equations: Floats,
    scales: Floats,
    frame: _Frame,
    least_cosine: float,
    normal: Floats,
) -> bool:
    """Fit a jet of some size to the first `count` rows and write its normal; false where there is none."""
    if count < size + spare or not _solved(rows, count, size, equations, scales, spare == 0):
        return False
    a, b = equations[0, size] / scales[0], equations[1, size] / scales[1]
    length = np.sqrt(1.0 + a * a + b * b)
    for i in range(3):
        normal[i] = (frame.n[i] - a * frame.u[i] - b * frame.w[i]) / length
    return bool(1.0 / length >= least_cosine)


@kernel
def _neighbours(faces: Index, corners: Corners, s: int, around: Index, of_fan: Index) -> tuple[int, int]:
    """Vertices of the first ring, then of the second, and their fans; returns how many are in the first and in both."""
    count = near = 0
    corner = corners.corners[corners.starts[s]]
    own = faces[corner // 3, corner % 3]
    for ring in range(2):
        near = count
        for place in range(corners.starts[s], corners.starts[s + 1]):
            c = corners.corners[place]
            if ring and not corners.seen[c // 3]:
                continue
            for step in (1, 2):
                k = (c % 3 + step) % 3
                fan = corners.sectors[c // 3, k]
                if not ring:
                    count = _add(around, of_fan, count, own, faces[c // 3, k], fan)
                    continue
                for at in range(corners.starts[fan], corners.starts[fan + 1]):
                    other = corners.corners[at]
                    if not corners.seen[other // 3]:
                        continue
                    for side in (1, 2):
                        m = (other % 3 + side) % 3
                        vertex = faces[other // 3, m]
                        count = _add(around, of_fan, count, own, vertex, corners.sectors[other // 3, m])
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
def _set_rows(
    vertices: Floats, around: Index, count: int, here: Floats, n: Floats, u: Floats, w: Floats, rows: Floats
) -> None:
    """Neighbours in the frame of a vertex."""
    for i in range(count):
        p = vertices[around[i]]
        x, y, z = p[0] - here[0], p[1] - here[1], p[2] - here[2]
        rows[i, 0] = x * u[0] + y * u[1] + z * u[2]
        rows[i, 1] = x * w[0] + y * w[1] + z * w[2]
        rows[i, 2] = x * n[0] + y * n[1] + z * n[2]


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
def _even_out(rows: Floats, near: int, count: int, u: Floats, w: Floats, scales: Floats) -> bool:
    """Turn the frame to the axes of the first ring, and divide by its extents along them, mm."""
    xx = xy = yy = 0.0
    for i in range(near):
        xx += rows[i, 0] * rows[i, 0] / near
        xy += rows[i, 0] * rows[i, 1] / near
        yy += rows[i, 1] * rows[i, 1] / near
    angle = 0.5 * np.arctan2(2.0 * xy, xx - yy)
    c, s = np.cos(angle), np.sin(angle)
    scales[0] = np.sqrt(max(c * c * xx + 2.0 * c * s * xy + s * s * yy, 0.0))
    scales[1] = np.sqrt(max(s * s * xx - 2.0 * c * s * xy + c * c * yy, 0.0))
    if not scales[1] > FLATTEST_RING * scales[0]:
        return False
    for i in range(3):
        u[i], w[i] = c * u[i] + s * w[i], c * w[i] - s * u[i]
    for i in range(count):
        x, y = rows[i, 0], rows[i, 1]
        rows[i, 0], rows[i, 1] = (c * x + s * y) / scales[0], (c * y - s * x) / scales[1]
    return True


@kernel
def _weight(x: float, y: float) -> float:
    """Weight of a neighbour: one over its squared distance twice, so that the second ring helps and the first decides."""
    square = x * x + y * y + NEAREST * NEAREST
    return float(1.0 / (square * square))


@kernel
def _solved(rows: Floats, count: int, size: int, A: Floats, scales: Floats, first_ring: bool) -> bool:
    """Coefficients in the units of the rows, in the last column of A; false where the neighbours do not tell them all.

    In the first ring alone each neighbour counts by its slope, whatever its distance.
    """
    row = np.empty(CUBIC)
    for i in range(size):
        for j in range(size + 1):
            A[i, j] = 0.0
    for k in range(count):
        x, y, z = rows[k, 0], rows[k, 1], rows[k, 2]
        _terms(x, y, size, row)
        weight = _weight(x, y)
        if first_ring:
            weight = 1.0 / max((x * scales[0]) ** 2 + (y * scales[1]) ** 2, 1e-300)
        for i in range(size):
            for j in range(i, size):
                A[i, j] += weight * row[i] * row[j]
            A[i, size] += weight * row[i] * z
    for i in range(size):
        if not A[i, i] > 0.0:
            return False
        for j in range(i):
            A[i, j] = A[j, i]
    return eliminated(A, size, LEAST_PIVOT)


@kernel
def _residual(rows: Floats, count: int, size: int, A: Floats) -> float:
    """Root mean square of what a jet leaves of its neighbours, weighed as in the fit, per degree of freedom, mm."""
    row = np.empty(CUBIC)
    total = weights = 0.0
    for k in range(count):
        weight = _weight(rows[k, 0], rows[k, 1])
        _terms(rows[k, 0], rows[k, 1], size, row)
        off = rows[k, 2]
        for i in range(size):
            off -= A[i, size] * row[i]
        total += weight * off * off
        weights += weight
    return float(np.sqrt(total / weights * count / (count - size)))


# -- Predicted places: where the neighbours of a vertex put it, by a cubic fitted to them without it. -----------

TERMS = 10
"""Coefficients of a cubic over the plane: height, two slopes, three curvatures, and their four changes."""

LEAST_TERM_PIVOT = 1e-6
"""Least pivot of the normal equations, scaled to a unit diagonal, for neighbours that determine such a cubic."""

SOFTENING = 0.3
"""Squared distance, in units of the first ring, within which neighbours have about the same weight."""


@kernel
def predicted(
    vertices: Floats, faces: Index, corners: Corners, asked: Bools, first: int, last: int, found: Floats
) -> None:
    """Ask the neighbours of some fans from `first` on, and write what is found of each (S, 2); NaN stays where nothing is told.

    First by how much more a vertex would stand beyond the surface than its neighbours do, by the weights that the cubic
    gives them, if each stood there by the mean sagitta of its own edges; then by how much it does. Both in mean sagittas.
    """
    around, of_fan = np.empty(MOST_NEIGHBOURS, np.int32), np.empty(MOST_NEIGHBOURS, np.int32)
    rows, weights = np.empty((MOST_NEIGHBOURS, 3)), np.empty(MOST_NEIGHBOURS)
    A, B = np.empty((TERMS, TERMS + 1)), np.empty((TERMS, TERMS + 1))
    terms, scales, u, w, n = np.empty(TERMS), np.empty(2), np.empty(3), np.empty(3), np.empty(3)
    for s in range(first, last):
        if not asked[s]:
            continue
        near, count = _neighbours(faces, corners, s, around, of_fan)
        if count < TERMS + SPARE:
            continue
        n[:] = 0.0
        for place in range(corners.starts[s], corners.starts[s + 1]):
            f = corners.corners[place] // 3
            a, b = (
                vertices[faces[f, 1]] - vertices[faces[f, 0]],
                vertices[faces[f, 2]] - vertices[faces[f, 0]],
            )
            n[0] += a[1] * b[2] - a[2] * b[1]
            n[1] += a[2] * b[0] - a[0] * b[2]
            n[2] += a[0] * b[1] - a[1] * b[0]
        length = np.sqrt(np.sum(n * n))
        if length == 0.0:
            continue
        n /= length
        _frame(n, u, w)
        corner = corners.corners[corners.starts[s]]
        here = vertices[faces[corner // 3, corner % 3]]
        _set_rows(vertices, around, count, here, n, u, w, rows)
        if not _even_out(rows, near, count, u, w, scales):
            continue
        u /= scales[0]
        w /= scales[1]
        A[:], B[:] = 0.0, 0.0
        for k in range(count):
            x, y = rows[k, 0], rows[k, 1]
            terms[0] = 1.0
            _terms(x, y, CUBIC, terms[1:])
            weights[k] = 1.0 / (x * x + y * y + SOFTENING) ** 2
            for i in range(TERMS):
                for j in range(TERMS):
                    A[i, j] += weights[k] * terms[i] * terms[j]
                A[i, TERMS] += weights[k] * terms[i] * rows[k, 2]
        B[:, :TERMS] = A[:, :TERMS]
        B[0, TERMS] = 1.0
        if not (eliminated(A, TERMS, LEAST_TERM_PIVOT) and eliminated(B, TERMS, LEAST_TERM_PIVOT)):
            continue
        bends = A[3, TERMS], A[4, TERMS], A[5, TERMS]
        own, sizes = _sagitta(vertices, faces, corners, s, here, u, w, bends)
        expected = 0.0
        for i in range(count):
            terms[0] = 1.0
            _terms(rows[i, 0], rows[i, 1], CUBIC, terms[1:])
            share = weights[i] * np.sum(B[:, TERMS] * terms)
            other, size = _sagitta(vertices, faces, corners, of_fan[i], vertices[around[i]], u, w, bends)
            expected += share * other
            sizes += size
        typical = sizes / (count + 1)
        if typical > 0.0:
            found[s, 0] = (own - expected) / typical
            found[s, 1] = min(max(-A[0, TERMS] / typical, -1.0), 1.0)


@kernel
def _sagitta(
    vertices: Floats,
    faces: Index,
    corners: Corners,
    s: int,
    here: Floats,
    u: Floats,
    w: Floats,
    bends: tuple[float, float, float],
) -> tuple[float, float]:
    """Mean sagitta of the edges of a fan under given curvatures, mm: signed, positive where convex; and its magnitude."""
    total = size = 0.0
    for place in range(corners.starts[s], corners.starts[s + 1]):
        f, k = corners.corners[place] // 3, corners.corners[place] % 3
        for step in (1, 2):
            p = vertices[faces[f, (k + step) % 3]]
            x = y = 0.0
            for i in range(3):
                x += (p[i] - here[i]) * u[i]
                y += (p[i] - here[i]) * w[i]
            rise = -(0.5 * bends[0] * x * x + bends[1] * x * y + 0.5 * bends[2] * y * y) / 4.0
            total += rise
            size += abs(rise)
    count = 2 * (corners.starts[s + 1] - corners.starts[s])
    return total / count, size / count


@kernel
def eliminated(equations: Floats, count: int, least_pivot: float) -> bool:
    """Solve `count` symmetric positive equations (n, n + 1) in place; false where they do not determine all unknowns.

    The right side stands in column `count`, where the unknowns take its place. Of each diagonal element at least the share
    `least_pivot` has to be left.
    """
    diagonal = np.empty(count)
    for i in range(count):
        diagonal[i] = equations[i, i]
    for i in range(count):
        if not equations[i, i] > least_pivot * diagonal[i]:
            return False
        for j in range(i + 1, count):
            factor = equations[j, i] / equations[i, i]
            for k in range(i, count + 1):
                equations[j, k] -= factor * equations[i, k]
    for i in range(count - 1, -1, -1):
        for k in range(i + 1, count):
            equations[i, count] -= equations[i, k] * equations[k, count]
        equations[i, count] /= equations[i, i]
    return True

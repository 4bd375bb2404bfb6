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

CUBIC, QUADRIC = (
    9,
    5,
)  # Coefficients of jets through the vertex: slopes, curvatures, of cubics changes of these
TERMS = 10  # Coefficients of a cubic over the plane that need not go through the vertex: its height there, and those of a jet
MOST_NEIGHBOURS = 48  # Most neighbours used of a vertex; two rings of a regular mesh hold 18
SPARE = 3  # Neighbours beyond the number of coefficients: with fewer, a jet is merely an interpolation
LEAST_PIVOT = (
    1e-5  # Least pivot of the normal equations, scaled to a unit diagonal, for neighbours that determine a jet
)


class Corners(NamedTuple):
    """The corners of a mesh by sector, a set of corners about one vertex, and the facets that jets may use."""

    vertices: Floats
    faces: Index
    sectors: Index  # (F, 3) sector of each corner
    seen: Bools  # (F,) facets that jets may use: those outside of planes
    starts: Index  # (S + 1,) first entry of each sector in corners
    corners: Index  # Corners 3 f + i by sector


def corners_by(vertices: Floats, faces: Index, sectors: Index, seen: Bools | None = None) -> Corners:
    """Sort the corners of facets by their sectors; jets may use all facets by default."""
    flat, seen = sectors.reshape(-1), np.ones(len(faces), np.bool_) if seen is None else seen
    starts = np.concatenate([[0], np.cumsum(np.bincount(flat))]).astype(np.int32)
    return Corners(vertices, faces, sectors, seen, starts, np.argsort(flat, kind="stable").astype(np.int32))


class Jets(NamedTuple):
    """Normal and noise of each sector."""

    normals: Floats  # (S, 3) unit normals
    noise: Floats  # (S,) root mean square of what the jet leaves of its neighbours, per degree of freedom, mm; NaN without a jet


def jets(mesh: Corners, means: Floats, least_cosines: Floats) -> Jets:
    """Fit jets to all sectors; the mean normal is kept where no jet is determined, or where it leaves the facets' normals."""
    found = Jets(means.copy(), np.full(len(means), np.nan))

    def work(first: int, last: int) -> None:
        _jets(mesh, means, least_cosines, first, last, found)

    run_blocks(work, len(means), 512)
    return found


@kernel
def _jets(mesh: Corners, means: Floats, least_cosines: Floats, first: int, last: int, found: Jets) -> None:
    around, of_fan = np.empty(MOST_NEIGHBOURS, np.int32), np.empty(MOST_NEIGHBOURS, np.int32)
    rows, weights = np.empty((MOST_NEIGHBOURS, TERMS + 1)), np.empty((2, MOST_NEIGHBOURS))
    A, frame, scales, normal = np.empty((TERMS, TERMS + 2)), np.empty((3, 3)), np.empty(2), np.empty(3)
    for s in range(first, last):
        if least_cosines[s] >= 1.0 - 1e-15 or mesh.starts[s + 1] == mesh.starts[s]:
            continue
        near, count = _neighbours(mesh, s, around, of_fan)
        frame[0] = means[s]
        if near < 3 or not _set_rows(mesh, s, around, near, count, frame, scales, rows):
            continue
        x = y = 0.0
        for i in range(count):
            # Within 0.3 extents of the ring a weight grows no further: rounding tilts the jet the more the nearer a neighbour is.
            square = rows[i, 1] * rows[i, 1] + rows[i, 2] * rows[i, 2] + 0.3 * 0.3
            # In the first ring alone each neighbour counts by its slope, whatever its distance.
            weights[0, i] = 1.0 / max((rows[i, 1] * scales[0]) ** 2 + (rows[i, 2] * scales[1]) ** 2, 1e-300)
            # Else by one over its squared distance twice: the second ring helps and the first decides.
            weights[1, i] = 1.0 / (square * square)
            if i < near:
                x += rows[i, 1] / near
                y += rows[i, 2] / near
        # A cubic is not drawn on beyond what it knows: the first ring has to lie about the vertex, and not to one side, as at a border.
        centred = x * x + y * y < 0.5 * 0.5
        told = False
        for ring in range(2):
            # The error of a cubic across a long ring tilts it along the ring, which would lift long edges.
            if ring == 1 and told and max(scales[0], scales[1]) > 3.0 * min(scales[0], scales[1]):
                break
            used = count if ring == 1 else near
            size = CUBIC if ring == 1 and centred else QUADRIC
            if used < size + ring * SPARE or not _solved(rows, used, size, weights[ring], LEAST_PIVOT, A):
                continue
            a, b = A[0, size] / scales[0], A[1, size] / scales[1]
            length = np.sqrt(1.0 + a * a + b * b)
            if not 1.0 / length >= least_cosines[s]:
                continue
            for i in range(3):
                normal[i] = (frame[0, i] - a * frame[1, i] - b * frame[2, i]) / length
            if ring == 1 or near > QUADRIC:
                found.noise[s] = _residual(rows, used, size, weights[1], A)
            # Where both jets differ by more the surface is poorly determined, and the first ring decides.
            spread = np.arccos(min(max(least_cosines[s], -1.0), 1.0))
            if not told or np.sum(normal * found.normals[s]) >= np.cos(0.35 * spread):
                found.normals[s] = normal
            told = True


@kernel
def _residual(rows: Floats, count: int, size: int, weights: Floats, A: Floats) -> float:
    """Root mean square of what a jet leaves of its neighbours, per degree of freedom, mm."""
    total = sums = 0.0
    for k in range(count):
        off = rows[k, TERMS]
        for i in range(size):
            off -= A[i, size] * rows[k, i + 1]
        total += weights[k] * off * off
        sums += weights[k]
    return float(np.sqrt(total / sums * count / (count - size)))


@kernel
def _neighbours(mesh: Corners, s: int, around: Index, of_fan: Index) -> tuple[int, int]:
    """Vertices of the first ring, then of the second, and their fans; returns how many are in the first and in both."""
    count = near = 0
    first = mesh.starts[s]
    own = mesh.faces[mesh.corners[first] // 3, mesh.corners[first] % 3]
    for ring in range(2):
        near = count
        # The first ring is about the vertex itself, the second about each vertex of the first.
        for place in range(first, mesh.starts[s + 1] if ring else first + 1):
            c = mesh.corners[place]
            if ring and not mesh.seen[c // 3]:
                continue
            for step in range(1, 3 if ring else 2):
                hub = np.int64(mesh.sectors[c // 3, (c % 3 + step) % 3]) if ring else s
                for at in range(mesh.starts[hub], mesh.starts[hub + 1]):
                    f, k = mesh.corners[at] // 3, mesh.corners[at] % 3
                    if ring and not mesh.seen[f]:
                        continue
                    for side in range(1, 3):
                        vertex = mesh.faces[f, (k + side) % 3]
                        known = vertex == own or count == MOST_NEIGHBOURS
                        for i in range(count):
                            if known or around[i] == vertex:
                                known = True
                                break
                        if not known:
                            around[count], of_fan[count] = vertex, mesh.sectors[f, (k + side) % 3]
                            count += 1
    return near, count


@kernel
def _set_rows(
    mesh: Corners, s: int, around: Index, near: int, count: int, frame: Floats, scales: Floats, rows: Floats
) -> bool:
    """The terms of a cubic and the height at each neighbour of a sector, whose normal is the first row of the frame.

    The frame is turned to the axes of the first ring, and its extents along them divide what lies across the normal; false where
    that ring lies on a line.
    """
    n, u, w = frame[0], frame[1], frame[2]
    corner = mesh.corners[mesh.starts[s]]
    own = mesh.faces[corner // 3, corner % 3]
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
    xx = xy = yy = 0.0
    for i in range(count):
        x = y = z = 0.0
        for axis in range(3):
            step = mesh.vertices[around[i], axis] - mesh.vertices[own, axis]
            x += step * u[axis]
            y += step * w[axis]
            z += step * n[axis]
        rows[i, 1], rows[i, 2], rows[i, TERMS] = x, y, z
        if i < near:
            xx += x * x / near
            xy += x * y / near
            yy += y * y / near
    angle = 0.5 * np.arctan2(2.0 * xy, xx - yy)
    c, t = np.cos(angle), np.sin(angle)
    scales[0] = np.sqrt(max(c * c * xx + 2.0 * c * t * xy + t * t * yy, 0.0))
    scales[1] = np.sqrt(max(t * t * xx - 2.0 * c * t * xy + c * c * yy, 0.0))
    if not scales[1] > 1e-6 * scales[0]:
        return False
    for i in range(3):
        u[i], w[i] = c * u[i] + t * w[i], c * w[i] - t * u[i]
    for i in range(count):
        x, y = (c * rows[i, 1] + t * rows[i, 2]) / scales[0], (c * rows[i, 2] - t * rows[i, 1]) / scales[1]
        rows[i, 0], rows[i, 1], rows[i, 2] = 1.0, x, y
        rows[i, 3], rows[i, 4], rows[i, 5] = 0.5 * x * x, x * y, 0.5 * y * y
        rows[i, 6], rows[i, 7] = x * x * x / 6.0, 0.5 * x * x * y
        rows[i, 8], rows[i, 9] = 0.5 * x * y * y, y * y * y / 6.0
    return True


@kernel
def _solved(rows: Floats, count: int, size: int, weights: Floats, least_pivot: float, A: Floats) -> bool:
    """Fit a cubic or, of fewer terms, a jet to `count` neighbours; false where these do not determine all `size` coefficients.

    Column `size` of A takes the coefficients, the next one the solution with 1 in place of the height term's sum. Of each
    diagonal element of the normal equations at least the share `least_pivot` has to be left.
    """
    first = 0 if size == TERMS else 1  # a jet goes through the vertex
    diagonal = np.empty(size)
    for i in range(size):
        A[i, :] = 0.0
        A[i, size + 1] = 1.0 if first + i == 0 else 0.0
    for k in range(count):
        for i in range(size):
            share = weights[k] * rows[k, first + i]
            for j in range(i, size):
                A[i, j] += share * rows[k, first + j]
            A[i, size] += share * rows[k, TERMS]
    for i in range(size):
        diagonal[i] = A[i, i]
        for j in range(i):
            A[i, j] = A[j, i]
    for i in range(size):
        if not A[i, i] > least_pivot * diagonal[i]:
            return False
        for j in range(i + 1, size):
            factor = A[j, i] / A[i, i]
            for k in range(i, size + 2):
                A[j, k] -= factor * A[i, k]
    for i in range(size - 1, -1, -1):
        for side in range(size, size + 2):
            for k in range(i + 1, size):
                A[i, side] -= A[i, k] * A[k, side]
            A[i, side] /= A[i, i]
    return True


# -- Predicted places: where the neighbours of a vertex put it, by a cubic fitted to them without it. -----------

LEAST_TERM_PIVOT = 1e-6  # Least pivot, as above, for neighbours that determine such a cubic


@kernel
def predicted(mesh: Corners, areas: Floats, asked: Bools, first: int, last: int, found: Floats) -> None:
    """Ask the neighbours of some fans from `first` on, and write what is found of each (S, 2); NaN stays where nothing is told.

    First by how much more a vertex would stand beyond the surface than its neighbours do, by the weights that the cubic
    gives them, if each stood there by the mean sagitta of its own edges; then by how much it does. Both in mean sagittas.
    `areas` (F, 3) are the normals of facets times their areas, in any unit.
    """
    around, of_fan = np.empty(MOST_NEIGHBOURS, np.int32), np.empty(MOST_NEIGHBOURS, np.int32)
    rows, weights = np.empty((MOST_NEIGHBOURS, TERMS + 1)), np.empty(MOST_NEIGHBOURS)
    A, frame, scales = np.empty((TERMS, TERMS + 2)), np.empty((3, 3)), np.empty(2)
    for s in range(first, last):
        if not asked[s]:
            continue
        near, count = _neighbours(mesh, s, around, of_fan)
        if count < TERMS + SPARE:
            continue
        frame[0] = 0.0
        for place in range(mesh.starts[s], mesh.starts[s + 1]):
            frame[0] += areas[mesh.corners[place] // 3]
        length = np.sqrt(np.sum(frame[0] * frame[0]))
        if length == 0.0:
            continue
        frame[0] /= length
        if not _set_rows(mesh, s, around, near, count, frame, scales, rows):
            continue
        for k in range(count):
            # About the same within half an extent.
            weights[k] = 1.0 / (rows[k, 1] ** 2 + rows[k, 2] ** 2 + 0.3) ** 2
        if not _solved(rows, count, min(count, TERMS), weights, LEAST_TERM_PIVOT, A):
            continue
        mine = expected = sizes = 0.0
        for i in range(count + 1):  # the neighbours, and last the vertex itself
            fan = np.int64(of_fan[i]) if i < count else s
            rise, size = _sagitta(mesh, fan, frame, scales, A)
            sizes += size
            if i == count:
                mine = rise
                continue
            share = 0.0
            for k in range(TERMS):
                share += A[k, TERMS + 1] * rows[i, k]
            expected += weights[i] * share * rise
        typical = sizes / (count + 1)
        if typical > 0.0:
            found[s, 0] = (mine - expected) / typical
            found[s, 1] = min(max(-A[0, TERMS] / typical, -1.0), 1.0)


@kernel
def _sagitta(mesh: Corners, s: int | np.int64, frame: Floats, scales: Floats, A: Floats) -> tuple[float, float]:
    """Mean sagitta of the edges of a fan under the curvatures of a cubic, mm: signed, positive where convex; and its magnitude."""
    total = size = 0.0
    for place in range(mesh.starts[s], mesh.starts[s + 1]):
        f, k = mesh.corners[place] // 3, mesh.corners[place] % 3
        for step in range(1, 3):
            p, q = mesh.faces[f, k], mesh.faces[f, (k + step) % 3]
            x = y = 0.0
            for i in range(3):
                along = mesh.vertices[q, i] - mesh.vertices[p, i]
                x += along * frame[1, i] / scales[0]
                y += along * frame[2, i] / scales[1]
            rise = -(0.5 * A[3, TERMS] * x * x + A[4, TERMS] * x * y + 0.5 * A[5, TERMS] * y * y) / 4.0
            total += rise
            size += abs(rise)
    count = 2 * (mesh.starts[s + 1] - mesh.starts[s])
    return total / count, size / count

"""Allowances: how far a curve may leave its contour at each place, by what the mesh says of the surface there.

A smooth surface through the corners of a facet leaves it, at barycentric places l, by 4 sum l_i l_j s_ij, where s_ij is
how far it leaves the edge from i to j (the error of linear interpolation of a quadric). In the layer that is more the
flatter the surface lies.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ebamcheck.curves.sagitta import Sagittas
from ebamcheck.layers.stack import Layers
from ebamcheck.mesh.part import Part
from ebamcheck.mesh.topology import Index
from ebamcheck.numeric.kernels import kernel, run_blocks
from ebamcheck.numeric.rings import Bools, Floats, Ints

UNEVEN = 2.0
"""How much more than that of even curvature a place may move. A move of twice what the surface really leaves the contour
by, to its side, is no farther from it than the contour was: this is the most that evidence can allow."""

FLATTEST_SURFACE = 0.25
"""Sine of the slope under which a move in the layer is not let grow further; see :mod:`ebamcheck.curves.lifting`."""

NEIGHBOURS = 4
"""Segments on either side whose allowance a segment of a curved side shares: that of one, by the turns at the two ends of
its facet's edges, scatters as the mesh is irregular, while the surface goes on evenly."""

POINTS_A_BLOCK = 4096


class Allowances(NamedTuple):
    """How far curves may leave contours."""

    limit_mm: Floats
    """(N, 2) from each point, and from the middle of the segment after it, mm; along the segment it is the parabola
    through those of its start, its middle and its end."""
    plane: Bools
    """(N,) the segment after the point lies in a plane of the part."""


class Allowing:
    """Allowances of contours of one part; what they need of the mesh is found once.

    Parameters
    ----------
    part
        The mesh that was cut.
    sagittas
        How far its surface can leave its edges.
    """

    def __init__(self, part: Part, sagittas: Sagittas) -> None:
        self._part = part
        self._sagittas = sagittas
        self.rounding_mm = sagittas.rounding_mm
        faces = part.faces
        self._corners = np.argsort(faces.reshape(-1), kind="stable").astype(np.int32)
        sizes = np.bincount(faces.reshape(-1), minlength=len(part.vertices))
        self._starts = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
        a, b, c = (part.vertices[faces[:, k]] for k in range(3))
        normals = np.cross(b - a, c - a)
        sizes = np.linalg.norm(normals, axis=1)
        level = np.hypot(normals[:, 0], normals[:, 1]) / np.where(sizes > 0.0, sizes, 1.0)
        self._growth: Floats = 1.0 / np.maximum(level, FLATTEST_SURFACE)

    def of(self, layers: Layers) -> Allowances:
        """How far curves may leave contours; points without an edge not at all."""
        count = len(layers.points)
        found = Allowances(np.zeros((count, 2)), np.zeros(count, np.bool_))
        if layers.edge is None or layers.edge_t is None:
            return found
        following = np.arange(1, count + 1)
        filled = np.diff(layers.ring_starts) > 0
        following[layers.ring_starts[1:][filled] - 1] = layers.ring_starts[:-1][filled]
        edge, edge_t = np.ascontiguousarray(layers.edge), np.ascontiguousarray(layers.edge_t)

        def work(first: int, last: int) -> None:
            _allow(
                self._part.faces, self._starts, self._corners, self._growth, self._sagittas.of_edge,
                self._sagittas.of_side, self._sagittas.plane, edge, edge_t, following, first, last,
                found.limit_mm, found.plane,
            )  # fmt: skip

        run_blocks(work, count, POINTS_A_BLOCK)
        _share(found, following, layers)
        return found


def _share(found: Allowances, following: Ints, layers: Layers) -> None:
    """Let places on curved sides have what their neighbourhood has, or their ring on average; points what both of their
    segments have."""
    preceding = np.empty_like(following)
    preceding[following] = np.arange(following.size)
    middle = found.limit_mm[:, 1]
    own = np.where(found.plane, 0.0, middle)
    most = own.copy()
    for way in (following, preceding):
        beside = own
        for _ in range(NEIGHBOURS):
            # A plane ends the side: what lies beyond says nothing of it.
            beside = np.where(found.plane, 0.0, beside[way])
            np.maximum(most, beside, out=most)
    sizes = np.diff(layers.ring_starts)
    ring = np.repeat(np.arange(sizes.size), sizes)
    long = np.hypot(*(layers.points[following] - layers.points).T)
    total = np.bincount(ring, long, minlength=sizes.size)
    mean = np.bincount(ring, long * own, minlength=sizes.size) / np.where(total > 0.0, total, 1.0)
    middle[:] = np.where(found.plane, middle, np.maximum(most, mean[ring]))
    found.limit_mm[:, 0] = np.maximum(found.limit_mm[:, 0], np.minimum(middle[preceding], middle))


@kernel
def _allow(
    faces: Index,
    corner_starts: Ints,
    corners: Index,
    growth: Floats,
    of_edge: Floats,
    of_side: Floats,
    plane: Bools,
    edge: Index,
    edge_t: Floats,
    following: Ints,
    first: int,
    last: int,
    found: Floats,
    in_plane: Bools,
) -> None:
    here, there = np.zeros(3), np.zeros(3)
    for i in range(first, last):
        low, high = edge[i, 0], edge[i, 1]
        if low < 0:
            continue
        t = edge_t[i]
        up, down = -1, -1
        for place in range(corner_starts[low], corner_starts[low + 1]):
            f, k = corners[place] // 3, corners[place] % 3
            if faces[f, (k + 1) % 3] == high:
                up = 3 * f + k
            if faces[f, (k + 2) % 3] == high:
                down = 3 * f + (k + 2) % 3
        if up >= 0:
            found[i, 0] = UNEVEN * 4.0 * t * (1.0 - t) * of_edge[up] * growth[up // 3]
        if down < 0:
            continue
        found[i, 0] = max(found[i, 0], UNEVEN * 4.0 * t * (1.0 - t) * of_edge[down] * growth[down // 3])
        f, j = down // 3, following[i]
        here[:] = 0.0
        there[:] = 0.0
        for k in range(3):
            v = faces[f, k]
            here[k] = 1.0 - t if v == low else (t if v == high else 0.0)
            there[k] = 1.0 - edge_t[j] if v == edge[j, 0] else (edge_t[j] if v == edge[j, 1] else 0.0)
        middle = 0.0
        if abs(there.sum() - 1.0) < 1e-9:
            for k in range(3):
                m = (k + 1) % 3
                middle += 0.25 * (here[k] + there[k]) * (here[m] + there[m]) * of_side[3 * f + k]
            middle *= 4.0
        else:  # the segment goes on over other facets: a point between them was left out
            middle = max(of_side[3 * f], of_side[3 * f + 1], of_side[3 * f + 2])
        found[i, 1] = UNEVEN * middle * growth[f]
        in_plane[i] = plane[f]

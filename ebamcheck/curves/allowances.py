"""Allowances: how far a curve may leave its contour at each place, from what the mesh tells about the surface there.

A smooth surface through the corners of a facet leaves the facet, at barycentric coordinates l, by 4 sum l_i l_j s_ij, where
s_ij is the sagitta over the edge from i to j (the error of linear interpolation of a quadric). Measured within the layer, that
distance grows as the surface approaches the horizontal. The distance from an exact surface is known, but is still limited by
the sagittas that follow from the dihedral angles of the mesh.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ebamcheck.curves.exact import ExactSurfaces, no_surfaces
from ebamcheck.curves.exact.forms import FLAT, KIND, signed_distance
from ebamcheck.curves.exact.sections import slope_of
from ebamcheck.curves.plausible import LEAST_SAGITTA_MM
from ebamcheck.curves.sagitta import Sagittas
from ebamcheck.layers.stack import Layers
from ebamcheck.mesh.part import Part
from ebamcheck.mesh.topology import Index
from ebamcheck.numeric.kernels import kernel, run_blocks
from ebamcheck.numeric.rings import Bools, Floats, Ints

UNEVEN = 2.0
"""Largest allowed move, over the sagitta of even curvature. A point moved towards the surface by twice its distance is
no farther from it than it was: this is the most that evidence can allow."""

FLATTEST_SURFACE = 0.25
"""Sine of the surface's slope below which a move in the layer grows no further; see :mod:`ebamcheck.curves.lifting`."""

LEAST_LEVEL = 0.05
"""Sine of the slope below which the distance of an exact surface within the layer grows no further."""

ROOM = 1.5
"""Largest distance of an exact surface's section from the contour, over the surface's first-order distance."""

OF_TURNS = 4.0
"""Largest distance of an exact surface from a facet, over the sagitta by the mesh's dihedral angles or over their median,
whichever is greater. On regular, decimated and scattered meshes alike 2.5 is the most seen. The limit is independent of the
search that found the surface."""

NEIGHBOURS = 4
"""Segments on either side whose allowance a segment of a curved side shares. A single allowance, from the turns at the ends
of one facet's edges, scatters on an irregular mesh although the surface is smooth."""

POINTS_A_BLOCK = 4096


class Allowances(NamedTuple):
    """How far curves may leave contours."""

    limit_mm: Floats
    """(N, 2) limit at each point, and at the middle of the segment after it, mm; along the segment the limit is the
    parabola through the values at its start, middle and end."""
    plane: Bools
    """(N,) whether the segment after the point lies in a plane of the part."""


class _Told(NamedTuple):
    """What the kernels read of a mesh and of the surface that it approximates."""

    faces: Index
    corner_starts: Ints
    corners: Index
    growth: Floats
    of_edge: Floats
    of_side: Floats
    plane: Bools
    typical: float
    exact: Index
    forms: Floats


class _Points(NamedTuple):
    """Points of contours on the edges of a mesh."""

    places: Floats
    edge: Index
    edge_t: Floats
    following: Ints


class Allowing:
    """Computes the allowances of contours of one part; what it needs of the mesh is found once.

    Parameters
    ----------
    part
        The mesh that was cut.
    sagittas
        How far the surface can leave the edges of the mesh.
    exact
        Exact surfaces of the part; None where they are not looked for.
    """

    def __init__(self, part: Part, sagittas: Sagittas, exact: ExactSurfaces | None = None) -> None:
        self.rounding_mm = sagittas.rounding_mm
        faces = part.faces
        corners = np.argsort(faces.reshape(-1), kind="stable").astype(np.int32)
        sizes = np.bincount(faces.reshape(-1), minlength=len(part.vertices))
        starts = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
        a, b, c = (part.vertices[faces[:, k]] for k in range(3))
        normals = np.cross(b - a, c - a)
        lengths = np.linalg.norm(normals, axis=1)
        level = np.hypot(normals[:, 0], normals[:, 1]) / np.where(lengths > 0.0, lengths, 1.0)
        growth = 1.0 / np.maximum(level, FLATTEST_SURFACE)
        known = no_surfaces(len(faces)) if exact is None else exact
        curved = sagittas.of_edge[sagittas.of_edge > LEAST_SAGITTA_MM]
        typical = float(np.median(curved)) if curved.size else 0.0
        self._told = _Told(
            faces,
            starts,
            corners,
            growth,
            sagittas.of_edge,
            sagittas.of_side,
            sagittas.plane,
            typical,
            *known,
        )

    def of(self, layers: Layers) -> Allowances:
        """How far curves may leave contours; points without an edge not at all."""
        count = len(layers.points)
        found = Allowances(np.zeros((count, 2)), np.zeros(count, np.bool_))
        if layers.edge is None or layers.edge_t is None:
            return found
        following = np.arange(1, count + 1)
        filled = np.diff(layers.ring_starts) > 0
        following[layers.ring_starts[1:][filled] - 1] = layers.ring_starts[:-1][filled]
        ring_heights = np.repeat(layers.heights, np.diff(layers.layer_starts))
        heights = np.repeat(ring_heights, np.diff(layers.ring_starts))
        points = _Points(
            np.ascontiguousarray(layers.points),
            np.ascontiguousarray(layers.edge),
            np.ascontiguousarray(layers.edge_t),
            following,
        )

        def work(first: int, last: int) -> None:
            _allow(self._told, points, heights, first, last, found)

        run_blocks(work, count, POINTS_A_BLOCK)
        _share(found, following, layers)
        return found


def _share(found: Allowances, following: Ints, layers: Layers) -> None:
    """Raise each segment's limit on a curved side to the greatest nearby and to the mean of its ring, and each point's to the
    lesser of those of its two segments."""
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
def _allow(told: _Told, points: _Points, heights: Floats, first: int, last: int, found: Allowances) -> None:
    for i in range(first, last):
        low, high = points.edge[i, 0], points.edge[i, 1]
        if low < 0:
            continue
        up, down = _half_edges(told, low, high)
        t = points.edge_t[i]
        x, y, z = points.places[i, 0], points.places[i, 1], heights[i]
        arc = UNEVEN * 4.0 * t * (1.0 - t)
        if up >= 0:
            f = up // 3
            found.limit_mm[i, 0] = max(arc * told.of_edge[up] * told.growth[f], _exact_mm(told, f, x, y, z))
        if down < 0:
            continue
        f, j = down // 3, points.following[i]
        here = max(arc * told.of_edge[down] * told.growth[f], _exact_mm(told, f, x, y, z))
        found.limit_mm[i, 0] = max(found.limit_mm[i, 0], here)
        x, y = 0.5 * (x + points.places[j, 0]), 0.5 * (y + points.places[j, 1])
        exact = _exact_mm(told, f, x, y, z)
        found.limit_mm[i, 1] = max(_of_middle(told, points, i, down), exact)
        found.plane[i] = told.plane[f] and exact == 0.0


@kernel
def _half_edges(told: _Told, low: int, high: int) -> tuple[int, int]:
    """Half-edges low -> high and high -> low; -1 for none."""
    up, down = -1, -1
    for place in range(told.corner_starts[low], told.corner_starts[low + 1]):
        f, k = told.corners[place] // 3, told.corners[place] % 3
        if told.faces[f, (k + 1) % 3] == high:
            up = 3 * f + k
        if told.faces[f, (k + 2) % 3] == high:
            down = 3 * f + (k + 2) % 3
    return up, down


@kernel
def _of_middle(told: _Told, points: _Points, i: int, down: int) -> float:
    """What the middle of the segment after point i may move, by the sagittas of its facet's edges, mm."""
    f, j = down // 3, points.following[i]
    here, there = np.zeros(3), np.zeros(3)
    for k in range(3):
        v = told.faces[f, k]
        for weights, point in ((here, i), (there, j)):
            if v == points.edge[point, 0]:
                weights[k] = 1.0 - points.edge_t[point]
            elif v == points.edge[point, 1]:
                weights[k] = points.edge_t[point]
    middle = 0.0
    if abs(there.sum() - 1.0) < 1e-9:
        for k in range(3):
            m = (k + 1) % 3
            middle += (here[k] + there[k]) * (here[m] + there[m]) * told.of_side[3 * f + k]
    else:  # the segment goes on over other facets: a point between them was left out
        middle = max(told.of_side[3 * f], told.of_side[3 * f + 1], told.of_side[3 * f + 2])
    return float(UNEVEN * middle * told.growth[f])


@kernel
def _exact_mm(told: _Told, f: int, x: float, y: float, z: float) -> float:
    """How far the exact surface of a facet passes a place in the layer, mm; 0 where none is known, and of planes."""
    row = told.exact[f]
    if row < 0 or int(told.forms[row, KIND]) == FLAT:
        return 0.0
    at = signed_distance(told.forms[row], x, y, z)
    own = max(told.of_edge[3 * f], told.of_edge[3 * f + 1], told.of_edge[3 * f + 2])
    stands = min(ROOM * abs(at[0]), OF_TURNS * max(own, told.typical))
    return float(stands / max(slope_of(at), LEAST_LEVEL))

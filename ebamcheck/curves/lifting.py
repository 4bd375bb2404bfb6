"""Lifting: contour points move from the straight edges of the mesh to the curved edges of the surface that it approximates.

A contour's points lie on chords of the surface, so a curve through them keeps the chord error. Each edge between two vertices
is therefore replaced by a cubic that is perpendicular to the surface normals at its ends (a Hermite edge, as in Vlachos et al.
2001, "Curved PN triangles"), and the point moves to where that cubic crosses the layer. The edge bends at both ends by the
lesser of the two angles that the normals demand, and not at all where these demand large bends to opposite sides: so a normal
spoilt by a neighbour of another curvature does not make it overshoot. Edges of planes and the rulings of strips do not bend.
On exact surfaces a point moves to their section.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from ebamcheck.curves.oriented_contours import FLAT_MM, NO_PLANE, Sides, as_they_are
from ebamcheck.curves.sections import place, refined
from ebamcheck.kernels import Bools, Floats, Ints
from ebamcheck.layers.stack import Layers
from ebamcheck.mesh.part import Part
from ebamcheck.mesh.topology import Index
from ebamcheck.surface.exact_forms import FLAT, KIND
from ebamcheck.surface.lift_limits import LiftLimits, lift_limits, plausible_share
from ebamcheck.surface.part_surface import PartSurface
from ebamcheck.surface.planes import area_vectors
from ebamcheck.surface.regions import PLANE, STRIP
from ebamcheck.threads import run_blocks

FLATTEST_SURFACE = 0.25
"""Sine of the surface's slope below which a move in the layer grows no further: a point moves at most the height of the
curved edge over its chord, divided by this."""

OF_SAGITTAS = 8.0
"""Largest distance between a curve and its contour, over the largest sagitta of the mesh there or the median one, by the greater,
and over the sine of the slope. On a regular mesh the surface is one sagitta off, over the longest facets of scattered points up to
six: of 1,394 rings of 255 meshes of known parts, all that are farther off than four are nearer to their part than the contour."""


class Limits(NamedTuple):
    """How far curves may leave contours."""

    of_point: Floats  # (N,) limit at each point, mm; along the segment after it the greater of both ends
    plane: Bools  # (N,) whether the segment after the point lies in a plane of the part, and does not leave it


class Lifting:
    """Lifts contours of one part by its surface, and limits how far curves may leave them."""

    def __init__(self, surface: PartSurface, flat_mm: float = FLAT_MM) -> None:
        self.surface, self.flat_mm = surface, flat_mm
        self.limits = lift_limits(surface, flat_mm)
        level = np.hypot(surface.facet_normals[:, 0], surface.facet_normals[:, 1])
        self._steepness = np.maximum(level, FLATTEST_SURFACE)
        self._planes = _sure_planes(surface)
        faces = surface.faces
        tails, heads = faces.reshape(-1), np.roll(faces, -1, axis=1).reshape(-1)
        keys, half_edges, counts = np.unique(
            tails.astype(np.int64) * len(surface.vertices) + heads, return_index=True, return_counts=True
        )
        # An edge of more than two facets is left out.
        self._keys, self._half_edge = keys[counts == 1], half_edges[counts == 1]

    def lifted_rings(self, layers: Layers) -> tuple[Sides, Ints]:
        """Lift the points of layers and insert points on exact surfaces; returns them and the new starts of the rings."""
        heights = layers.heights[layers.ring_layer]
        sides = self.lift(layers)
        return refined(self.surface.exact.rows, sides, heights, layers.ring_starts, layers.closed)

    def lift(self, layers: Layers) -> Sides:
        """Lift the points of layers that carry their edges; points without one stay where they are."""
        found = as_they_are(np.ascontiguousarray(layers.points).copy())
        if layers.edge_t is None:
            raise ValueError("layers without edges cannot be lifted")
        i, up, down = self._half_edges(layers)
        surface = self.surface
        before, after = up // 3, down // 3
        found.unknown[i] = False
        kind, region = surface.kind, surface.region
        found.plane_before[i] = np.where(kind[before] == PLANE, region[before], NO_PLANE)
        found.plane_after[i] = np.where(kind[after] == PLANE, region[after], NO_PLANE)
        heights = np.repeat(layers.heights[layers.ring_layer], np.diff(layers.ring_starts))[i]
        on_forms = place(surface.exact, before, after, heights, i, found)
        free = np.flatnonzero(~on_forms)
        edge = _Edges(surface, up[free], down[free])
        _lift(edge, self.limits, i[free], heights[free], layers.edge_t[i[free]], found)
        return found

    def allowed(self, layers: Layers) -> Limits:
        """How far curves may leave contours, by the sagittas of the mesh alone; points without an edge not at all."""
        count = len(layers.points)
        found = Limits(np.zeros(count), np.zeros(count, np.bool_))
        i, up, down = self._half_edges(layers)
        before, after, flat = up // 3, down // 3, self._planes
        tail, sagittas = self.surface.faces.reshape(-1), self.surface.sagittas
        largest = np.maximum(sagittas.largest[tail[up]], sagittas.largest[tail[down]])
        height = np.maximum(largest, sagittas.typical)
        reach = OF_SAGITTAS / np.minimum(self._steepness[before], self._steepness[after])
        known = np.isfinite(height) & ~(flat[before] & flat[after])
        found.of_point[i] = np.where(known, height, 0.0) * reach
        found.plane[i] = flat[after]
        return found

    def _half_edges(self, layers: Layers) -> tuple[Ints, Ints, Ints]:
        """Points on the edges of the mesh, and the half-edges that run up and down each.

        Facets look outward and solids lie to the left of a contour: the segment that ends at a point is in the facet that runs
        up its edge, the one that begins there in the facet that runs down.
        """
        none = np.zeros(0, np.int64)
        if layers.edge is None or not self._keys.size:
            return none, none, none
        low, high = layers.edge.astype(np.int64).T
        count = len(self.surface.vertices)
        keys = np.stack([low * count + high, high * count + low])
        at = np.minimum(np.searchsorted(self._keys, keys), self._keys.size - 1)
        i = np.flatnonzero((low >= 0) & (self._keys[at] == keys).all(axis=0))
        up, down = self._half_edge[at[:, i]]
        return i, up, down


def _sure_planes(surface: PartSurface) -> Bools:
    """Facets (F,) of planes that are far larger than a facet of the curved regions, and on no curved surface by its formula.

    Slivers make some pairs of facets of a curved surface coplanar.
    """
    areas = np.linalg.norm(area_vectors(surface.vertices[surface.faces]), axis=1)
    label, forms = surface.exact
    plane = (surface.kind == PLANE) & ~np.append(forms[:, KIND] != FLAT, False)[label]
    if not (surface.kind == PLANE).all():
        least_mm2 = 4.0 * areas[surface.kind != PLANE].mean()
        plane &= np.bincount(surface.region, areas)[surface.region] > least_mm2
    return np.asarray(plane)


class _Edges:
    """Edges that contour points lie on, as arrays with a row for each point: ends, normals on both sides, and how they bend."""

    def __init__(self, surface: PartSurface, up: Ints, down: Ints) -> None:
        self.up = up
        f, g = up // 3, down // 3
        rows, normals = surface.sectors.reshape(-1), surface.normals
        ahead = 3 * f + (up + 1) % 3, 3 * g + (down + 1) % 3
        self.up_low, self.up_high = normals[rows[up]], normals[rows[ahead[0]]]
        self.down_high, self.down_low = normals[rows[down]], normals[rows[ahead[1]]]
        corners = surface.faces.reshape(-1)
        self.start = surface.vertices[corners[up]]
        self.chord = surface.vertices[corners[ahead[0]]] - self.start
        self.kinds = surface.kind[f], surface.kind[g]
        self.smooth = surface.smooth[up] & surface.smooth[down]
        self.same_strip = self.smooth & (self.kinds[0] == STRIP) & (self.kinds[1] == STRIP)
        self.same_strip &= surface.region[f] == surface.region[g]

    def bends(self) -> tuple[Floats, Floats]:
        """Bends at the lower and the upper end (n, 3): tangent less chord, mm; 0 for edges that are straight lines of the part."""
        # A strip's normals stand across its rulings.
        ruled = (self.smooth & (self.kinds[1] == STRIP))[:, None]
        low = self._bend(np.where(ruled, self.down_low, self.up_low), self.down_low)
        high = self._bend(np.where(ruled, self.down_high, self.up_high), self.down_high)
        planes = self.kinds[0] == PLANE, self.kinds[1] == PLANE
        ruling = (self.kinds[0] == STRIP) & (self.kinds[1] == STRIP) & ~self.same_strip
        straight = np.where(self.smooth, planes[0] | planes[1] | ruling, planes[0] & planes[1])
        lesser = np.minimum(_dot(low, low), _dot(high, high))
        inflected = _dot(low, high) >= 0.0
        # Bends of more than 5 degrees to opposite sides show a flat side between curved ones.
        straight |= inflected & (lesser >= np.sin(np.deg2rad(5.0)) ** 2 * _dot(self.chord, self.chord))
        evened = [b * np.sqrt(lesser / np.maximum(_dot(b, b), 1e-300))[:, None] for b in (low, high)]
        strip = self.same_strip[:, None]
        low, high = np.where(strip, low, evened[0]), np.where(strip, high, evened[1])
        low[straight] = high[straight] = 0.0
        return low, high

    def _bend(self, normal: Floats, other: Floats) -> Floats:
        """Across the normal on a smooth edge, along both sides on a crease."""
        across = -_dot(self.chord, normal)[:, None] * normal
        along = np.cross(normal, other)
        square = _dot(along, along)
        crease = along * (_dot(self.chord, along) / np.maximum(square, 1e-300))[:, None] - self.chord
        crease[square < 0.01] = 0.0  # below a sine of 0.1 between both sides its direction is unknown
        return np.where(self.smooth[:, None], across, crease)


def _lift(edge: _Edges, limits: LiftLimits, i: Ints, height: Floats, t: Floats, found: Sides) -> None:
    """Lift points `i` of contours to the curved edges over their straight ones."""
    plausible_mm, most_mm = limits.plausible_mm[edge.up], limits.most_mm[edge.up]
    found.share[i] = np.minimum(limits.share[edge.kinds[0]], limits.share[edge.kinds[1]])
    low, high = edge.bends()
    # The cubic leaves its chord by at most a quarter of the bend.
    most = 0.25 * np.sqrt(np.maximum(_dot(low, low), _dot(high, high)))
    told = np.minimum(plausible_share(most, plausible_mm), most_mm / np.maximum(most, 1e-300))
    share = found.share[i] * told
    low, high = low * share[:, None], high * share[:, None]
    curved = np.flatnonzero(share * most > 0.0)
    t = t.copy()
    start, rise, bend, other = (column[curved, 2] for column in (edge.start, edge.chord, low, high))
    t[curved] = _places(start - height[curved], rise, bend, other, t[curved])
    s = 1.0 - t
    ahead = edge.start + edge.chord * t[:, None] + (t * s * s)[:, None] * low - (t * t * s)[:, None] * high
    move = ahead[:, :2] - found.points[i]
    moved = np.hypot(*move.T)
    farthest = share * most / FLATTEST_SURFACE
    move *= np.minimum(farthest / np.maximum(moved, 1e-300), 1.0)[:, None]
    found.points[i[curved]] += move[curved]
    found.before[i] = _direction(edge.up_low, edge.up_high, t)
    found.after[i] = _direction(edge.down_low, edge.down_high, t)
    sideways = 0.5 * np.hypot(*(edge.down_low + edge.down_high)[:, :2].T)
    found.plausible[i] = plausible_mm / np.maximum(sideways, FLATTEST_SURFACE)
    found.smooth[i] = edge.smooth


def _places(start: Floats, rise: Floats, bend_low: Floats, bend_high: Floats, t: Floats) -> Floats:
    """Parameters at which curved edges pass height 0: Newton's steps, kept within halves that hold them."""
    found = t.copy()
    columns = np.stack([t, np.zeros(t.size), np.ones(t.size), start, rise, bend_low, bend_high])
    i = np.arange(t.size)
    for _ in range(60):  # as many halvings reach rounding
        t, a, b, begin, rise, low, high = columns
        s = 1.0 - t
        off = begin + rise * t + t * s * (s * low - t * high)
        below = off <= 0.0
        a, b = np.where(below, t, a), np.where(below, b, t)
        slope = rise + s * (s - 2.0 * t) * low - t * (2.0 * s - t) * high
        following = t - off / np.where(slope != 0.0, slope, 1e-300)
        following = np.where((a < following) & (following < b), following, 0.5 * (a + b))
        found[i] = following
        moving = np.flatnonzero(np.abs(following - t) > 1e-14)
        if not moving.size:
            break
        i = i[moving]
        columns = np.stack([following, a, b, begin, rise, low, high])[:, moving]
    return found


def _direction(low: Floats, high: Floats, t: Floats) -> Floats:
    """Directions of a contour with the solid to its left, from outward normals; NaN where there is none."""
    normal = low * (1.0 - t)[:, None] + high * t[:, None]
    sideways = np.hypot(normal[:, 0], normal[:, 1])[:, None]
    turned = np.column_stack([-normal[:, 1], normal[:, 0]])
    return np.where(sideways > 1e-6, turned / np.maximum(sideways, 1e-300), np.nan)


def _dot(a: Floats, b: Floats) -> Floats:
    return np.asarray(np.einsum("ij,ij->i", a, b))


# -- The mesh edge under each contour point, by geometry, for slicers that do not return it. --------------------


def with_edges(layers: Layers, part: Part, tolerance_mm: float) -> Layers | None:
    """Layers with the mesh edge of each point; None if they are not contours of the part: less than half of their points get one.

    A layer cuts an edge whose lower end is not above it, and whose upper end is. A point gets the edge whose cut is nearest, if
    that is within `tolerance_mm`.
    """
    if layers.edge is not None:
        return layers
    count = len(layers.points)
    edge, edge_t = np.full((count, 2), -1, np.int32), np.zeros(count)
    ends = _edges(part)
    low, high = part.vertices[ends[:, 0]], part.vertices[ends[:, 1]]
    by_low = np.argsort(low[:, 2], kind="stable")
    sorted_low = low[by_low, 2]
    starts = layers.ring_starts[layers.layer_starts]
    reach_mm = float(np.nextafter(tolerance_mm, np.inf))

    def work(first: int, last: int) -> None:
        for k in range(first, last):
            z, rows = float(layers.heights[k]), np.arange(starts[k], starts[k + 1])
            begun = by_low[: int(np.searchsorted(sorted_low, z, side="right"))]
            cut = begun[high[begun, 2] > z]
            if not cut.size or not rows.size:
                continue
            t = (z - low[cut, 2]) / (high[cut, 2] - low[cut, 2])
            places = low[cut, :2] + t[:, None] * (high[cut] - low[cut])[:, :2]
            away, nearest = cKDTree(places).query(layers.points[rows], distance_upper_bound=reach_mm)
            near = np.isfinite(away)
            chosen = np.asarray(nearest)[near]
            edge[rows[near]], edge_t[rows[near]] = ends[cut[chosen]], t[chosen]

    run_blocks(work, len(layers))
    if count and np.count_nonzero(edge[:, 0] >= 0) < 0.5 * count:
        return None  # traced from a raster
    return replace(layers, edge=edge, edge_t=edge_t)


def _edges(part: Part) -> Index:
    """Edges of the mesh that are not level, each once, lower vertex first, (E, 2)."""
    pairs = np.concatenate([part.faces[:, [0, 1]], part.faces[:, [1, 2]], part.faces[:, [2, 0]]])
    z = part.vertices[:, 2]
    turned = z[pairs[:, 0]] > z[pairs[:, 1]]
    pairs[turned] = pairs[turned][:, ::-1]
    pairs = pairs[z[pairs[:, 0]] < z[pairs[:, 1]]]
    key = pairs[:, 0].astype(np.int64) * len(part.vertices) + pairs[:, 1]
    return np.ascontiguousarray(pairs[np.unique(key, return_index=True)[1]], dtype=np.int32)

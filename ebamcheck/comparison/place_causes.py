"""Likely causes of a disagreement, from the mesh, the layers, and what the slicers declare about the place.

A cause is something found at the place that is known to make slicers disagree; it is no proof.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ebamcheck.kernels import Floats, Ints
from ebamcheck.mesh.part import Part
from ebamcheck.mesh.topology import body_labels, edge_groups

COPLANAR_FACE = "coplanar face"
VERTEX = "vertex on plane"
OPEN_EDGE = "open edge"
NON_MANIFOLD = "non-manifold edge"
ORIENTATION = "inconsistent orientation"
OVERLAP = "overlapping shells"
SELF_INTERSECTION = "self-intersection"
TOUCHING = "touching shells"
OPEN_PATH = "open path"
OPEN_SURFACE = "open surface"
THIN = "thin feature"
THIN_GAP = "thin gap"
SHALLOW = "shallow slope"
UNKNOWN_CAUSE = "unknown"

# Distance within which a flaw of the mesh explains a disagreement, over the sum of the disagreement's depth and limit
NEAR_DEPTHS = 3.0
# Largest depth of a thin feature, over the limit of the methods compared; a wall or gap has two sides
THIN_LIMITS = 4.0
# Shells nearer to each other than this share of the part's size touch: single precision cannot separate them
TOUCHING_SHARE = 1e-7
PROBES = 16  # points on a circle around the place at which the winding number is computed


class MeshFlaws:
    """Edges of a part that are open, non-manifold or inconsistently oriented, and its facets by height."""

    def __init__(self, part: Part) -> None:
        self.part = part

    @cached_property
    def _edges(self) -> tuple[Ints, dict[str, NDArray[np.bool_]]]:
        """Distinct edges (E, 2) and which of them are flawed, by cause."""
        faces = self.part.faces.astype(np.int64)
        directed = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
        directed = directed[directed[:, 0] != directed[:, 1]]
        forward = directed[:, 0] < directed[:, 1]
        key = directed.min(axis=1) * len(self.part.vertices) + directed.max(axis=1)
        distinct, where = np.unique(key, return_inverse=True)
        uses = np.bincount(where, minlength=distinct.size)
        up = np.bincount(where, forward, minlength=distinct.size)
        count = max(len(self.part.vertices), 1)
        edges = np.stack([distinct // count, distinct % count], axis=1)
        flaws = {OPEN_EDGE: uses == 1, NON_MANIFOLD: uses > 2, ORIENTATION: (uses == 2) & (up != 1)}
        return edges, flaws

    @cached_property
    def _flawed(self) -> dict[str, NDArray[np.float64]]:
        """End points of the flawed edges, (n, 2, 3) mm, by cause."""
        edges, flaws = self._edges
        return {cause: self.part.vertices[edges[which]] for cause, which in flaws.items()}

    @cached_property
    def _by_height(self) -> tuple[Ints, Floats, Floats, float]:
        """Facets sorted by lowest z, their lowest and highest z, and the height of the tallest facet."""
        z = self.part.vertices[:, 2][self.part.faces]
        low, high = z.min(axis=1), z.max(axis=1)
        order = np.argsort(low, kind="stable")
        tallest = float((high - low).max()) if len(order) else 0.0
        return order, low[order], high[order], tallest

    def crossing(self, height_mm: float) -> Ints:
        """Facets that a section at this height (+ 0) cuts."""
        order, low, high, tallest = self._by_height
        first = np.searchsorted(low, height_mm - tallest, side="left")
        past = np.searchsorted(low, height_mm, side="right")
        return order[first:past][high[first:past] > height_mm]

    def section(self, height_mm: float) -> Floats:
        """Oriented segments of the section, (n, 4) mm: x0, y0, x1, y1 with the solid on their left."""
        corners = self.part.triangles[self.crossing(height_mm)]
        above = corners[:, :, 2] > height_mm
        # Rotate each facet's corners so that the one alone on its side of the plane comes first.
        alone = np.where(above.sum(axis=1) == 1, above.argmax(axis=1), (~above).argmax(axis=1))
        turned = np.take_along_axis(corners, ((alone[:, None] + np.arange(3)) % 3)[:, :, None], axis=1)
        t = (height_mm - turned[:, :1, 2]) / (turned[:, 1:, 2] - turned[:, :1, 2])
        ends = turned[:, :1, :2] + t[:, :, None] * (turned[:, 1:, :2] - turned[:, :1, :2])
        odd_above = turned[:, 0, 2] > height_mm
        start = np.where(odd_above[:, None], ends[:, 0], ends[:, 1])
        stop = np.where(odd_above[:, None], ends[:, 1], ends[:, 0])
        return np.concatenate([start, stop], axis=1)

    def edge_flaw(self, x_mm: float, y_mm: float, height_mm: float, reach_mm: float) -> str:
        """Cause of the flawed edge nearest to a place on a layer, within reach; empty if there is none."""
        best, cause = reach_mm, ""
        for name, ends in self._flawed.items():
            if not len(ends):
                continue
            low, high = ends[:, :, 2].min(axis=1), ends[:, :, 2].max(axis=1)
            a, b = (ends[(low <= height_mm + reach_mm) & (high >= height_mm - reach_mm)]).swapaxes(0, 1)
            if not len(a):
                continue
            u, p = b - a, np.array([x_mm, y_mm, height_mm]) - a
            square = np.einsum("ij,ij->i", u, u)
            t = np.clip(np.einsum("ij,ij->i", p, u) / np.where(square > 0.0, square, 1.0), 0.0, 1.0)
            nearest = float(np.linalg.norm(p - t[:, None] * u, axis=1).min())
            if nearest <= best:
                best, cause = nearest, name
        return cause

    def winding_flaw(self, x_mm: float, y_mm: float, height_mm: float, reach_mm: float) -> str:
        """``overlapping shells`` or ``inconsistent orientation``, by the winding numbers around a place."""
        segments = self.section(height_mm)
        if not len(segments):
            return ""
        angle = 2.0 * np.pi * (np.arange(PROBES) + 0.5) / PROBES
        xs = np.append(x_mm + 0.5 * reach_mm * np.cos(angle), x_mm)[:, None]
        ys = np.append(y_mm + 0.5 * reach_mm * np.sin(angle), y_mm)[:, None]
        x0, y0, x1, y1 = segments.T
        spans = (y0 > ys) != (y1 > ys)
        rise = np.where(y1 == y0, 1.0, y1 - y0)
        right = spans & (x0 + (ys - y0) * (x1 - x0) / rise > xs)
        numbers = np.where(right, np.where(y1 > y0, 1, -1), 0).sum(axis=1)
        if (numbers < 0).any():
            return ORIENTATION
        return OVERLAP if (numbers > 1).any() else ""

    @cached_property
    def _body(self) -> Ints:
        """Body of each facet, (F,)."""
        labels = body_labels(self.part.faces, edge_groups(self.part.faces, len(self.part.vertices)))
        return labels.astype(np.int64)

    @cached_property
    def bodies(self) -> int:
        """Number of bodies, which share no edge."""
        return int(self._body.max(initial=-1)) + 1

    @cached_property
    def is_open(self) -> bool:
        """Whether the part has an edge with only one facet."""
        return bool(self._edges[1][OPEN_EDGE].any())

    def around(self, x_mm: float, y_mm: float, height_mm: float, reach_mm: float) -> Surroundings:
        """Return the mesh's section around a place on a layer."""
        facets = self.crossing(height_mm)
        segments = self.section(height_mm)
        return surroundings(segments, self._body[facets], self.part.triangles[facets], x_mm, y_mm, reach_mm)

    def place(self, height_mm: float) -> tuple[float, float]:
        """Point of the part's surface on a layer: the middle of the first segment of its section."""
        segments = self.section(height_mm)
        if not len(segments):
            return (np.nan, np.nan)
        x, y = 0.5 * (segments[0, :2] + segments[0, 2:])
        return float(x), float(y)


class Place(NamedTuple):
    """Where a disagreement is, and how large."""

    x_mm: float
    y_mm: float
    height_mm: float
    depth_mm: float
    limit_mm: float
    layer_class: str
    open_paths: bool

    @property
    def known(self) -> bool:
        """Whether the disagreement has a place in the layer."""
        return bool(np.isfinite(self.x_mm) and np.isfinite(self.y_mm))

    @property
    def reach_mm(self) -> float:
        """Distance within which a flaw of the mesh explains the disagreement."""
        return NEAR_DEPTHS * (self.depth_mm + self.limit_mm) if np.isfinite(self.depth_mm) else self.limit_mm


def likely_cause(
    flaws: MeshFlaws,
    place: Place,
    declared: Sequence[Mapping[str, Any]] = (),
    contours: Callable[[], Sequence[Floats]] = tuple,
) -> str:
    """Name the likeliest cause of a disagreement at a place.

    In this order: the layer's class, what the slicers themselves declare, flaws of the mesh at the place, open paths and
    surfaces, and the part's shape: a nearly level face, or a wall or gap only a few limits wide.

    `declared` has the settings of the layers of both slicers, with their ``doubtful_regions`` (see
    :meth:`ebamcheck.backend.Prepared.slice`) and ``unbalanced_pixels``; `contours` returns the segments (n, 4) mm of both slicers
    on the layer, with the solid on their left, and is called only if the mesh shows no cause.
    """
    if place.layer_class == "face-on-plane":
        return COPLANAR_FACE
    if place.layer_class == "vertex-on-plane":
        return VERTEX
    around = None
    if place.known:
        around = flaws.around(place.x_mm, place.y_mm, place.height_mm, place.reach_mm)
        at_place = (
            declared_doubt(place, declared)
            or flaws.edge_flaw(place.x_mm, place.y_mm, place.height_mm, place.reach_mm)
            or _shell_flaw(flaws, place, around)
        )
        if at_place:
            return at_place
    if place.open_paths:
        return OPEN_PATH
    if flaws.is_open and any(settings.get("unbalanced_pixels", 0) for settings in declared):
        return OPEN_SURFACE
    return _shape(flaws, place, around, contours()) if around is not None else UNKNOWN_CAUSE


def declared_doubt(place: Place, declared: Sequence[Mapping[str, Any]]) -> str:
    """Why one of the slicers declares a place within a limit of this one doubtful; empty if none does."""
    at = np.array([place.x_mm, place.y_mm, place.height_mm])
    for settings in declared:
        for region in settings.get("doubtful_regions", ()):
            low, high = np.asarray(region["box_mm"], dtype=np.float64).reshape(2, 3)
            if ((low - place.limit_mm <= at) & (at <= high + place.limit_mm)).all():
                return str(region["why"])
    return ""


def _shell_flaw(flaws: MeshFlaws, place: Place, around: Surroundings) -> str:
    """Cause in the shells around the place: they cross or touch, or a winding number is other than 0 or 1."""
    first, second = around.crossing()
    if first.size:
        same = around.body[first] == around.body[second]
        return SELF_INTERSECTION if same.any() else OVERLAP
    flaw = flaws.winding_flaw(place.x_mm, place.y_mm, place.height_mm, place.reach_mm)
    if flaw:
        return flaw
    touching = around.touching_bodies(TOUCHING_SHARE * float(flaws.part.size.max(initial=0.0)))
    return TOUCHING if touching else ""


def _shape(flaws: MeshFlaws, place: Place, around: Surroundings, contours: Sequence[Floats]) -> str:
    """Cause in the part's shape at the place: it magnifies small errors, or is missed between samples."""
    height_error_mm = ROUNDING_SHARE * float(flaws.part.size.max(initial=0.0))
    if around.travel_per_mm() * height_error_mm >= 0.5 * place.depth_mm > 0.0:
        return SHALLOW
    thin_mm = 2.0 * THIN_LIMITS * place.limit_mm
    for width_mm, is_wall in (around.width(), *(_width(place, segments) for segments in contours)):
        if width_mm <= thin_mm:
            return THIN if is_wall else THIN_GAP
    return UNKNOWN_CAUSE


def _width(place: Place, segments: Floats) -> tuple[float, bool]:
    """Width of the wall or gap at the place by the contours of a slicer, (n, 4) mm, and whether it is a wall."""
    none = np.zeros(len(segments), np.int64)
    flat = np.zeros((len(segments), 3, 3))
    return surroundings(segments, none, flat, place.x_mm, place.y_mm, place.reach_mm).width()


MOST_SEGMENTS = 400  # most segments examined, the nearest ones: all pairs of them are compared
# Largest cosine between the directions of the two sides of a wall or gap: opposite to within about 45 degrees
FACING_COS = -0.7
AS_NEAR = 1.0 + 1e-6  # factor of the least distance within which segments count as equally near
MOST_SIDES = 8  # most equally near segments examined; they meet in one point
ROUNDING_SHARE = 2.0**-22  # largest height error by single precision, over the part's size (four roundings)


@dataclass(frozen=True, eq=False)
class Surroundings:
    """Segments near a place, the nearest first."""

    place: Floats
    """(2,) mm."""
    segments: Floats
    """(n, 4) ``x0, y0, x1, y1`` with the solid on their left."""
    body: Ints
    """(n,) body of each segment's facet."""
    normals: Floats
    """(n, 3) unit normal of each segment's facet."""
    distance: Floats
    """(n,) distance of each segment from the place, mm, ascending."""

    def crossing(self) -> tuple[Ints, Ints]:
        """Pairs of segments that cross in the interior of both."""
        p, q = self.segments[:, :2], self.segments[:, 2:]
        side_p = _sides(p, q, p)
        side_q = _sides(p, q, q)
        apart = side_p * side_q < 0.0
        return tuple(np.nonzero(np.triu(apart & apart.T, 1)))  # type: ignore[return-value]

    def touching_bodies(self, within_mm: float) -> bool:
        """Whether an end of a segment lies on a segment of another body."""
        other = self.body[:, None] != self.body[None, :]
        starts = self.segments[:, None, :2]
        gaps = np.linalg.norm(_nearest_points(self.segments, starts) - starts, axis=2)
        return bool((other & (gaps <= within_mm)).any())

    def width(self) -> tuple[float, bool]:
        """Distance between the sides of the wall or gap at the place, mm, and whether it is a wall.

        One side is the nearest segment, the other the nearest one that faces it. Of several equally near segments, as at
        the mouth of a slit, it is the one whose other side is nearest. Infinite if there is no other side.
        """
        if not len(self.segments):
            return np.inf, False
        along = self.segments[:, 2:] - self.segments[:, :2]
        along = along / np.maximum(np.linalg.norm(along, axis=1), np.finfo(np.float64).tiny)[:, None]
        as_near = np.flatnonzero(self.distance <= AS_NEAR * self.distance[0])[:MOST_SIDES]
        return min((self._across(along, int(k)) for k in as_near), key=lambda found: found[0])

    def _across(self, along: Floats, side: int) -> tuple[float, bool]:
        """Distance from one side to the nearest segment that faces it, and whether solid lies between."""
        facing = along @ along[side] < FACING_COS
        if not facing.any():
            return np.inf, False
        k = int(np.argmax(facing))
        foot = _nearest_points(self.segments[side : side + 1], self.place)[0]
        away = _nearest_points(self.segments[k : k + 1], foot)[0] - foot
        left = np.array([-along[side, 1], along[side, 0]])
        return float(np.linalg.norm(away)), bool(left @ away > 0.0)

    def travel_per_mm(self) -> float:
        """Movement of the contour at the place per mm of height: 0 at a vertical wall."""
        if not len(self.normals):
            return 0.0
        x, y, z = self.normals[0]
        return float(abs(z) / max(np.hypot(x, y), np.finfo(np.float64).tiny))


def surroundings(
    segments: Floats, body: Ints, corners: Floats, x_mm: float, y_mm: float, reach_mm: float
) -> Surroundings:
    """Select the segments (n, 4) within reach of a place; `corners` (n, 3, 3) are their facets'."""
    place = np.array([x_mm, y_mm])
    distance = np.linalg.norm(_nearest_points(segments, place) - place, axis=1)
    order = np.argsort(distance, kind="stable")[:MOST_SEGMENTS]
    near = order[distance[order] <= reach_mm]
    a, b, c = np.moveaxis(corners[near], 1, 0)
    normals = np.cross(b - a, c - a)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = normals / np.where(length > 0.0, length, 1.0)
    return Surroundings(place, segments[near], body[near], normals, distance[near])


def _nearest_points(segments: Floats, places: Floats) -> Floats:
    """Point of each segment (n, 4) that is nearest to each place, (..., n, 2) for places (..., 1, 2)."""
    a, u = segments[:, :2], segments[:, 2:] - segments[:, :2]
    square = (u * u).sum(axis=-1)
    t = np.clip(((places - a) * u).sum(axis=-1) / np.where(square > 0.0, square, 1.0), 0.0, 1.0)
    return np.asarray(a + t[..., None] * u)


def _sides(p: Floats, q: Floats, at: Floats) -> Floats:
    """Side (n, n) of the line through each segment p-q (rows) on which each point lies (columns)."""
    u = (q - p)[:, None]
    v = at[None] - p[:, None]
    sides: Floats = u[:, :, 0] * v[:, :, 1] - u[:, :, 1] * v[:, :, 0]
    return sides

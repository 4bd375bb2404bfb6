"""Likely cause of a disagreement at its place, from the mesh, the layers, and the declarations of the slicers.

A cause is something at the place that is known to make slicers disagree; it is no proof.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from ebamcheck.comparison.outline import windings
from ebamcheck.kernels import Floats, Ints
from ebamcheck.mesh.part import Part
from ebamcheck.mesh.topology import EdgeGroups, body_labels, direction_balance, edge_groups

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
ROUNDING_SHARE = 2.0**-22  # largest height error by single precision, over the part's size (four roundings)
PROBES = 16  # points on a circle around the place at which the winding number is computed
MOST_SEGMENTS = 400  # most segments examined, the nearest ones: all pairs of them are compared
# Largest cosine between the directions of the two sides of a wall or gap: opposite to within about 45 degrees
FACING_COS = -0.7
AS_NEAR = 1.0 + 1e-6  # factor of the least distance within which segments count as equally near
MOST_SIDES = 8  # most equally near segments examined; they meet in one point
TINY = float(np.finfo(np.float64).tiny)


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


class MeshFlaws:
    """Edges of a part that are open, non-manifold or inconsistently oriented, and its facets by height."""

    def __init__(self, part: Part) -> None:
        self.part = part
        self.size_mm = float(part.size.max(initial=0.0))

    @cached_property
    def _groups(self) -> EdgeGroups:
        return edge_groups(self.part.faces, len(self.part.vertices))

    @cached_property
    def _flawed(self) -> dict[str, Floats]:
        """End points of the flawed edges, (n, 2, 3) mm, by cause."""
        faces, uses = self.part.faces, np.diff(self._groups.starts)
        facet, corner = np.divmod(self._groups.half_edges[self._groups.starts[:-1]], 3)
        ends = np.stack([faces[facet, corner], faces[facet, (corner + 1) % 3]], axis=1)
        turned = (uses == 2) & (direction_balance(faces, self._groups) != 0)
        flaws = {OPEN_EDGE: uses == 1, NON_MANIFOLD: uses > 2, ORIENTATION: turned}
        return {cause: self.part.vertices[ends[which]] for cause, which in flaws.items()}

    @cached_property
    def _by_height(self) -> tuple[Ints, Floats, Floats, float]:
        """Facets sorted by lowest z, their lowest and highest z, and the height of the tallest facet."""
        z = self.part.vertices[:, 2][self.part.faces]
        low, high = z.min(axis=1), z.max(axis=1)
        order = np.argsort(low, kind="stable")
        return order, low[order], high[order], float((high - low).max(initial=0.0))

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
        ends = np.where((turned[:, 0, 2] > height_mm)[:, None, None], ends, ends[:, ::-1])
        return np.asarray(ends.reshape(-1, 4))

    def edge_flaw(self, x_mm: float, y_mm: float, height_mm: float, reach_mm: float) -> str:
        """Cause of the flawed edge nearest to a place on a layer, within reach; empty if there is none."""
        best, cause = reach_mm, ""
        for name, ends in self._flawed.items():
            low, high = ends[:, :, 2].min(axis=1), ends[:, :, 2].max(axis=1)
            a, b = (ends[(low <= height_mm + reach_mm) & (high >= height_mm - reach_mm)]).swapaxes(0, 1)
            u, p = b - a, np.array([x_mm, y_mm, height_mm]) - a
            square = np.einsum("ij,ij->i", u, u)
            t = np.clip(np.einsum("ij,ij->i", p, u) / np.where(square > 0.0, square, 1.0), 0.0, 1.0)
            nearest = float(np.linalg.norm(p - t[:, None] * u, axis=1).min(initial=np.inf))
            if nearest <= best:
                best, cause = nearest, name
        return cause

    def winding_flaw(self, x_mm: float, y_mm: float, height_mm: float, reach_mm: float) -> str:
        """``overlapping shells`` or ``inconsistent orientation``, by the winding numbers around a place."""
        angle = 2.0 * np.pi * (np.arange(PROBES) + 0.5) / PROBES
        around = np.array([x_mm, y_mm]) + 0.5 * reach_mm * np.column_stack([np.cos(angle), np.sin(angle)])
        # In a mirror, so that it counts the crossings to the right: an open section has other numbers on either side.
        mirror = np.array([-1.0, 1.0, -1.0, 1.0])
        numbers = -windings(self.section(height_mm) * mirror, np.vstack([around, (x_mm, y_mm)]) * mirror[:2])
        if (numbers < 0).any():
            return ORIENTATION
        return OVERLAP if (numbers > 1).any() else ""

    @cached_property
    def _body(self) -> Ints:
        """Body of each facet, (F,)."""
        return body_labels(self.part.faces, self._groups).astype(np.int64)

    @cached_property
    def bodies(self) -> int:
        """Number of bodies, which share no edge."""
        return int(self._body.max(initial=-1)) + 1

    @property
    def is_open(self) -> bool:
        """Whether the part has an edge with only one facet."""
        return len(self._flawed[OPEN_EDGE]) > 0

    def around(self, place: Place) -> Surroundings:
        """Return the mesh's section around a place on a layer."""
        facets = self.crossing(place.height_mm)
        corners = self.part.triangles[facets]
        return Surroundings.of(place, self.section(place.height_mm), self._body[facets], corners)

    def place(self, height_mm: float) -> tuple[float, float]:
        """Point of the part's surface on a layer: the middle of the first segment of its section."""
        segments = self.section(height_mm)
        if not len(segments):
            return (np.nan, np.nan)
        x, y = 0.5 * (segments[0, :2] + segments[0, 2:])
        return float(x), float(y)


def likely_cause(
    flaws: MeshFlaws,
    place: Place,
    declared: Sequence[Mapping[str, Any]] = (),
    contours: Callable[[], Sequence[Floats]] = tuple,
) -> str:
    """Name the likeliest cause of a disagreement at a place.

    In this order: the layer's class, the declarations of the slicers, flaws of the mesh at the place, open paths and surfaces, and
    the part's shape: a nearly level face, or a wall or gap only a few limits wide.

    `declared` has the settings of the layers of both slicers, with their ``doubtful_regions`` (see
    :meth:`ebamcheck.backend.Prepared.slice`) and ``unbalanced_pixels``; `contours` returns the segments (n, 4) mm of both slicers
    on the layer, with the solid on their left, and is called only if the mesh shows no cause.
    """
    if place.layer_class == "face-on-plane":
        return COPLANAR_FACE
    if place.layer_class == "vertex-on-plane":
        return VERTEX
    around = flaws.around(place) if place.known else None
    if around is not None:
        at = place.x_mm, place.y_mm, place.height_mm, place.reach_mm
        if cause := declared_doubt(place, declared) or flaws.edge_flaw(*at):
            return cause
        first, second = around.crossing()
        if first.size:
            return SELF_INTERSECTION if (around.body[first] == around.body[second]).any() else OVERLAP
        if cause := flaws.winding_flaw(*at):
            return cause
        if around.touching_bodies(TOUCHING_SHARE * flaws.size_mm):
            return TOUCHING
    if place.open_paths:
        return OPEN_PATH
    if flaws.is_open and any(settings.get("unbalanced_pixels", 0) for settings in declared):
        return OPEN_SURFACE
    if around is None:
        return UNKNOWN_CAUSE
    if around.travel_per_mm() * ROUNDING_SHARE * flaws.size_mm >= 0.5 * place.depth_mm > 0.0:
        return SHALLOW
    for near in (around, *(Surroundings.of(place, segments) for segments in contours())):
        width_mm, is_wall = near.width()
        if width_mm <= 2.0 * THIN_LIMITS * place.limit_mm:
            return THIN if is_wall else THIN_GAP
    return UNKNOWN_CAUSE


def declared_doubt(place: Place, declared: Sequence[Mapping[str, Any]]) -> str:
    """Why one of the slicers declares a place within a limit of this one doubtful; empty if none does."""
    at = np.array([place.x_mm, place.y_mm, place.height_mm])
    for settings in declared:
        for region in settings.get("doubtful_regions", ()):
            low, high = np.asarray(region["box_mm"], dtype=np.float64).reshape(2, 3)
            if ((low - place.limit_mm <= at) & (at <= high + place.limit_mm)).all():
                return str(region["why"])
    return ""


@dataclass(frozen=True, eq=False)
class Surroundings:
    """Segments near a place, the nearest first."""

    place: Floats  # (2,) mm
    segments: Floats  # (n, 4) x0, y0, x1, y1 with the solid on their left
    body: Ints  # (n,) body of each segment's facet; empty of a slicer's contours
    normals: Floats  # (n, 3) unit normal of each segment's facet; likewise
    distance: Floats  # (n,) distance of each segment from the place, mm, ascending

    @classmethod
    def of(
        cls, place: Place, segments: Floats, body: Ints | None = None, corners: Floats | None = None
    ) -> Surroundings:
        """Select the segments (n, 4) within reach of a place; those of a mesh have a `body` and `corners` (n, 3, 3) of facets."""
        at = np.array([place.x_mm, place.y_mm])
        distance = np.linalg.norm(_nearest_points(segments, at) - at, axis=1)
        order = np.argsort(distance, kind="stable")[:MOST_SEGMENTS]
        near = order[distance[order] <= place.reach_mm]
        if body is None or corners is None:
            return cls(at, segments[near], np.zeros(0, np.int64), np.zeros((0, 3)), distance[near])
        a, b, c = np.moveaxis(corners[near], 1, 0)
        normals = np.cross(b - a, c - a)
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        normals = normals / np.where(length > 0.0, length, 1.0)
        return cls(at, segments[near], body[near], normals, distance[near])

    def crossing(self) -> tuple[Ints, Ints]:
        """Pairs of segments that cross in the interior of both."""
        p, q = self.segments[:, :2], self.segments[:, 2:]
        (ux, uy), sides = (q - p).T[:, :, None], []
        for end in (p, q):  # on which side of the line through each segment (rows) each end lies (columns)
            vx, vy = np.moveaxis(end[None] - p[:, None], 2, 0)
            sides.append(ux * vy - uy * vx)
        apart = sides[0] * sides[1] < 0.0
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
        along = along / np.maximum(np.linalg.norm(along, axis=1), TINY)[:, None]
        as_near = np.flatnonzero(self.distance <= AS_NEAR * self.distance[0])[:MOST_SIDES]
        widths = []
        for side in as_near.tolist():
            facing = np.flatnonzero(along @ along[side] < FACING_COS)[:1]
            if not facing.size:
                widths.append((np.inf, False))
                continue
            foot = _nearest_points(self.segments[side : side + 1], self.place)[0]
            away = _nearest_points(self.segments[facing], foot)[0] - foot
            left = np.array([-along[side, 1], along[side, 0]])
            widths.append((float(np.linalg.norm(away)), bool(left @ away > 0.0)))
        return min(widths, key=lambda width: width[0])

    def travel_per_mm(self) -> float:
        """Movement of the contour at the place per mm of height: 0 at a vertical wall."""
        if not len(self.normals):
            return 0.0
        x, y, z = self.normals[0]
        return float(abs(z) / max(np.hypot(x, y), TINY))


def _nearest_points(segments: Floats, places: Floats) -> Floats:
    """Point of each segment (n, 4) that is nearest to each place, (..., n, 2) for places (..., 1, 2)."""
    a, u = segments[:, :2], segments[:, 2:] - segments[:, :2]
    square = (u * u).sum(axis=-1)
    t = np.clip(((places - a) * u).sum(axis=-1) / np.where(square > 0.0, square, 1.0), 0.0, 1.0)
    return np.asarray(a + t[..., None] * u)

"""The gate of the fit: which rings of curves are accepted, and the contour's polyline in place of any other.

A ring is accepted if it crosses neither itself nor another, runs in the direction of its contour, lies inside the same ring as
that, and leaves it by no more than a surface plausibly stands over the facets there
(:class:`~ebamcheck.curves.lifting.Limits`): not at all inside of planes.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ebamcheck.columns_file import starts_of
from ebamcheck.curves.bezier import BezierSpans
from ebamcheck.curves.columns import Curves, Evidence, of_layers, sampled_along, with_rings
from ebamcheck.curves.crossings import crossings
from ebamcheck.curves.deviation import deviation_of
from ebamcheck.curves.lifting import Limits
from ebamcheck.curves.runs import LINE, around, clean
from ebamcheck.geometry import rings
from ebamcheck.geometry.raster import each_of
from ebamcheck.kernels import Bools, Floats, Ints
from ebamcheck.layers.stack import Layers
from ebamcheck.mesh.bodies import volumes_between
from ebamcheck.mesh.part import Part

CAUSES = ("", "sagitta", "plane", "crossing", "turned", "nesting")
"""Names of the causes for which a ring is not accepted, by number; "" for an accepted one."""

ACCEPTED, SAGITTA, PLANE, CROSSING, TURNED, NESTING = range(len(CAUSES))

METHODS = ("", "polyline")  # The requested method, and that to which a ring falls back
POLYLINE = 1


class Slack(NamedTuple):
    """Tolerances that are added to the limits of a fit, mm."""

    anywhere: float  # Of the fit and of the cleaning
    in_planes: float  # Of the cleaning and of the file's rounding


def gated(curves: Curves, layers: Layers, limits: Limits, slack: Slack) -> Curves:
    """Curves with their evidence; those rings that are not accepted are the polylines of their contours."""
    asked = found = evidence(curves, layers, limits, slack)
    fallen = np.zeros(curves.closed.size, np.uint8)
    for _ in range(6):  # a ring falls once, but its neighbours may have to follow it
        falling = ~found.accepted & (fallen == 0)
        if not falling.any():
            break
        for name in ("cause", "value_mm", "limit_mm", "at"):  # of what was asked for, or of what followed it
            getattr(asked, name)[falling] = getattr(found, name)[falling]
        curves = with_rings(curves, polylines(_rings_of(layers, falling)), falling)
        fallen[falling] = POLYLINE
        found = evidence(curves, layers, limits, slack)
    # A polyline is the contour itself: what is still wrong with it was wrong with the contour, not with the fit.
    asked = replace(asked, points_mm=found.points_mm, bulge_mm=found.bulge_mm)
    accepted = found.accepted | ((fallen == POLYLINE) & (found.cause != CROSSING))
    if not accepted.all():
        accepted |= ~evidence(polylines(layers), layers, limits, slack).accepted
    return replace(curves, evidence=replace(asked, method=fallen, accepted=accepted))


def evidence(curves: Curves, layers: Layers, limits: Limits, slack: Slack) -> Evidence:
    """Judge each ring of curves against its contour."""
    spans = curves.bezier_spans()
    found = _farthest(curves, layers, limits, slack, spans)
    cause = found.cause
    crossed = crossings(curves, spans)
    fresh = crossed.crossed & (cause == ACCEPTED)
    cause[fresh] = CROSSING
    found.at[fresh] = crossed.at[fresh]
    cause[(np.sign(_ring_areas(curves, spans)) != np.sign(layers.ring_areas)) & (cause == ACCEPTED)] = TURNED
    cause[_moved_out(curves, layers, spans) & (cause == ACCEPTED)] = NESTING
    return replace(found, accepted=cause == ACCEPTED)


def _farthest(curves: Curves, layers: Layers, limits: Limits, slack: Slack, spans: BezierSpans) -> Evidence:
    """Where each ring is farthest beyond its limit: places of the curve first, then points of the contour."""
    count = curves.closed.size
    off = deviation_of(curves, layers, spans)
    following = around(layers.ring_starts)[1]
    k = off.segment
    inside = limits.plane[k] & (off.share > 0.0) & (off.share < 1.0)
    room = np.maximum(limits.of_point[k], limits.of_point[following[k]])
    found = Evidence(
        cause=np.zeros(count, np.uint8),
        method=np.zeros(count, np.uint8),
        accepted=np.ones(count, np.bool_),
        value_mm=np.zeros(count),
        limit_mm=np.full(count, slack.anywhere),
        at=np.full((count, 2), np.nan),
        mean_limit_mm=slack.anywhere + _mean_along(layers, limits, following),
        points_mm=np.zeros(count),
        bulge_mm=np.zeros(count),
    )
    measured = np.diff(off.starts) > 0
    worst = np.full(count, -np.inf)
    limit = np.where(inside, slack.in_planes, room + slack.anywhere)
    of_places = off.starts, off.of_place, limit, off.places, limits.plane[k], found.bulge_mm
    limit, free = limits.of_point + slack.anywhere, np.zeros(len(layers.points), np.bool_)
    of_points = layers.ring_starts, off.of_point, limit, layers.points, free, found.points_mm
    for starts, value, limit, places, plane, largest in (of_places, of_points):
        rows = np.flatnonzero(np.diff(starts))
        if not rows.size:
            continue
        largest[rows] = np.maximum.reduceat(value, starts[rows])
        excess = np.maximum.reduceat(value - limit, starts[rows])
        at = np.flatnonzero(value - limit == np.repeat(excess, np.diff(starts)[rows]))
        at = at[np.searchsorted(at, starts[rows])]  # the first place of each ring
        beyond = measured[rows] & (excess > worst[rows])
        at, rows = at[beyond], rows[beyond]
        worst[rows] = excess[beyond]
        found.value_mm[rows], found.limit_mm[rows], found.at[rows] = value[at], limit[at], places[at]
        found.cause[rows] = np.where(value[at] > limit[at], np.where(plane[at], PLANE, SAGITTA), ACCEPTED)
    return found


def _mean_along(layers: Layers, limits: Limits, following: Ints) -> Floats:
    """A quarter of the mean limit along each ring, (R,) mm: single places may be off by more than a whole ring."""
    ring = np.repeat(np.arange(layers.closed.size), np.diff(layers.ring_starts))
    long = np.hypot(*(layers.points[following] - layers.points).T)
    middle = np.where(limits.plane, 0.0, 0.5 * (limits.of_point + limits.of_point[following])) * 0.25
    total, weighed = (np.bincount(ring, w, minlength=layers.closed.size) for w in (long, long * middle))
    return np.asarray(weighed / np.where(total > 0.0, total, 1.0))


def _ring_areas(curves: Curves, spans: BezierSpans) -> Floats:
    """Exact signed area of each closed ring, (R,) mm2; 0 for open paths. Arcs are cubics within 1e-9 of them."""
    area = np.zeros(len(spans))
    for i, j, share in ((0, 1, 6.0), (0, 2, 3.0), (0, 3, 1.0), (1, 2, 3.0), (1, 3, 3.0), (2, 3, 6.0)):
        p, q = spans.points[:, i], spans.points[:, j]
        area += share * (p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0])
    total = np.bincount(spans.ring, area / 20.0, minlength=curves.closed.size)
    return np.where(curves.closed, total, 0.0)


def _moved_out(curves: Curves, layers: Layers, spans: BezierSpans) -> Bools:
    """Rings (R,) whose enclosing ring is not that of their contour."""
    several = np.repeat(np.diff(layers.layer_starts) > 1, np.diff(layers.layer_starts))
    if not several.any():
        return np.zeros(curves.closed.size, np.bool_)
    # A coarse polyline is enough: one point of a ring tells, as nesting matters only if none cross.
    sampled = sampled_along(spans, curves.closed, math.inf, 0.01)
    areas = rings.signed_areas(sampled.points, sampled.ring_starts, curves.closed)
    boxes = rings.bounds(sampled.points, sampled.ring_starts)
    parents = rings.parents(sampled.points, sampled.ring_starts, layers.layer_starts, areas, boxes)
    return np.asarray(several & (parents != layers.parents))


def polylines(layers: Layers) -> Curves:
    """Contours as curves, without points that repeat or lie on the line between their neighbours."""
    points = np.ascontiguousarray(layers.points)
    cleaned = clean(points, layers.ring_starts, layers.closed, 0.0, 0.0)
    sizes = np.diff(cleaned.starts)
    filled = sizes > 0
    more = sizes + (layers.closed & filled)
    ring, place = each_of(more)
    control = points[cleaned.rows[cleaned.starts[ring] + place % sizes[ring]]]
    kind = np.full(np.count_nonzero(filled), LINE, np.uint8)
    no_knots = np.zeros(kind.size + 1, np.int64), np.zeros(0)
    return of_layers(layers, starts_of(filled), kind, (starts_of(more[filled]), control), no_knots)


def _rings_of(layers: Layers, which: Bools) -> Layers:
    """The layers with only some of their rings, without edges."""
    sizes = np.diff(layers.ring_starts)
    return replace(
        layers,
        points=layers.points[np.repeat(which, sizes)],
        ring_starts=starts_of(sizes[which]),
        layer_starts=starts_of(np.bincount(layers.ring_layer[which], minlength=len(layers))),
        closed=layers.closed[which],
        edge=None,
        edge_t=None,
    )


# -- a whole stack of curves: layers against their neighbours, and against the mesh between them ----------------
#
# The mean lift of a layer is the area that its curves enclose beyond its contours, over their length. It may
# differ between two layers by no more than the mesh allows there: a layer that stands out was lifted the
# wrong way. The volume between two layers is known exactly from the mesh. The volume by the areas of the
# curves must agree with it, up to the error that the areas of the contours themselves make, and up to how far
# curves may lie outside or inside their contours.


class StackEvidence(NamedTuple):
    """How layers agree with each other and with the mesh."""

    lift_mm: Floats  # (L,) mean lift of each layer; 0 without contours
    allowed_mm: Floats  # (L,) mean limit along the contours, by the mesh and the tolerance
    # (L,) differences less the allowed ones: of the lift from that of the layer below, and of the volumes above that layer by the
    # curves and of the mesh.
    jump_excess_mm: Floats
    volume_excess_mm3: Floats

    @property
    def accepted(self) -> bool:
        """Whether no layer stands out."""
        return bool((self.jump_excess_mm <= 0.0).all() and (self.volume_excess_mm3 <= 0.0).all())


def stack_evidence(curves: Curves, layers: Layers, part: Part, found: Evidence) -> StackEvidence:
    """Compare the layers of curves, from below, and the volume between them with that of the mesh."""
    count = len(layers)
    of_ring = curves.ring_layer
    length = np.bincount(of_ring, layers.ring_lengths, minlength=count)
    weight = np.where(length > 0.0, length, 1.0)
    more = _ring_areas(curves, curves.bezier_spans()) - layers.ring_areas
    gain = np.bincount(of_ring, more, minlength=count)
    may = np.bincount(of_ring, found.mean_limit_mm * layers.ring_lengths, minlength=count) / weight
    lift = gain / weight
    jumps, volumes = np.zeros(count), np.zeros(count)
    if count > 1 and (np.diff(layers.heights) > 0.0).all():
        jumps[1:] = np.abs(np.diff(lift)) - (may[1:] + may[:-1])
        step = np.diff(layers.heights)
        mesh = volumes_between(part, layers.heights)
        areas = layers.areas()
        plain = 0.5 * step * (areas[1:] + areas[:-1])
        curved = plain + 0.5 * step * (gain[1:] + gain[:-1])
        allowed = np.abs(mesh - plain) + 0.5 * step * (may[1:] * length[1:] + may[:-1] * length[:-1])
        volumes[1:] = np.abs(mesh - curved) - allowed - 1e-9 * np.abs(mesh)
    return StackEvidence(lift, may, jumps, volumes)

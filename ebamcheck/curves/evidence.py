"""Evidence that curves may leave their contours as they do, ring by ring.

A ring is accepted if all of these hold. Curve and contour are nowhere farther apart than the mesh allows there plus the
tolerance of the fit. On planar facets they are no farther apart than the rounding of the file plus the cleaning. The curve
crosses neither itself nor another. It runs in the direction of its contour and lies inside the same ring.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ebamcheck.curves.allowances import Allowances
from ebamcheck.curves.bezier import evaluate_bezier
from ebamcheck.curves.columns import EVIDENCE_COLUMNS, Curves, Evidence
from ebamcheck.curves.crossings import crossings
from ebamcheck.geometry.nearest import nearest, segments_along, tree_over
from ebamcheck.layers.stack import Layers
from ebamcheck.mesh.bodies import volumes_between
from ebamcheck.mesh.part import Part
from ebamcheck.numeric import rings
from ebamcheck.numeric.kernels import kernel, run_blocks
from ebamcheck.numeric.rings import Bools, Floats, Ints

CAUSES = ("", "sagitta", "plane", "crossing", "turned", "nesting")
"""Names of the causes for which a ring is not accepted, by number; "" for an accepted one."""

ACCEPTED, SAGITTA, PLANE, CROSSING, TURNED, NESTING = range(len(CAUSES))

CHORDS_A_SPAN = 4
"""Chords of a span at whose ends its distance from the contour is taken: enough for a cubic."""

NESTING_MM = 0.01
"""Chord error of the polylines by which nesting is found: one point of a ring tells, as nesting matters only if none cross."""

RINGS_A_BLOCK = 16


def joined(blocks: Sequence[Evidence]) -> Evidence:
    """Evidence of consecutive blocks of one stack."""
    columns: dict[str, Any] = {n: np.concatenate([getattr(b, n) for b in blocks]) for n in EVIDENCE_COLUMNS}
    return replace(blocks[0], **columns)


def evidence(
    curves: Curves, layers: Layers, allowed: Allowances, slack_mm: float, plane_slack_mm: float
) -> Evidence:
    """Judge each ring of curves.

    Parameters
    ----------
    curves, layers
        Curves and the contours that they were fitted to.
    allowed
        How far the curves may leave each place of the contours.
    slack_mm
        Added to that: the tolerances of the fit and of the cleaning.
    plane_slack_mm
        Added in planes of the part, in place of `slack_mm`.
    """
    found = _distances(curves, layers, allowed, slack_mm, plane_slack_mm)
    cause = found.cause
    crossed = crossings(curves)
    fresh = crossed.crossed & (cause == ACCEPTED)
    cause[fresh] = CROSSING
    found.at[fresh] = crossed.at[fresh]
    cause[(np.sign(ring_areas(curves)) != np.sign(layers.ring_areas)) & (cause == ACCEPTED)] = TURNED
    cause[_moved_out(curves, layers) & (cause == ACCEPTED)] = NESTING
    return replace(found, accepted=cause == ACCEPTED)


def ring_areas(curves: Curves) -> Floats:
    """Exact signed area of each closed ring, (R,) mm2; 0 for open paths. Arcs are cubics within 1e-9 of them."""
    spans = curves.bezier_spans()
    P = spans.points

    def cross(i: int, j: int) -> Floats:
        return np.asarray(P[:, i, 0] * P[:, j, 1] - P[:, i, 1] * P[:, j, 0])

    area = (
        6.0 * cross(0, 1)
        + 3.0 * cross(0, 2)
        + cross(0, 3)
        + 3.0 * cross(1, 2)
        + 3.0 * cross(1, 3)
        + 6.0 * cross(2, 3)
    )
    total = np.bincount(spans.ring, area / 20.0, minlength=curves.closed.size)
    return np.where(curves.closed, total, 0.0)


def _moved_out(curves: Curves, layers: Layers) -> Bools:
    """Rings (R,) whose enclosing ring is not that of their contour."""
    several = np.repeat(np.diff(layers.layer_starts) > 1, np.diff(layers.layer_starts))
    moved = np.zeros(curves.closed.size, np.bool_)
    if not several.any():
        return moved
    sampled = curves.sampled_rings(NESTING_MM)
    areas = rings.signed_areas(sampled.points, sampled.ring_starts, curves.closed)
    boxes = rings.bounds(sampled.points, sampled.ring_starts)
    parents = rings.parents(sampled.points, sampled.ring_starts, layers.layer_starts, areas, boxes)
    return np.asarray(several & (parents != layers.parents))


def _distances(
    curves: Curves, layers: Layers, allowed: Allowances, slack_mm: float, plane_slack_mm: float
) -> Evidence:
    count = curves.closed.size
    spans = curves.bezier_spans()
    starts = np.concatenate([[0], np.cumsum(np.bincount(spans.ring, minlength=count))]).astype(np.int64)
    found = Evidence(
        np.zeros(count, np.uint8),
        np.zeros(count, np.uint8),
        np.ones(count, np.bool_),
        np.zeros(count),
        np.full(count, slack_mm),
        np.full((count, 2), np.nan),
        _mean_limits(layers, allowed, slack_mm),
    )
    contours = _Contours(
        np.ascontiguousarray(layers.points),
        layers.ring_starts,
        layers.closed,
        allowed.limit_mm,
        allowed.plane,
    )
    slacks = (slack_mm, plane_slack_mm)
    told = _Told(found.value_mm, found.limit_mm, found.at, found.cause)

    def work(first: int, last: int) -> None:
        _measure_rings(contours, slacks, spans.points, starts, first, last, told)

    run_blocks(work, count, RINGS_A_BLOCK)
    return found


def _mean_limits(layers: Layers, allowed: Allowances, slack_mm: float) -> Floats:
    """Mean limit at the middles of a ring's segments, (R,) mm, weighted by their lengths."""
    sizes = np.diff(layers.ring_starts)
    ring = np.repeat(np.arange(sizes.size), sizes)
    following = np.arange(1, len(ring) + 1)
    following[layers.ring_starts[1:][sizes > 0] - 1] = layers.ring_starts[:-1][sizes > 0]
    long = np.hypot(*(layers.points[following] - layers.points).T)
    total = np.bincount(ring, long, minlength=sizes.size)
    weighed = np.bincount(ring, long * allowed.limit_mm[:, 1], minlength=sizes.size)
    return slack_mm + weighed / np.where(total > 0.0, total, 1.0)


class _Contours(NamedTuple):
    """Contours, and how far curves may leave them."""

    points: Floats
    ring_starts: Ints
    closed: Bools
    allowed: Floats
    plane: Bools


class _Told(NamedTuple):
    """Columns of :class:`Evidence` that :func:`_measure_rings` fills."""

    value: Floats
    limit: Floats
    at: Floats
    cause: NDArray[np.uint8]


@kernel
def _measure_rings(
    contours: _Contours,
    slacks: tuple[float, float],
    spans: Floats,
    span_starts: Ints,
    first: int,
    last: int,
    told: _Told,
) -> None:
    """Find where each ring of curves is farthest beyond what is allowed; slacks: anywhere, and inside of planes, mm."""
    points, allowed, plane = contours.points, contours.allowed, contours.plane
    value, limit, at, cause = told
    slack, plane_slack = slacks
    for r in range(first, last):
        a, b = contours.ring_starts[r], contours.ring_starts[r + 1]
        B = spans[span_starts[r] : span_starts[r + 1]]
        if b - a < 2 or len(B) == 0:
            continue
        along = _along(B)
        contour = tree_over(segments_along(points[a:b], contours.closed[r]))
        curve = tree_over(segments_along(along, False))
        excess, guess = -np.inf, 0
        for i in range(len(along)):
            found = nearest(contour, along[i, 0], along[i, 1], guess)
            guess = found.segment
            may = _limit(allowed, plane, a, b, guess, found.t, slack, plane_slack)
            if found.distance - may > excess:
                excess, value[r], limit[r] = found.distance - may, found.distance, may
                at[r, 0], at[r, 1] = along[i, 0], along[i, 1]
                cause[r] = (PLANE if plane[a + guess] else SAGITTA) if excess > 0.0 else ACCEPTED
        guess = 0
        for i in range(a, b):
            found = nearest(curve, points[i, 0], points[i, 1], guess)
            guess = found.segment
            may = allowed[i, 0] + slack
            distance = found.distance
            if distance > may:
                distance = _refined(B, found.segment, found.t, points[i, 0], points[i, 1])
            if distance - may > excess:
                excess, value[r], limit[r] = distance - may, distance, may
                at[r, 0], at[r, 1] = points[i, 0], points[i, 1]
                cause[r] = SAGITTA if excess > 0.0 else ACCEPTED


@kernel
def _along(B: Floats) -> Floats:
    """Points along spans, CHORDS_A_SPAN chords each, and the end."""
    along = np.empty((len(B) * CHORDS_A_SPAN + 1, 2))
    for i in range(len(along) - 1):
        for axis in range(2):
            along[i, axis] = evaluate_bezier(B[i // CHORDS_A_SPAN], (i % CHORDS_A_SPAN) / CHORDS_A_SPAN, axis)
    along[len(along) - 1] = B[len(B) - 1, 3]
    return along


@kernel
def _limit(
    allowed: Floats, plane: Bools, a: int, b: int, segment: int, t: float, slack: float, plane_slack: float
) -> float:
    """What is allowed at a place of a contour's segment; in a plane, at its inside alone."""
    k = a + segment
    following = k + 1 if k + 1 < b else a
    start, middle, end = allowed[k, 0], allowed[k, 1], allowed[following, 0]
    may = (1.0 - t) * (1.0 - 2.0 * t) * start + 4.0 * t * (1.0 - t) * middle + t * (2.0 * t - 1.0) * end
    inside = plane[k] and 0.0 < t < 1.0
    return float(max(may, 0.0) + (plane_slack if inside else slack))


@kernel
def _refined(B: Floats, segment: int, t: float, x: float, y: float) -> float:
    """Distance of (x, y) from the span of a chord, by the least of finer chords about the nearest place."""
    span = B[segment // CHORDS_A_SPAN]
    middle = (segment % CHORDS_A_SPAN + t) / CHORDS_A_SPAN
    best = np.inf
    width = 1.0 / CHORDS_A_SPAN
    for _ in range(12):
        chosen = middle
        for k in range(-4, 5):
            u = min(max(middle + 0.25 * k * width, 0.0), 1.0)
            away = math.hypot(evaluate_bezier(span, u, 0) - x, evaluate_bezier(span, u, 1) - y)
            if away < best:
                best, chosen = away, u
        middle = chosen
        width *= 0.5
    return best


# -- Evidence over a whole stack of curves: layers against their neighbours, and against the mesh between them -
#
# The mean lift of a layer is the area that its curves enclose beyond its contours, over their length. It may
# differ between two layers by no more than the mesh allows there: a layer that stands out was lifted the
# wrong way. The volume between two layers is known exactly from the mesh. The volume by the areas of the
# curves must agree with it, up to the error that the areas of the contours themselves make, and up to how far
# curves may lie outside or inside their contours.


VOLUME_ROUNDING = 1e-9
"""Relative rounding error allowed in the sum of a volume."""


class StackEvidence(NamedTuple):
    """How layers agree with each other and with the mesh."""

    lift_mm: Floats
    """(L,) mean lift of each layer; 0 without contours."""
    allowed_mm: Floats
    """(L,) mean limit along the contours, by the mesh and the tolerance."""
    jump_excess_mm: Floats
    """(L,) difference of the lift from that of the layer below, less the allowed one; 0 or less is within the limit."""
    volume_excess_mm3: Floats
    """(L,) difference between the volumes, above the layer below, by the curves and of the mesh, less the allowed one."""

    @property
    def accepted(self) -> bool:
        """Whether no layer stands out."""
        return bool((self.jump_excess_mm <= 0.0).all() and (self.volume_excess_mm3 <= 0.0).all())


def stack_evidence(curves: Curves, layers: Layers, part: Part, found: Evidence) -> StackEvidence:
    """Compare the layers of curves, and the volume between them with that of the mesh.

    Parameters
    ----------
    curves, layers
        Curves and the contours that they were fitted to, from below.
    part
        The mesh that was cut.
    found
        Evidence of the rings.
    """
    count = len(layers)
    of_ring = curves.ring_layer
    length = np.bincount(of_ring, layers.ring_lengths, minlength=count)
    weight = np.where(length > 0.0, length, 1.0)
    gain = np.bincount(of_ring, ring_areas(curves) - layers.ring_areas, minlength=count)
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
        volumes[1:] = np.abs(mesh - curved) - allowed - VOLUME_ROUNDING * np.abs(mesh)
    return StackEvidence(lift, may, jumps, volumes)

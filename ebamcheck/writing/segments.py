"""The pieces of fitted contours as segments that a machine can drive: straight, cubic (exact), or circular within a tolerance; and
their parts."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ebamcheck.kernels import Bools, Floats, Ints
from ebamcheck.nc.inputs import ARC, DEGREE, LINE, SPLINE, CurveColumns
from ebamcheck.threads import run_blocks

STRAIGHT, CUBIC, CIRCULAR = range(3)  # Kinds of segments
# What splines become: cubics, exactly, or arcs or chords within a tolerance. Arcs stay arcs, but for "all chords".
Form = Literal["cubics", "arcs", "chords", "all chords"]


@dataclass(frozen=True, eq=False)
class Segments:
    """Segments of all pieces, in the order of travel."""

    starts: Ints  # (P + 1,) first segment of each piece
    kind: NDArray[np.uint8]  # (N,) STRAIGHT, CUBIC or CIRCULAR
    end: Floats  # (N, 2) mm
    bezier: Floats  # (C, 4, 2) Bezier points of the cubic segments alone, in their order
    middle: Floats  # (A, 2) points half-way along the circular segments alone, in their order


# Segments of the pieces of one kind: (p,) segments of each, their ends, their kind, and the points half-way along arcs
_Made = tuple[Ints, Floats, int, Floats | None]


def contour_segments(curves: CurveColumns, form: Form, tolerance_mm: float) -> Segments:
    """Turn every piece into segments; those of splines and arcs leave them by at most `tolerance_mm`."""
    piece_kind = np.asarray(curves.kind)
    control = np.asarray(curves.control, dtype=np.float64)
    first = np.asarray(curves.control_starts, dtype=np.int64)
    found, inner = spans(curves), np.repeat(piece_kind == LINE, np.diff(first))
    inner[first[:-1][np.diff(first) > 0]] = False
    made: dict[int, _Made] = {
        LINE: (np.maximum(np.diff(first)[piece_kind == LINE] - 1, 0), control[inner], STRAIGHT, None),
        SPLINE: _splines(found, piece_kind == SPLINE, form, tolerance_mm),
        ARC: _arcs(control, first[:-1][piece_kind == ARC], form, tolerance_mm),
    }
    count = np.zeros(piece_kind.size, np.int64)
    for which, (sizes, *_) in made.items():
        count[piece_kind == which] = sizes
    starts = np.concatenate([[0], np.cumsum(count)]).astype(np.int64)
    owner = np.repeat(piece_kind, count)
    kind, end, middle = np.empty(owner.size, np.uint8), np.empty((owner.size, 2)), np.empty((owner.size, 2))
    for which, (_, ends, is_kind, middles) in made.items():
        rows = owner == which
        kind[rows], end[rows] = is_kind, ends
        if middles is not None:
            middle[rows] = middles
    filled = np.flatnonzero(count > 0)
    end[starts[filled + 1] - 1] = control[first[filled + 1] - 1]  # bit for bit where the next piece starts
    bezier = found.bezier if form == "cubics" else np.zeros((0, 4, 2))
    return Segments(starts, kind, end, bezier, middle[kind == CIRCULAR])


def _splines(found: Spans, which: Bools, form: Form, tolerance_mm: float) -> _Made:
    if form == "cubics":
        return np.diff(found.starts)[which], found.bezier[:, 3], CUBIC, None
    if form == "arcs":
        starts, middle, end = spline_arcs(found, tolerance_mm)
        return np.diff(starts)[which], end, CIRCULAR, middle
    starts, points = chords(found, tolerance_mm)
    return np.diff(starts)[which], points, STRAIGHT, None


def _arcs(control: Floats, first: Ints, form: Form, tolerance_mm: float) -> _Made:
    if form == "all chords":
        starts, points = arc_chords(control[first], control[first + 1], control[first + 2], tolerance_mm)
        return np.diff(starts), points, STRAIGHT, None
    return np.ones(first.size, np.int64), control[first + 2], CIRCULAR, control[first + 1]


@dataclass(frozen=True, eq=False)
class Spans:
    """Knot spans of all spline pieces, in order, each over 0 <= t <= 1."""

    starts: Ints  # (P + 1,) first span of each piece; lines have none
    bezier: Floats  # (S, 4, 2) Bezier points, mm


def spans(curves: CurveColumns) -> Spans:
    """Split every spline piece at its knots into Bezier spans (blossoming; Farin, Curves and Surfaces)."""
    piece_of_knot = np.repeat(np.arange(len(curves.kind)), np.diff(curves.knot_starts))
    knots = np.asarray(curves.knots, dtype=np.float64)
    place = np.arange(knots.size) - np.asarray(curves.knot_starts)[:-1][piece_of_knot]
    count = np.diff(curves.control_starts)[piece_of_knot]
    inner = (place >= DEGREE) & (place < count) & (np.asarray(curves.kind)[piece_of_knot] == SPLINE)
    at = np.flatnonzero(inner)
    at = at[knots[at] < knots[np.minimum(at + 1, knots.size - 1)]]
    piece = piece_of_knot[at]
    first_control = np.asarray(curves.control_starts)[:-1][piece] + place[at] - DEGREE
    control = np.asarray(curves.control, dtype=np.float64)[first_control[:, None] + np.arange(4)]
    local = knots[at[:, None] + np.arange(-2, 4)]
    a, b = local[:, 2], local[:, 3]
    points = [_blossom(control, local, *t) for t in ((a, a, a), (a, a, b), (a, b, b), (b, b, b))]
    starts = np.searchsorted(piece, np.arange(len(curves.kind) + 1)).astype(np.int64)
    return Spans(starts, np.stack(points, axis=1) if at.size else np.zeros((0, 4, 2)))


def _blossom(control: Floats, local: Floats, t0: Floats, t1: Floats, t2: Floats) -> Floats:
    """Polar form of each span at three parameters; `local` (S, 6) are the knots around the span."""
    level = control
    for depth, t in enumerate((t0, t1, t2)):
        size = DEGREE - depth
        low = local[:, depth : depth + size]
        high = local[:, DEGREE : DEGREE + size]
        share = ((t[:, None] - low) / (high - low))[..., None]
        level = (1.0 - share) * level[:, :-1] + share * level[:, 1:]
    return level[:, 0]


def chords(found: Spans, tolerance_mm: float) -> tuple[Ints, Floats]:
    """Points on the spans such that their chords keep to `tolerance_mm`; the first point of a span is not given.

    The chord error of n equal parts is at most ``max |p''| / (8 n^2)``, and p'' of a cubic is largest at an end. Returns the first
    point of each piece, (P + 1,), and the points (N, 2), mm."""
    b = found.bezier
    quadratic = 3.0 * (b[:, 0] - 2.0 * b[:, 1] + b[:, 2])
    first, last = 2.0 * quadratic, 2.0 * quadratic + 6.0 * (b[:, 3] - b[:, 0] + 3.0 * (b[:, 1] - b[:, 2]))
    bend = np.maximum(np.linalg.norm(first, axis=1), np.linalg.norm(last, axis=1))
    parts = np.maximum(1, np.ceil(np.sqrt(bend / (8.0 * tolerance_mm)))).astype(np.int64)
    offset = np.concatenate([[0], np.cumsum(parts)]).astype(np.int64)
    span = np.repeat(np.arange(parts.size), parts)
    step = np.arange(offset[-1]) - offset[:-1][span] + 1
    return offset[found.starts], bezier_places(b[span], step / parts[span])


# -- splines as arcs: tangent-continuous pairs ---------------------------------------------------------
# Each stretch of a span becomes two arcs that share end points and tangents with it and a tangent with each other, with legs of
# equal length (Bolton, Biarc curves, CAD 7, 1975); a stretch that leaves the tolerance is halved.
SAMPLES = 12  # Places inside a stretch where the distance from its arcs is measured
# A stretch of 2^-14 of a span that is still no pair of arcs has a cusp, and becomes a straight line.
MOST_HALVINGS = 14


def spline_arcs(found: Spans, tolerance_mm: float) -> tuple[Ints, Floats, Floats]:
    """Arcs (N,) within `tolerance_mm` of the spans of all spline pieces.

    Returns the first arc of each piece (P + 1,), points (N, 2) half-way along each arc, on the chord of a straight line, and its
    end (N, 2)."""
    span = np.arange(len(found.bezier))
    low, high = np.zeros(span.size), np.ones(span.size)
    done = [(span[:0], low[:0], *[np.zeros((0, 2))] * 4)]
    for level in range(MOST_HALVINGS + 1):
        if not span.size:
            break
        bezier = found.bezier[span]
        *pairs, error_mm = _pairs(bezier, low, high)
        # What lies between the samples may be a little farther.
        good = error_mm <= 0.9 * tolerance_mm
        end = bezier_places(bezier, high)
        if level == MOST_HALVINGS:
            start = bezier_places(bezier, low)
            for share, points in zip((0.25, 0.5, 0.75), pairs, strict=True):
                points[~good] = start[~good] + share * (end[~good] - start[~good])
            good[:] = True
        done.append((span[good], low[good], *(points[good] for points in pairs), end[good]))
        bounds = np.stack([low, 0.5 * (low + high), high], axis=1)[~good]
        span = np.repeat(span[~good], 2)
        low, high = bounds[:, :2].ravel(), bounds[:, 1:].ravel()
    span, low, first, joint, second, end = (np.concatenate(column) for column in zip(*done, strict=True))
    order = np.lexsort((low, span))
    middle = np.stack([first[order], second[order]], axis=1).reshape(-1, 2)
    ends = np.stack([joint[order], end[order]], axis=1).reshape(-1, 2)
    return 2 * np.searchsorted(span[order], found.starts), middle, ends


def _pairs(bezier: Floats, low: Floats, high: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Pairs of arcs on the stretches from `low` to `high` of cubics (n, 4, 2): middle, joint, middle, and their distance from
    them."""
    start, end = bezier_places(bezier, low), bezier_places(bezier, high)
    chord = end - start
    t0, t1 = _direction(bezier, low, chord), _direction(bezier, high, chord)
    along = (chord * (t0 + t1)).sum(axis=1)
    squared = (chord * chord).sum(axis=1)
    bend = 2.0 * (1.0 - (t0 * t1).sum(axis=1))
    root = along + np.sqrt(along**2 + np.maximum(bend, 0.0) * squared)
    with np.errstate(divide="ignore", invalid="ignore"):
        leg = (squared / root)[:, None]
    joint = 0.5 * (start + end + leg * (t0 - t1))
    heading = chord - leg * (t0 + t1)
    first, second = _height(start, joint, t0), -_height(end, joint, -t1)
    inside = np.linspace(0.0, 1.0, SAMPLES + 2)[1:-1]
    t = low[:, None] + (high - low)[:, None] * inside
    points = bezier_places(np.repeat(bezier, SAMPLES, axis=0), t.ravel()).reshape(-1, SAMPLES, 2)
    before = ((points - joint[:, None]) * heading[:, None]).sum(axis=2) < 0.0
    away = np.where(before, _off_arc(points, start, joint, first), _off_arc(points, joint, end, second))
    error = np.where(np.isfinite(away).all(axis=1), np.abs(away).max(axis=1), np.inf)
    return _middle(start, joint, first), joint, _middle(joint, end, second), error


def bezier_places(bezier: Floats, t: Floats) -> Floats:
    """Places (n, 2) of Bezier spans (n, 4, 2) at a parameter (n,) of each."""
    s, t = 1.0 - t[:, None], t[:, None]
    b = bezier
    return np.asarray(s**3 * b[:, 0] + 3.0 * s * s * t * b[:, 1] + 3.0 * s * t * t * b[:, 2] + t**3 * b[:, 3])


def _direction(bezier: Floats, t: Floats, chord: Floats) -> Floats:
    """Unit tangents (n, 2)."""
    s, t = 1.0 - t[:, None], t[:, None]
    leg = np.diff(bezier, axis=1)
    along = s * s * leg[:, 0] + 2.0 * s * t * leg[:, 1] + t * t * leg[:, 2]
    size = np.hypot(along[:, 0], along[:, 1])
    # A derivative so much shorter than the chord gives no direction; the chord's is taken.
    lost = size <= 1e-9 * np.hypot(chord[:, 0], chord[:, 1])
    along = np.where(lost[:, None], chord, along)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(along / np.hypot(along[:, 0], along[:, 1])[:, None])


def _height(start: Floats, end: Floats, tangent: Floats) -> Floats:
    """Height of arcs over their chords, to the left of travel, by the tangent at their start."""
    chord = end - start
    cross = tangent[:, 0] * chord[:, 1] - tangent[:, 1] * chord[:, 0]
    size = np.hypot(chord[:, 0], chord[:, 1])
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(-0.5 * size * cross / (size + (tangent * chord).sum(axis=1)))


def _middle(start: Floats, end: Floats, height: Floats) -> Floats:
    chord = end - start
    with np.errstate(divide="ignore", invalid="ignore"):
        normal = np.column_stack([-chord[:, 1], chord[:, 0]]) / np.hypot(chord[:, 0], chord[:, 1])[:, None]
    return np.asarray(0.5 * (start + end) + height[:, None] * normal)


def _off_arc(points: Floats, start: Floats, end: Floats, height: Floats) -> Floats:
    """Signed distance (n, k), to first order, of points (n, k, 2) from circles; stable for flat arcs."""
    chord = end - start
    half = 0.5 * np.hypot(chord[:, 0], chord[:, 1])[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        unit = chord / (2.0 * half)
        rel = points - 0.5 * (start + end)[:, None]
        x = (rel * unit[:, None]).sum(axis=2)
        y = rel[:, :, 1] * unit[:, None, 0] - rel[:, :, 0] * unit[:, None, 1]
        h = height[:, None]
        return np.asarray((h * (x * x + y * y - half**2) - y * (h * h - half**2)) / (half**2 + h * h))


@dataclass(frozen=True, eq=False)
class Circles:
    """Circles of arcs, as columns."""

    centre: Floats  # (n, 2) mm; of no use where the arc is straight
    counter_clockwise: Bools  # (n,) sense of travel
    sagitta_mm: Floats  # (n,) height of the arc over its chord
    sweep_rad: Floats  # (n,) angle travelled, positive


def circles(start: Floats, middle: Floats, end: Floats) -> Circles:
    """Circle of each arc (n,) by its start, the point half-way along it, and its end, each (n, 2) mm, the latter rounded or not.

    The centre lies on the perpendicular bisector of start and end, so that both radii are equal.
    """
    chord = end - start
    half = 0.5 * np.hypot(chord[:, 0], chord[:, 1])
    with np.errstate(divide="ignore", invalid="ignore"):
        normal = np.column_stack([-chord[:, 1], chord[:, 0]]) / (2.0 * half)[:, None]
        height = ((middle - 0.5 * (start + end)) * normal).sum(axis=1)
        centre = 0.5 * (start + end) + normal * ((height**2 - half**2) / (2.0 * height))[:, None]
    sweep = 4.0 * np.arctan2(np.abs(height), half)
    return Circles(centre, height < 0.0, np.abs(height), sweep)


def arc_chords(start: Floats, middle: Floats, end: Floats, tolerance_mm: float) -> tuple[Ints, Floats]:
    """Points (N, 2) along arcs whose chords keep to `tolerance_mm`, but for the first of an arc, after the first of each arc (n +
    1,).

    The chord of a sweep s leaves a circle of radius r by ``r (1 - cos(s / 2))``.
    """
    found = circles(start, middle, end)
    spoke = start - found.centre
    radius = np.hypot(spoke[:, 0], spoke[:, 1])
    straight = ~(found.sagitta_mm > tolerance_mm)
    with np.errstate(divide="ignore", invalid="ignore"):
        step = 2.0 * np.arccos(np.clip(1.0 - tolerance_mm / radius, 0.0, 1.0))
        parts = np.where(straight, 1.0, np.ceil(found.sweep_rad / step)).astype(np.int64)
    starts = np.concatenate([[0], np.cumsum(parts)]).astype(np.int64)
    arc = np.repeat(np.arange(parts.size), parts)
    share = (np.arange(starts[-1]) - starts[:-1][arc] + 1) / parts[arc]
    turn = share * np.where(found.counter_clockwise, found.sweep_rad, -found.sweep_rad)[arc]
    cos, sin = np.cos(turn), np.sin(turn)
    x, y = spoke[arc, 0], spoke[arc, 1]
    points = found.centre[arc] + np.column_stack([cos * x - sin * y, sin * x + cos * y])
    points[starts[1:] - 1] = end
    return starts, points


# Exact cuts of segments at lengths along them: a part of a line, a cubic or an arc is one again.
HALVINGS = 52  # Bisections of the parameter of a cubic at a length: the bits of a number
# Cubics that are bisected together: so many stay in the cache. A multiple of four, in which sums of rows are formed.
AT_ONCE = 1024
NODES, WEIGHTS = np.polynomial.legendre.leggauss(16)


def segment_lengths(kind: NDArray[np.uint8], points: Floats) -> Floats:
    """Length of each segment, (n,) mm; cubics by 16-point Gauss quadrature.

    `points` (n, 4, 2), mm, are the Bezier points of a cubic, start and end of a line, and those and, second, the middle of an arc.
    """
    result: Floats = np.asarray(np.linalg.norm(points[:, 3] - points[:, 0], axis=1))
    cubic, arc = kind == CUBIC, kind == CIRCULAR
    result[cubic] = _lengths_to(3.0 * np.diff(points[cubic], axis=1), np.ones(int(cubic.sum())))
    found = circles(points[arc, 0], points[arc, 1], points[arc, 3])
    result[arc] = found.sweep_rad * np.linalg.norm(points[arc, 0] - found.centre, axis=1)
    return result


def segment_parts(kind: NDArray[np.uint8], points: Floats, lengths: Floats, low_mm: Floats, high_mm: Floats) -> Floats:
    """Points (n, 4, 2) of the part of each segment from one length along it to another; an end of the segment stays bit for bit."""
    result = np.empty_like(points)
    for which, part in ((STRAIGHT, _line_parts), (CIRCULAR, _arc_parts), (CUBIC, _cubic_parts)):
        rows = np.flatnonzero(kind == which)
        result[rows] = part(points[rows], lengths[rows], low_mm[rows], high_mm[rows])
    first, last = low_mm == 0.0, high_mm == lengths
    result[first, 0], result[last, 3] = points[first, 0], points[last, 3]
    return result


def segment_places(
    kind: NDArray[np.uint8], points: Floats, lengths: Floats, step_mm: float
) -> tuple[Ints, Floats, Floats, Floats]:
    """Places in the middle of pieces, of at most a length, of segments: the segment (m,), mm from its start, the place (m, 2),
    length of the piece."""
    count = np.maximum(np.ceil(lengths / step_mm), 1.0).astype(np.int64)
    owner = np.repeat(np.arange(count.size), count)
    t = (np.arange(owner.size) - np.repeat(np.cumsum(count) - count, count) + 0.5) / count[owner]
    places = points[owner, 0] + t[:, None] * (points[owner, 3] - points[owner, 0])
    cubic, arc = (np.flatnonzero(kind[owner] == which) for which in (CUBIC, CIRCULAR))
    at = np.broadcast_to(t[cubic], (3, cubic.size))
    places[cubic] = _polar(points[owner[cubic]], *at)
    places[arc] = _on_arcs(points[owner[arc]], t[arc])
    return owner, t * lengths[owner], places, (lengths / count)[owner]


def _on_arcs(points: Floats, t: Floats) -> Floats:
    """Places (n, 2) at shares of the sweep of arcs."""
    found = circles(points[:, 0], points[:, 1], points[:, 3])
    spoke = points[:, 0] - found.centre
    turn = t * np.where(found.counter_clockwise, found.sweep_rad, -found.sweep_rad)
    cos, sin = np.cos(turn), np.sin(turn)
    turned = (cos * spoke[:, 0] - sin * spoke[:, 1], sin * spoke[:, 0] + cos * spoke[:, 1])
    return np.asarray(found.centre + np.column_stack(turned))


def _line_parts(points: Floats, lengths: Floats, low: Floats, high: Floats) -> Floats:
    way = points[:, 3] - points[:, 0]
    a, b = (points[:, 0] + way * (at / lengths)[:, None] for at in (low, high))
    return np.stack([a, a, b, b], axis=1)


def _arc_parts(points: Floats, lengths: Floats, low: Floats, high: Floats) -> Floats:
    middle = _on_arcs(points, 0.5 * (low + high) / lengths)
    first, last = (_on_arcs(points, at / lengths) for at in (low, high))
    return np.stack([first, middle, middle, last], axis=1)


def _cubic_parts(points: Floats, lengths: Floats, low: Floats, high: Floats) -> Floats:
    """Parts of cubics by their polar form (Farin, Curves and Surfaces)."""
    u, v = (_cubic_parameters(points, length) for length in (low, high))
    polar = partial(_polar, points)
    return np.stack([polar(u, u, u), polar(u, u, v), polar(u, v, v), polar(v, v, v)], axis=1)


def _polar(points: Floats, *parameters: Floats) -> Floats:
    level = points
    for t in parameters:
        level = level[:, :-1] + t[:, None, None] * np.diff(level, axis=1)
    return np.asarray(level[:, 0])


def _cubic_parameters(points: Floats, length: Floats) -> Floats:
    """Parameter of each cubic at a length along it, (n,)."""

    def bisected(rows: slice) -> Floats:
        derivative, wanted = 3.0 * np.diff(points[rows], axis=1), length[rows]
        low, high = np.zeros(wanted.size), np.ones(wanted.size)
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            short = _lengths_to(derivative, middle) < wanted
            low, high = np.where(short, middle, low), np.where(short, high, middle)
        return 0.5 * (low + high)

    def some(first: int, last: int) -> Floats:
        return np.concatenate([bisected(slice(AT_ONCE * k, AT_ONCE * (k + 1))) for k in range(first, last)])

    blocks = run_blocks(some, math.ceil(len(points) / AT_ONCE)) if len(points) else [np.zeros(0)]
    return np.concatenate(blocks)


def _lengths_to(derivative: Floats, t: Floats) -> Floats:
    """Length from 0 to t, (n,), of cubics whose derivatives have the Bezier points (n, 3, 2)."""
    u = 0.5 * t[:, None] * (NODES + 1.0)
    rest = 1.0 - u
    shares = (rest**2, 2.0 * rest * u, u**2)
    x, y = (
        shares[0] * derivative[:, 0, axis, None]
        + shares[1] * derivative[:, 1, axis, None]
        + shares[2] * derivative[:, 2, axis, None]
        for axis in (0, 1)
    )
    return np.asarray(0.5 * t * (np.hypot(x, y) @ WEIGHTS))

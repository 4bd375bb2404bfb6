"""Splines as circular arcs: tangent-continuous pairs of arcs within a tolerance.

Each stretch of a span becomes two arcs that share end points and tangents with it and a tangent with each
other, with legs of equal length (Bolton, Biarc curves, CAD 7, 1975); a stretch that leaves the tolerance is
halved.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ebamcheck.numeric.rings import Bools, Floats, Ints
from ebamcheck.writing.polynomials import Spans

SAMPLES = 12
"""Places inside a stretch where the distance from its arcs is measured."""

SAMPLED_SHARE = 0.9
"""Share of the tolerance allowed at the samples: what lies between them may be a little farther."""

MOST_HALVINGS = 14
"""A stretch of 2^-14 of a span that is still no pair of arcs has a cusp, and becomes a straight line."""

NO_TANGENT = 1e-9
"""A derivative shorter than this share of the chord gives no direction; the chord's is taken."""


class Pairs(NamedTuple):
    """Pairs of arcs, one a stretch."""

    first_middle: Floats
    joint: Floats
    second_middle: Floats
    error_mm: Floats


class ArcPieces(NamedTuple):
    """Arcs and lines in place of splines."""

    starts: Ints
    """(P + 1,) first arc of each piece."""
    middle: Floats
    """(N, 2) points half-way along each arc; on the chord of a straight line."""
    end: Floats
    """(N, 2)"""


def spline_arcs(found: Spans, tolerance_mm: float) -> ArcPieces:
    """Arcs (N,) within `tolerance_mm` of the spans of all spline pieces."""
    span = np.arange(len(found.bezier))
    low, high = np.zeros(span.size), np.ones(span.size)
    done: list[tuple[Ints, Floats, Floats, Floats, Floats, Floats]] = []
    for level in range(MOST_HALVINGS + 1):
        if not span.size:
            break
        bezier = found.bezier[span]
        pairs = _pairs(bezier, low, high)
        good = pairs.error_mm <= SAMPLED_SHARE * tolerance_mm
        end = _at(bezier, high)
        if level == MOST_HALVINGS:
            start = _at(bezier, low)
            _straighten(pairs, start, end, ~good)
            good[:] = True
        done.append(
            (span[good], low[good], pairs.first_middle[good], pairs.joint[good], pairs.second_middle[good], end[good])
        )  # fmt: skip
        middle = 0.5 * (low + high)
        span = np.repeat(span[~good], 2)
        low, high = _interleaved(low[~good], middle[~good]), _interleaved(middle[~good], high[~good])
    return _ordered(found, done)


def _ordered(found: Spans, done: list[tuple[Ints, Floats, Floats, Floats, Floats, Floats]]) -> ArcPieces:
    if not done:
        return ArcPieces(found.starts, np.zeros((0, 2)), np.zeros((0, 2)))
    span, low, first, joint, second, end = (np.concatenate(column) for column in zip(*done, strict=True))
    order = np.lexsort((low, span))
    middle = np.stack([first[order], second[order]], axis=1).reshape(-1, 2)
    ends = np.stack([joint[order], end[order]], axis=1).reshape(-1, 2)
    return ArcPieces(2 * np.searchsorted(span[order], found.starts), middle, ends)


def _interleaved(a: Floats, b: Floats) -> Floats:
    return np.stack([a, b], axis=1).ravel()


def _pairs(bezier: Floats, low: Floats, high: Floats) -> Pairs:
    """Pairs of arcs on the stretches from `low` to `high` of cubics (n, 4, 2), and their distance from them."""
    start, end = _at(bezier, low), _at(bezier, high)
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
    points = _at(np.repeat(bezier, SAMPLES, axis=0), t.ravel()).reshape(-1, SAMPLES, 2)
    before = ((points - joint[:, None]) * heading[:, None]).sum(axis=2) < 0.0
    away = np.where(before, _off_arc(points, start, joint, first), _off_arc(points, joint, end, second))
    error = np.where(np.isfinite(away).all(axis=1), np.abs(away).max(axis=1), np.inf)
    return Pairs(_middle(start, joint, first), joint, _middle(joint, end, second), error)


def _at(bezier: Floats, t: Floats) -> Floats:
    s, t = 1.0 - t[:, None], t[:, None]
    b = bezier
    return np.asarray(s**3 * b[:, 0] + 3.0 * s * s * t * b[:, 1] + 3.0 * s * t * t * b[:, 2] + t**3 * b[:, 3])


def _direction(bezier: Floats, t: Floats, chord: Floats) -> Floats:
    """Unit tangents (n, 2)."""
    s, t = 1.0 - t[:, None], t[:, None]
    leg = np.diff(bezier, axis=1)
    along = s * s * leg[:, 0] + 2.0 * s * t * leg[:, 1] + t * t * leg[:, 2]
    size = np.hypot(along[:, 0], along[:, 1])
    lost = size <= NO_TANGENT * np.hypot(chord[:, 0], chord[:, 1])
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


def _straighten(pairs: Pairs, start: Floats, end: Floats, which: Bools) -> None:
    for share, points in ((0.25, pairs.first_middle), (0.5, pairs.joint), (0.75, pairs.second_middle)):
        points[which] = start[which] + share * (end[which] - start[which])

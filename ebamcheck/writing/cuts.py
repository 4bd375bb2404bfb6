"""Exact cuts of path segments at lengths along them: a part of a line, a cubic or an arc is one again."""

from __future__ import annotations

import math
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ebamcheck.kernels import Floats, Ints
from ebamcheck.threads import run_blocks
from ebamcheck.writing.segments import CIRCULAR, CUBIC, STRAIGHT, circles

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


def segment_parts(
    kind: NDArray[np.uint8], points: Floats, lengths: Floats, low_mm: Floats, high_mm: Floats
) -> Floats:
    """Points (n, 4, 2) of the part of each segment from one length along it to another; an end of the segment stays bit for bit."""
    result = np.empty_like(points)
    for which, part in ((STRAIGHT, _lines), (CIRCULAR, _arcs), (CUBIC, _cubics)):
        rows = np.flatnonzero(kind == which)
        result[rows] = part(points[rows], lengths[rows], low_mm[rows], high_mm[rows])
    first, last = low_mm == 0.0, high_mm == lengths
    result[first, 0], result[last, 3] = points[first, 0], points[last, 3]
    return result


def segment_places(
    kind: NDArray[np.uint8], points: Floats, lengths: Floats, step_mm: float
) -> tuple[Ints, Floats, Floats, Floats]:
    """Places in the middle of pieces, of at most a length, of segments: the segment (m,), mm from its start, the place (m, 2), length of the piece."""
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


def _lines(points: Floats, lengths: Floats, low: Floats, high: Floats) -> Floats:
    way = points[:, 3] - points[:, 0]
    a, b = (points[:, 0] + way * (at / lengths)[:, None] for at in (low, high))
    return np.stack([a, a, b, b], axis=1)


def _arcs(points: Floats, lengths: Floats, low: Floats, high: Floats) -> Floats:
    middle = _on_arcs(points, 0.5 * (low + high) / lengths)
    first, last = (_on_arcs(points, at / lengths) for at in (low, high))
    return np.stack([first, middle, middle, last], axis=1)


def _cubics(points: Floats, lengths: Floats, low: Floats, high: Floats) -> Floats:
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

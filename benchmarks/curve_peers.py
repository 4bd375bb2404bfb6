"""Yardsticks of the curves' benchmark: what other programs make of a contour within the same tolerance.

Both start from the contour alone, and part it at corners. They know no mesh, and so keep the error of its chords.
"""

from __future__ import annotations

import math
import warnings
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.interpolate import splev, splprep

from benchmarks.curve_parts_solids import Floats
from ebamcheck.layers.stack import Layers, from_rings

CORNER_RAD = math.radians(40.0)
"""Turn at which a contour is parted, as by `curves.corner_angle_deg`."""

SAMPLES_A_BLOCK = 16
LEAST_ARC_POINTS = 4
HALVINGS = 12


class Yardstick(NamedTuple):
    """What a peer made of a stack."""

    sampled: Layers
    """Polylines along its curves."""
    blocks: int


def arc_welded(layers: Layers, tolerance_mm: float) -> Yardstick:
    """Greedy arcs as ArcWelder makes them: through the first, middle and last point of the longest run that keeps the
    tolerance, at its points and at the middles between them; else lines."""
    return _of_runs(layers, lambda run: _welded(run, tolerance_mm))


def splines(layers: Layers, tolerance_mm: float) -> Yardstick:
    """Smoothing splines of :func:`scipy.interpolate.splprep` with the fewest knots whose points keep the tolerance."""
    return _of_runs(layers, lambda run: _spline(run, tolerance_mm))


def _of_runs(layers: Layers, fit_run) -> Yardstick:  # type: ignore[no-untyped-def]
    stack, blocks = [], 0
    for k in range(len(layers)):
        found = []
        for r in layers.rings_of(k):
            parts = [fit_run(run) for run in _runs(layers.ring(r))]
            blocks += sum(count for _, count in parts)
            found.append(np.concatenate([points[:-1] for points, _ in parts]))
        stack.append(found)
    return Yardstick(from_rings(layers.heights, stack), blocks)


def _runs(ring: Floats) -> list[Floats]:
    """A closed ring parted at its corners; without one, at its first point."""
    before, after = ring - np.roll(ring, 1, axis=0), np.roll(ring, -1, axis=0) - ring
    turn = np.arctan2(before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0], (before * after).sum(axis=1))
    corners = np.flatnonzero(np.abs(turn) > CORNER_RAD)
    first = int(corners[0]) if corners.size else 0
    closed = np.concatenate([np.roll(ring, -first, axis=0), ring[first : first + 1]])
    cuts = [0, *(corners[1:] - first).tolist(), len(ring)]
    return [closed[a : b + 1] for a, b in pairwise(cuts)]


def _welded(run: Floats, tolerance_mm: float) -> tuple[Floats, int]:
    points, blocks, i = [run[:1]], 0, 0
    while i < len(run) - 1:
        best, j = None, i + LEAST_ARC_POINTS - 1
        while j < len(run):
            found = _arc(run[i : j + 1], tolerance_mm)
            if found is None:
                break
            best, end = found, j
            j += 1
        if best is None:
            best, end = run[i : i + 2], i + 1
        points.append(best[1:])
        blocks += 1
        i = end
    return np.concatenate(points), blocks


def _arc(points: Floats, tolerance_mm: float) -> Floats | None:
    """Samples of the arc through first, middle and last point, or None where it leaves them."""
    (ax, ay), (bx, by), (cx, cy) = points[0], points[len(points) // 2], points[-1]
    d = 2.0 * (ax * (by - cy) + bx * (cy - ay) + cx * (ay - by))
    if abs(d) < 1e-12:
        return None
    a, b, c = ax * ax + ay * ay, bx * bx + by * by, cx * cx + cy * cy
    x = (a * (by - cy) + b * (cy - ay) + c * (ay - by)) / d
    y = (a * (cx - bx) + b * (ax - cx) + c * (bx - ax)) / d
    radius = math.hypot(ax - x, ay - y)
    near = np.concatenate([points, 0.5 * (points[1:] + points[:-1])]) - (x, y)
    if np.abs(np.hypot(near[:, 0], near[:, 1]) - radius).max() > tolerance_mm:
        return None
    angle = np.unwrap(np.arctan2(points[:, 1] - y, points[:, 0] - x))
    if abs(angle[-1] - angle[0]) > 2.0 * math.pi - 0.1:
        return None
    along = np.linspace(angle[0], angle[-1], max(SAMPLES_A_BLOCK, 4 * len(points)))
    sampled = np.column_stack([x + radius * np.cos(along), y + radius * np.sin(along)])
    sampled[0], sampled[-1] = points[0], points[-1]
    return sampled


def _spline(run: Floats, tolerance_mm: float) -> tuple[Floats, int]:
    if len(run) < 5:
        return run, len(run) - 1
    low, high, best = 0.0, len(run) * tolerance_mm**2, None
    for k in range(HALVINGS):  # of the sum of squares that splprep may leave
        s = high if k == 0 else 0.5 * (low + high)
        with warnings.catch_warnings():  # a sum that it cannot reach is told by the distance below
            warnings.simplefilter("ignore", RuntimeWarning)
            tck, u = splprep(list(run.T), s=s, k=3, quiet=2)[:2]  # type: ignore[call-overload]
        off = np.hypot(*(np.array(splev(u, tck)) - run.T)).max()
        if off <= tolerance_mm:
            low, best = s, tck
            if k == 0:
                break
        else:
            high = s
    if best is None:
        return run, len(run) - 1
    spans = len(np.unique(best[0])) - 1
    sampled = np.array(splev(np.linspace(0.0, 1.0, max(4 * len(run), SAMPLES_A_BLOCK * spans)), best)).T
    sampled[0], sampled[-1] = run[0], run[-1]
    return sampled, spans

"""Sampled paths: points of a B-spline, and the distance of two paths as shapes, whatever their parameters."""

from __future__ import annotations

import math

import numpy as np

from ebamcheck.geometry.nearest import nearest, segments_along, square_between, tree_over
from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Floats, Ints

CLOSER = 1.0 - 1e-9  # Share of a square under which a distance is the smaller one, however both are rounded
MOST_STEPS = 16  # Segments that are walked along from one place to the next; what is farther is looked for
DEGREE = 3  # Degree of every spline piece


@kernel
def _farthest(places: Floats, polyline: Floats, known_mm: float) -> tuple[Ints, Floats]:
    """Nearest segment (n,) of a polyline to each place and its distance (n,), for the farthest places.

    Both follow the same way, so that the segment near a place is a step or two from that of the place before. A place
    that is nearer to it than another one is to the polyline, or than `known_mm`, is not the farthest: what was found of
    it is enough, and no nearer segment is looked for.
    """
    ring = tree_over(segments_along(polyline, False))
    segment = np.zeros(len(places), np.int64)
    away = np.empty(len(places))
    guess, most = 0, known_mm
    for i in range(len(places)):
        guess, square = _followed(polyline, guess, places[i, 0], places[i, 1])
        segment[i], away[i] = guess, math.sqrt(square)
        if square < CLOSER * most * most:
            continue
        found = nearest(ring, places[i, 0], places[i, 1], guess)
        guess = found.segment
        segment[i], away[i] = found.segment, found.distance
        most = max(most, found.distance)
    return segment, away


@kernel
def _followed(polyline: Floats, start: int, x: float, y: float) -> tuple[int, float]:
    """Segment up to which a polyline comes nearer to a place from `start` on, else down from it; square of its distance."""
    segment, square = start, _square(polyline, start, x, y)
    for step in (1, -1):
        for _ in range(MOST_STEPS):
            there = np.inf
            if 0 <= segment + step < len(polyline) - 1:
                there = _square(polyline, segment + step, x, y)
            if not there <= square:
                break
            segment, square = segment + step, there
        if segment != start:
            break
    return segment, square


@kernel
def _square(polyline: Floats, i: int, x: float, y: float) -> float:
    """Square of the distance of a place from a segment."""
    return square_between(x, y, polyline[i, 0], polyline[i, 1], polyline[i + 1, 0], polyline[i + 1, 1])


def shape_distance(driven: Floats, wanted: Floats) -> Floats:
    """Largest distance of paths (A, n, 2) and (E, m, 2) as shapes, both ways, (A,) at the motion of the first where it is.

    It is that of the motion from the other path, and of what lies nearest to the motion there: exact for the largest, and no more than
    that for the others.
    """
    path, target = np.ascontiguousarray(driven).reshape(-1, 2), np.ascontiguousarray(wanted).reshape(-1, 2)
    _, away = _farthest(path, target, 0.0)
    result = away.reshape(len(driven), -1).max(axis=1)
    segment, missed = _farthest(target, path, float(result.max(initial=0.0)))
    np.maximum.at(result, segment // driven.shape[1], missed)
    return np.asarray(result)


# -- points of splines ---------------------------------------------------------------------------------


def spline_points(knots: Floats, control: Floats, at: Floats) -> Floats:
    """Points (S, n, 2) of a clamped cubic B-spline; row s of parameters `at` (S, n) lies in the s-th span between two different knots.

    C. de Boor, "On calculating with B-splines", J. Approx. Theory 6 (1972) 50.
    """
    span = np.flatnonzero(knots[1:] > knots[:-1])
    first = span - DEGREE
    place = [np.asarray(control)[first + k][:, None] for k in range(DEGREE + 1)]
    for r in range(1, DEGREE + 1):
        for k in range(DEGREE, r - 1, -1):
            low, high = knots[first + k][:, None], knots[span + 1 + k - r][:, None]
            share = ((at - low) / (high - low))[..., None]
            place[k] = (1.0 - share) * place[k - 1] + share * place[k]
    return np.asarray(place[DEGREE], np.float64)

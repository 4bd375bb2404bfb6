"""Distance of two sampled paths as shapes, whatever their parameters."""

from __future__ import annotations

import numpy as np

from ebamcheck.curves.nearest import boxed, nearest
from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Floats, Ints


@kernel
def _nearest_segments(places: Floats, polyline: Floats) -> tuple[Ints, Floats]:
    """Nearest segment (n,) of a polyline to each place, and its distance (n,)."""
    ring = boxed(polyline)
    segment = np.zeros(len(places), np.int64)
    away = np.empty(len(places))
    guess = 0
    for i in range(len(places)):
        found = nearest(ring, places[i, 0], places[i, 1], guess)
        guess = found.segment
        segment[i], away[i] = found.segment, found.distance
    return segment, away


def shape_distance(driven: Floats, wanted: Floats) -> Floats:
    """Largest distance between two paths, both ways, for each motion of the first.

    Parameters
    ----------
    driven
        (A, n, 2) samples of motions that follow one another, mm.
    wanted
        (E, m, 2) samples of spans that follow one another.

    Returns
    -------
    (A,) distance of the motion from the other path, and of what lies nearest to the motion there.
    """
    path, target = np.ascontiguousarray(driven).reshape(-1, 2), np.ascontiguousarray(wanted).reshape(-1, 2)
    _, away = _nearest_segments(path, target)
    result = away.reshape(len(driven), -1).max(axis=1)
    segment, missed = _nearest_segments(target, path)
    np.maximum.at(result, segment // driven.shape[1], missed)
    return np.asarray(result)

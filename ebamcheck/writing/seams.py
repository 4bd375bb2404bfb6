"""Where closed contours start: away from the seams of the layer below."""

from __future__ import annotations

import numpy as np

from ebamcheck.kernels import Bools, Floats, Ints

STEP_MM = 1.0  # Places along a contour at which it may start
# Places, each one shift further along, of which the first that lies apart is taken, or the farthest.
TRIES = 8
# Share of the shift by which a seam must miss every seam below: around a bend the way is longer than the distance.
APART = 0.5
NO_SEAMS: Floats = np.zeros((0, 2))  # Seams under the lowest layer of a part


def seam_shifts(
    layer_starts: Ints, track_starts: Ints, closed: Bools, points: Floats, lengths: Floats, shift_mm: float,
    below: Floats = NO_SEAMS,
) -> tuple[Floats, Floats]:  # fmt: skip
    """Lengths along tracks at which they are to start, (T,) mm: 0 for open ones, and where there is no seam below; and the uppermost seams, (n, 2).

    A contour that is `closed` (T,) starts a shift further along itself than its place next to the seam below; others keep their start.
    `points` (N, 4, 2) and `lengths` (N,) of segments are those of :mod:`ebamcheck.writing.cuts`, `below` (n, 2) the seams under the
    lowest layer.
    """
    shifts = np.zeros(closed.size)
    for k in range(layer_starts.size - 1):
        seams = []
        for t in range(int(layer_starts[k]), int(layer_starts[k + 1])):
            a, b = int(track_starts[t]), int(track_starts[t + 1])
            if closed[t] and b > a:
                along, places = _places(points[a:b], lengths[a:b])
                chosen = _chosen(along, places, float(lengths[a:b].sum()), below, shift_mm)
                shifts[t] = along[chosen]
                seams.append(places[chosen])
        below = np.array(seams) if seams else below
    return shifts, below


def _places(points: Floats, lengths: Floats) -> tuple[Floats, Floats]:
    """Places (n, 2) along a track, and their lengths (n,) along it; within a curve as if it were even."""
    count = np.maximum(np.ceil(lengths / STEP_MM).astype(np.int64), 1)
    segment = np.repeat(np.arange(lengths.size), count)
    t = (np.arange(segment.size) - np.repeat(np.cumsum(count) - count, count)) / count[segment]
    along = (np.cumsum(lengths) - lengths)[segment] + t * lengths[segment]
    p, u = points[segment], t[:, None]
    places = (
        (1 - u) ** 3 * p[:, 0]
        + 3 * (1 - u) ** 2 * u * p[:, 1]
        + 3 * (1 - u) * u**2 * p[:, 2]
        + u**3 * p[:, 3]
    )
    return along, places


def _chosen(along: Floats, places: Floats, whole_mm: float, below: Floats, shift_mm: float) -> int:
    """Index of the place at which a contour starts."""
    if not len(below):
        return 0
    away = np.hypot(places[:, :1] - below[:, 0], places[:, 1:] - below[:, 1])
    nearest = along[int(away.min(axis=1).argmin())]
    tried = (nearest + shift_mm * np.arange(1, TRIES + 1)) % whole_mm
    index = np.searchsorted(along, tried, side="right") - 1
    apart = away[index].min(axis=1)
    first = np.flatnonzero(apart >= APART * shift_mm)
    return int(index[first[0] if first.size else apart.argmax()])

"""Samples: places along contours at which distances are taken."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ebamcheck.numeric.kernels import kernel
from ebamcheck.numeric.rings import Floats, Ints

PIECES = 512
"""Least number of equal pieces into which a contour is divided; along each the distance is taken as
linear, which is a good approximation while the nearest segment stays the same."""


class Samples(NamedTuple):
    """Both ends of every segment, and places between on long segments, path after path.

    A closed ring ends where it starts, with a sample of its own.
    """

    places: Floats
    """(M, 2) mm."""
    lengths: Floats
    """(M,) length of the piece from each sample to the next, mm; -1 at the end of a path."""
    segments: Ints
    """(M,) segment on which that piece lies; at the end of a path, the last segment."""


@kernel
def samples_along(segments: Floats, paths: Ints) -> Samples:
    """Cut segments (S, 4), `paths` telling where those of each path start, into pieces."""
    extents = np.empty(len(segments))
    total = 0.0
    for s in range(len(segments)):
        ux, uy = segments[s, 2] - segments[s, 0], segments[s, 3] - segments[s, 1]
        extents[s] = math.sqrt(ux * ux + uy * uy)
        total += extents[s]
    step = total / PIECES
    count = paths.size - 1
    for s in range(len(segments)):
        count += _pieces(extents[s], step)
    places, lengths, owners = np.empty((count, 2)), np.empty(count), np.empty(count, np.int64)
    n = 0
    for p in range(paths.size - 1):
        for s in range(paths[p], paths[p + 1]):
            pieces = _pieces(extents[s], step)
            x0, y0, x1, y1 = segments[s, 0], segments[s, 1], segments[s, 2], segments[s, 3]
            for j in range(pieces):
                t = j / pieces
                places[n, 0], places[n, 1] = x0 + t * (x1 - x0), y0 + t * (y1 - y0)
                lengths[n], owners[n] = extents[s] / pieces, s
                n += 1
        s = paths[p + 1] - 1
        places[n, 0], places[n, 1] = segments[s, 2], segments[s, 3]
        lengths[n], owners[n] = -1.0, s
        n += 1
    return Samples(places, lengths, owners)


@kernel
def _pieces(length: float, step: float) -> int:
    """Pieces into which a segment is cut."""
    return max(1, math.ceil(length / step)) if step > 0.0 else 1

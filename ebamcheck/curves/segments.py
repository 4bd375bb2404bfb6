"""Segments: lines, cubics and arcs in a row, one for each segment of a contour at first, from which the pieces of curves are
made."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ebamcheck.columns_file import starts_of
from ebamcheck.curves.columns import Curves
from ebamcheck.curves.oriented_contours import OrientedContours
from ebamcheck.curves.splitting import ARC, LINE, SPLINE, around
from ebamcheck.geometry.raster import each_of
from ebamcheck.kernels import Bools, Floats, Ints
from ebamcheck.layers.stack import Layers

UNEVEN = 4.0  # Largest ratio of a knot interval to the length of its span, either way; beyond it a spline ends and the next begins


class Segments(NamedTuple):
    """Segments of rings, as columns."""

    points: Floats
    """(n, 4, 2) Bezier points of a cubic, mm. A line has its ends in the first and last place; an arc also its middle in the
    second."""
    kind: NDArray[np.uint8]  # (n,) LINE, SPLINE (a cubic) or ARC
    corner: Bools  # (n,) whether there is a corner before the segment
    ring_starts: Ints  # (R + 1,) first segment of each ring


def smooth_segments(contours: OrientedContours, closed: Bools) -> Segments:
    """One cubic or line for each segment of the contours.

    The inner legs of a cubic are as long as those of a circle's that turns as much (Stone, DeRose 1989).
    """
    ring, following, _ = around(contours.starts)
    at = np.arange(ring.size)
    i = np.flatnonzero((following > at) | (closed[ring] & (following != at)))
    j = following[i]
    p, q, start, end = contours.points[i], contours.points[j], contours.after[i], contours.before[j]
    x, y = (q - p).T
    half = 0.5 * (np.abs(start) + np.abs(end))
    leg = 2.0 / (3.0 * (1.0 + np.cos(np.minimum(half, 0.5 * np.pi))))
    B = np.stack([p, p, q, q], axis=1)
    curved = ~contours.straight[i]
    for k, angle, side in ((1, start, 1.0), (2, end, -1.0)):
        c, s = np.cos(angle) * leg, side * np.sin(angle) * leg
        B[curved, k] += side * np.column_stack([c * x + s * y, c * y - s * x])[curved]
    kind = np.where(curved, np.uint8(SPLINE), np.uint8(LINE))
    return Segments(B, kind, contours.corner[i], starts_of(np.bincount(ring[i], minlength=closed.size)))


def curves_of(segments: Segments, layers: Layers) -> Curves:
    """Join segments of layers into pieces: lines into polylines, cubics without a corner into splines, arcs each its own.

    A spline of cubics has double inner knots, whose intervals make it continuously differentiable.
    """
    B, kind = segments.points, segments.kind
    count = len(kind)
    begins = np.zeros(count + 1, np.bool_)
    begins[segments.ring_starts] = True
    begins = begins[:-1]
    curved = kind == SPLINE
    begins[1:] |= (kind[1:] != kind[:-1]) | (kind[1:] == ARC) | (curved[1:] & segments.corner[1:])
    legs = np.hypot(*np.moveaxis(B[:, [1, 3]] - B[:, [0, 2]], 2, 0))
    begins[1:] |= curved[1:] & ((legs[1:, 0] == 0.0) | (legs[:-1] == 0.0).any(axis=1))
    # Each knot interval is to that before as the legs that meet between them. So, over the length of a first leg, it grows by
    # the logarithms of first over last legs; where it has grown too uneven the next spline begins.
    growth = np.log(np.where(legs > 0.0, legs, 1.0)) @ np.array([1.0, -1.0]) * curved
    grown = np.cumsum(growth) - growth
    while True:
        start = np.maximum.accumulate(np.where(begins, np.arange(count), 0))
        uneven = np.flatnonzero(curved & (np.abs(grown - grown[start]) >= np.log(UNEVEN)))
        if not uneven.size:
            break
        begins[uneven[np.unique(start[uneven], return_index=True)[1]]] = True
    first = np.flatnonzero(begins)
    sizes = np.diff(first, append=count)
    last, of_piece = first + sizes - 1, kind[first]
    piece, place = each_of(sizes)
    splines = of_piece == SPLINE
    control_starts = starts_of(np.where(splines, 2 * sizes + 2, np.where(of_piece == ARC, 3, sizes + 1)))
    knot_starts = starts_of(np.where(splines, 2 * sizes + 6, 0))
    control, knots = np.empty((int(control_starts[-1]), 2)), np.empty(int(knot_starts[-1]))
    control[control_starts[:-1]], control[control_starts[1:] - 1] = B[first, 0], B[last, 3]
    at = control_starts[piece]
    inner, arcs = np.flatnonzero((kind == LINE) & (place < sizes[piece] - 1)), np.flatnonzero(kind == ARC)
    control[at[inner] + place[inner] + 1], control[at[arcs] + 1] = B[inner, 3], B[arcs, 1]
    k = np.flatnonzero(curved)
    for step in (1, 2):
        control[at[k] + 2 * place[k] + step] = B[k, step]
    own = np.where(begins | (legs[start, 0] == 0.0), 1.0, legs[start, 0])
    relative = np.where(begins, 1.0, legs[:, 0] / own * np.exp(grown - grown[start]))
    chord = np.hypot(*(B[:, 3] - B[:, 0]).T)
    total, wanted = (np.bincount(piece, column, minlength=first.size) for column in (relative, chord))
    interval = np.where(curved, relative * (wanted / np.where(total > 0.0, total, 1.0))[piece], 0.0)
    along = np.cumsum(interval)
    along -= (along - interval)[first][piece]
    at = knot_starts[piece]
    for step in (4, 5):
        knots[at[k] + 2 * place[k] + step] = along[k]
    head, tail = knot_starts[:-1][splines], knot_starts[1:][splines]
    for step in range(4):
        knots[head + step] = 0.0
    for step in (1, 2):
        knots[tail - step] = along[last[splines]]
    return Curves(
        heights=layers.heights,
        layer_starts=layers.layer_starts,
        ring_starts=np.searchsorted(first, segments.ring_starts).astype(np.int64),
        closed=layers.closed,
        kind=of_piece,
        control_starts=control_starts,
        control=control,
        knot_starts=knot_starts,
        knots=knots,
    )
